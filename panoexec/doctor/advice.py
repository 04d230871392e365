"""Advice: the ArduPilot and PX4 parameters behind each requirement of a mission.

Names and values from ArduPilot's parameter descriptions (4.6, 4.7) and PX4's (1.14 to 1.18).
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

Topic: TypeAlias = Literal[
    "link", "rates", "limits", "gimbal", "feedback", "camera", "evidence", "battery", "position", "control", "time"
]

_ADVICE: Final[dict[Topic, dict[str, str]]] = {
    "link": {
        "ardupilot": "SERIALn_PROTOCOL = 2 (MAVLink 2) and SERIALn_BAUD equal to [vehicle] baud on the connected port",
        "px4": "MAV_n_CONFIG = the connected port, MAV_n_MODE = 2 (onboard), SER_*_BAUD equal to [vehicle] baud",
    },
    "rates": {
        "ardupilot": "raise SERIALn_BAUD (921600) with [vehicle] baud; clear bit 12 (ignore stream rates) of "
        "SERIALn_OPTIONS, since 4.7 bit 2 of MAVn_OPTIONS",
        "px4": "raise SER_*_BAUD (921600) with [vehicle] baud, and MAV_n_RATE (bytes/s; 0 = half the baud rate)",
    },
    "limits": {
        "ardupilot": "MNT1_PITCH_MIN, MNT1_PITCH_MAX, MNT1_YAW_MIN, MNT1_YAW_MAX",
        "px4": "the gimbal's own settings; for AUX outputs MNT_MIN_PITCH, MNT_MAX_PITCH (before 1.18 MNT_RANGE_PITCH), "
        "MNT_RANGE_YAW",
    },
    "gimbal": {
        "ardupilot": "MNT1_TYPE = 6 (MAVLink gimbal; 8 Siyi, 1 servos, …) and reboot; the gimbal's port needs "
        "SERIALn_PROTOCOL = 2",
        "px4": "MNT_MODE_IN = 4 and MNT_MODE_OUT = 2 (MAVLink gimbal protocol v2), and reboot; the gimbal's port needs "
        "MAV_n_CONFIG, MAV_n_MODE = 10 (gimbal) and MAV_n_FORWARD = 1",
    },
    "feedback": {
        "ardupilot": "a mount with its own IMU: MNT1_TYPE = 6 (MAVLink), 8 (Siyi), 4 or 5 (SToRM32), 3 (Alexmos); "
        "1 (servo) and 7 (PWM) report the demanded angles",
        "px4": "a gimbal with MAVLink: MNT_MODE_OUT = 2; AUX outputs (0) report no measured angles",
    },
    "camera": {
        "ardupilot": "CAM1_TYPE = 6 (MAVLink camera v2), 4 (of the mount: Siyi, Topotek, Viewpro, Xacti), 1 (servo) or "
        "2 (relay), and reboot",
        "px4": "a MAVLink camera (component 100) whose port has MAV_n_FORWARD = 1, or TRIG_MODE = 1 with "
        "TRIG_INTERFACE and PWM_AUX_FUNCn = 2000 (camera trigger), and reboot",
    },
    "evidence": {
        "ardupilot": "wire the hot-shoe and set CAM1_FEEDBAK_PIN (50 = AUX1) and CAM1_FEEDBAK_POL, or CAM1_TYPE = 6 "
        "with a MAVLink camera",
        "px4": "wire the hot-shoe and set CAM_CAP_FBACK = 1 with PWM_AUX_FUNCn = 2032 (camera capture), or "
        "use a MAVLink camera; reboot",
    },
    "battery": {
        "ardupilot": "BATT_MONITOR = 4 (or as the battery needs) and BATT_CAPACITY",
        "px4": "BAT1_SOURCE, BAT1_CAPACITY and BAT1_N_CELLS",
    },
    "position": {
        "ardupilot": "wait for GPS and estimator; GPS1_TYPE, EK3_SRC1_POSXY",
        "px4": "wait for GPS and estimator; EKF2_GPS_CTRL",
    },
    "control": {
        "ardupilot": "release the gimbal at the other ground station, or set [gimbal] when_taken",
        "px4": "release the gimbal at the other ground station, or set [gimbal] when_taken; MNT_MODE_IN = 4",
    },
    "time": {
        "ardupilot": "BRD_RTC_TYPES with bit 0 (GPS)",
        "px4": "GPS reception",
    },
}


def advise(topic: Topic, autopilot: str) -> str:
    """The parameters to set, for the detected autopilot, or for both kinds if it is unknown.

    Args:
        topic: the missing requirement.
        autopilot: ardupilot, px4 or "".
    """
    known = _ADVICE[topic]
    if autopilot in known:
        return known[autopilot]
    return f"ArduPilot: {known['ardupilot']}; PX4: {known['px4']}"
