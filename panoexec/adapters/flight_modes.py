"""Flight modes from HEARTBEAT.custom_mode, by the names that MAVSDK gives them (`[guards] allowed_modes`). Pure.

MAVSDK's own answer depends on its guess of the autopilot and follows the heartbeats of every component of the vehicle;
here the heartbeat of the autopilot decides alone. Sources: ArduPilot's mode numbers (mode.h of
ArduCopter, ArduPlane and Rover), PX4's px4_custom_mode.h; names: MAVSDK's FlightMode.
"""

from __future__ import annotations

from typing import Final

from panoexec.adapters.link.roster import AutopilotKind

UNKNOWN: Final = "UNKNOWN"
_CUSTOM_MODE_ENABLED: Final = 1
_WINGS: Final = frozenset({1, 19, 20, 21, 22, 23, 24, 25})
"""MAV_TYPEs that ArduPlane flies."""
_WHEELS: Final = frozenset({10, 11})
"""MAV_TYPEs that Rover drives: ground rover, boat."""

_ARDUCOPTER: Final = {
    0: "STABILIZED",
    1: "ACRO",
    2: "ALTCTL",
    3: "MISSION",
    4: "OFFBOARD",
    5: "HOLD",
    6: "RETURN_TO_LAUNCH",
    9: "LAND",
    16: "POSCTL",
    22: "HOLD",
    23: "FOLLOW_ME",
    27: "RETURN_TO_LAUNCH",
}
_ARDUPLANE: Final = {
    0: "MANUAL",
    2: "STABILIZED",
    4: "ACRO",
    8: "ALTCTL",
    10: "MISSION",
    11: "RETURN_TO_LAUNCH",
    12: "HOLD",
    13: "TAKEOFF",
}
_ARDUROVER: Final = {
    0: "MANUAL",
    1: "ACRO",
    4: "HOLD",
    6: "FOLLOW_ME",
    10: "MISSION",
    11: "RETURN_TO_LAUNCH",
    15: "OFFBOARD",
}
_PX4_MAIN: Final = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
}
_PX4_AUTO: Final = 4
_PX4_SUB: Final = {
    1: "READY",
    2: "TAKEOFF",
    3: "HOLD",
    4: "MISSION",
    5: "RETURN_TO_LAUNCH",
    6: "LAND",
    8: "FOLLOW_ME",
}


_OWN_ARDUCOPTER: Final = {
    number: name
    for number, name in enumerate(
        (
            *(
                "STABILIZE",
                "ACRO",
                "ALT_HOLD",
                "AUTO",
                "GUIDED",
                "LOITER",
                "RTL",
                "CIRCLE",
                "",
                "LAND",
                "",
                "DRIFT",
                "",
            ),
            *("SPORT", "FLIP", "AUTOTUNE", "POSHOLD", "BRAKE", "THROW", "AVOID_ADSB", "GUIDED_NOGPS", "SMART_RTL"),
            *("FLOWHOLD", "FOLLOW", "ZIGZAG", "SYSTEMID", "AUTOROTATE", "AUTO_RTL", "TURTLE"),
        )
    )
    if name
}
_OWN_PX4: Final = {
    "ALTCTL": "Altitude",
    "POSCTL": "Position",
    "HOLD": "Hold",
    "RETURN_TO_LAUNCH": "Return",
    "MISSION": "Mission",
    "TAKEOFF": "Takeoff",
    "LAND": "Land",
    "MANUAL": "Manual",
    "OFFBOARD": "Offboard",
    "STABILIZED": "Stabilized",
    "ACRO": "Acro",
    "FOLLOW_ME": "Follow Me",
}


def own_name(autopilot: AutopilotKind, kind: int, custom_mode: int, mode: str) -> str:
    """What the autopilot's ground stations call a flight mode, which is what the pilot chose; "" if that is unknown.

    Args:
        autopilot: which one it is.
        kind: MAV_TYPE.
        custom_mode: of the autopilot's HEARTBEAT.
        mode: its name by `flight_mode`.
    """
    if autopilot == "ardupilot":
        return "" if kind in _WINGS | _WHEELS else _OWN_ARDUCOPTER.get(custom_mode, "")
    return _OWN_PX4.get(mode, "")


def flight_mode(autopilot: AutopilotKind, kind: int, base_mode: int, custom_mode: int) -> str | None:
    """The flight mode's name, `UNKNOWN` for one without a name; None if the heartbeat does not tell one.

    Args:
        autopilot: which one it is.
        kind: MAV_TYPE.
        base_mode: of the autopilot's HEARTBEAT.
        custom_mode: of the same.
    """
    if not base_mode & _CUSTOM_MODE_ENABLED:
        return None
    if autopilot == "ardupilot":
        modes = _ARDUPLANE if kind in _WINGS else _ARDUROVER if kind in _WHEELS else _ARDUCOPTER
        return modes.get(custom_mode, UNKNOWN)
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    return _PX4_SUB.get(sub, UNKNOWN) if main == _PX4_AUTO else _PX4_MAIN.get(main, UNKNOWN)
