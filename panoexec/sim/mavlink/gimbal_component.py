"""The gimbal as a MAVLink gimbal device (component 154), protocol version 2.

Sources: MAVLink common.xml, messages 283 to 286 and GIMBAL_DEVICE_FLAGS.
"""

from __future__ import annotations

import math

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.component import NAN, Command, Component, bitmask, command_of
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.gimbal_beside import own_manager
from panoexec.sim.mavlink.held_up import HeldUp
from panoexec.sim.mavlink.mount_reports import stepped
from panoexec.sim.mavlink.wire import Link, Message, Sender
from panoexec.sim.physics.gimbal import Angles, GimbalPhysics, Rates, Target, angles_of, body_rates, quaternion
from panoexec.sim.physics.world import Repeater, Timeline

COMPONENT_ID = mavlink.MAV_COMP_ID_GIMBAL
VENDOR, MODEL = "panoexec", "simulated gimbal"
_LIMIT_MARGIN_DEG = 0.05
"""ArduPilot truncates the limits to whole degrees: an exact -90 would become -89 and exclude the nadir."""
_UID = 0x50414E4F0154

_CAPABILITIES = bitmask(
    getattr(mavlink, f"GIMBAL_DEVICE_CAP_FLAGS_{name}")
    for name in (
        "HAS_NEUTRAL",
        "HAS_ROLL_AXIS",
        "HAS_ROLL_LOCK",
        "HAS_PITCH_AXIS",
        "HAS_PITCH_LOCK",
        "HAS_YAW_AXIS",
        "HAS_YAW_FOLLOW",
        "HAS_YAW_LOCK",
    )
)
_PAN = bitmask(getattr(mavlink, f"GIMBAL_DEVICE_CAP_FLAGS_HAS_YAW_{name}") for name in ("AXIS", "FOLLOW", "LOCK"))
_FRAME_VEHICLE = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
_FRAME_EARTH = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
_LOCK_YAW = mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
_LOCKS_LEVEL = mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK


class GimbalComponent:
    """Executes GIMBAL_DEVICE_SET_ATTITUDE and streams its measured attitude relative to the vehicle's nose.

    Attributes:
        physics: the gimbal's mechanics.
        vehicle_yaw_deg: the heading last received from the autopilot (286), NaN before; and its rate, deg/s.
    """

    def __init__(
        self, config: SimConfig, *, timeline: Timeline, physics: GimbalPhysics, faults: Faults, link: Link
    ) -> None:
        self.physics = physics
        self.vehicle_yaw_deg = NAN
        self.vehicle_yaw_rate_deg_s = 0.0
        self.vehicle_yaw_time_s = 0.0
        self._timeline = timeline
        self._faults = faults
        self._boot_s = config.payload_boot_s
        self._component = Component(
            timeline=timeline, sender=Sender(config.system_id, COMPONENT_ID), link=link, heartbeat=self._heartbeat
        )
        self._component.builders.update(
            {
                mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION: self._information,
                mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: self.attitude_status,
            }
        )
        self._attitude_stream = Repeater(timeline, self._stream_attitude)
        self._manager = own_manager(
            config, component=self._component, physics=physics, timeline=timeline, obey=self._obey
        )
        self._held_up = HeldUp(faults)
        self._frozen: Angles | None = None
        self._frozen_nose_deg = 0.0

    def start(self) -> None:
        """Start the heartbeat and the attitude stream; a gimbal device sends both without a request."""
        self._component.start(phase_s=0.3)
        self._attitude_stream.start(1 / self.physics.config.report_hz)
        if self._manager is not None:
            self._manager.start()

    def measured(self) -> Angles:
        """A measurement at this moment, yaw relative to the vehicle's nose; includes the effects of faults."""
        now = self._timeline.now_s
        if self._faults.active("attitude-nan", now):
            return Angles(NAN, NAN, NAN)
        if self._faults.active("attitude-frozen", now):
            if self._frozen is None:
                self._frozen, self._frozen_nose_deg = self._fresh(), self.physics.nose_deg
            return self._frozen
        self._frozen = None
        return self._fresh()

    def _fresh(self) -> Angles:
        c = self.physics.config
        if c.report_target:
            target = self.physics.target
            nose = self.physics.nose_deg if target.yaw_lock else 0.0
            return Angles(target.yaw_deg - nose, target.roll_deg, target.pitch_deg)
        yaw, roll, pitch = stepped(self.physics.measure(), c.report_step_deg)
        return Angles(yaw - self.physics.nose_deg, roll, pitch)

    def receive(self, message: Message) -> None:
        """Handle a message."""
        kind = message.get_type()
        if kind == "GIMBAL_DEVICE_SET_ATTITUDE":
            if self._component.is_for_me(message):
                self._obey(message)
        elif kind == "AUTOPILOT_STATE_FOR_GIMBAL_DEVICE":
            if self._component.is_for_me(message):
                w, x, y, z = message.q
                self.vehicle_yaw_deg = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
                rate = getattr(message, "angular_velocity_z", 0.0)
                self.vehicle_yaw_rate_deg_s = math.degrees(rate) if math.isfinite(rate) else 0.0
                self.vehicle_yaw_time_s = self._timeline.now_s
        elif (command := command_of(message)) is not None and (
            self._component.is_addressed(message) or self._component.is_request_to_all(message)
        ):
            self._command(command)

    def _command(self, command: Command) -> None:
        result = self._rate(command)
        if result is None and self._manager is not None:
            result = self._manager.command(command)
        if result is not None:
            self._component.acknowledge(command, result)
            return
        result = self._component.common_command(command, unknown_message=mavlink.MAV_RESULT_UNSUPPORTED)
        self._component.acknowledge(command, mavlink.MAV_RESULT_UNSUPPORTED if result is None else result)

    def _rate(self, command: Command) -> int | None:
        """SET_MESSAGE_INTERVAL of its attitude stream: 0 is its own rate, -1 stops it; None for other commands."""
        number, interval_us = int(command.params[0]), command.params[1]
        is_rate = command.id == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        if not is_rate or number != mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS:
            return None
        if not self.physics.config.report_obeys:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        if interval_us < 0:
            self._attitude_stream.stop()
        else:
            self._attitude_stream.start(interval_us / 1e6 if interval_us else 1 / self.physics.config.report_hz)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _obey(self, message: Message) -> None:
        flags = message.flags
        if flags & (mavlink.GIMBAL_DEVICE_FLAGS_NEUTRAL | mavlink.GIMBAL_DEVICE_FLAGS_RETRACT):
            self.physics.command(Target())
            return
        lock = bool(flags & _LOCK_YAW)
        earth = bool(flags & _FRAME_EARTH) or (lock and not flags & _FRAME_VEHICLE)
        q = tuple(message.q)
        if all(math.isfinite(part) for part in q) and sum(part * part for part in q) > 0.5:
            yaw, roll, pitch = angles_of(q)
            if lock and earth:
                yaw -= self.physics.config.north_off_deg
            elif lock:
                yaw += self.physics.nose_deg
            elif earth and not lock:
                yaw -= self.physics.nose_deg
            self.physics.command(Target(pitch_deg=pitch, roll_deg=roll, yaw_deg=yaw, yaw_lock=lock))
            return
        rates = (message.angular_velocity_z, message.angular_velocity_x, message.angular_velocity_y)
        if any(math.isfinite(rate) for rate in rates):
            yaw_s, roll_s, pitch_s = (math.degrees(rate) if math.isfinite(rate) else 0.0 for rate in rates)
            self.physics.command(Target(yaw_lock=lock, rates=Rates(yaw_s, roll_s, pitch_s)))

    def _stream_attitude(self) -> None:
        now_s = self._timeline.now_s
        message = self._held_up.passed(self.attitude_status(), now_s)
        if message is not None and not self._faults.active("attitude-stop", now_s):
            self._component.send(message)

    def _boot_ms(self) -> int:
        return max(0, round((self._timeline.now_s - self._boot_s) * 1000))

    def _heartbeat(self) -> Message:
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )

    def attitude_status(self) -> Message:
        """GIMBAL_DEVICE_ATTITUDE_STATUS (285) at this moment: angles and rates relative to the vehicle's nose."""
        measured, lock = self.measured(), self.physics.target.yaw_lock
        nose_deg = self.physics.nose_deg if self._frozen is None else self._frozen_nose_deg
        turning = self.vehicle_yaw_rate_deg_s
        yaw_s, roll_s, pitch_s = self.physics.measure_rates()
        relative_s = yaw_s - turning if self.physics.config.pans else 0.0
        rates = body_rates(measured, Rates(relative_s, roll_s, pitch_s))
        frame, off_deg = _FRAME_VEHICLE, self.physics.config.north_off_deg
        if off_deg:
            frame, nose_deg = _FRAME_EARTH, nose_deg + off_deg
            measured = Angles(measured.yaw_deg + nose_deg, measured.roll_deg, measured.pitch_deg)
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            0,
            0,
            self._boot_ms(),
            _LOCKS_LEVEL | frame | (_LOCK_YAW if lock else 0),
            quaternion(measured),
            *rates,
            0,
            math.radians((nose_deg + 180) % 360 - 180),
            math.radians(turning),
            0,
        )

    def _information(self) -> Message:
        c = self.physics.config
        limits = (c.roll.min_deg, c.roll.max_deg, c.pitch.min_deg, c.pitch.max_deg)
        yaw = (-180.0, 180.0) if c.yaw_endless else (c.yaw.min_deg, c.yaw.max_deg)
        return mavlink.MAVLink_gimbal_device_information_message(
            self._boot_ms(),
            VENDOR.encode(),
            MODEL.encode(),
            b"",
            0x00000001,
            0x00000001,
            _UID,
            _CAPABILITIES if c.pans else _CAPABILITIES & ~_PAN,
            0,
            *(math.radians(limit + math.copysign(_LIMIT_MARGIN_DEG, limit)) for limit in (*limits, *yaw)),
            0,
        )
