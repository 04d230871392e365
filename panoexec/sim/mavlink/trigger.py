"""A camera on a servo or relay of the autopilot (ArduPilot's CAM1_TYPE 1): no name, no size, no evidence but a count.

The autopilot (component 1) answers for it: CAMERA_INFORMATION without contents, and CAMERA_FEEDBACK (180) at the
trigger, with the vehicle's attitude. Photos are exposed and rendered as usual. With CAM1_INTRVAL_MIN the autopilot
keeps a trigger that comes too early and carries it out later, whatever it answered: one at most, as ArduPilot does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.camera_component import Fix, apply_drift_fault, gimbal_state
from panoexec.sim.mavlink.component import NAN, Builder, Command
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.photo_command import PhotoCommand
from panoexec.sim.mavlink.wire import Message
from panoexec.sim.physics.airframe import Airframe
from panoexec.sim.physics.camera import CameraModel, Exposure
from panoexec.sim.physics.gimbal import GimbalPhysics
from panoexec.sim.physics.world import SimClock, Timeline


class CameraTrigger:
    """Closes a contact and reports it.

    Attributes:
        commands: the commands that it handles.
        model: the camera at the other end of the wire.
    """

    commands = frozenset(
        {
            mavlink.MAV_CMD_IMAGE_START_CAPTURE,
            mavlink.MAV_CMD_IMAGE_STOP_CAPTURE,
            mavlink.MAV_CMD_DO_DIGICAM_CONTROL,
        }
    )

    def __init__(
        self,
        config: SimConfig,
        *,
        clock: SimClock,
        timeline: Timeline,
        physics: GimbalPhysics,
        faults: Faults,
        develop: Callable[[Exposure, Fix], str],
    ) -> None:
        self._clock = clock
        self._timeline = timeline
        self._physics = physics
        self._faults = faults
        self._develop = develop
        self._count = 0
        self._config = config.camera
        self._triggered_s = -math.inf
        self._is_deferred = False
        self._last_photo: PhotoCommand | None = None
        self._last_feedback = mavlink.MAVLink_camera_feedback_message(*(0,) * 13, 0)
        self._boot_ms: Callable[[], int] = lambda: 0
        self._airframe: Airframe | None = None
        self._send: Callable[[Message], None] = lambda _: None
        self.model = CameraModel(
            config.camera,
            timeline,
            look=lambda: gimbal_state(physics, timeline.now_s),
            on_exposed=self._exposed,
            seed=config.seed,
        )

    def connect(self, *, boot_ms: Callable[[], int], airframe: Airframe, send: Callable[[Message], None]) -> None:
        """Connect it to its autopilot."""
        self._boot_ms, self._airframe, self._send = boot_ms, airframe, send

    def builders(self) -> dict[int, Builder]:
        """The messages that the autopilot sends on its behalf."""
        return {
            mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION: self._information,
            mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS: self._settings,
            mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: self._capture_status,
            mavlink.MAVLINK_MSG_ID_CAMERA_FEEDBACK: lambda: self._last_feedback,
        }

    def command(self, command: Command) -> int | None:
        """Trigger; the command is accepted whether or not a photo results."""
        if not self._is_trigger(command):
            return int(mavlink.MAV_RESULT_ACCEPTED)
        now, last = self._timeline.now_s, self._last_photo
        if last is not None and last.is_repeated_by(command, (now - last.sent_s) / self._clock.speedup):
            self._last_photo = replace(last, sent_s=now, repeats=last.repeats + 1)
            return last.result
        self._faults.photo_commanded(now)
        result = self._trigger()
        self._last_photo = PhotoCommand(command=command, sent_s=now, result=result)
        return result

    @staticmethod
    def _is_trigger(command: Command) -> bool:
        """Whether a command of `commands` asks for a photo."""
        if command.id == mavlink.MAV_CMD_DO_DIGICAM_CONTROL:
            return command.params[4] >= 0.5
        return command.id == int(mavlink.MAV_CMD_IMAGE_START_CAPTURE)

    def _trigger(self) -> int | None:
        if self._faults.photo("photo-lost"):
            return None
        if self._faults.photo("photo-refused"):
            return int(mavlink.MAV_RESULT_DENIED)
        wait_s = self._triggered_s + self._config.trigger_min_s - self._timeline.now_s
        if self._config.trigger_min_s and wait_s > 0:
            if not self._is_deferred:
                self._is_deferred = True
                self._timeline.after(wait_s, self._deferred)
            fails = self._config.trigger_fails
            return int(mavlink.MAV_RESULT_FAILED if fails else mavlink.MAV_RESULT_ACCEPTED)
        self._close_contact()
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _deferred(self) -> None:
        self._is_deferred = False
        self._close_contact()

    def _close_contact(self) -> None:
        """Trigger the camera now, and report that."""
        self._triggered_s = self._timeline.now_s
        self._count += 1
        self.model.shoot()
        apply_drift_fault(self._faults, self._physics)
        if not self._faults.photo("capture-lost"):
            message = self._last_feedback = self._feedback()
            self._send(message)
            if self._faults.photo("capture-twice"):
                self._timeline.after(0.2, lambda: self._send(message))

    def _feedback(self) -> Message:
        """The message that reports the trigger."""
        assert self._airframe is not None
        position, state = self._airframe.position(), self._airframe.state()
        yaw = (state.yaw_deg + self._physics.heading_error_deg) % 360
        return mavlink.MAVLink_camera_feedback_message(
            round(self._clock.utc(self._timeline.now_s) * 1e6),
            0,
            0,
            self._count,
            round(position.latitude_deg * 1e7),
            round(position.longitude_deg * 1e7),
            position.altitude_m,
            position.relative_altitude_m,
            state.roll_deg,
            state.pitch_deg,
            yaw,
            0.0,
            mavlink.CAMERA_FEEDBACK_PHOTO,
            self._count,
        )

    def _exposed(self, exposure: Exposure) -> None:
        assert self._airframe is not None
        position = self._airframe.position()
        self._develop(
            exposure,
            Fix(
                latitude_deg=position.latitude_deg,
                longitude_deg=position.longitude_deg,
                altitude_m=position.altitude_m,
                relative_altitude_m=position.relative_altitude_m,
                heading_deg=math.nan,
            ),
        )

    def _information(self) -> Message:
        return mavlink.MAVLink_camera_information_message(
            self._boot_ms(),
            [0] * 32,
            [0] * 32,
            0,
            NAN,
            NAN,
            NAN,
            0,
            0,
            0,
            0,
            0,
            b"",
            gimbal_device_id=1,
        )

    def _settings(self) -> Message:
        return mavlink.MAVLink_camera_settings_message(self._boot_ms(), mavlink.CAMERA_MODE_IMAGE, NAN, NAN)

    def _capture_status(self) -> Message:
        return mavlink.MAVLink_camera_capture_status_message(self._boot_ms(), 0, 0, 0.0, 0, NAN, self._count)
