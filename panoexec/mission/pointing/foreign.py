"""Recognises that another station points the gimbal, though the mission has control of it.

ArduPilot and PX4 carry out MAV_CMD_DO_MOUNT_CONTROL and the ROI commands of any station at once, whoever is in control,
and tell nobody else of them. What is left to see is the gimbal: it leaves the way to its
target, or the target, and comes to rest elsewhere.

* One that is stuck stays where it is: it never turns away from its target.
* One whose north is off misses in yaw only, by the same angle everywhere; one that is slow does not come to rest. Both
  go one way, so in yaw only a gimbal that turns back, or that rests on its way and goes on, obeys somebody else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from panoexec.angles import FloatArray, angle_between, yaw_pitch_roll
from panoexec.mission.pointing.poses import Reading, pose_of
from panoexec.mission.pointing.steady_error import error_at_rest
from panoexec.planning.geometry.pose_error import pose_error

ELSEWHERE_DEG: Final = 10.0
"""Least angle between target and rest; errors of calibration are smaller, except those of the north."""
PITCH_DEG: Final = 3.0
"""Least part of it in pitch: the north has none in it."""
AWAY_DEG: Final = 3.0
"""How far it must have turned away from its target in pitch."""
BACK_DEG: Final = 8.0
"""How far it must have turned in yaw before it turned back, and then back."""
PAUSED_S: Final = 0.5
"""How long it must have rested on its way."""
PAUSED_WITHIN_DEG: Final = 0.5
SAME_DEG: Final = 1.0
"""Two poses closer than this are the same: one that is pointed there again and again does not leave it."""


class ForeignPointing:
    """Takes the slews of a mission whose target was not reached, until one is reached."""

    def __init__(self) -> None:
        self._rest: FloatArray | None = None

    def settled(self) -> None:
        """The gimbal has obeyed."""
        self._rest = None

    def failed(self, readings: Sequence[Reading], *, commanded_s: float, pitch_deg: float, yaw_deg: float) -> str:
        """Why it must be another station that points the gimbal; "" if it need not be.

        Args:
            readings: of the wait, oldest first.
            commanded_s: when the gimbal was commanded.
            pitch_deg: of the target.
            yaw_deg: of the target, in the frame of the readings.
        """
        at_rest = error_at_rest(readings, pitch_deg=pitch_deg, yaw_deg=yaw_deg)
        poses = [r.rotation for r in readings if r.rotation is not None and r.time_s >= commanded_s]
        if at_rest is None or not poses:
            return ""
        stacked = np.stack(poses)
        times = np.array([r.time_s for r in readings if r.rotation is not None and r.time_s >= commanded_s])
        off_deg = np.asarray(pose_error(pitch_deg, yaw_deg, stacked).boresight_deg)
        last = stacked[-1, :, 0]
        same = self._rest is not None and float(angle_between(self._rest, last)) < SAME_DEG
        elsewhere = off_deg[-1] >= ELSEWHERE_DEG
        yaws, pitches, _ = (np.asarray(values) for values in yaw_pitch_roll(stacked))
        # in pitch: on a way in both axes, the angle to the target may grow before it shrinks
        pitch_off_deg = np.abs(pitches - pitch_deg)
        in_pitch = abs(at_rest.mean_deg[0]) >= PITCH_DEG
        left = in_pitch and pitch_off_deg[-1] - pitch_off_deg.min() >= AWAY_DEG
        if not elsewhere or not (same or left or _changed_its_mind(times, np.unwrap(yaws, period=360.0))):
            return ""
        self._rest = last
        pose = pose_of(stacked[-1])
        return (
            "another station points the gimbal: it came to rest at"
            f" pitch {pose.pitch_deg:.1f}°, yaw {pose.yaw_deg:.1f}°, {math.floor(off_deg[-1]):d}° from its target"
        )


def _changed_its_mind(times: FloatArray, yaws_deg: FloatArray) -> bool:
    """Whether a yaw turned back, or rested on its way, both well away from where it began and where it ended."""
    from_start, from_end = yaws_deg - yaws_deg[0], yaws_deg - yaws_deg[-1]
    between = (np.abs(from_start) >= BACK_DEG) & (np.abs(from_end) >= BACK_DEG)
    # on the far side of both: it has been further than where it came to rest
    if bool(np.any(between & (from_start * from_end > 0))):
        return True
    ends = np.searchsorted(times, times + PAUSED_S)
    return any(
        bool(between[first]) and last < len(times) and float(np.ptp(yaws_deg[first : last + 1])) < PAUSED_WITHIN_DEG
        for first, last in enumerate(ends)
    )
