"""Converts MAVLink attitude messages to the samples of `devices`. Pure; fields as in MAVSDK's JSON (NaN is None)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from panoexec.devices import AttitudeSample, Quaternion, VehicleAttitude, YawFrame
from panoexec.planning.model import GimbalLimits

YAW_LOCK: Final = 16
YAW_IN_VEHICLE_FRAME: Final = 32
YAW_IN_EARTH_FRAME: Final = 64
"""GIMBAL_DEVICE_FLAGS."""
HAS_YAW_AXIS: Final = 256
"""GIMBAL_MANAGER_CAP_FLAGS."""

_NAN: Final = math.nan
_UNKNOWN: Final[Quaternion] = (_NAN, _NAN, _NAN, _NAN)


def number(value: Any) -> float:
    """A field as float; NaN for null (JSON has no NaN: MAVSDK writes null)."""
    return _NAN if value is None else float(value)


def yaw_frame(flags: int) -> YawFrame:
    """The frame of a gimbal device's attitude, from GIMBAL_DEVICE_FLAGS.

    Devices that set neither of the frame flags (introduced in 2022) use the earth frame when yaw is locked, else the
    vehicle frame (GIMBAL_DEVICE_ATTITUDE_STATUS, message 285).
    """
    if flags & YAW_IN_EARTH_FRAME:
        return YawFrame.EARTH
    if flags & YAW_IN_VEHICLE_FRAME:
        return YawFrame.VEHICLE
    return YawFrame.EARTH if flags & YAW_LOCK else YawFrame.VEHICLE


def gimbal_sample(
    fields: Mapping[str, Any],
    received_s: float,
    frame: YawFrame | None = None,
    *,
    heading_deg: float = _NAN,
    north_off_deg: float = _NAN,
) -> AttitudeSample:
    """A sample from GIMBAL_DEVICE_ATTITUDE_STATUS (285).

    Args:
        fields: of the message.
        received_s: when it arrived, on the mission's clock.
        frame: overrides the flags, for a mount that sets the wrong ones.
        heading_deg: the vehicle's heading at the time of the report; if known, a sample in the vehicle frame is
            converted to the earth frame (285: q_earth = q_delta_yaw * q_vehicle).
        north_off_deg: the gimbal's north from that of the autopilot (its heading of the vehicle minus the autopilot's);
            if known, a sample in the earth frame is turned back by it.

    Raises:
        KeyError, TypeError, ValueError: invalid fields.
    """
    reported = fields["q"]  # without `number` for speed: this runs at 50 Hz
    w, x, y, z = reported if None not in reported else _UNKNOWN
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    # a zero quaternion is not an attitude: mark it as NaN
    q = (w / norm, x / norm, y / norm, z / norm) if norm > 1e-6 else _UNKNOWN
    frame = frame or yaw_frame(fields["flags"])
    if frame is YawFrame.VEHICLE and math.isfinite(heading_deg):
        q, frame = _turned(q, heading_deg), YawFrame.EARTH
    elif frame is YawFrame.EARTH and math.isfinite(north_off_deg):
        q = _turned(q, -north_off_deg)
    return AttitudeSample(
        received_s=received_s,
        vehicle_s=fields["time_boot_ms"] / 1000.0,
        q_wxyz=q,
        yaw_frame=frame,
        rate_deg_s=_rate_deg_s(fields, q),
        failure_flags=fields["failure_flags"],
        axis_rates_deg_s=_axis_rates_deg_s(fields, q),
    )


def told_heading_deg(fields: Mapping[str, Any]) -> float:
    """The vehicle's heading as a gimbal reports it in 285 (`delta_yaw`); NaN if unknown or to be ignored."""
    if not fields["flags"] & (YAW_IN_VEHICLE_FRAME | YAW_IN_EARTH_FRAME):
        return _NAN
    return math.degrees(number(fields.get("delta_yaw")))


def _turned(q: Quaternion, yaw_deg: float) -> Quaternion:
    """The attitude rotated about the vertical: Rz(yaw) * q."""
    c, s = math.cos(math.radians(yaw_deg) / 2), math.sin(math.radians(yaw_deg) / 2)
    w, x, y, z = q
    return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


def _rate_deg_s(fields: Mapping[str, Any], q: Quaternion) -> float:
    """Angular speed relative to the earth.

    In the vehicle frame the reported rates lack the vehicle's own yaw rate (285: w_earth = w_delta_yaw_velocity +
    w_vehicle), which a gimbal compensates in wind and which is no motion of the camera. NaN if `delta_yaw_velocity` is
    unknown; exactly 0 counts as unknown, as the value of a field that older gimbals do not send.
    """
    rates = fields["angular_velocity_x"], fields["angular_velocity_y"], fields["angular_velocity_z"]
    if None in rates:
        return _NAN
    x, y, z = rates
    if fields["flags"] & YAW_IN_VEHICLE_FRAME:
        turning = number(fields.get("delta_yaw_velocity")) or _NAN
        down_x, down_y, down_z = _down(q)
        x, y, z = x + turning * down_x, y + turning * down_y, z + turning * down_z
    return math.degrees(math.hypot(x, y, z))


def _axis_rates_deg_s(fields: Mapping[str, Any], q: Quaternion) -> tuple[float, float, float]:
    """Rates of pitch, roll and yaw relative to the earth, for a camera whose roll is small; NaN if unknown.

    Pitch and roll are the same in every yaw frame. Three zeros count as unknown: no sensor measures them, and devices
    that measure no rates send them.
    """
    x, y, z = fields["angular_velocity_x"], fields["angular_velocity_y"], fields["angular_velocity_z"]
    if None in (x, y, z) or x == y == z == 0:
        return _NAN, _NAN, _NAN
    down_x, _, down_z = _down(q)
    turning = (number(fields.get("delta_yaw_velocity")) or _NAN) if fields["flags"] & YAW_IN_VEHICLE_FRAME else 0.0
    yaw = x * down_x + z * down_z + turning
    return math.degrees(y), math.degrees(x * down_z - z * down_x), math.degrees(yaw)


def _down(q: Quaternion) -> tuple[float, float, float]:
    """The earth's vertical (down) in the camera's axes."""
    w, x, y, z = q
    return 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


def vehicle_attitude(fields: Mapping[str, Any], received_s: float) -> VehicleAttitude:
    """The airframe's attitude from ATTITUDE (30): Euler angles 3-2-1 (yaw, pitch, roll), radians, to a quaternion.

    Raises:
        KeyError, TypeError, ValueError: invalid fields.
    """
    roll, pitch, yaw = number(fields["roll"]) / 2, number(fields["pitch"]) / 2, number(fields["yaw"]) / 2
    cr, cp, cy = math.cos(roll), math.cos(pitch), math.cos(yaw)
    sr, sp, sy = math.sin(roll), math.sin(pitch), math.sin(yaw)
    return VehicleAttitude(
        received_s=received_s,
        vehicle_s=fields["time_boot_ms"] / 1000.0,
        q_wxyz=(
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
    )


def manager_limits(fields: Mapping[str, Any]) -> GimbalLimits | None:
    """Limits from GIMBAL_MANAGER_INFORMATION (280, radians; yaw relative to the vehicle); None if it has none."""
    low, high, left, right = (
        # single precision radians: a limit of -90° must not come out as -89.999996°
        round(math.degrees(number(fields[key])), 3)
        for key in ("pitch_min", "pitch_max", "yaw_min", "yaw_max")
    )
    # a manager that knows no limits sends zeros or NaN; a gimbal without a pan axis says so in its capability flags
    capabilities = int(fields.get("cap_flags") or 0)
    if capabilities and not capabilities & HAS_YAW_AXIS and not left < right:
        left = right = 0.0
    elif not left < right:
        return None
    if not (math.isfinite(low + high + left + right) and low < high):
        return None
    return GimbalLimits(
        pitch_min_deg=low,
        pitch_max_deg=high,
        yaw_min_deg=left,
        yaw_max_deg=right,
        # some managers send 3.14 rad for π
        yaw_endless=right - left >= 359.5,
    )


def interpolate(earlier: VehicleAttitude, later: VehicleAttitude, fraction: float) -> VehicleAttitude:
    """The attitude `fraction` of the way between neighbours a few degrees apart, along the chord of their quaternions.

    Args:
        earlier: at fraction 0.
        later: at fraction 1.
        fraction: [0, 1]; up to 2 continues beyond the later one.
    """
    a, b = earlier, later
    sign = 1.0 if sum(p * q for p, q in zip(a.q_wxyz, b.q_wxyz, strict=True)) >= 0 else -1.0
    w, x, y, z = (p + (sign * q - p) * fraction for p, q in zip(a.q_wxyz, b.q_wxyz, strict=True))
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return VehicleAttitude(
        received_s=a.received_s + (b.received_s - a.received_s) * fraction,
        vehicle_s=a.vehicle_s + (b.vehicle_s - a.vehicle_s) * fraction,
        q_wxyz=(w / norm, x / norm, y / norm, z / norm) if norm > 1e-6 else _UNKNOWN,
    )
