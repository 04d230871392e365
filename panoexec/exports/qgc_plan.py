"""A mission file for QGroundControl (`.plan`): the same poses, executed by the autopilot alone.

The autopilot waits for a fixed time instead of feedback and verifies nothing: this is a fallback, or a way to display a
plan in QGroundControl. ArduPilot also stores gimbal angles of mission items in whole degrees.

The vehicle takes off at its position, points the gimbal at each pose (MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, earth-fixed),
waits, takes a photo, and returns at the end.
"""

from __future__ import annotations

import json
import math
from typing import Any, Final

from panoexec.angles import wrap_180, yaw_pitch_roll_321
from panoexec.errors import UsageError
from panoexec.exports.model import ExportSet, ExportShot

_NAV_RETURN_TO_LAUNCH, _NAV_TAKEOFF, _NAV_DELAY = 20, 22, 93
_DO_GIMBAL_MANAGER_PITCHYAW, _IMAGE_START_CAPTURE = 1000, 2000
_FRAME_MISSION, _FRAME_GLOBAL_RELATIVE_ALTITUDE = 2, 3
_ROLL_PITCH_YAW_LOCK: Final = 4 + 8 + 16
"""GIMBAL_MANAGER_FLAGS: roll and pitch from the horizon, yaw from north."""
_LEVEL_DEG: Final = 0.01


def qgc_text(exports: ExportSet, *, height_m: float = 30.0, interval_s: float = 1.0) -> str:
    """The file's text.

    Args:
        exports: the poses; the plan's yaw must be relative to true north.
        height_m: height above the take-off position.
        interval_s: wait after each photo.

    Raises:
        UsageError: a pose is rolled, which the gimbal manager's command cannot say.
    """
    rolled = next((shot for shot in exports.shots if abs(_roll_deg(shot)) > _LEVEL_DEG), None)
    if rolled is not None:
        raise UsageError(
            f"qgc: shot {rolled.index} is rolled by {_roll_deg(rolled):.1f}°, and "
            "MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW has no roll: choose another format"
        )
    mission = _Mission()
    mission.add(_NAV_TAKEOFF, 0, 0, 0, None, 0, 0, height_m, frame=_FRAME_GLOBAL_RELATIVE_ALTITUDE)
    # without feedback: one second for the slew in addition to the settle time
    wait_s = math.ceil(exports.settle_s + 1.0)
    for number, shot in enumerate(exports.shots, start=1):
        yaw = float(wrap_180(shot.target_yaw_deg + exports.reference_yaw_north_deg))
        pitch = shot.target_pitch_deg
        mission.add(_DO_GIMBAL_MANAGER_PITCHYAW, round(pitch, 3), round(yaw, 3), None, None, _ROLL_PITCH_YAW_LOCK, 0, 0)
        mission.add(_NAV_DELAY, wait_s, -1, -1, -1, 0, 0, 0)
        mission.add(_IMAGE_START_CAPTURE, 0, 0, 1, number, None, None, None)
        mission.add(_NAV_DELAY, math.ceil(interval_s), -1, -1, -1, 0, 0, 0)
    mission.add(_NAV_RETURN_TO_LAUNCH, 0, 0, 0, 0, 0, 0, 0)
    document = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "version": 2,
            "firmwareType": 3,
            "vehicleType": 2,
            "cruiseSpeed": 15,
            "hoverSpeed": 5,
            "globalPlanAltitudeMode": 1,
            "plannedHomePosition": _home(exports),
            "items": mission.items,
        },
    }
    return json.dumps(document, indent=2) + "\n"


def _roll_deg(shot: ExportShot) -> float:
    return float(yaw_pitch_roll_321(shot.rotation)[2])


def _home(exports: ExportSet) -> list[float]:
    for shot in exports.shots:
        if math.isfinite(shot.latitude_deg) and math.isfinite(shot.longitude_deg):
            altitude = shot.altitude_m if math.isfinite(shot.altitude_m) else 0.0
            return [shot.latitude_deg, shot.longitude_deg, altitude]
    return [0.0, 0.0, 0.0]


class _Mission:
    """A list of numbered mission items."""

    def __init__(self) -> None:
        self.items: list[dict[str, Any]] = []

    def add(self, command: int, *params: float | None, frame: int = _FRAME_MISSION) -> None:
        item: dict[str, Any] = {
            "type": "SimpleItem",
            "doJumpId": len(self.items) + 1,
            "command": command,
            "frame": frame,
            "autoContinue": True,
            "params": list(params),
        }
        if frame == _FRAME_GLOBAL_RELATIVE_ALTITUDE:
            item |= {"Altitude": params[6], "AltitudeMode": 1, "AMSLAltAboveTerrain": None}
        self.items.append(item)
