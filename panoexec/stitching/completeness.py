"""Completeness of a panorama: the paper's equation (8), C = (ground - holes) / ground, and its holes.

The ground is the part of the band below the horizon, without masks. The paper counts pixels of the equirectangular
panorama, which overweights the nadir; the fraction by solid angle is computed as well.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, wrap_180
from panoexec.planning.model import AngleBox, Band


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """What must be covered.

    Attributes:
        band: the requested band.
        horizon_deg: elevation up to which the ground reaches.
        masks: boxes that need no coverage.
    """

    band: Band
    horizon_deg: float = 0.0
    masks: tuple[AngleBox, ...] = ()

    def mask(self, elevation_deg: FloatArray, azimuth_deg: FloatArray) -> NDArray[np.bool_]:
        """Mask of the directions that belong to it, (elevations, azimuths)."""
        top = min(self.band.elevation_max_deg, self.horizon_deg)
        rows = (elevation_deg >= self.band.elevation_min_deg) & (elevation_deg <= top)
        columns = _within(azimuth_deg, self.band.azimuth_min_deg, self.band.azimuth_max_deg)
        out = rows[:, None] & columns[None, :]
        for box in self.masks:
            rows = (elevation_deg >= box.elevation_min_deg) & (elevation_deg <= box.elevation_max_deg)
            out &= ~(rows[:, None] & _within(azimuth_deg, box.azimuth_min_deg, box.azimuth_max_deg)[None, :])
        return np.asarray(out)


def _within(azimuth_deg: FloatArray, low: float, high: float) -> NDArray[np.bool_]:
    return np.asarray((azimuth_deg - low) % 360 <= high - low)


@dataclass(frozen=True, slots=True, kw_only=True)
class PanoramaHole:
    """A connected part of the ground that no photo covers.

    Attributes:
        elevation_deg: of its middle.
        azimuth_deg: of its middle.
        size_deg: across, corner to corner of its bounding box.
        pixels: of the panorama.
    """

    elevation_deg: float
    azimuth_deg: float
    size_deg: float
    pixels: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Completeness:
    """The result.

    Attributes:
        fraction: equation (8), by pixels; 1.0 exactly if there is no hole, and without any ground.
        solid_angle_fraction: likewise by solid angle.
        ground_px: pixels of the ground.
        hole_px: those of them that are not covered.
        holes: largest first.
    """

    fraction: float
    solid_angle_fraction: float
    ground_px: int
    hole_px: int
    holes: tuple[PanoramaHole, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockCount:
    """The counts of one block.

    Attributes:
        ground_px: pixels of the ground.
        ground_weight: sum of the cosines of their elevations.
        hole_weight: likewise of those not covered.
        cells: (k, 3) row and column of the coarse map, and pixels not covered in it.
    """

    ground_px: int
    ground_weight: float
    hole_weight: float
    cells: NDArray[np.int64]


class CompletenessCounter:
    """Adds up the blocks of a panorama.

    Args:
        canvas: (width, height) of the panorama.
        ground: what must be covered.
        map_width: width in cells of the coarse map on which holes are separated.
    """

    def __init__(self, canvas: tuple[int, int], ground: Ground, map_width: int = 1440) -> None:
        self._canvas = canvas
        self._ground = ground
        self.factor = max(1, -(-canvas[0] // map_width))
        self.map = np.zeros((-(-canvas[1] // self.factor), -(-canvas[0] // self.factor)), dtype=np.int64)
        self._ground_px = 0
        self._weight = 0.0
        self._hole_weight = 0.0

    def count(self, left: int, top: int, covered: NDArray[np.bool_]) -> BlockCount:
        """Count a block, without adding it.

        Args:
            left: its first column on the canvas.
            top: its first row.
            covered: (height, width).
        """
        width, height = self._canvas
        h, w = covered.shape
        elevation = 90 - (top + np.arange(h) + 0.5) / height * 180
        azimuth = (left + np.arange(w) + 0.5) / width * 360 - 180
        required = self._ground.mask(elevation, azimuth)
        holes = required & ~covered
        area = np.cos(np.radians(elevation))
        rows, columns = np.nonzero(holes)
        places = (rows + top) // self.factor * self.map.shape[1] + (columns + left) // self.factor
        cells, counts = np.unique(places, return_counts=True)
        return BlockCount(
            ground_px=int(required.sum()),
            ground_weight=float((area * required.sum(axis=1)).sum()),
            hole_weight=float((area * holes.sum(axis=1)).sum()),
            cells=np.stack([cells // self.map.shape[1], cells % self.map.shape[1], counts], axis=1).astype(np.int64),
        )

    def add(self, block: BlockCount) -> None:
        """Add a block's count."""
        self._ground_px += block.ground_px
        self._weight += block.ground_weight
        self._hole_weight += block.hole_weight
        np.add.at(self.map, (block.cells[:, 0], block.cells[:, 1]), block.cells[:, 2])

    def result(self) -> Completeness:
        """The result over all blocks."""
        hole_px = int(self.map.sum(dtype=np.int64))
        ground = self._ground_px
        return Completeness(
            fraction=(ground - hole_px) / ground if ground else 1.0,
            solid_angle_fraction=1 - self._hole_weight / self._weight if ground else 1.0,
            ground_px=ground,
            hole_px=hole_px,
            holes=tuple(sorted(self._holes(), key=lambda hole: -hole.pixels)),
        )

    def _holes(self) -> list[PanoramaHole]:
        """Connected cells (eight neighbours, wrapping around in azimuth) of the map."""
        left = {(int(r), int(c)) for r, c in zip(*np.nonzero(self.map), strict=True)}
        columns = self.map.shape[1]
        found = []
        while left:
            start = left.pop()
            # column numbers continue beyond the border, so that a hole across ±180° has one centre
            cells, queue = [start], deque([start])
            while queue:
                row, column = queue.popleft()
                for dr in (-1, 0, 1):
                    for dc in (-1, 0, 1):
                        cell = (row + dr, (column + dc) % columns)
                        if cell in left:
                            left.discard(cell)
                            cells.append((row + dr, column + dc))
                            queue.append((row + dr, column + dc))
            found.append(self._describe(np.array(cells)))
        return found

    def _describe(self, cells: NDArray[np.int64]) -> PanoramaHole:
        counts = self.map[cells[:, 0], cells[:, 1] % self.map.shape[1]].astype(np.float64)
        degrees = 360.0 * self.factor / self._canvas[0]
        middle = ((cells + 0.5) * counts[:, None]).sum(axis=0) / counts.sum()
        elevation = 90 - middle[0] * degrees
        span = (np.ptp(cells, axis=0) + 1) * degrees
        across = min(span[1], 360.0) * math.cos(math.radians(elevation))
        return PanoramaHole(
            elevation_deg=round(float(elevation), 3),
            azimuth_deg=round(float(wrap_180(middle[1] * degrees - 180)), 3),
            size_deg=round(float(np.hypot(span[0], across)), 3),
            pixels=int(counts.sum()),
        )
