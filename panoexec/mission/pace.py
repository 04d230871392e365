"""How long slews take, what the hardware allows at best, and how long the rest of a mission will take."""

from __future__ import annotations

import math

from panoexec.angles import wrap_180
from panoexec.planning.model import GimbalLimits


def axis_time_s(angle_deg: float, rate_deg_s: float, acceleration_deg_s2: float) -> float:
    """Least time from rest to rest: a trapezoid of speed, or a triangle if the rate is never reached."""
    angle = abs(angle_deg)
    if angle >= rate_deg_s**2 / acceleration_deg_s2:
        return angle / rate_deg_s + rate_deg_s / acceleration_deg_s2
    return 2 * math.sqrt(angle / acceleration_deg_s2)


def slew_time_s(
    limits: GimbalLimits, *, from_pitch_deg: float, from_yaw_deg: float, to_pitch_deg: float, to_yaw_deg: float
) -> float:
    """Least time of a slew: both axes move at once, the yaw axis the short way if it turns without end."""
    yaw = to_yaw_deg - from_yaw_deg
    if limits.yaw_endless:
        yaw = float(wrap_180(yaw))
    return max(
        axis_time_s(to_pitch_deg - from_pitch_deg, limits.pitch_rate_deg_s, limits.pitch_acceleration_deg_s2),
        axis_time_s(yaw, limits.yaw_rate_deg_s, limits.yaw_acceleration_deg_s2),
    )


class Pace:
    """Learns the seconds a shot costs while flying, and estimates the rest.

    The first guess comes from the plan; each accepted shot then pulls the estimate by `weight` (an exponentially
    weighted mean, so that a change of wind or light is followed within a few shots).
    """

    def __init__(self, *, expected_shot_s: float, weight: float = 0.1) -> None:
        self._shot_s = expected_shot_s
        self._weight = weight
        self._last_s = math.nan
        self._samples = 0

    @property
    def shot_s(self) -> float:
        """Seconds a shot costs now, retakes included."""
        return self._shot_s

    def restart(self, now_s: float) -> None:
        """Shooting begins, or goes on after a pause."""
        self._last_s = now_s

    def accepted(self, now_s: float) -> None:
        """A shot was accepted."""
        if not math.isnan(self._last_s):
            self._samples += 1
            weight = max(self._weight, 1 / (self._samples + 1))
            self._shot_s += weight * (now_s - self._last_s - self._shot_s)
        self._last_s = now_s

    def eta_s(self, shots_left: int) -> float:
        """Seconds until that many shots are taken."""
        return shots_left * self._shot_s
