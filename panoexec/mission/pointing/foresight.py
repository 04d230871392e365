"""Foresees the errors of a pose: whether it will still be inside its tolerance when the shutter opens.

Two ways. The *speed* of the last readings is that of a straight line through them; it is all there is where a gimbal
reports no angular rates, and where the vehicle's nose is the camera's yaw. A gimbal that measures its rates shows the
motion of the moment, which the line shows only when half of it is over: gusts and the gimbal's answer to them turn
about within a tenth of a second.

In a model of 8 m/s (errors of 0.035° rms, encoders of 0.017°, rates of 0.05°/s, τ 0.1°, 16 000 exposures each) 3.5 % of
the exposures that the line lets go are rejected, and 1.5 % of those that the rates do, for 9 ms more of waiting.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from panoexec.angles import FloatArray
from panoexec.mission.pointing.rate_bias import RateBias, Triple
from panoexec.mission.pointing.unseen_motion import slope
from panoexec.planning.geometry.pose_error import PoseError
from panoexec.planning.model import Tolerance

SPEED_SHARE: Final = 0.8
"""The part of the tolerance in which a gimbal in a gust must be foreseen by its speed: beyond, it is as often out."""
RATE_SHARE: Final = 0.6
"""The same, foreseen by its rates; less costs more waiting than it saves photos."""
RATE_SPAN_S: Final = 0.02
"""The pose must stay inside for so long before and after the moment that is foreseen by rates."""
CALM_PATIENCE_S: Final = 0.5
"""How long a calm moment is waited for by rates: where it does not come, they are too rough to foresee anything."""
REST_PATIENCE_S: Final = 1.0
"""How long a pose is waited for that is farther inside: one that rests near the edge comes no nearer."""
STILL_DEG_S: Final = 0.1
"""Rates of a gimbal at rest, with the noise of its gyroscopes."""
_LEAST_READINGS: Final = 3
_MEAN_READINGS: Final = 4
_AXES: Final = ("pitch", "roll", "yaw")


class Foresight:
    """The latest pose errors, and where they go.

    Args:
        tolerance: of each axis.
        span_s: the speed is that of the readings of so long; 0: none are kept.
        bias: of the rates, which is taken off.
    """

    def __init__(self, tolerance: Tolerance, span_s: float, bias: RateBias | None = None) -> None:
        self._limits = np.array([tolerance.pitch_deg, tolerance.roll_deg, tolerance.yaw_deg])
        self._span_s = span_s
        self._bias = bias or RateBias()
        self._track: deque[tuple[float, Triple, Triple]] = deque()
        self._waiting_since_s = math.nan

    @property
    def keeps(self) -> bool:
        """Whether it needs the readings."""
        return self._span_s > 0

    def add(self, time_s: float, errors_deg: Triple, rates_deg_s: Triple) -> None:
        """Take the errors of pitch, roll and yaw of one reading, and their rates (NaN if unknown)."""
        self._track.append((time_s, errors_deg, rates_deg_s))
        while self._track[0][0] < time_s - self._span_s - 1e-6:
            self._track.popleft()

    def clear(self) -> None:
        """Forget the readings: one was unusable."""
        self._track.clear()

    def leaving(self, ahead_s: float, share: float = 1.0) -> str:
        """Which axis would leave a share of its tolerance within a time, at its present speed; "" if none would."""
        times, errors, _ = self._arrays()
        for name, values, limit in zip(_AXES, errors.T, share * self._limits, strict=True):
            coming_deg = float(values.mean()) + slope(times, values) * (times[-1] - times.mean() + ahead_s)
            if abs(coming_deg) > limit:
                return f"{name} will be off by {coming_deg:+.3g}° in {ahead_s:.2f} s (at most {limit:g}°)"
        return ""

    def is_gusty(self, ahead_s: float) -> bool:
        """Whether a gust is about to take the pose out of the tolerance, in so many seconds.

        A pose whose rates have been within `STILL_DEG_S` is in no gust, and needs no more room than by its speed; nor
        is a calm moment waited for longer than `CALM_PATIENCE_S`, nor a pose that is farther inside for longer than
        `REST_PATIENCE_S`: then all of the tolerance counts.
        """
        _, errors, rates = self._arrays()
        newest_s = self._track[-1][0]
        if math.isnan(self._waiting_since_s):
            self._waiting_since_s = newest_s
        told = ~np.isnan(rates).any(axis=0)
        waited_s = newest_s - self._waiting_since_s
        if not told.any() or len(errors) < _LEAST_READINGS or waited_s > CALM_PATIENCE_S:
            return self.leaving(ahead_s, SPEED_SHARE if waited_s <= REST_PATIENCE_S else 1.0) != ""
        rates = rates - np.array(self._bias.rates_deg_s)
        mean_deg = errors[-_MEAN_READINGS:].mean(axis=0)
        now_deg_s = np.where(told, rates[-1], 0.0)
        moving = told & (np.abs(rates) > STILL_DEG_S).any(axis=0)
        limits = np.where(moving, RATE_SHARE, SPEED_SHARE) * self._limits
        foreseen = (mean_deg + now_deg_s * time_s for time_s in (ahead_s - RATE_SPAN_S, ahead_s + RATE_SPAN_S))
        return any(bool((np.abs(coming) > limits).any()) for coming in foreseen)

    def _arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times (n,), errors (n, 3), rates (n, 3)."""
        times, errors, rates = zip(*self._track, strict=True)
        return np.array(times), np.array(errors), np.array(rates)


def axis_errors(errors: PoseError) -> list[Triple]:
    """Errors of pitch, roll and yaw of each pose, degrees."""
    axes = (np.atleast_1d(axis).tolist() for axis in (errors.pitch_deg, errors.roll_deg, errors.yaw_deg))
    return list(zip(*axes, strict=True))
