"""Where the images of one row stand: all round, around a part that the gimbal cannot pan to, or over a sector."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, wrap_180
from panoexec.planning.model import Constraints, GimbalLimits

IntArray = NDArray[np.intp]

Widest = Callable[[FloatArray], FloatArray]
"""The widest spacing of neighbours allowed at pitches (k,), degrees."""

_HAIR_DEG = 1e-9


class RowLayout:
    """How many images of a row stand how far apart, and where.

    Attributes:
        closed: whether rows close on themselves (the band is a full circle).
        span_deg: of the band in azimuth.
        blind_deg: the largest part of the band's azimuths within it that no image's yaw can have.
    """

    def __init__(self, constraints: Constraints, widest: Widest) -> None:
        band = constraints.band
        self._widest = widest
        self._middle_deg = (band.azimuth_min_deg + band.azimuth_max_deg) / 2
        self.closed = band.is_full_circle
        self.span_deg = min(band.azimuth_span_deg, 360.0)
        self._blind_from, self.blind_deg = _blind_arc(constraints.gimbal)
        self._left, self._right = 0.0, 0.0
        if not self.closed and self.blind_deg > 0:
            self._place_sector()

    @property
    def is_even(self) -> bool:
        """Whether rows are evenly spaced and free to turn."""
        return self.closed and self.blind_deg == 0

    def spacing_and_reach(self, pitch_deg: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
        """Widest yaw between neighbours and largest azimuth to be covered from the nearest image's own, each (k,)."""
        if self.closed:
            even = 360.0 / count
            spacing = np.maximum(even, np.where(count > 1, self.blind_deg, 0.0)) if self.blind_deg else even
            return spacing, spacing / 2
        spacing, left, right = self._sector(pitch_deg, count)
        return spacing, np.maximum(np.maximum(left, right), spacing / 2)

    def _sector(self, pitch_deg: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Spacing and the distances of the outer images from the sector's ends, each (k,)."""
        gaps = np.maximum(count - 1, 1)
        spacing = np.where(count > 1, np.minimum(self._widest(pitch_deg), self.span_deg / count), 0.0)
        margin = (self.span_deg - (count - 1) * spacing) / 2
        left, right = np.maximum(margin, self._left), np.maximum(margin, self._right)
        spacing = np.where(count > 1, np.maximum(self.span_deg - left - right, 0.0) / gaps, 0.0)
        return spacing, left, right

    def yaws_deg(self, pitch_deg: float, count: int, phase_deg: float) -> FloatArray:
        """The yaws (count,) of a row, clockwise, in [-180, 180); the phase turns rows that are free to turn."""
        steps = np.arange(count)
        if self.closed:
            if not self.blind_deg:
                return wrap_180(phase_deg + steps * 360.0 / count)
            start = self._blind_from + self.blind_deg
            if count == 1:
                return wrap_180(np.array([start + (360.0 - self.blind_deg) / 2]))
            gap = max(360.0 / count, self.blind_deg)
            start += (gap - self.blind_deg) / 2
            return wrap_180(start + steps * (360.0 - gap) / (count - 1))
        spacing, left, right = (float(v[0]) for v in self._sector(np.array([pitch_deg]), np.array([count])))
        start = self._middle_deg - self.span_deg / 2 + left
        if count == 1:
            start = self._middle_deg + (left - right) / 2
        return wrap_180(start + steps * spacing)

    def _place_sector(self) -> None:
        """What of the sector's ends cannot be panned to; `blind_deg` becomes what is left inside the sector."""
        start = self._middle_deg - self.span_deg / 2
        blind_from = (self._blind_from - start) % 360.0
        blind_to = blind_from + self.blind_deg
        inside = 0.0
        if blind_from <= _HAIR_DEG or blind_to >= 360.0 - _HAIR_DEG:
            self._left = max(0.0, (blind_to - 360.0) if blind_to > 360.0 else (blind_to if blind_from <= _HAIR_DEG else 0.0))
        if blind_to > 360.0:
            self._left = min(blind_to - 360.0, self.span_deg)
        if blind_from < self.span_deg:
            if blind_to >= self.span_deg:
                self._right = self.span_deg - blind_from
            else:
                inside = self.blind_deg
        self.blind_deg = inside


def _blind_arc(gimbal: GimbalLimits | None) -> tuple[float, float]:
    """Start and width of the yaws that the gimbal cannot have, degrees; width 0 where it reaches all."""
    if gimbal is None:
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


def check_span(span_deg: float) -> bool:
    """Whether a span is a full circle."""
    return math.isclose(span_deg, 360.0)
