"""What an autopilot reports of a mount that has no MAVLink component: measured by a driver, or demanded."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from panoexec.sim.config import GimbalConfig
from panoexec.sim.physics.gimbal import Angles, GimbalPhysics, Target, quaternion

_KEPT = 200


class DriverReports:
    """Angles as a driver of the autopilot gets them from a gimbal: seldom, in steps, and some time old."""

    def __init__(self, config: GimbalConfig, *, physics: GimbalPhysics, now: Callable[[], float]) -> None:
        self._config = config
        self._physics = physics
        self._now = now
        self._kept: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=_KEPT)

    def poll(self) -> None:
        """The driver gets the gimbal's angles."""
        yaw, roll, pitch = stepped(self._physics.measure(), self._config.report_step_deg)
        nose = self._physics.nose_deg
        self._kept.append((self._now(), quaternion(Angles(yaw - nose, roll, pitch))))

    def latest(self) -> tuple[float, ...] | None:
        """What the autopilot knows now: a quaternion relative to the vehicle's nose; None before the first."""
        before_s = self._now() - self._config.report_age_s
        return next((q for time_s, q in reversed(self._kept) if time_s <= before_s), None)


def stepped(angles: Angles, step_deg: float) -> Angles:
    """The angles in whole steps; 0: as they are."""
    if not step_deg:
        return angles
    return Angles(*(round(angle / step_deg) * step_deg for angle in angles))


def demanded(target: Target, nose_deg: float, *, earth: bool) -> tuple[float, ...]:
    """The target as a quaternion.

    Args:
        target: of the gimbal.
        nose_deg: the vehicle's heading.
        earth: yaw from north, else from the nose.
    """
    yaw = target.yaw_deg + (nose_deg if earth else 0.0) - (nose_deg if target.yaw_lock else 0.0)
    return quaternion(Angles(math.remainder(yaw, 360.0), target.roll_deg, target.pitch_deg))
