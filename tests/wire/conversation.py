"""A conversation with an autopilot and its gimbal, held alike with a real one, to record it, and with the embedded one.

Record: `python -m tests.wire.conversation PORT FILE`, with ArduCopter SITL sending to that UDP port, standing on the
ground, `MNT1_TYPE 6`, `MNT1_DEFLT_MODE 2`, `CAM1_TYPE 0`, `CAM2_TYPE 0`, and `panoexec simulate --attach` joined to it
for at least 20 s. With `--servo` behind, the one of servos: `MNT1_TYPE 1`, `CAM1_TYPE 1`, `SERVO9_FUNCTION` to
`SERVO12_FUNCTION` 8, 7, 6 and 10, `MNT1_PITCH_MIN -90`, `MNT1_PITCH_MAX 45`, and nothing attached.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from panoexec.sim.mavlink.dialect import mavlink
from tests.wire.sim_peer import Peer, UdpPeer, command, command_int, result_of

NAN = math.nan
PITCHYAW, CONFIGURE = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
INTERVAL, REQUEST = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE
LOCK = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK

FIELDS: dict[str, tuple[str, ...]] = {
    "HEARTBEAT": ("type", "autopilot"),
    "GIMBAL_MANAGER_INFORMATION": ("cap_flags", "gimbal_device_id", "pitch_min", "pitch_max", "yaw_min", "yaw_max"),
    "GIMBAL_MANAGER_STATUS": (
        "flags",
        "gimbal_device_id",
        "primary_control_sysid",
        "primary_control_compid",
        "secondary_control_sysid",
        "secondary_control_compid",
    ),
    "GIMBAL_DEVICE_ATTITUDE_STATUS": ("target_system", "target_component", "flags", "gimbal_device_id"),
    "CAMERA_INFORMATION": ("flags", "resolution_h", "resolution_v", "gimbal_device_id", "lens_id"),
    "CAMERA_FEEDBACK": ("target_system", "cam_idx", "img_idx", "flags", "foc_len"),
    "CAMERA_CAPTURE_STATUS": ("image_status", "video_status", "image_count"),
    "CAMERA_SETTINGS": ("mode_id",),
    "MESSAGE_INTERVAL": ("message_id", "interval_us"),
}
"""What is compared of a message; of others only that they come."""

_IGNORED = {
    "HEARTBEAT",
    "GPS_GLOBAL_ORIGIN",
    "HOME_POSITION",
    "PARAM_VALUE",
    "TIMESYNC",
    "STATUSTEXT",
    "COMMAND_ACK",
    "SYSTEM_TIME",
}

ASKED: list[tuple[str, int, Any]] = [
    *[(f"request {m}", 1, command(REQUEST, m)) for m in (280, 281, 283, 285, 30, 33, 245, 148, 397)],
    ("request 283 of the gimbal", 154, command(REQUEST, 283, to=154)),
    ("request 259 of the camera", 100, command(REQUEST, 259, to=100)),
    ("request 262 of the camera", 100, command(REQUEST, 262, to=100)),
    ("interval of 283", 1, command(INTERVAL, 283, 100_000)),
    ("interval of an unknown message", 1, command(INTERVAL, 50_000, 100_000)),
    ("negative interval", 1, command(INTERVAL, 30, -5)),
    ("interval of 30", 1, command(INTERVAL, 30, 20_000)),
    ("get interval of 30", 1, command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, 30)),
    ("interval of 285", 1, command(INTERVAL, 285, 20_000)),
    ("angles without control", 1, command(PITCHYAW, -20, 30, NAN, NAN, LOCK, 0, 0)),
    ("take control", 1, command(CONFIGURE, -2, -2, -1, -1, 0, 0, 0)),
    ("angles, locked", 1, command(PITCHYAW, -30, 60, NAN, NAN, LOCK, 0, 1)),
    ("angles, following", 1, command(PITCHYAW, -30, 10, NAN, NAN, 0, 0, 0)),
    ("angles as COMMAND_INT", 1, command_int(PITCHYAW, -10, -60, NAN, NAN, LOCK, 0, 1)),
    ("pitch beyond the limit", 1, command(PITCHYAW, 120, 0, NAN, NAN, LOCK, 0, 0)),
    ("angles of another gimbal", 1, command(PITCHYAW, 0, 0, NAN, NAN, LOCK, 0, 3)),
    ("pitch without yaw", 1, command(PITCHYAW, -30, NAN, NAN, NAN, LOCK, 0, 0)),
    ("turn at rates", 1, command(PITCHYAW, NAN, NAN, 0, 0, LOCK, 0, 0)),
    ("nothing", 1, command(PITCHYAW, NAN, NAN, NAN, NAN, 0, 0, 0)),
    ("leave control unchanged", 1, command(CONFIGURE, -1, -1, -1, -1, 0, 0, 0)),
    ("release control", 1, command(CONFIGURE, -3, -3, -1, -1, 0, 0, 0)),
    ("give control to another", 1, command(CONFIGURE, 255, 190, -1, -1, 0, 0, 0)),
    ("release what another has", 1, command(CONFIGURE, -3, -3, -1, -1, 0, 0, 0)),
    ("nonsense for control", 1, command(CONFIGURE, 300, 1, -1, -1, 0, 0, 0)),
    ("no control for anybody", 1, command(CONFIGURE, 0, 0, -1, -1, 0, 0, 0)),
    ("photo of a camera that is not there", 1, command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1, 1)),
    ("an unknown command", 1, command(31_999)),
]


ASKED_SERVO: list[tuple[str, int, Any]] = [
    *[(f"request {m}", 1, command(REQUEST, m)) for m in (280, 281, 283, 285, 259, 260, 261, 262, 180)],
    ("interval of 285", 1, command(INTERVAL, 285, 20_000)),
    ("take control", 1, command(CONFIGURE, -2, -2, -1, -1, 0, 0, 0)),
    ("angles, locked", 1, command(PITCHYAW, -30, 60, NAN, NAN, LOCK, 0, 1)),
    ("angles, following", 1, command(PITCHYAW, -30, 10, NAN, NAN, 0, 0, 0)),
    ("pitch beyond the limit", 1, command(PITCHYAW, 60, 0, NAN, NAN, LOCK, 0, 0)),
    ("photo", 1, command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1, 1)),
    ("photo the old way", 1, command(mavlink.MAV_CMD_DO_DIGICAM_CONTROL, 0, 0, 0, 0, 1)),
    ("photo mode", 1, command(mavlink.MAV_CMD_SET_CAMERA_MODE, 0, 0)),
    ("stop photos", 1, command(mavlink.MAV_CMD_IMAGE_STOP_CAPTURE)),
    ("count of photos", 1, command(REQUEST, 262)),
]
"""For `MNT1_TYPE` 1 (servos) and `CAM1_TYPE` 1 (servo)."""


def hold(peer: Peer, asked: Sequence[tuple[str, int, Any]] = ASKED) -> Iterator[dict[str, Any]]:
    """Hold the conversation; what came of each step."""
    yield {"step": "silence", "ack": None, "messages": _messages(peer.listen(3.0))}
    for step, component, message in asked:
        peer.listen(0.05)
        peer.send(message)
        heard = peer.listen(0.45)
        yield {"step": step, "ack": result_of(heard, message.command, component), "messages": _messages(heard)}
    heard = peer.listen(4.0)
    rates = {}
    for name in ("ATTITUDE", "GIMBAL_DEVICE_ATTITUDE_STATUS"):
        stamps = [h.message.time_boot_ms for h in heard if h.name == name and h.component == 1]
        rates[name] = round(1000 * (len(stamps) - 1) / (stamps[-1] - stamps[0])) if len(stamps) > 1 else 0
    yield {"step": "rates", "ack": None, "messages": {}, "rates_hz": rates}
    yield _reboot(peer)


def _reboot(peer: Peer) -> dict[str, Any]:
    """Restart the autopilot; what it sends in the three seconds after its first new heartbeat."""
    message = command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    peer.send(message)
    ack = result_of(peer.listen(0.3), message.command)
    peer.listen(0.3)
    for _ in range(60):
        if any(item.name == "HEARTBEAT" and item.component == 1 for item in peer.listen(0.5)):
            break
    return {"step": "reboot", "ack": ack, "messages": _messages(peer.listen(3.0))}


def _messages(heard: list[Any]) -> dict[str, dict[str, float]]:
    """The last message of each kind and component: its fields that are compared."""
    found: dict[str, dict[str, float]] = {}
    for item in heard:
        if item.name not in _IGNORED and not item.name.startswith("UNKNOWN"):
            fields = FIELDS.get(item.name, ())
            found[f"{item.component} {item.name}"] = {f: round(getattr(item.message, f), 4) for f in fields}
    return dict(sorted(found.items()))


def main() -> None:
    peer, path = UdpPeer(int(sys.argv[1])), Path(sys.argv[2])
    peer.listen(1.5)
    asked = ASKED_SERVO if "--servo" in sys.argv else ASKED
    lines = [json.dumps(step) for step in hold(peer, asked)]
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
