"""Telemetry of the embedded autopilot: one builder per message, with the differences between ArduPilot and PX4."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.component import NAN, Builder, bitmask
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.modes import FlightModes
from panoexec.sim.mavlink.wire import Message
from panoexec.sim.physics.airframe import Airframe
from panoexec.sim.physics.world import SimClock, seeded

_SENSORS = bitmask(
    getattr(mavlink, f"MAV_SYS_STATUS_{name}")
    for name in (
        "SENSOR_3D_GYRO",
        "SENSOR_3D_ACCEL",
        "SENSOR_3D_MAG",
        "SENSOR_ABSOLUTE_PRESSURE",
        "SENSOR_GPS",
        "SENSOR_BATTERY",
        "SENSOR_ATTITUDE_STABILIZATION",
        "SENSOR_YAW_POSITION",
        "SENSOR_Z_ALTITUDE_CONTROL",
        "SENSOR_XY_POSITION_CONTROL",
        "SENSOR_MOTOR_OUTPUTS",
        "SENSOR_RC_RECEIVER",
        "AHRS",
        "PREARM_CHECK",
    )
)
_EKF_OK = bitmask(
    getattr(mavlink, f"EKF_{name}")
    for name in ("ATTITUDE", "VELOCITY_HORIZ", "VELOCITY_VERT", "POS_HORIZ_REL", "POS_HORIZ_ABS", "POS_VERT_ABS")
)
_CAPABILITIES = bitmask(
    getattr(mavlink, f"MAV_PROTOCOL_CAPABILITY_{name}")
    for name in ("MAVLINK2", "PARAM_FLOAT", "COMMAND_INT", "MISSION_INT")
)
_CELLS = 4
_CURRENT_CA = 1800
_UNKNOWN_CELL = 65535
_UNKNOWN_DOP = 65535


class Telemetry:
    """Messages about the vehicle, stamped with the autopilot's boot time."""

    def __init__(
        self,
        config: SimConfig,
        *,
        clock: SimClock,
        now: Callable[[], float],
        boot_ms: Callable[[], int],
        airframe: Airframe,
        heading_error_deg: Callable[[], float],
        modes: FlightModes,
        has_fix: Callable[[], bool] = lambda: True,
        has_position: Callable[[], bool] = lambda: True,
    ) -> None:
        self._channels_us = [1500, 1500, 1000, 1500, *(1000,) * 14]  # a transmitter: sticks at rest, switches low
        self._config = config
        self._clock = clock
        self._now = now
        self._boot_ms = boot_ms
        self._airframe = airframe
        self._heading_error_deg = heading_error_deg
        self._modes = modes
        self._has_fix = has_fix
        self._has_position = has_position
        self._noise: random.Random = seeded(config.seed, "telemetry")

    def builders(self) -> dict[int, Builder]:
        """All messages by id."""
        ids = {
            "SYS_STATUS": self.sys_status,
            "SYSTEM_TIME": self.system_time,
            "GPS_RAW_INT": self.gps_raw_int,
            "ATTITUDE": self.attitude,
            "ATTITUDE_QUATERNION": self.attitude_quaternion,
            "LOCAL_POSITION_NED": self.local_position_ned,
            "GLOBAL_POSITION_INT": self.global_position_int,
            "VFR_HUD": self.vfr_hud,
            "BATTERY_STATUS": self.battery_status,
            "AUTOPILOT_VERSION": self.autopilot_version,
            "HOME_POSITION": self.home_position,
            "EXTENDED_SYS_STATE": self.extended_sys_state,
            "RC_CHANNELS": self.rc_channels,
            "AUTOPILOT_STATE_FOR_GIMBAL_DEVICE": self.state_for_gimbal,
        }
        if self._config.autopilot == "ardupilot":
            ids["EKF_STATUS_REPORT"] = self.ekf_status
        else:
            ids["ESTIMATOR_STATUS"] = self.estimator_status
        return {getattr(mavlink, f"MAVLINK_MSG_ID_{name}"): build for name, build in ids.items()}

    def heartbeat(self) -> Message:
        """HEARTBEAT (0)."""
        ardupilot = self._config.autopilot == "ardupilot"
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR,
            mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA if ardupilot else mavlink.MAV_AUTOPILOT_PX4,
            self._modes.base_mode(armed=self._airframe.armed),
            self._modes.custom_mode,
            mavlink.MAV_STATE_ACTIVE if self._airframe.armed else mavlink.MAV_STATE_STANDBY,
            3,
        )

    def _attitude(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Estimated roll, pitch, yaw in radians, yaw in ±π, and their rates."""
        state, sigma = self._airframe.state(), self._config.airframe.attitude_noise_deg
        noise = [self._noise.gauss(0.0, sigma) for _ in range(3)]
        yaw = state.yaw_deg + self._heading_error_deg() + noise[2]
        angles = (state.roll_deg + noise[0], state.pitch_deg + noise[1], (yaw + 180) % 360 - 180)
        rates = (state.roll_rate_deg_s, state.pitch_rate_deg_s, state.yaw_rate_deg_s)
        roll, pitch, heading = (math.radians(angle) for angle in angles)
        p, q, r = (math.radians(rate) for rate in rates)
        return (roll, pitch, heading), (p, q, r)

    def attitude(self) -> Message:
        """ATTITUDE (30)."""
        angles, rates = self._attitude()
        return mavlink.MAVLink_attitude_message(self._boot_ms(), *angles, *rates)

    def _quaternion(self) -> tuple[float, float, float, float]:
        (roll, pitch, yaw), _ = self._attitude()
        cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
        cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
        return (
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            sy * cp * sr + cy * sp * cr,
            sy * cp * cr - cy * sp * sr,
        )

    def attitude_quaternion(self) -> Message:
        """ATTITUDE_QUATERNION (31)."""
        _, rates = self._attitude()
        return mavlink.MAVLink_attitude_quaternion_message(self._boot_ms(), *self._quaternion(), *rates)

    def state_for_gimbal(self) -> Message:
        """AUTOPILOT_STATE_FOR_GIMBAL_DEVICE (286)."""
        velocity = self._airframe.position().velocity_m_s
        _, rates = self._attitude()
        # ArduPilot does not fill it in
        landed = 0 if self._config.autopilot == "ardupilot" else self._airframe.landed_state
        return mavlink.MAVLink_autopilot_state_for_gimbal_device_message(
            self._config.system_id,
            0,
            self._boot_ms() * 1000,
            self._quaternion(),
            0,
            *velocity,
            0,
            0.0,
            0,
            landed,
            rates[2],
        )

    def global_position_int(self) -> Message:
        """GLOBAL_POSITION_INT (33)."""
        p = self._airframe.position()
        (_, _, yaw), _ = self._attitude()
        velocity = (round(v * 100) for v in p.velocity_m_s)
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms(),
            round(p.latitude_deg * 1e7),
            round(p.longitude_deg * 1e7),
            round(p.altitude_m * 1e3),
            round(p.relative_altitude_m * 1e3),
            *velocity,
            round(math.degrees(yaw) % 360 * 100) % 36000,
        )

    def local_position_ned(self) -> Message:
        """LOCAL_POSITION_NED (32)."""
        s, velocity = self._airframe.state(), self._airframe.position().velocity_m_s
        return mavlink.MAVLink_local_position_ned_message(self._boot_ms(), s.north_m, s.east_m, -s.up_m, *velocity)

    def gps_raw_int(self) -> Message:
        """GPS_RAW_INT (24)."""
        p = self._airframe.position()
        north, east, _ = p.velocity_m_s
        fix = self._has_fix()
        return mavlink.MAVLink_gps_raw_int_message(
            round(self._clock.utc(self._now()) * 1e6),
            mavlink.GPS_FIX_TYPE_3D_FIX if fix else mavlink.GPS_FIX_TYPE_NO_FIX,
            round(p.latitude_deg * 1e7),
            round(p.longitude_deg * 1e7),
            round(p.altitude_m * 1e3),
            80 if fix else _UNKNOWN_DOP,
            120 if fix else _UNKNOWN_DOP,
            round(math.hypot(north, east) * 100),
            round(math.degrees(math.atan2(east, north)) % 360 * 100) % 36000,
            14 if fix else 0,
        )

    def vfr_hud(self) -> Message:
        """VFR_HUD (74)."""
        p = self._airframe.position()
        (_, _, yaw), _ = self._attitude()
        north, east, down = p.velocity_m_s
        return mavlink.MAVLink_vfr_hud_message(
            self._airframe.wind_m_s,
            math.hypot(north, east),
            round(math.degrees(yaw)) % 360,
            40 if self._airframe.armed else 0,
            p.altitude_m,
            -down,
        )

    def sys_status(self) -> Message:
        """SYS_STATUS (1)."""
        frac = self._airframe.battery_frac
        return mavlink.MAVLink_sys_status_message(
            _SENSORS,
            _SENSORS,
            _SENSORS if self._has_fix() else _SENSORS & ~mavlink.MAV_SYS_STATUS_SENSOR_GPS,
            250,
            round(self._airframe.voltage_v * 1000),
            _CURRENT_CA if self._airframe.is_flying else 50,
            round(frac * 100),
            *(0,) * 6,
        )

    def override_channels(self, message: Message) -> None:
        """RC_CHANNELS_OVERRIDE (70): takes the place of the transmitter; 0 and 65535 leave a channel as it is."""
        for number in range(1, len(self._channels_us) + 1):
            value = getattr(message, f"chan{number}_raw", 0)
            if value not in {0, _UNKNOWN_CELL}:
                self._channels_us[number - 1] = value

    def rc_channels(self) -> Message:
        """RC_CHANNELS (65)."""
        return mavlink.MAVLink_rc_channels_message(self._boot_ms(), len(self._channels_us), *self._channels_us, 254)

    def battery_status(self) -> Message:
        """BATTERY_STATUS (147)."""
        frac, c = self._airframe.battery_frac, self._config.airframe
        cell = round(self._airframe.voltage_v / _CELLS * 1000)
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_LIPO,
            32767,
            [cell] * _CELLS + [_UNKNOWN_CELL] * (10 - _CELLS),
            _CURRENT_CA if self._airframe.is_flying else 50,
            round((1 - frac) * c.battery_minutes / 60 * _CURRENT_CA * 10),
            -1,
            round(frac * 100),
            round(frac * c.battery_minutes * 60),
            mavlink.MAV_BATTERY_CHARGE_STATE_OK if frac > 0.2 else mavlink.MAV_BATTERY_CHARGE_STATE_LOW,
        )

    def extended_sys_state(self) -> Message:
        """EXTENDED_SYS_STATE (245)."""
        return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, self._airframe.landed_state)

    def system_time(self) -> Message:
        """SYSTEM_TIME (2)."""
        return mavlink.MAVLink_system_time_message(round(self._clock.utc(self._now()) * 1e6), self._boot_ms())

    def home_position(self) -> Message:
        """HOME_POSITION (242)."""
        c = self._config.airframe
        return mavlink.MAVLink_home_position_message(
            round(c.latitude_deg * 1e7),
            round(c.longitude_deg * 1e7),
            round(c.home_altitude_m * 1e3),
            0.0,
            0.0,
            0.0,
            (1.0, 0.0, 0.0, 0.0),
            NAN,
            NAN,
            NAN,
        )

    def ekf_status(self) -> Message:
        """EKF_STATUS_REPORT (193), ArduPilot's own."""
        return mavlink.MAVLink_ekf_status_report_message(self._estimator_flags(), 0.02, 0.02, 0.02, 0.02, 0.0)

    def estimator_status(self) -> Message:
        """ESTIMATOR_STATUS (230), PX4's; its flags have the same bits."""
        stamp_us = self._boot_ms() * 1000
        return mavlink.MAVLink_estimator_status_message(
            stamp_us, self._estimator_flags(), 0.02, 0.02, 0.02, 0.02, NAN, NAN, 0.5, 0.8
        )

    def _estimator_flags(self) -> int:
        if self._has_position():
            return _EKF_OK
        return int(_EKF_OK & ~mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_CONST_POS_MODE)

    def autopilot_version(self) -> Message:
        """AUTOPILOT_VERSION (148)."""
        ardupilot = self._config.autopilot == "ardupilot"
        version = (4, 7, 0) if ardupilot else (1, 15, 0)
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES,
            version[0] << 24 | version[1] << 16 | version[2] << 8,
            0,
            0,
            0,
            [0] * 8,
            [0] * 8,
            [0] * 8,
            0,
            0,
            0x70616E6F,
        )
