"""The autopilot parameters of the payload and of turns, for programs that read them (PARAM_* messages)."""

from __future__ import annotations

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import Message

_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


class Parameters:
    """Parameter protocol: read, list and set; a new value has no effect on the simulation."""

    def __init__(self, config: SimConfig) -> None:
        gimbal, airframe = config.gimbal, config.airframe
        if config.autopilot == "ardupilot":
            self._values: dict[str, float] = {
                "SYSID_THISMAV": config.system_id,
                "MNT1_TYPE": {"mavlink": 6, "servo": 1, "driver": 8, "echo": 7}[config.mount],
                "MNT1_PITCH_MIN": gimbal.pitch.min_deg,
                "MNT1_PITCH_MAX": gimbal.pitch.max_deg,
                "MNT1_YAW_MIN": gimbal.yaw.min_deg,
                "MNT1_YAW_MAX": gimbal.yaw.max_deg,
                "MNT1_RC_RATE": 0.0,
                "CAM1_TYPE": 0 if config.camera_kind == "mavlink" else 1,
                "CAM1_FEEDBAK_PIN": -1.0,
                "ATC_SLEW_YAW": 100 * airframe.turn_rate_deg_s,
                "ATC_RATE_Y_MAX": 0.0,
                "ATC_ACCEL_Y_MAX": 100 * airframe.turn_acceleration_deg_s2,
            }
            if config.camera.trigger_min_told:
                self._values["CAM1_INTRVAL_MIN"] = config.camera.trigger_min_s
        else:
            self._values = {
                "MAV_SYS_ID": config.system_id,
                "MNT_MODE_IN": 4,
                "MNT_MODE_OUT": 0 if config.mount == "echo" else 2,
                "MPC_YAWRAUTO_MAX": airframe.turn_rate_deg_s,
                "MPC_YAWRAUTO_ACC": airframe.turn_acceleration_deg_s2,
            }
            if config.camera_kind == "px4-trigger":  # without its driver PX4 has no such parameters
                interval_ms = 1000 * max(config.camera.trigger_min_s, 0.04)
                self._values |= {"TRIG_MODE": 1, "TRIG_INTERFACE": 1, "TRIG_INTERVAL": interval_ms}
        if not config.mount_told:
            self._values.pop("MNT1_TYPE", None)
            self._values.pop("MNT_MODE_OUT", None)

    def answers(self, message: Message) -> list[Message]:
        """The reply to a PARAM_REQUEST_READ, PARAM_REQUEST_LIST or PARAM_SET; empty for other messages."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self._value(name) for name in self._values]
        if kind == "PARAM_REQUEST_READ":
            names = list(self._values)
            name = message.param_id
            if 0 <= message.param_index < len(names):
                name = names[message.param_index]
            return [self._value(name)] if name in self._values else []
        if kind == "PARAM_SET" and message.param_id in self._values:
            self._values[message.param_id] = message.param_value
            return [self._value(message.param_id)]
        return []

    def _value(self, name: str) -> Message:
        index = list(self._values).index(name)
        return mavlink.MAVLink_param_value_message(name.encode(), self._values[name], _REAL32, len(self._values), index)
