"""What is measured of one photo by itself: exposure, corners to match, and the energy of fine and coarse detail.

Everything is computed on blocks of pixels, so that a photo of a megapixel costs hundredths of a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.pictures.decoding import Grey

Floats = NDArray[np.float32]

BLOCK_PX: Final = 4
"""Gradients are summed over blocks of this size; corners are the centres of blocks."""
CELL_PX: Final = 24
"""At most one corner in each cell of this size."""
DETAIL_PX: Final = 16
"""Energies of detail are summed over cells of this size."""
MIN_CORNER: Final = 16.0
"""Least contrast (grey levels) across the weaker direction of a corner, within 12 pixels, that noise does not make."""
DISTINCT_CORNER: Final = 48.0
"""Contrast of a corner that another photo of the same place must show, too: not a wave, not a wisp of cloud."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """How a photo is exposed.

    Attributes:
        mean: grey level, 0 to 255.
        low, high: the grey levels of the first and the last hundredth of the pixels.
        black_frac, white_frac: shares of pixels at either end of the scale.
    """

    mean: float
    low: float
    high: float
    black_frac: float
    white_frac: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """What is measured of one photo.

    Attributes:
        grey: (h, w) luma at the scale of the examination.
        exposure: see `Exposure`.
        corners: (n, 2) x, y of the block centres, pixels; the best of each cell.
        strength: (n,) contrast of each corner, grey levels.
        fine: (rows, columns, 3) sums of the squared fine gradients over cells: xx, xy, yy.
        coarse: (rows, columns, 3) likewise of the gradients at a quarter of the scale.
        means: (rows, columns) mean grey level of each cell.
        texture: (rows, columns) whether a cell has a corner worth matching.
    """

    grey: Grey
    exposure: Exposure
    corners: FloatArray
    strength: Floats
    fine: Floats
    coarse: Floats
    means: Floats
    texture: NDArray[np.bool_]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height at the scale of the examination."""
        return self.grey.shape[1], self.grey.shape[0]


def exposure_of(grey: Grey) -> Exposure:
    """Exposure of a photo, from every third row and column."""
    counts = np.bincount(grey[::3, ::3].ravel(), minlength=256)
    share = np.cumsum(counts) / counts.sum()
    return Exposure(
        mean=float((counts * np.arange(256)).sum() / counts.sum()),
        low=float(np.searchsorted(share, 0.01)),
        high=float(np.searchsorted(share, 0.99)),
        black_frac=float(share[4]),
        white_frac=float(1 - share[250]),
    )


def features_of(grey: Grey) -> Features:
    """Measure a photo.

    Args:
        grey: (h, w) luma.
    """
    image = grey.astype(np.float32)
    right = image[:-1, 1:] - image[:-1, :-1]
    down = image[1:, :-1] - image[:-1, :-1]
    right, down = (np.pad(part, ((0, 1), (0, 1))) for part in (right, down))
    fine = np.stack([_sums(a * b, DETAIL_PX) for a, b in ((right, right), (right, down), (down, down))], axis=-1)
    fine = fine * np.float32(1 / DETAIL_PX**2)
    small = _means(image, 4)
    right, down = small[:-1, 1:] - small[:-1, :-1], small[1:, :-1] - small[:-1, :-1]
    # the last row and column of differences are missing: as many cells as the fine ones
    right, down = (np.pad(part, ((0, 1), (0, 1))) for part in (right, down))
    coarse = np.stack([_sums(a * b, DETAIL_PX // 4) for a, b in ((right, right), (right, down), (down, down))], axis=-1)
    coarse = coarse * np.float32(1 / (DETAIL_PX // 4) ** 2)
    means = _means(image, DETAIL_PX)
    corners, strength = _corners(image)
    columns, rows = image.shape[1] // DETAIL_PX, image.shape[0] // DETAIL_PX
    texture = np.zeros((rows + 1, columns + 1), dtype=bool)
    places = (corners // DETAIL_PX).astype(np.intp)
    texture[places[:, 1], places[:, 0]] = True
    return Features(
        grey=grey,
        exposure=exposure_of(grey),
        corners=corners,
        strength=strength,
        fine=fine,
        coarse=coarse,
        means=means,
        texture=texture,
    )


def _corners(image: Floats) -> tuple[FloatArray, Floats]:
    """Corners of an image at half its scale: less noise, a quarter of the time."""
    half = _means(image, 2)
    right = (half[1:-1, 2:] - half[1:-1, :-2]) * np.float32(0.5)
    down = (half[2:, 1:-1] - half[:-2, 1:-1]) * np.float32(0.5)
    size = BLOCK_PX // 2
    xx, xy, yy = (_box(_sums(a * b, size)) for a, b in ((right, right), (right, down), (down, down)))
    middle, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    weaker = np.sqrt(np.maximum(middle - spread, 0))
    cell = CELL_PX // BLOCK_PX
    rows, columns = weaker.shape[0] // cell, weaker.shape[1] // cell
    blocks = weaker[: rows * cell, : columns * cell].reshape(rows, cell, columns, cell).transpose(0, 2, 1, 3)
    cells = blocks.reshape(rows * columns, cell * cell)
    best = cells.argmax(axis=1)
    strength = cells[np.arange(len(cells)), best]
    number = np.arange(rows * columns)
    row, column = number // columns * cell + best // cell, number % columns * cell + best % cell
    # the border of one pixel that the central difference loses, and the centre of the block
    corners = np.stack([(column * size + 1 + size / 2) * 2, (row * size + 1 + size / 2) * 2], axis=-1) - 0.5
    good = strength >= MIN_CORNER
    return corners[good], strength[good]


def _means(image: Floats, size: int) -> Floats:
    return _sums(image, size) * np.float32(1 / size**2)


def _sums(image: Floats, size: int) -> Floats:
    """Sums over blocks of `size` x `size`; what remains at the right and at the bottom is left out."""
    rows, columns = image.shape[0] // size, image.shape[1] // size
    whole = image[: rows * size, : columns * size]
    across = whole.reshape(rows * size, columns, size).sum(axis=2)
    return np.asarray(across.reshape(rows, size, columns).sum(axis=1))


def _box(blocks: Floats) -> Floats:
    """Sums over 3 x 3 blocks; the border repeats."""
    wide = np.pad(blocks, 1, mode="edge")
    across = wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]
    return np.asarray(across[:-2] + across[1:-1] + across[2:])
