"""PX4's own camera trigger on an output pin (TRIG_MODE 1).

It is no MAVLink camera: no CAMERA_INFORMATION, no MAV_CMD_IMAGE_START_CAPTURE. MAV_CMD_DO_DIGICAM_CONTROL (203)
triggers; CAMERA_TRIGGER (112) and CAMERA_IMAGE_CAPTURED (263) with the unknown capture result -1 follow from the
autopilot (component 1).
"""

from __future__ import annotations

from panoexec.sim.mavlink.component import Builder, Command
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.trigger import CameraTrigger
from panoexec.sim.mavlink.wire import Message

_UNKNOWN_RESULT = -1


class Px4Trigger(CameraTrigger):
    """Closes a contact when it is told by MAV_CMD_DO_DIGICAM_CONTROL."""

    commands = frozenset({mavlink.MAV_CMD_DO_DIGICAM_CONTROL})

    def builders(self) -> dict[int, Builder]:
        """PX4 answers no request about a camera."""
        return {}

    @staticmethod
    def _is_trigger(command: Command) -> bool:
        return command.params[4] == 1.0

    def _feedback(self) -> Message:
        assert self._airframe is not None
        position = self._airframe.position()
        self._send(mavlink.MAVLink_camera_trigger_message(round(self._timeline.now_s * 1e6), self._count))
        return mavlink.MAVLink_camera_image_captured_message(
            self._boot_ms(),
            round(self._clock.utc(self._timeline.now_s) * 1e6),
            0,
            round(position.latitude_deg * 1e7),
            round(position.longitude_deg * 1e7),
            round(position.altitude_m * 1e3),
            round(position.relative_altitude_m * 1e3),
            [1, 0, 0, 0],
            self._count,
            _UNKNOWN_RESULT,
            b"",
        )
