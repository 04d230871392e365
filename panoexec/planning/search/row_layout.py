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

    The gimbal's pan range leaves a *blind* arc of yaws. If it is inside the band's azimuths, two neighbours are at its
    ends, or further apart, and must overlap across it; if it cuts off an end of a sector, the outer image is at its
    edge.

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
        self._left_deg = self._right_deg = 0.0
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
        return self._left_deg < self.span_deg

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
        spacing, left, right = (float(v[0]) for v in self._sector(np.array([pitch_deg]), np.array([count])))
        if count == 1:
            return wrap_180(np.array([self._start_deg + (self.span_deg + left - right) / 2]))
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
        """Spacing, and distances of the outer images from the sector's two ends, each (k,)."""
        spacing = np.where(count > 1, np.minimum(self._widest(pitch_deg), self.span_deg / count), 0.0)
        margin = (self.span_deg - (count - 1) * spacing) / 2
        left, right = np.maximum(margin, self._left_deg), np.maximum(margin, self._right_deg)
        between = np.maximum(self.span_deg - left - right, 0.0)
        alone = count == 1
        left, right = np.where(alone, self._alone(-1), left), np.where(alone, self._alone(1), right)
        return np.where(alone, 0.0, between / np.maximum(count - 1, 1)), left, right

    def _alone(self, side: int) -> float:
        """Distance of a single image from an end of the sector: in the middle, or as near to it as possible."""
        yaw = min(max(self.span_deg / 2, self._left_deg), max(self.span_deg - self._right_deg, self._left_deg))
        return yaw if side < 0 else self.span_deg - yaw

    def _meet_sector(self) -> None:
        """Split the blind arc into the parts that cut off the sector's ends and the part inside it."""
        start = (self._blind_from_deg - self._start_deg) % 360.0
        stop = start + self.blind_deg
        inside = 0.0
        if stop > 360.0 - _HAIR_DEG or start < _HAIR_DEG:
            self._left_deg = min(stop - 360.0 if stop > 360.0 - _HAIR_DEG else stop, self.span_deg)
        if _HAIR_DEG <= start < self.span_deg:
            if stop >= self.span_deg:
                self._right_deg = self.span_deg - start
            else:
                inside = self.blind_deg
        self.blind_deg = inside

    def _sector_around_blind(self, count: int) -> tuple[float, float]:
        """Spacing and reach of a sector's row with images at both ends of the blind arc."""
        if count == 1:
            left, right = self._parts_deg()
            return 0.0, max(left, self.span_deg - left, right)
        low, high = 0.0, self.span_deg
        for _ in range(50):
            middle = (low + high) / 2
            low, high = (low, middle) if sum(self._counts_beside(middle)) <= count else (middle, high)
        return high, max(high, self.blind_deg) / 2

    def _yaws_around_blind(self, count: int) -> FloatArray:
        left, _ = self._parts_deg()
        if count == 1:
            return np.array([self._start_deg + left])
        spacing, _ = self._around_blind(count)
        before, after = self._counts_beside(spacing)
        from_left = self._start_deg + left - np.arange(before)[::-1] * spacing
        from_right = self._start_deg + left + self.blind_deg + np.arange(after) * spacing
        return np.concatenate([from_left, from_right])

    def _parts_deg(self) -> tuple[float, float]:
        """Widths of the sector before and after the blind arc, degrees."""
        left = (self._blind_from_deg - self._start_deg) % 360.0
        return left, self.span_deg - left - self.blind_deg

    def _counts_beside(self, spacing_deg: float) -> tuple[int, int]:
        """Numbers of images before and after the blind arc at a spacing, with one image at each of its ends."""
        before, after = (1 + int(np.ceil(max(part / spacing_deg - 0.5, 0.0) - 1e-9)) for part in self._parts_deg())
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
