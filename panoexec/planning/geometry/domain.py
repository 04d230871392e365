"""The domain to cover: a band or sector of the sphere minus its masks, as cells of a grid in elevation and azimuth.

The limits of the band and of the masks cut the sphere into cells. Each cell is wholly inside or outside the domain, and
the domain is the union of the closed inside cells (so there is no slit between two masks that touch). Limits closer
to each other than 1e-9° count as equal.

An arc of an image border needs no cover where it runs outside the domain. The outside is described by the *maximal
boxes* of outside cells: every interior point of the outside is an interior point of one of them, because a small box
around the point can be grown until it is blocked on all sides. So the union of the open boxes is exactly the outside.
Each box is shrunk by 1e-12 rad against rounding, so the domain can only grow by that amount.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray, direction, elevation_azimuth
from panoexec.errors import PlanningError
from panoexec.planning.model import AngleBox, Band

_SAME_DEG = 1e-9
GROWTH_RAD = 1e-12
"""The domain is enlarged by this angle (rad) against rounding errors."""

_NOTHING = (2.0, -1.0)
"""An empty interval of [0, 1]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Border:
    """A segment of a domain's border.

    It is a parallel (`from_deg`, `to_deg` are azimuths, `at_deg` an elevation) or a meridian (elevations, an azimuth).
    `inner` is +1 where the domain lies above a parallel or clockwise of a meridian, and -1 on the other side.
    """

    is_parallel: bool
    at_deg: float
    from_deg: float
    to_deg: float
    inner: int

    def points(self, along_deg: ArrayLike) -> FloatArray:
        """Directions (..., 3) at azimuths along a parallel or elevations along a meridian."""
        return direction(self.at_deg, along_deg) if self.is_parallel else direction(along_deg, self.at_deg)


@dataclass(frozen=True, slots=True)
class Domain:
    """The set of directions to cover; see the module docstring.

    Attributes:
        elevations_deg: (a + 1,) limits of the cells from the nadir to the zenith.
        azimuths_deg: (b + 1,) limits of the cells, clockwise over one full turn.
        inside: (a, b) whether the cell between limits i and i + 1, j and j + 1 belongs to the domain.
    """

    elevations_deg: FloatArray
    azimuths_deg: FloatArray
    inside: NDArray[np.bool_]

    @staticmethod
    def of(band: Band, masks: tuple[AngleBox, ...] = ()) -> Domain:
        """The domain of a band minus masks.

        Raises:
            PlanningError: the band has no extent.
        """
        low, high = max(band.elevation_min_deg, -90.0), min(band.elevation_max_deg, 90.0)
        if not low < high:
            raise PlanningError(
                f"the band from elevation {band.elevation_min_deg:g} to {band.elevation_max_deg:g} has no height; "
                "the minimum must be below the maximum, within -90 to 90"
            )
        if not band.azimuth_span_deg > 0:
            raise PlanningError(
                f"the sector from azimuth {band.azimuth_min_deg:g} to {band.azimuth_max_deg:g} has no width; "
                "the maximum must be above the minimum (170 to 190 is a sector around the back)"
            )
        start = band.azimuth_min_deg
        span = band.azimuth_span_deg if band.azimuth_span_deg < 360.0 - _SAME_DEG else 360.0
        boxes = [(m.elevation_min_deg, m.elevation_max_deg, *_turned(m, start)) for m in masks]
        elevations = _limits([-90.0, low, high, 90.0], [e for box in boxes for e in box[:2]], 90.0)
        azimuths = _limits([0.0, span, 360.0], [a for box in boxes for a in (box[2], box[3], box[3] - 360)], 360.0)
        middle_e = (elevations[:-1] + elevations[1:])[:, None] / 2
        middle_a = (azimuths[:-1] + azimuths[1:])[None] / 2
        inside = (middle_e > low) & (middle_e < high) & (middle_a < span)
        for e_min, e_max, a_min, a_max in boxes:
            in_azimuth = ((middle_a > a_min) & (middle_a < a_max)) | (middle_a < a_max - 360)
            inside &= ~((middle_e > e_min) & (middle_e < e_max) & in_azimuth)
        return Domain(elevations, azimuths + start, inside)

    @property
    def solid_angle_sr(self) -> float:
        """Solid angle of all inside cells, steradians."""
        height = np.diff(np.sin(np.radians(self.elevations_deg)))
        width = np.radians(np.diff(self.azimuths_deg))
        return float(height @ self.inside @ width)

    def cell_centres(self) -> FloatArray:
        """A direction in each inside cell, (k, 3); so every connected component of the domain has at least one."""
        i, j = np.nonzero(self.inside)
        elevation = (self.elevations_deg[i] + self.elevations_deg[i + 1]) / 2
        return direction(elevation, (self.azimuths_deg[j] + self.azimuths_deg[j + 1]) / 2)

    def contains(self, directions: ArrayLike) -> NDArray[np.bool_]:
        """Mask (...) of the world directions (..., 3) in the domain; on a cell's border the result is arbitrary."""
        elevation, azimuth = elevation_azimuth(directions)
        i = np.searchsorted(self.elevations_deg, elevation, side="right") - 1
        j = np.searchsorted(self.azimuths_deg, self.azimuths_deg[0] + (azimuth - self.azimuths_deg[0]) % 360.0, "right")
        rows, columns = self.inside.shape
        return np.asarray(self.inside[np.clip(i, 0, rows - 1), np.clip(j - 1, 0, columns - 1)])

    def borders(self) -> Iterator[Border]:
        """The segments between an inside and an outside cell, and the poles that belong to the domain.

        A pole is a parallel of length 0: it closes the domain in elevation and azimuth coordinates.
        """
        columns = self.inside.shape[1]
        padded = np.pad(self.inside, ((1, 1), (0, 0)))
        above_less_below = padded[1:].astype(int) - padded[:-1].astype(int)
        for i, elevation in enumerate(self.elevations_deg):
            for first, last, side in _runs(above_less_below[i]):
                yield Border(
                    is_parallel=True,
                    at_deg=float(elevation),
                    from_deg=float(self.azimuths_deg[first]),
                    to_deg=float(self.azimuths_deg[last]),
                    inner=side,
                )
        for j in range(columns):
            step = self.inside[:, j].astype(int) - self.inside[:, j - 1].astype(int)
            for first, last, side in _runs(step):
                yield Border(
                    is_parallel=False,
                    at_deg=float(self.azimuths_deg[j]),
                    from_deg=float(self.elevations_deg[first]),
                    to_deg=float(self.elevations_deg[last]),
                    inner=side,
                )

    @property
    def outside_boxes(self) -> tuple[_Box, ...]:
        """The maximal boxes of outside cells, the larger ones as two each."""
        return _outside_boxes(
            self.elevations_deg.tobytes(), self.azimuths_deg.tobytes(), self.inside.tobytes(), self.inside.shape
        )

    def outside_intervals(self, starts: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where arcs of great circles run outside the domain.

        Args:
            starts: unit vectors (m, 3).
            ends: likewise, less than half a turn from their start.

        Returns:
            Lower and upper limits (m, k) of open intervals of the chord parameter s in [0, 1], where the arc's points
            are the directions of (1 - s)·start + s·end; an empty interval has its lower limit above its upper one.
        """
        lower, upper = [np.empty((len(starts), 0))], [np.empty((len(starts), 0))]
        for box in self.outside_boxes:
            low, high = _box_intervals(box, starts, ends)
            lower.append(low)
            upper.append(high)
        return np.concatenate(lower, axis=1), np.concatenate(upper, axis=1)


def _turned(mask: AngleBox, start_deg: float) -> tuple[float, float]:
    """A mask's azimuths relative to the sector's start: the first in [0, 360), the second up to one turn larger."""
    width = mask.azimuth_max_deg - mask.azimuth_min_deg
    width = width % 360.0 if width < 0 else min(width, 360.0)
    begin = (mask.azimuth_min_deg - start_deg) % 360.0
    return begin, begin + width


def _limits(fixed: list[float], others: list[float], extent: float) -> FloatArray:
    """Sorted limits within ±extent (or 0 to extent, depending on the first of `fixed`), without duplicates."""
    kept = sorted(set(fixed))
    for value in sorted(others):
        if kept[0] < value < extent and min(abs(value - k) for k in kept) > _SAME_DEG:
            kept.append(value)
    return np.array(sorted(kept))


def _runs(values: NDArray[np.int_]) -> list[tuple[int, int, int]]:
    """Runs (first, one past last, value) of equal nonzero values."""
    changes = [0, *(np.nonzero(np.diff(values))[0] + 1).tolist(), len(values)]
    return [(a, b, int(values[a])) for a, b in pairwise(changes) if values[a]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Box:
    """Limits in degrees; None where the box includes a pole or all azimuths."""

    low_deg: float | None
    high_deg: float | None
    azimuths_deg: tuple[float, float] | None


@lru_cache(maxsize=8)
def _outside_boxes(elevations: bytes, azimuths: bytes, inside: bytes, shape: tuple[int, ...]) -> tuple[_Box, ...]:
    """See `Domain.outside_boxes`; remembered, as a domain with many masks has thousands and is asked often."""
    chosen = ~np.frombuffer(inside, dtype=bool).reshape(shape)
    return tuple(_largest_boxes(np.frombuffer(elevations), np.frombuffer(azimuths), chosen))


def _largest_boxes(elevations: FloatArray, azimuths: FloatArray, chosen: NDArray[np.bool_]) -> Iterator[_Box]:
    """All maximal boxes of chosen cells; a box wider than half a turn is given as two overlapping boxes."""
    rows, columns = chosen.shape
    for first in range(rows):
        free: NDArray[np.bool_] = np.ones(columns, dtype=bool)
        for last in range(first, rows):
            free = free & chosen[last]
            if not free.any():
                break
            for start, length in _cyclic_runs(free):
                span = (start + np.arange(length)) % columns
                below = first > 0 and bool(chosen[first - 1, span].all())
                above = last + 1 < rows and bool(chosen[last + 1, span].all())
                if below or above:
                    continue
                low = None if first == 0 else float(elevations[first])
                high = None if last + 1 == rows else float(elevations[last + 1])
                if length == columns:
                    yield _Box(low_deg=low, high_deg=high, azimuths_deg=None)
                    continue
                begin = float(azimuths[start])
                width = float(azimuths[(start + length) % columns] - begin) % 360.0
                yield _Box(low_deg=low, high_deg=high, azimuths_deg=(begin, begin + min(width, 180.0)))
                if width > 180.0:
                    yield _Box(low_deg=low, high_deg=high, azimuths_deg=(begin + width - 180.0, begin + width))


def _cyclic_runs(values: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Runs (start, length) of True in a cyclic array."""
    n = len(values)
    if values.all():
        return [(0, n)]
    starts = np.nonzero(values & ~np.roll(values, 1))[0]
    ends = np.nonzero(values & ~np.roll(values, -1))[0]
    if len(starts) and ends[0] < starts[0]:  # the last run goes on at the beginning
        ends = np.roll(ends, -1)
    return list(zip(starts.tolist(), ((ends - starts) % n + 1).tolist(), strict=True))


def _box_intervals(box: _Box, starts: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The intervals (m, ≤ 3) of arcs inside an open, slightly shrunk box; see `Domain.outside_intervals`."""
    low, high = np.zeros(len(starts)), np.ones(len(starts))
    if box.azimuths_deg is not None:
        begin, end = (math.radians(a) for a in box.azimuths_deg)
        for normal in ((-math.sin(begin), math.cos(begin), 0.0), (math.sin(end), -math.cos(end), 0.0)):
            a, b = (points @ np.array(normal) - GROWTH_RAD for points in (starts, ends))
            below, above = _positive(a, b)
            low, high = np.maximum(low, below), np.minimum(high, above)
    holes = []
    for limit, sign in ((box.low_deg, 1.0), (box.high_deg, -1.0)):
        if limit is None:
            continue
        # above `limit` means inside a cap about the zenith or, below the horizon, outside a cap about the nadir
        inward = sign * math.radians(limit) + GROWTH_RAD
        below, above = _cap(starts, ends, -sign * math.copysign(1.0, inward), abs(inward))
        if inward >= 0:
            low, high = np.maximum(low, below), np.minimum(high, above)
        else:
            holes.append((below, above))
    return _without(low, high, holes)


def _without(
    low: FloatArray, high: FloatArray, holes: list[tuple[FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Intervals [low, high] minus up to two closed intervals each: (m, 1 + number of holes)."""
    pieces = [(low, high)]
    for hole_low, hole_high in holes:
        gone = hole_low > hole_high
        cut_low, cut_high = np.where(gone, 2.0, hole_low), np.where(gone, 2.0, hole_high)
        pieces = [
            part
            for a, b in pieces
            for part in ((a, np.minimum(b, cut_low)), (np.where(gone, 2.0, np.maximum(a, cut_high)), b))
        ]
    return np.stack([a for a, _ in pieces], axis=1), np.stack([b for _, b in pieces], axis=1)


def _positive(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The interval of s in [0, 1] where (1 - s)·a + s·b ≥ 0."""
    span = np.where(a == b, 1.0, a - b)
    zero = a / span
    low = np.where(a >= 0, 0.0, np.where(b >= 0, zero, _NOTHING[0]))
    high = np.where(b >= 0, 1.0, np.where(a >= 0, zero, _NOTHING[1]))
    return low, high


def _cap(starts: FloatArray, ends: FloatArray, axis_down: float, elevation_rad: float) -> tuple[FloatArray, FloatArray]:
    """The interval of each arc's parameter inside a cap of at most a hemisphere about a pole.

    Args:
        starts: (m, 3).
        ends: (m, 3).
        axis_down: +1 for a cap about the nadir, -1 about the zenith.
        elevation_rad: [0, π/2], the cap's border above the horizon as seen from its pole.
    """
    cos_length = np.sum(starts * ends, axis=1)
    sideways = ends - cos_length[:, None] * starts
    sin_length = np.linalg.norm(sideways, axis=1)
    length = np.arctan2(sin_length, cos_length)
    height_0 = axis_down * starts[:, 2]
    height_1 = axis_down * sideways[:, 2] / np.maximum(sin_length, 1e-300)
    top = np.hypot(height_0, height_1)
    sine = math.sin(min(elevation_rad, math.pi / 2))
    half = np.arccos(np.clip(sine / np.maximum(top, 1e-300), -1.0, 1.0))
    # take the highest point of the great circle in the turn nearest to the arc's middle: the cap is convex and the arc
    # shorter than half a turn, so in no other turn can the two meet
    peak = np.arctan2(height_1, height_0)
    peak = length / 2 + (peak - length / 2 + math.pi) % (2 * math.pi) - math.pi
    missed = (top < sine) | (elevation_rad > math.pi / 2)
    low, high = np.clip(peak - half, 0.0, length), np.clip(peak + half, 0.0, length)
    missed |= (peak - half > length) | (peak + half < 0)
    return np.where(missed, _NOTHING[0], _chord(low, length)), np.where(missed, _NOTHING[1], _chord(high, length))


def _chord(along: FloatArray, length: FloatArray) -> FloatArray:
    """The chord parameter of the point at an angle along an arc of an angular length, both radians."""
    total = np.sin(along) + np.sin(length - along)
    return np.where(total > 0, np.sin(along) / np.where(total > 0, total, 1.0), 0.5)
