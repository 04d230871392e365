"""Angles of photos near the poles, for programs that read yaw, pitch and roll in the 3-2-1 order.

There a small roll of the gimbal can become any yaw and roll in that order, which turns images upside down in programs
that start from them (PTGui). So beyond ±80° of pitch the gimbal's own yaw and pitch are written, with roll 0; the error
is the gimbal's roll, which is within the tolerance.
"""

from __future__ import annotations

from typing import Final

from panoexec.angles import FloatArray, yaw_pitch_roll

_POLAR_DEG: Final = 80.0


def polar_angles(rotation: FloatArray) -> tuple[float, float] | None:
    """The gimbal's yaw and pitch (degrees) where it points near a pole; None elsewhere.

    Args:
        rotation: (3, 3) camera to world.
    """
    yaw, pitch, _ = (float(angle) for angle in yaw_pitch_roll(rotation))
    if abs(pitch) <= _POLAR_DEG:
        return None
    return yaw, min(90.0, max(-90.0, pitch))
