"""Spoils simulated photos as faults do: pictures black, dark, smeared or out of focus, files truncated or damaged."""

from __future__ import annotations

import math
import random
from typing import Final

import numpy as np
from numpy.typing import NDArray

from panoexec.sim.photos.landscape import Image

IMAGE_FAULTS: Final = ("photo-black", "photo-dark", "photo-blur", "photo-defocus")
FILE_FAULTS: Final = ("photo-truncated", "photo-damaged")
OTHER_FILE_FAULTS: Final = ("photo-swapped", "photo-stale")
"""Faults that put another picture under the photo's name."""
_SIZES: Final = {"photo-dark": 4.0, "photo-blur": 6.0, "photo-defocus": 6.0}
_SECTOR: Final = 512


def spoiled_image(image: Image, fault: str, size: float | None, *, seed: int) -> Image:
    """The picture as the fault leaves it; unchanged for any other fault.

    Args:
        image: (h, w, 3) RGB.
        fault: its name.
        size: of the fault, in its unit; None: the default.
        seed: of what is random.
    """
    if fault not in IMAGE_FAULTS:
        return image
    rng = random.Random(seed)
    value = _SIZES.get(fault, 0.0) if size is None else size
    if fault == "photo-black":
        noise = np.random.default_rng(seed).integers(0, 3, image.shape, dtype=np.uint8)
        return np.asarray(noise)
    if fault == "photo-dark":
        # stops of exposure act on light, which the stored values are a power of
        light = (image.astype(np.float32) / 255) ** 2.2 * 2.0**-value
        return np.asarray(255 * light ** (1 / 2.2) + 0.5, dtype=np.uint8)
    if fault == "photo-blur":
        return _averaged(image, _line(value, rng.uniform(0, math.pi)))
    return _averaged(image, _disc(value))


def spoiled_file(content: bytes, fault: str, *, seed: int) -> bytes:
    """The file as the fault leaves it; unchanged for any other fault.

    Args:
        content: a JPEG.
        fault: its name.
        seed: of what is random.
    """
    if fault not in FILE_FAULTS:
        return content
    rng = random.Random(seed)
    start = _picture_data(content)
    if fault == "photo-truncated":
        return content[: rng.randrange(start, len(content) - 2)]
    sectors = rng.choice((1, 2, 8, 64))
    length = min(sectors * _SECTOR, (len(content) - start) // 2)
    place = rng.randrange(start, len(content) - 2 - length)
    damaged = bytearray(content)
    if rng.random() < 0.5:
        damaged[place : place + length] = bytes(length)
    else:
        damaged[place : place + length] = rng.randbytes(length)
    return bytes(damaged)


def _picture_data(content: bytes) -> int:
    """Where a JPEG's picture data begin: behind the header of its only scan."""
    place = 2
    while True:
        marker, length = content[place + 1], int.from_bytes(content[place + 2 : place + 4], "big")
        place += 2 + length
        if marker == 0xDA:
            return place


def _line(length_px: float, angle: float) -> list[tuple[float, float, float]]:
    """Samples (x, y, weight) along a line."""
    count = max(2, math.ceil(length_px * 2))
    return [
        (length_px * t * math.cos(angle), length_px * t * math.sin(angle), 1 / count)
        for t in ((k + 0.5) / count - 0.5 for k in range(count))
    ]


def _disc(diameter_px: float) -> list[tuple[float, float, float]]:
    """Samples over a disc."""
    radius = diameter_px / 2
    steps = range(-math.ceil(radius), math.ceil(radius) + 1)
    inside = [(float(x), float(y)) for x in steps for y in steps if math.hypot(x, y) <= radius]
    return [(x, y, 1 / len(inside)) for x, y in inside]


def _averaged(image: Image, samples: list[tuple[float, float, float]]) -> Image:
    """The weighted mean of displaced copies, between pixels bilinear; the border repeats."""
    reach = math.ceil(max(max(abs(x), abs(y)) for x, y, _ in samples)) + 1
    kernel: NDArray[np.float64] = np.zeros((2 * reach + 1, 2 * reach + 1))
    for x, y, weight in samples:
        left, top = math.floor(x), math.floor(y)
        for row, share_y in ((top, 1 - (y - top)), (top + 1, y - top)):
            for column, share_x in ((left, 1 - (x - left)), (left + 1, x - left)):
                kernel[row + reach, column + reach] += weight * share_x * share_y
    wide = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="edge").astype(np.float32)
    total = np.zeros(image.shape, dtype=np.float32)
    height, width = image.shape[:2]
    for row, column in np.argwhere(kernel > 1e-9):
        total += np.float32(kernel[row, column]) * wide[row : row + height, column : column + width]
    return np.asarray(np.clip(total + 0.5, 0, 255), dtype=np.uint8)
