"""Where the camera points now, for whoever watches: what the gimbal reported last, never what was commanded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from panoexec.mission.context import MissionContext
from panoexec.mission.pointing.poses import pose_of, readings_since
from panoexec.planning.geometry.pose_error import pose_error

_RECENT_S: Final = 0.5
"""An older report is no pose of now."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LivePose:
    """The newest attitude, in the plan's frame, degrees.

    Attributes:
        pitch_deg, roll_deg, yaw_deg: of the gimbal's axes.
        error_deg: pitch, roll and yaw minus those of the current shot; None between shots.
    """

    pitch_deg: float
    roll_deg: float
    yaw_deg: float
    error_deg: tuple[float, float, float] | None


def live_pose(context: MissionContext) -> LivePose | None:
    """The pose as of now; None without a usable report, or while the plan's north is not known."""
    record = context.record
    reference = record.reference_yaw_north_deg
    if math.isnan(reference):
        return None
    feed = context.gimbal.feed
    readings = readings_since(feed, context.clock.monotonic() - _RECENT_S, reference)
    rotation = next((one.rotation for one in reversed(readings) if one.rotation is not None), None)
    if rotation is None:
        return None
    pose = pose_of(rotation)
    shot = record.shots.get(record.current) if record.current is not None else None
    error = None
    if shot is not None:
        errors = pose_error(shot.shot.pitch_deg, shot.shot.yaw_deg, rotation)
        error = (float(errors.pitch_deg), float(errors.roll_deg), float(errors.yaw_deg))
    return LivePose(pitch_deg=pose.pitch_deg, roll_deg=pose.roll_deg, yaw_deg=pose.yaw_deg, error_deg=error)
