"""The camera as a MAVLink camera (component 100, or 101 beside another one), camera protocol version 2.

Sources: MAVLink common.xml, messages 259 to 263, MAV_CMD_IMAGE_START_CAPTURE (2000).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.camera_settings import CameraSettings
from panoexec.sim.mavlink.component import NAN, Command, Component, bitmask, command_of, padded
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.ftp_server import ftp_server_of
from panoexec.sim.mavlink.gimbal_component import GimbalComponent
from panoexec.sim.mavlink.photo_command import PhotoCommand
from panoexec.sim.mavlink.wire import Link, Message, Sender
from panoexec.sim.photos.exposure import Settings
from panoexec.sim.physics.camera import CameraModel, Exposure, GimbalState, Refusal
from panoexec.sim.physics.following import TIME_RESOLUTION_S
from panoexec.sim.physics.gimbal import Angles, GimbalPhysics, quaternion
from panoexec.sim.physics.world import SimClock, Timeline

COMPONENT_ID = mavlink.MAV_COMP_ID_CAMERA
BESIDE_ID = mavlink.MAV_COMP_ID_CAMERA2
"""Its component where another one is component 100."""
VENDOR = "panoexec"
_URL_BYTES = 205
_POSITION_INTERVAL_US = 200_000
_POSITION_LOST_S = 3.0
_DRIFT_HOLD_S = 0.7

_OLD_REQUESTS = {
    mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION: mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    mavlink.MAV_CMD_REQUEST_CAMERA_SETTINGS: mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    mavlink.MAV_CMD_REQUEST_STORAGE_INFORMATION: mavlink.MAVLINK_MSG_ID_STORAGE_INFORMATION,
    mavlink.MAV_CMD_REQUEST_CAMERA_CAPTURE_STATUS: mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
}
"""Commands that preceded MAV_CMD_REQUEST_MESSAGE, which some programs still send."""

_REFUSALS = {
    Refusal.BUSY: mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    Refusal.STORAGE_FULL: mavlink.MAV_RESULT_FAILED,
    Refusal.FAULT: mavlink.MAV_RESULT_DENIED,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Fix:
    """Position of the camera as received from the autopilot."""

    latitude_deg: float = 0.0
    longitude_deg: float = 0.0
    altitude_m: float = 0.0
    relative_altitude_m: float = 0.0
    heading_deg: float = NAN


class Develop(Protocol):
    """Makes a photo of an exposure."""

    def __call__(self, exposure: Exposure, fix: Fix, settings: Settings | None = None, /) -> str:
        """Returns the URL of its file."""
        ...


class CameraComponent:
    """Takes photos on command, reports each photo, and reports its storage.

    Attributes:
        model: the camera's behaviour.
        fix: the newest position received from the autopilot.
    """

    def __init__(
        self,
        config: SimConfig,
        *,
        clock: SimClock,
        timeline: Timeline,
        gimbal: GimbalComponent,
        faults: Faults,
        link: Link,
        develop: Develop,
        definition_uri: str = "",
    ) -> None:
        self._definition_uri = definition_uri
        self._config = config.camera
        self._boot_s = config.payload_boot_s
        self._clock = clock
        self._timeline = timeline
        self._gimbal = gimbal
        self._faults = faults
        self._develop = develop
        self._system_id = config.system_id
        self._captured: dict[int, Message] = {}
        self._booted_s = self._boot_s
        self._mode = mavlink.CAMERA_MODE_VIDEO if config.camera.starts_in_video else mavlink.CAMERA_MODE_IMAGE
        self._last_photo: PhotoCommand | None = None
        self._sequence_left = 0
        self._is_there = False
        self._actions: dict[int, Callable[[Command], int | None]] = {
            mavlink.MAV_CMD_IMAGE_START_CAPTURE: self._start_capture,
            mavlink.MAV_CMD_IMAGE_STOP_CAPTURE: self._stop_capture,
            mavlink.MAV_CMD_SET_CAMERA_MODE: self._set_mode,
            mavlink.MAV_CMD_REQUEST_CAMERA_IMAGE_CAPTURE: lambda command: self._again(int(command.params[0])),
        }
        self.fix = Fix()
        self._fix_s = -math.inf
        self.model = CameraModel(
            config.camera,
            timeline,
            look=lambda: gimbal_state(gimbal.physics, timeline.now_s),
            on_exposed=self._exposed,
            time_resolution_s=0.0 if config.attach_url is None else TIME_RESOLUTION_S,
            seed=config.seed,
        )
        component = COMPONENT_ID if config.camera_beside == "none" else BESIDE_ID
        self._component = Component(
            timeline=timeline, sender=Sender(config.system_id, component), link=link, heartbeat=self._heartbeat
        )
        self._ftp = ftp_server_of(config, self._component)
        self._camera_settings = None if config.camera.definition == "none" else CameraSettings(self._component)
        self._component.builders.update(
            {
                mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION: self._information,
                mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS: self._settings,
                mavlink.MAVLINK_MSG_ID_STORAGE_INFORMATION: self._storage,
                mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: self._capture_status,
            }
        )

    def start(self) -> None:
        """Start the heartbeat."""
        self._is_there = True
        self._component.start(phase_s=0.6)

    def set_storage_full(self, *, full: bool) -> None:
        """Fill the storage, or free it; STORAGE_INFORMATION (261) is sent at every change, as the protocol demands."""
        if full != self.model.storage_full:
            self.model.storage_full = full
            if self._is_there:
                self._component.send(self._storage())

    def receive(self, message: Message) -> None:
        """Handle a message."""
        kind = message.get_type()
        if kind == "GLOBAL_POSITION_INT" and message.get_srcSystem() == self._system_id:
            self._fix_s = self._timeline.now_s
            self.fix = Fix(
                latitude_deg=message.lat * 1e-7,
                longitude_deg=message.lon * 1e-7,
                altitude_m=message.alt * 1e-3,
                relative_altitude_m=message.relative_alt * 1e-3,
                heading_deg=message.hdg * 1e-2,
            )
        elif kind == "HEARTBEAT":
            # a reboot resets the autopilot's message intervals: request the position again
            lost = self._timeline.now_s - self._fix_s > _POSITION_LOST_S
            if lost and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1:
                self._ask_for_position()
        elif kind == "FILE_TRANSFER_PROTOCOL" and self._ftp is not None:
            self._ftp.receive(message)
        elif kind.startswith("PARAM_EXT_") and self._camera_settings is not None:
            self._camera_settings.receive(message)
        elif self._component.is_addressed(message) and (command := command_of(message)) is not None:
            result = self._command(command)
            if result is not None:
                self._component.acknowledge(command, result)

    def _ask_for_position(self) -> None:
        self._component.send(
            mavlink.MAVLink_command_long_message(
                self._system_id,
                mavlink.MAV_COMP_ID_AUTOPILOT1,
                mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                0,
                mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
                _POSITION_INTERVAL_US,
                0,
                0,
                0,
                0,
                0,
            )
        )

    def _command(self, command: Command) -> int | None:
        """Execute a command; return the MAV_RESULT, or None for no acknowledgement."""
        captured = mavlink.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED
        if command.id == mavlink.MAV_CMD_REQUEST_MESSAGE and command.params[0] == captured:
            return self._again(int(command.params[1]))
        common = self._component.common_command(command, unknown_message=mavlink.MAV_RESULT_UNSUPPORTED)
        if common is not None:
            return common
        if (message_id := _OLD_REQUESTS.get(command.id)) is not None:
            return self._component.request(message_id)
        action = self._actions.get(command.id)
        return int(mavlink.MAV_RESULT_UNSUPPORTED) if action is None else action(command)

    def _stop_capture(self, command: Command) -> int:
        del command
        self._sequence_left = 0
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _set_mode(self, command: Command) -> int:
        wanted = int(command.params[1])
        if wanted not in {mavlink.CAMERA_MODE_IMAGE, mavlink.CAMERA_MODE_VIDEO}:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        if self._config.refuses_modes:
            return int(mavlink.MAV_RESULT_DENIED)
        if wanted != self._mode:
            self._mode = wanted
            self._component.send(self._settings())  # as the protocol demands at every change
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _again(self, index: int) -> int:
        """Send the message of an earlier photo again."""
        message = self._captured.get(index)
        if message is None:
            return int(mavlink.MAV_RESULT_DENIED)
        self._component.send(message)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _start_capture(self, command: Command) -> int | None:
        now = self._timeline.now_s
        last = self._last_photo
        if last is not None and last.is_repeated_by(command, (now - last.sent_s) / self._clock.speedup):
            # the sender got no acknowledgement: acknowledge again if it was acknowledged, and take no second photo
            self._last_photo = replace(last, sent_s=now, repeats=last.repeats + 1)
            return last.result
        self._faults.photo_commanded(now)
        result = self._shoot(command)
        self._last_photo = PhotoCommand(command=command, sent_s=now, result=result)
        return result

    def _shoot(self, command: Command) -> int | None:
        if self._faults.photo("photo-lost"):
            return None
        if self._faults.photo("photo-refused") or self._mode != mavlink.CAMERA_MODE_IMAGE:
            return int(_REFUSALS[Refusal.FAULT])
        refusal = self.model.shoot()
        if refusal is not None:
            return int(_REFUSALS[refusal])
        total = int(command.params[2])
        self._sequence_left = max(0, total - 1) if total else 1 << 30
        if self._sequence_left:
            self._schedule_next(max(command.params[1], self._config.interval_s))
        apply_drift_fault(self._faults, self._gimbal.physics)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _schedule_next(self, interval_s: float) -> None:
        def again() -> None:
            if self._sequence_left <= 0:
                return
            self._sequence_left -= 1
            self._faults.photo_commanded(self._timeline.now_s)
            if self.model.shoot() is None and self._sequence_left:
                self._schedule_next(interval_s)

        self._timeline.after(interval_s, again)

    def _exposed(self, exposure: Exposure) -> None:
        settings = self._camera_settings
        taken_with = None if settings is None else settings.at(exposure.estimate.pitch_deg)
        url = self._develop(exposure, self.fix, taken_with)
        if len(url.encode()) > _URL_BYTES:
            url = url.rsplit("/", 1)[-1]
        fix = self.fix
        message = mavlink.MAVLink_camera_image_captured_message(
            0 if self._config.undated else self._stamp_ms(exposure.start_s),
            round(self._clock.utc(exposure.start_s) * 1e6),
            1,
            round(fix.latitude_deg * 1e7),
            round(fix.longitude_deg * 1e7),
            round(fix.altitude_m * 1e3),
            round(fix.relative_altitude_m * 1e3),
            quaternion(exposure.measured),
            exposure.index,
            1,
            url.encode(),
        )
        config, taken = self._config, self.model.images
        if config.reset_after and taken == config.reset_after:
            self._timeline.after(config.report_s + 0.3, self._restart)
        if config.silent_every and taken % config.silent_every == 0:
            return
        self._captured[exposure.index] = message
        if self._faults.photo("capture-lost"):
            return
        self._timeline.after(config.report_s, lambda: self._component.send(message))
        if self._faults.photo("capture-twice"):
            self._timeline.after(self._config.report_s + 0.2, lambda: self._component.send(message))

    def _restart(self) -> None:
        """Boot anew: index and clock begin again, earlier photos are forgotten."""
        self.model.restart()
        self._captured.clear()
        if self._camera_settings is not None:
            self._camera_settings.forget()
        self._booted_s = self._timeline.now_s

    def _boot_ms(self) -> int:
        return self._stamp_ms(self._timeline.now_s)

    def _stamp_ms(self, time_s: float) -> int:
        """A moment by the camera's own clock, which may run slow or be stepped."""
        config = self._config
        stamp_s = config.clock_rate * (time_s - self._booted_s)
        if stamp_s >= config.clock_step_at_s:
            stamp_s += config.clock_step_s
        return max(0, round(stamp_s * 1000))

    def _heartbeat(self) -> Message:
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )

    def _information(self) -> Message:
        optics = self._config.optics
        flags = [mavlink.CAMERA_CAP_FLAGS_CAPTURE_IMAGE, mavlink.CAMERA_CAP_FLAGS_HAS_MODES]
        if self._config.starts_in_video:
            flags.append(mavlink.CAMERA_CAP_FLAGS_CAPTURE_VIDEO)
        return mavlink.MAVLink_camera_information_message(
            self._boot_ms(),
            padded(VENDOR, 32),
            padded(optics.name, 32),
            0x00000001,
            optics.focal_length_mm,
            optics.sensor_width_mm,
            optics.sensor_height_mm,
            optics.image_width_px,
            optics.image_height_px,
            0,
            bitmask(flags),
            int(bool(self._definition_uri)),
            self._definition_uri.encode(),
            gimbal_device_id=mavlink.MAV_COMP_ID_GIMBAL,
        )

    def _settings(self) -> Message:
        return mavlink.MAVLink_camera_settings_message(self._boot_ms(), self._mode, NAN, NAN)

    def _storage(self) -> Message:
        total, free = self._config.storage_mib, self.model.available_mib
        return mavlink.MAVLink_storage_information_message(
            self._boot_ms(),
            1,
            1,
            mavlink.STORAGE_STATUS_READY,
            total,
            total - free,
            free,
            NAN,
            NAN,
            mavlink.STORAGE_TYPE_SD,
            b"SIM",
            mavlink.STORAGE_USAGE_FLAG_SET | mavlink.STORAGE_USAGE_FLAG_PHOTO,
        )

    def _capture_status(self) -> Message:
        return mavlink.MAVLink_camera_capture_status_message(
            self._boot_ms(), int(self.model.is_busy), 0, 0.0, 0, self.model.available_mib, self.model.images
        )


def gimbal_state(physics: GimbalPhysics, now_s: float) -> GimbalState:
    """The gimbal's state at this moment, for a camera."""
    return GimbalState(truth=physics.truth_at(now_s), estimate=physics.estimate, measured=Angles(*physics.measure()))


def apply_drift_fault(faults: Faults, physics: GimbalPhysics) -> None:
    """Start a pointing drift if the fault `drift` applies to the last photo command."""
    if faults.photo("drift"):
        rng, size = faults.generator("drift"), faults.size("drift")
        signed = size * rng.choice((-1.0, 1.0))
        in_yaw = rng.random() < 0.5
        physics.slip(signed if in_yaw else 0.0, 0.0 if in_yaw else signed, _DRIFT_HOLD_S)
