"""Corrects the commands to a gimbal that turns to yaws from a north of its own, which is off.

What such a gimbal reports is corrected by the heading that it tells (`attitude_messages`). Whether it also obeys its
own north depends on the frame in which its manager commands it, which no message tells. So the first pose shows it: if
the gimbal comes to rest as far beside it as its north is off, the commands are turned by that angle from then on.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from panoexec.angles import direction, rotation_from_quaternion, wrap_180
from panoexec.devices import AttitudeSample, GimbalKnowledge, YawFrame

LEAST_DEG: Final = 3.0
"""A smaller contradiction is not corrected in commands: the gimbal's drift and noise."""
_SAME_DEG: Final = 2.0
_AT_REST_DEG_S: Final = 2.0
_PITCH_DEG: Final = 3.0
_STEEPEST_DEG: Final = 75.0
_OLDEST_S: Final = 1.0


class NorthTrim:
    """The angle by which commanded yaws are turned.

    Attributes:
        trim_deg: it; 0 as long as the gimbal turns to where it is told.
    """

    def __init__(self, known: GimbalKnowledge) -> None:
        self.trim_deg = 0.0
        self._known = known
        self._commanded: tuple[float, float] | None = None

    def command(self, pitch_deg: float, yaw_deg: float, *, newest: AttitudeSample | None, now_s: float) -> float:
        """The yaw to send for a pose.

        Args:
            pitch_deg: of the pose.
            yaw_deg: of the pose, from north.
            newest: the newest report of the gimbal.
            now_s: on the mission's clock.
        """
        off_deg = self._known.north_off_deg
        if self._known.north_corrected and abs(off_deg) >= LEAST_DEG and newest is not None:
            beside_deg = self._beside_deg(newest, now_s)
            if abs(float(wrap_180(beside_deg + off_deg - self.trim_deg))) <= _SAME_DEG:
                self.trim_deg = off_deg
        self._commanded = pitch_deg, yaw_deg
        return yaw_deg + self.trim_deg

    def _beside_deg(self, newest: AttitudeSample, now_s: float) -> float:
        """Yaw of the gimbal at rest minus that of the last command, NaN if it is not there."""
        if self._commanded is None or newest.yaw_frame is not YawFrame.EARTH or now_s - newest.received_s > _OLDEST_S:
            return math.nan
        pitch_deg, yaw_deg = self._commanded
        if abs(pitch_deg) > _STEEPEST_DEG or not all(map(math.isfinite, newest.q_wxyz)):
            return math.nan
        axis = rotation_from_quaternion(newest.q_wxyz)[:, 0]
        pitch = math.degrees(math.asin(min(max(-float(axis[2]), -1.0), 1.0)))
        if newest.rate_deg_s > _AT_REST_DEG_S or abs(pitch - pitch_deg) > _PITCH_DEG:
            return math.nan
        forward = direction(0.0, yaw_deg)
        yaw = math.degrees(
            math.atan2(float(forward[0] * axis[1] - forward[1] * axis[0]), float(np.dot(forward[:2], axis[:2])))
        )
        return float(wrap_180(yaw))
