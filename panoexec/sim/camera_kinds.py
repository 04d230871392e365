"""Kinds of cameras as they are sold and wired, by name: `--camera-kind NAME` of `simulate` and `dry-run`.

A kind only names settings of the simulation (`panoexec.sim.config`), so each of its numbers can be changed with
`--set`. How the camera then behaves on the wire is in `panoexec.sim.mavlink`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from panoexec.errors import UsageError
from panoexec.sim.config import SimConfig

DEFAULT: Final = "mavlink"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraKindSpec:
    """One kind.

    Attributes:
        text: what it does.
        vehicle: changed fields of `SimConfig`.
        camera: changed fields of `CameraConfig`.
        autopilot: the autopilot that it needs; "" for any.
    """

    text: str
    vehicle: Mapping[str, Any] = field(default_factory=dict)
    camera: Mapping[str, Any] = field(default_factory=dict)
    autopilot: str = ""


CAMERA_KINDS: Final[dict[str, CameraKindSpec]] = {
    DEFAULT: CameraKindSpec(text="a MAVLink camera (component 100) that reports and dates each photo"),
    "servo": CameraKindSpec(
        text="a shutter on the autopilot (CAM1_TYPE 1), reported by CAMERA_FEEDBACK alone",
        vehicle={"camera_kind": "servo"},
    ),
    "late": CameraKindSpec(
        text="the shutter opens 1.2 s after the command: autofocus, a tethered camera", camera={"latency_s": 1.2}
    ),
    "late-and-irregular": CameraKindSpec(
        text="the shutter opens 0.2 to 1.7 s after the command, each time another delay",
        camera={"latency_s": 0.2, "latency_jitter_s": 1.5},
    ),
    "deferred": CameraKindSpec(
        text="a shutter on the autopilot with CAM1_INTRVAL_MIN 2.5 s: an earlier trigger is accepted and carried out "
        "later",
        vehicle={"camera_kind": "servo"},
        camera={"trigger_min_s": 2.5},
        autopilot="ardupilot",
    ),
    "deferred-failed": CameraKindSpec(
        text="as deferred, but the early trigger is answered with FAILED, and carried out all the same; the parameter "
        "cannot be read",
        vehicle={"camera_kind": "servo"},
        camera={"trigger_min_s": 2.5, "trigger_fails": True, "trigger_min_told": False},
        autopilot="ardupilot",
    ),
    "deferred-untold": CameraKindSpec(
        text="as deferred, but the parameter cannot be read",
        vehicle={"camera_kind": "servo"},
        camera={"trigger_min_s": 2.5, "trigger_min_told": False},
        autopilot="ardupilot",
    ),
    "queue": CameraKindSpec(
        text="takes a photo every 2.5 s, accepts every command, and keeps up to three of them for later",
        camera={"interval_s": 2.5, "queue": 3},
    ),
    "slow": CameraKindSpec(
        text="takes a photo every 2.5 s, whatever its profile says, and rejects earlier commands temporarily",
        camera={"interval_s": 2.5},
    ),
    "video-mode": CameraKindSpec(
        text="was left in video mode: denies photos until MAV_CMD_SET_CAMERA_MODE (530)",
        camera={"starts_in_video": True},
    ),
    "video-locked": CameraKindSpec(
        text="is in video mode and denies every change of its mode",
        camera={"starts_in_video": True, "refuses_modes": True},
    ),
    "streamer": CameraKindSpec(
        text="a streamer of video is component 100 and takes no photos; the camera is component 101",
        vehicle={"camera_beside": "streamer"},
    ),
    "two-cameras": CameraKindSpec(
        text="a thermal camera is component 100, the camera of the panorama component 101",
        vehicle={"camera_beside": "camera"},
    ),
    "px4-trigger": CameraKindSpec(
        text="PX4's own trigger on an output pin (TRIG_MODE 1), commanded by MAV_CMD_DO_DIGICAM_CONTROL (203)",
        vehicle={"camera_kind": "px4-trigger"},
        autopilot="px4",
    ),
    "silent-third": CameraKindSpec(
        text="every third photo is taken, counted and never reported, on request neither", camera={"silent_every": 3}
    ),
    "index-reset": CameraKindSpec(
        text="restarts after its third photo: image index and clock begin anew", camera={"reset_after": 3}
    ),
    "definition": CameraKindSpec(
        text="offers a camera definition (by MAVLink FTP): exposure, white balance and focus can be set; until then it "
        "meters each photo by itself",
        camera={"definition": "mftp"},
    ),
    "undated": CameraKindSpec(
        text="reports its photos without a time, and its shutter opens 0.4 s after the command",
        camera={"undated": True, "latency_s": 0.4},
    ),
}
"""By name."""


def camera_kinds_text() -> str:
    """Every kind with what it does, one a line."""
    width = max(map(len, CAMERA_KINDS))
    return "\n".join(f"  {name:<{width}}  {kind.text}" for name, kind in CAMERA_KINDS.items())


def with_camera_kind(config: SimConfig, name: str, *, option: str = "--camera-kind") -> SimConfig:
    """The configuration with the camera of that kind.

    Raises:
        UsageError: there is no such kind, or not with this autopilot; lists what there is.
    """
    kind = CAMERA_KINDS.get(name)
    if kind is None:
        raise UsageError(f"{option} {name}: unknown kind of camera; known are {', '.join(CAMERA_KINDS)}")
    if kind.autopilot and (config.autopilot != kind.autopilot):
        raise UsageError(f"{option} {name}: only with --autopilot {kind.autopilot}")
    if config.attach_url is not None and (kind.camera.get("trigger_min_s") or "px4" in name):
        raise UsageError(f"{option} {name}: with a real autopilot its own parameters decide; use --trigger servo")
    return replace(config, **kind.vehicle, camera=replace(config.camera, **kind.camera))
