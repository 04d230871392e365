"""Yaws of the images of one row: over the full circle, around yaws that the gimbal cannot reach, or over a sector."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, wrap_180
from panoexec.planning.model import Constraints, GimbalLimits

IntArray = NDArray[np.intp]

Widest = Callable[[FloatArray], FloatArray]
"""The widest permitted spacing of neighbours at pitches (k,), degrees."""

_HAIR_DEG = 1e-9
_NO_REACH_DEG = 181.0


class RowLayout:
    """Number, spacing and yaws of the images of a row.

    The gimbal's pan range leaves a *blind* arc of yaws, in which no image may be. If it is inside the band's azimuths,
    two neighbours are at its ends, or further apart, and must overlap across it; if it cuts off an end of a sector, the
    outer image is at its edge; if it hides a whole sector, the images are at the end of the pan range that is nearer to
    the sector and beside it.

    Attributes:
        closed: whether rows are closed (the band is a full circle).
        span_deg: azimuth span of the band.
        blind_deg: width of the blind arc inside the band's azimuths; 0 for none.
    """

    def __init__(self, constraints: Constraints, widest: Widest) -> None:
        band = constraints.band
        self._widest = widest
        self._start_deg = band.azimuth_min_deg
        self.closed = band.is_full_circle
        self.span_deg = min(band.azimuth_span_deg, 360.0)
        self._blind_from_deg, self.blind_deg = _blind_arc(constraints.gimbal)
        # first and last yaw that images may have, from the sector's start
        self._first_deg, self._last_deg = 0.0, self.span_deg
        # widths of the parts of the sector before and after a blind arc inside it
        self._first_part_deg = self._last_part_deg = 0.0
        if not self.closed and self.blind_deg > 0:
            self._meet_sector()
        self._around_blind = lru_cache(maxsize=None)(self._sector_around_blind)

    @property
    def is_even(self) -> bool:
        """Whether rows are evenly spaced and may have any phase."""
        return self.closed and self.blind_deg == 0

    @property
    def reachable(self) -> bool:
        """Whether the gimbal reaches any yaw of the band's azimuths."""
        return self._first_deg <= self.span_deg and self._last_deg >= 0.0

    @property
    def usable_deg(self) -> float:
        """Width of the yaws that the images of a row share out, degrees."""
        return self._last_deg - self._first_deg

    def closing_spacing_deg(self, count: IntArray) -> FloatArray:
        """Spacing (k,) of neighbours in closed rows of (k,) images, not counting the pair across the blind arc."""
        even = 360.0 / count
        return np.where(even >= self.blind_deg, even, (360.0 - self.blind_deg) / np.maximum(count - 1, 1))

    def spacing_and_reach(self, pitch_deg: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
        """Widest spacing of neighbours, and largest azimuth between a covered direction and its nearest image: (k,)."""
        if self.closed:
            spacing = np.maximum(360.0 / count, np.where(count > 1, self.blind_deg, 0.0))
            return spacing, np.where((count == 1) | (self.blind_deg == 0), 180.0 / count, spacing / 2)
        if self.blind_deg > 0:
            places = [self._around_blind(c) for c in count.tolist()]
            spacing = np.array(
                [
                    max(step, self.blind_deg) if c > 1 else 0.0
                    for (step, _), c in zip(places, count.tolist(), strict=True)
                ]
            )
            reach = np.array([r for _, r in places])
            allowed = self._widest(pitch_deg)
            return spacing, np.where((spacing <= allowed) | (count == 1), reach, _NO_REACH_DEG)
        spacing, left, right = self._sector(pitch_deg, count)
        return spacing, np.maximum(np.maximum(left, right), spacing / 2)

    def yaws_deg(self, pitch_deg: float, count: int, phase_deg: float) -> FloatArray:
        """The yaws (count,) of a row, clockwise, in [-180, 180); the phase rotates rows that may have any phase."""
        steps = np.arange(count)
        if self.closed:
            return wrap_180(self._closed_yaws(count, phase_deg))
        if self.blind_deg > 0:
            return wrap_180(self._yaws_around_blind(count))
        spacing, left, _ = (float(v[0]) for v in self._sector(np.array([pitch_deg]), np.array([count])))
        return wrap_180(self._start_deg + left + steps * spacing)

    def _closed_yaws(self, count: int, phase_deg: float) -> FloatArray:
        steps = np.arange(count)
        if self.blind_deg == 0:
            return np.asarray(phase_deg + steps * 360.0 / count)
        start, seen = self._blind_from_deg + self.blind_deg, 360.0 - self.blind_deg
        if count == 1:
            return np.array([start + seen / 2])
        gap = max(360.0 / count, self.blind_deg)
        return np.asarray(start + (gap - self.blind_deg) / 2 + steps * (360.0 - gap) / (count - 1))

    def _sector(self, pitch_deg: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Spacing, and distances of the outer images from the sector's two ends, each (k,).

        A distance is negative where the image is outside the sector, because the gimbal reaches no yaw inside.
        """
        low, high = self._first_deg, self._last_deg
        spacing = np.where(count > 1, np.minimum(self._widest(pitch_deg), self.span_deg / count), 0.0)
        between = (count - 1) * spacing
        margin = (self.span_deg - between) / 2
        first, last = np.clip(margin, low, high), np.clip(self.span_deg - margin, low, high)
        # all at one end of the pan range: beside it there may be room
        first = np.where((last - first < _HAIR_DEG) & (first == high), np.maximum(high - between, low), first)
        last = np.where((last - first < _HAIR_DEG) & (last == low), np.minimum(low + between, high), last)
        return (last - first) / np.maximum(count - 1, 1), first, self.span_deg - last

    def _meet_sector(self) -> None:
        """What the blind arc leaves of the sector: one part, two with the arc between them, or nothing."""
        width = 360.0 - self.blind_deg
        start = (self._blind_from_deg + self.blind_deg - self._start_deg) % 360.0
        turns = [start - 360.0, start]
        self.blind_deg = 0.0
        parts = [(max(low, 0.0), min(low + width, self.span_deg)) for low in turns]
        parts = [(low, max(low, high)) for low, high in parts if low <= high + _HAIR_DEG]
        if len(parts) == 2 and min(high - low for low, high in parts) < _HAIR_DEG:
            # the pan range touches one end of the sector: an image there would have to overlap across the arc
            parts = [max(parts, key=lambda part: part[1] - part[0])]
        if len(parts) == 2:
            self._first_part_deg, self._last_part_deg = parts[0][1], self.span_deg - parts[1][0]
            self.blind_deg = max(parts[1][0] - parts[0][1], 0.0)
        elif parts:
            self._first_deg, self._last_deg = parts[0]
        else:
            # the pan range beside the sector whose nearer end is the least far from the sector's farther end
            ranges = [(low, low + width) for low in turns]
            self._first_deg, self._last_deg = min(ranges, key=lambda ends: max(ends[0], self.span_deg - ends[1]))

    def _sector_around_blind(self, count: int) -> tuple[float, float]:
        """Spacing and reach of a sector's row with images at both ends of the blind arc."""
        if count == 1:
            return 0.0, max(self._first_part_deg, self.span_deg - self._first_part_deg)
        low, high = 0.0, self.span_deg
        for _ in range(50):
            middle = (low + high) / 2
            low, high = (low, middle) if sum(self._counts_beside(middle)) <= count else (middle, high)
        return high, max(high, self.blind_deg) / 2

    def _yaws_around_blind(self, count: int) -> FloatArray:
        left = self._first_part_deg
        if count == 1:
            return np.array([self._start_deg + left])
        spacing, _ = self._around_blind(count)
        before, after = self._counts_beside(spacing)
        right = left + self.blind_deg
        # an outer image may stand beyond the sector's end, but not beyond the other side of the blind arc
        first = np.maximum(left - np.arange(before)[::-1] * spacing, right - 360.0)
        last = np.minimum(right + np.arange(after) * spacing, left + 360.0)
        return np.asarray(self._start_deg + np.concatenate([first, last]))

    def _counts_beside(self, spacing_deg: float) -> tuple[int, int]:
        """Numbers of images before and after the blind arc at a spacing, with one image at each of its ends."""
        parts = self._first_part_deg, self._last_part_deg
        before, after = (1 + int(np.ceil(max(part / spacing_deg - 0.5, 0.0) - 1e-9)) for part in parts)
        return before, after


def _blind_arc(gimbal: GimbalLimits | None) -> tuple[float, float]:
    """Start and width of the yaws that the gimbal cannot reach, degrees; width 0 if it reaches all."""
    if gimbal is None or gimbal.turning is not None:
        return 0.0, 0.0
    reach = gimbal.yaw_max_deg - gimbal.yaw_min_deg
    if reach >= 360.0 - _HAIR_DEG:
        return 0.0, 0.0
    return gimbal.yaw_max_deg, 360.0 - reach


def reachable_pitch(gimbal: GimbalLimits | None) -> tuple[float, float]:
    """Lowest and highest pitch a plan may use."""
    if gimbal is None:
        return -90.0, 90.0
    return max(-90.0, gimbal.pitch_min_deg), min(90.0, gimbal.pitch_max_deg)
