"""Component 100 beside the camera (101): a streamer of video that takes no photos, or a second, smaller camera.

Both announce themselves as cameras (MAV_TYPE_CAMERA); CAMERA_INFORMATION (259) alone tells what each can do.
"""

from __future__ import annotations

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.camera_component import COMPONENT_ID
from panoexec.sim.mavlink.component import NAN, Command, Component, bitmask, command_of, padded
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import Link, Message, Sender
from panoexec.sim.physics.world import Timeline

_STREAM_PX = (1920, 1080)
_THERMAL_PX = (640, 512)
_REPORT_S = 0.1


class CameraBeside:
    """Answers as component 100; as a camera it takes photos, which show nothing of the mission's."""

    def __init__(self, config: SimConfig, *, timeline: Timeline, link: Link) -> None:
        self._streams = config.camera_beside == "streamer"
        self._timeline = timeline
        self.asked_for_photos = 0
        """How often it was asked for a photo."""
        self.photos = 0
        """How many it took."""
        self._component = Component(
            timeline=timeline, sender=Sender(config.system_id, COMPONENT_ID), link=link, heartbeat=self._heartbeat
        )
        self._component.builders[mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION] = self._information
        if not self._streams:
            self._component.builders[mavlink.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS] = self._capture_status

    def start(self) -> None:
        """Start the heartbeat, before that of the camera."""
        self._component.start(phase_s=0.3)

    def receive(self, message: Message) -> None:
        """Handle a message."""
        if self._component.is_addressed(message) and (command := command_of(message)) is not None:
            result = self._command(command)
            if result is not None:
                self._component.acknowledge(command, result)

    def _command(self, command: Command) -> int | None:
        common = self._component.common_command(command, unknown_message=mavlink.MAV_RESULT_UNSUPPORTED)
        if common is not None:
            return common
        if command.id == mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION:
            return self._component.request(mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION)
        if command.id == mavlink.MAV_CMD_IMAGE_START_CAPTURE:
            self.asked_for_photos += 1
            if not self._streams:
                self.photos += 1
                report = self._captured(self.photos)
                self._timeline.after(_REPORT_S, lambda: self._component.send(report))
                return int(mavlink.MAV_RESULT_ACCEPTED)
        return int(mavlink.MAV_RESULT_UNSUPPORTED)

    def _boot_ms(self) -> int:
        return round(self._timeline.now_s * 1000)

    def _heartbeat(self) -> Message:
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )

    def _information(self) -> Message:
        flags = (mavlink.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM,)
        if not self._streams:
            flags = (mavlink.CAMERA_CAP_FLAGS_CAPTURE_IMAGE,)
        return mavlink.MAVLink_camera_information_message(
            self._boot_ms(),
            padded("panoexec", 32),
            padded("streamer" if self._streams else "thermal", 32),
            1,
            NAN,
            NAN,
            NAN,
            *(_STREAM_PX if self._streams else _THERMAL_PX),
            0,
            bitmask(flags),
            0,
            b"",
        )

    def _capture_status(self) -> Message:
        return mavlink.MAVLink_camera_capture_status_message(self._boot_ms(), 0, 0, 0.0, 0, NAN, self.photos)

    def _captured(self, index: int) -> Message:
        return mavlink.MAVLink_camera_image_captured_message(
            self._boot_ms(), 0, 1, 0, 0, 0, 0, [1, 0, 0, 0], index, 1, f"THERMAL_{index:05d}.jpg".encode()
        )
