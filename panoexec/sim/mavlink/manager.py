"""The autopilot's gimbal manager (MAVLink gimbal protocol v2), as implemented by ArduPilot and PX4.

Differences: ArduPilot numbers its gimbal 1, is the only one to answer for it, and accepts setpoints from anybody,
whoever is in control; PX4 uses the device's component id and denies commands of senders that are not in control.
ArduPilot sends the target to the device continuously, and forwards its attitude under its own id on request.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.component import NAN, Command, bitmask
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.mount_reports import DriverReports, demanded
from panoexec.sim.mavlink.wire import Message
from panoexec.sim.physics.airframe import AirframeState
from panoexec.sim.physics.gimbal import Angles, GimbalPhysics, Rates, Target, angles_of, quaternion

_LOCK_YAW = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
_LEVEL = mavlink.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | mavlink.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
_PAN = bitmask(getattr(mavlink, f"GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_{name}") for name in ("AXIS", "FOLLOW", "LOCK"))
_AHEAD = mavlink.GIMBAL_MANAGER_FLAGS_NEUTRAL | mavlink.GIMBAL_MANAGER_FLAGS_RETRACT
_CAPABILITIES = bitmask(
    getattr(mavlink, f"GIMBAL_MANAGER_CAP_FLAGS_{name}")
    for name in (
        "HAS_RETRACT",
        "HAS_NEUTRAL",
        "HAS_ROLL_AXIS",
        "HAS_ROLL_FOLLOW",
        "HAS_ROLL_LOCK",
        "HAS_PITCH_AXIS",
        "HAS_PITCH_FOLLOW",
        "HAS_PITCH_LOCK",
        "HAS_YAW_AXIS",
        "HAS_YAW_FOLLOW",
        "HAS_YAW_LOCK",
        "HAS_RC_INPUTS",
        "CAN_POINT_LOCATION_LOCAL",
        "CAN_POINT_LOCATION_GLOBAL",
    )
)


class GimbalManager:
    """Gimbal control, setpoint, and reports.

    Attributes:
        primary: (system, component) in control, (0, 0) = none.
    """

    def __init__(
        self,
        config: SimConfig,
        *,
        physics: GimbalPhysics,
        boot_ms: Callable[[], int],
        airframe_state: Callable[[], AirframeState] | None,
        to_device: Callable[[Message], None] | None,
        changed: Callable[[Message], None],
        device_id: int | None = None,
    ) -> None:
        """Create it.

        Args:
            config: of the vehicle.
            physics: the gimbal's mechanics.
            boot_ms: milliseconds since the boot of its component.
            airframe_state: attitude of the vehicle, for demanded angles; None: not needed.
            to_device: sends a message to the gimbal device; None: it drives the gimbal directly.
            changed: takes a status that changed.
            device_id: gimbal device id; None: as the autopilot numbers it.
        """
        self._own_device_id = device_id
        self._driver = DriverReports(config.gimbal, physics=physics, now=lambda: boot_ms() / 1000)
        self._config = config
        self._physics = physics
        self._boot_ms = boot_ms
        self._airframe_state = airframe_state
        self._to_device = to_device
        self._changed = changed
        self._target = Target()
        self._device_flags = 0
        self._reported: tuple[float, ...] | None = None
        self._device_information: Message | None = None
        self._device_rates: tuple[float, float, float] = (NAN, NAN, NAN)
        self.primary = (0, 0)

    @property
    def _is_px4(self) -> bool:
        return self._config.autopilot == "px4"

    @property
    def device_id(self) -> int:
        """The gimbal device id in the manager's messages."""
        if self._own_device_id is not None:
            return self._own_device_id
        return int(mavlink.MAV_COMP_ID_GIMBAL) if self._is_px4 and self._to_device else 1

    def forget(self) -> None:
        """Reset at a reboot of the autopilot: nobody is in control, the gimbal points ahead."""
        self.primary = (0, 0)
        self._target = Target()
        self._reported = None
        self.send_target()

    def command(self, command: Command) -> int:
        """DO_GIMBAL_MANAGER_PITCHYAW and DO_GIMBAL_MANAGER_CONFIGURE; MAV_RESULT."""
        if not self._is_px4 and int(command.params[6]) not in (0, self.device_id):
            return int(mavlink.MAV_RESULT_FAILED)
        if command.id == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE:
            return self._configure(command)
        if self._is_px4 and self.primary != command.sender:
            return int(mavlink.MAV_RESULT_DENIED)
        pitch, yaw, pitch_rate, yaw_rate = command.params[:4]
        flags = int(command.params[4])
        return self._point(pitch, yaw, pitch_rate, yaw_rate, flags)

    def set_pitchyaw(self, message: Message) -> None:
        """GIMBAL_MANAGER_SET_PITCHYAW (287): as the command, in radians, without acknowledgement; unknown to PX4."""
        if not self._is_px4:
            angles = (math.degrees(a) for a in (message.pitch, message.yaw, message.pitch_rate, message.yaw_rate))
            pitch, yaw, pitch_rate, yaw_rate = angles
            self._point(pitch, yaw, pitch_rate, yaw_rate, message.flags)

    def set_attitude(self, message: Message) -> None:
        """GIMBAL_MANAGER_SET_ATTITUDE (282); as in ArduPilot, the quaternion is converted to pitch and yaw."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if self._is_px4 and self.primary != sender:
            return
        if all(math.isfinite(part) for part in message.q):
            w, x, y, z = message.q
            pitch = math.degrees(math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0)))
            yaw = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
            self._point(pitch, yaw, NAN, NAN, message.flags)
        else:
            pitch_rate, yaw_rate = message.angular_velocity_y, message.angular_velocity_z
            self._point(NAN, NAN, math.degrees(pitch_rate), math.degrees(yaw_rate), message.flags)

    def _configure(self, command: Command) -> int:
        system, component = command.params[0], command.params[1]
        before = self.primary
        if math.isnan(system) or not -3 <= system <= 255 or not -3 <= component <= 255:
            return int(mavlink.MAV_RESULT_FAILED)
        if self._is_px4:
            # each on its own; -2 means the autopilot itself
            pairs = zip(self.primary, (system, component), command.sender, (self._config.system_id, 1), strict=True)
            first, second = (_px4_control(*pair) for pair in pairs)
            self.primary = first, second
        elif system == -2:
            self.primary = command.sender
        elif system == -3:
            if self.primary == command.sender:
                self.primary = (0, 0)
        elif system >= 0:
            self.primary = (int(system), int(component))
        if self.primary != before:
            self._changed(self.status())
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _point(self, pitch: float, yaw: float, pitch_rate: float, yaw_rate: float, flags: int) -> int:
        """Angles or rates, degrees; MAV_RESULT."""
        limits = self._physics.config.pitch
        if flags & _AHEAD:
            self._target = Target()
        elif not (math.isnan(pitch) or math.isnan(yaw)):
            # beyond the limits: accepted and clipped, without notice
            pitch = min(max(pitch, limits.min_deg), limits.max_deg)
            self._target = Target(pitch_deg=pitch, yaw_deg=yaw, yaw_lock=bool(flags & _LOCK_YAW))
        elif not (math.isnan(pitch_rate) or math.isnan(yaw_rate)):
            self._target = Target(yaw_lock=bool(flags & _LOCK_YAW), rates=Rates(yaw_rate, 0.0, pitch_rate))
        elif not (math.isnan(pitch_rate) and math.isnan(yaw_rate) and math.isnan(pitch) and math.isnan(yaw)):
            return int(mavlink.MAV_RESULT_FAILED)
        self.send_target()
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def take(self) -> None:
        """The autopilot takes the gimbal."""
        self.primary = (self._config.system_id, int(mavlink.MAV_COMP_ID_AUTOPILOT1))
        self._changed(self.status())

    def drop(self) -> None:
        """The autopilot gives up the gimbal, if it has it."""
        if self.primary == (self._config.system_id, int(mavlink.MAV_COMP_ID_AUTOPILOT1)):
            self.primary = (0, 0)
            self._changed(self.status())

    def steal(self, station: tuple[int, int]) -> None:
        """Another station takes control and points the gimbal ahead (fault)."""
        self.primary = station
        self._target = Target()
        self.send_target()
        self._changed(self.status())

    def send_target(self) -> None:
        """Send the target to the device: GIMBAL_DEVICE_SET_ATTITUDE (284), or to the servos directly."""
        target = self._target
        if self._to_device is None:
            self._physics.command(target)
            return
        lock = target.yaw_lock
        flags = (_LEVEL | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK) if lock else 0
        rates = target.rates
        q = (NAN,) * 4 if rates else quaternion(Angles(target.yaw_deg, target.roll_deg, target.pitch_deg))
        speed = (
            (math.radians(rates.roll_deg_s), math.radians(rates.pitch_deg_s), math.radians(rates.yaw_deg_s))
            if rates
            else (NAN, NAN, NAN)
        )
        self._to_device(
            mavlink.MAVLink_gimbal_device_set_attitude_message(
                self._config.system_id, mavlink.MAV_COMP_ID_GIMBAL, flags, q, *speed
            )
        )

    def poll_driver(self) -> None:
        """The driver of a mount without a component gets the gimbal's angles."""
        self._driver.poll()

    def device_reported(self, message: Message) -> None:
        """GIMBAL_DEVICE_INFORMATION (283) or _ATTITUDE_STATUS (285); only those of the first gimbal are of interest."""
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_GIMBAL:
            return
        if message.get_type() == "GIMBAL_DEVICE_INFORMATION":
            self._device_information = message
        if message.get_type() != "GIMBAL_DEVICE_ATTITUDE_STATUS":
            return
        w, x, y, z = message.q
        self._reported = (w, x, y, z)
        if message.flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME and math.isfinite(message.delta_yaw):
            yaw, roll, pitch = angles_of((w, x, y, z))
            self._reported = quaternion(Angles(yaw - math.degrees(message.delta_yaw), roll, pitch))

    def attitude_status(self) -> Message | None:
        """GIMBAL_DEVICE_ATTITUDE_STATUS under the autopilot's id: the device's last one, or the servos' demand."""
        if self._config.mount == "echo":
            return self._echo()
        if self._is_px4 and self._config.mount == "mavlink":
            return None  # only the device's own reports are forwarded
        if self._config.mount == "driver":
            q = self._driver.latest()
        else:
            q = self._reported if self._to_device is not None else self._demanded()
        if q is None:
            return None
        flags = _LEVEL | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
        if self._target.yaw_lock:
            flags |= mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, self._boot_ms(), flags, q, NAN, NAN, NAN, 0, NAN, NAN, self.device_id
        )

    def _echo(self) -> Message:
        """The demanded angles; PX4 sets no frame flag, so that the lock of the yaw tells the frame."""
        flags = _LEVEL | (0 if self._is_px4 else mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME)
        if self._target.yaw_lock:
            flags |= mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
        q = demanded(self._target, self._physics.nose_deg, earth=self._is_px4 and self._target.yaw_lock)
        rates = (0.0,) * 3 if self._is_px4 else (NAN,) * 3
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, self._boot_ms(), flags, q, *rates, 0, NAN, NAN, self.device_id
        )

    def _demanded(self) -> tuple[float, ...]:
        """The servo angles that point the camera at the setpoint, relative to the *airframe*: not measured."""
        assert self._airframe_state is not None
        target, state = self._target, self._airframe_state()
        # the servo mount reports no rate: while it moves at a rate, its demand is the current angle
        physics = self._physics.estimate
        pitch = physics.pitch_deg if target.rates else target.pitch_deg
        yaw = (physics.yaw_deg if target.rates else target.yaw_deg) - (
            self._physics.nose_deg if target.yaw_lock or target.rates else 0.0
        )
        if not self._physics.config.pans:
            yaw = 0.0
        bearing = math.radians(yaw)
        lean_roll = state.roll_deg * math.cos(bearing) + state.pitch_deg * math.sin(bearing)
        lean_pitch = state.pitch_deg * math.cos(bearing) - state.roll_deg * math.sin(bearing)
        return _euler_quaternion(-lean_roll, pitch - lean_pitch, yaw)

    def device_information(self) -> Message | None:
        """GIMBAL_DEVICE_INFORMATION of the device under the autopilot's id, as PX4 answers; None before it was told."""
        told = self._device_information
        if told is None:
            return None
        names = told.get_fieldnames()
        fields = {name: getattr(told, name) for name in names} | {"gimbal_device_id": self.device_id}
        for name in ("vendor_name", "model_name", "custom_name"):
            fields[name] = fields[name].encode()
        return mavlink.MAVLink_gimbal_device_information_message(**fields)

    def information(self) -> Message:
        """GIMBAL_MANAGER_INFORMATION (280): limits in radians."""
        c = self._physics.config
        yaw = (-180.0, 180.0) if c.yaw_endless else (c.yaw.min_deg, c.yaw.max_deg)
        limits = (c.roll.min_deg, c.roll.max_deg, c.pitch.min_deg, c.pitch.max_deg, *yaw)
        return mavlink.MAVLink_gimbal_manager_information_message(
            self._boot_ms(),
            _CAPABILITIES if c.pans else _CAPABILITIES & ~_PAN,
            self.device_id,
            *(math.radians(limit) for limit in limits),
        )

    def status(self) -> Message:
        """GIMBAL_MANAGER_STATUS (281)."""
        flags = _LEVEL | (_LOCK_YAW if self._is_px4 and self._target.yaw_lock else 0)
        return mavlink.MAVLink_gimbal_manager_status_message(
            self._boot_ms(), flags, self.device_id, *self.primary, 0, 0
        )


def _px4_control(now: int, asked: float, sender: int, own: int) -> int:
    """System or component in control after a request: -1 leaves it, -2 is the autopilot's, -3 gives up the sender's."""
    if asked == -1 or (asked == -3 and now != sender):
        return now
    return own if asked == -2 else 0 if asked == -3 else int(asked)


def _euler_quaternion(roll_deg: float, pitch_deg: float, yaw_deg: float) -> tuple[float, ...]:
    """`[w, x, y, z]` of 3-2-1 angles, the convention of autopilots."""
    half = math.pi / 360
    cr, sr = math.cos(roll_deg * half), math.sin(roll_deg * half)
    cp, sp = math.cos(pitch_deg * half), math.sin(pitch_deg * half)
    cy, sy = math.cos(yaw_deg * half), math.sin(yaw_deg * half)
    return (
        cy * cp * cr + sy * sp * sr,
        cy * cp * sr - sy * sp * cr,
        sy * cp * sr + cy * sp * cr,
        sy * cp * cr - cy * sp * sr,
    )
