"""Command-line options of the simulated vehicle, for `panoexec simulate` and `python -m panoexec.sim`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from panoexec.errors import UsageError
from panoexec.optics import Camera
from panoexec.sim import settings
from panoexec.sim.camera_kinds import CAMERA_KINDS, camera_kinds_text, with_camera_kind
from panoexec.sim.config import SCENE_KINDS, CameraConfig, SimConfig
from panoexec.sim.faults import FAULTS, parse_fault
from panoexec.sim.gimbal_kinds import GIMBAL_KINDS, gimbal_kinds_text, with_gimbal_kind

_MAX_SPEEDUP = 100.0
_PX4_TURN_DEG_S2 = 20.0
"""MPC_YAWRAUTO_ACC, by default."""


class _Kind(argparse.Action):
    """Stores a kind's name, or explains all kinds."""

    def __init__(self, *args: Any, explain: Callable[[], str], **options: Any) -> None:
        super().__init__(*args, **options)
        self._explain = explain

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any) -> None:
        if values == "help":
            parser.exit(message=f"{self._explain()}\n")
        setattr(namespace, self.dest, values)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options except those of the camera."""
    add_link_arguments(parser)
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="folder for photos and truth.jsonl (default: no photos)"
    )
    parser.add_argument("--on-ground", action="store_true", help="start disarmed on the ground instead of hovering")
    add_vehicle_arguments(parser)


def add_link_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the link."""
    link = parser.add_argument_group("link")
    link.add_argument(
        "--port",
        type=int,
        metavar="N",
        help="UDP port of MAVSDK or the ground station (14540 and 14550); with --listen: local port to bind",
    )
    link.add_argument("--host", default="127.0.0.1", help="host of that port (127.0.0.1)")
    link.add_argument("--listen", action="store_true", help="wait for a client on the port instead of sending to it")
    link.add_argument(
        "--camera-port",
        type=int,
        default=15740,
        metavar="N",
        help="TCP port of the camera with --camera-link gphoto2 (15740)",
    )
    link.add_argument(
        "--attach",
        metavar="URL",
        help="simulate only the payload, attached to a real autopilot: tcp:HOST:PORT, udpout:…, udpin:…",
    )


def add_vehicle_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the vehicle and the world."""
    vehicle = parser.add_argument_group("simulated vehicle")
    vehicle.add_argument("--autopilot", choices=("ardupilot", "px4"), default="ardupilot", help="autopilot to emulate")
    vehicle.add_argument(
        "--mount",
        choices=("mavlink", "servo"),
        default="mavlink",
        help="gimbal: MAVLink gimbal that reports measured angles, or servos that report demanded angles",
    )
    vehicle.add_argument(
        "--trigger",
        choices=("mavlink", "servo"),
        default="mavlink",
        help="camera: MAVLink camera, or servo trigger on the autopilot, reported only by CAMERA_FEEDBACK",
    )
    vehicle.add_argument(
        "--gimbal-kind",
        action=_Kind,
        explain=gimbal_kinds_text,
        metavar="NAME",
        default="",
        help="gimbal as it is sold or wired: " + ", ".join(GIMBAL_KINDS) + "; `help` explains them",
    )
    vehicle.add_argument(
        "--camera-kind",
        action=_Kind,
        explain=camera_kinds_text,
        metavar="NAME",
        default="",
        help="camera as it is sold or wired: " + ", ".join(CAMERA_KINDS) + "; `help` explains them",
    )
    vehicle.add_argument(
        "--camera-link",
        choices=("mavlink", "gphoto2"),
        default="mavlink",
        help="how the camera is reached: MAVLink, or gphoto2: a tethered camera (PTP/IP) that hands over its photos",
    )
    vehicle.add_argument("--wind", type=float, metavar="M_S", help="steady wind in m/s (2)")
    world = parser.add_argument_group("simulated world")
    world.add_argument(
        "--scene", type=Path, metavar="EQUIRECT.jpg", help="equirectangular image of the scene (generated)"
    )
    world.add_argument(
        "--scene-kind",
        choices=SCENE_KINDS,
        default="city",
        help="what the generated scene shows: little texture on a lake, in snow, at night (city)",
    )
    world.add_argument("--seed", type=int, default=1, metavar="N", help="random seed (1)")
    world.add_argument(
        "--speedup", type=float, default=1.0, metavar="N", help="speed-up: simulated seconds per second (1)"
    )
    world.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[=VALUE]",
        help=f"fault to inject (repeatable): {', '.join(sorted(FAULTS))}; VALUE: docs/simulator.md",
    )
    world.add_argument("--image-width", type=int, default=800, metavar="PX", help="width of the written photos (800)")
    world.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="assignments",
        help="set any other parameter (repeatable), e.g. gimbal.yaw.rate_deg_s=45 (docs/simulator.md)",
    )


def config_of(args: argparse.Namespace, camera: CameraConfig | None = None) -> SimConfig:
    """The configuration for parsed options.

    Args:
        args: parsed options of `add_arguments`.
        camera: from a profile; None for the default camera.

    Raises:
        UsageError: an invalid value.
    """
    config = SimConfig(
        host=args.host,
        port=None if args.port is None else _within(args.port, 1, 65535, "--port"),
        listen=args.listen,
        autopilot=args.autopilot,
        mount=args.mount,
        camera_kind=args.trigger,
        camera_link=args.camera_link,
        camera_port=_within(getattr(args, "camera_port", 0), 0, 65535, "--camera-port"),
        scene=args.scene,
        scene_kind=args.scene_kind,
        seed=args.seed,
        speedup=checked_speedup(args.speedup),
        faults=tuple(parse_fault(text) for text in args.fault),
        output=args.output,
        attach_url=args.attach,
        camera=camera or CameraConfig(),
    )
    if config.camera_link == "gphoto2" and config.camera_kind != "mavlink":
        raise UsageError("--camera-link gphoto2: the camera is tethered and has no --trigger servo")
    if args.gimbal_kind:
        config = with_gimbal_kind(config, args.gimbal_kind)
    if args.camera_kind:
        config = with_camera_kind(config, args.camera_kind)
    width = _within(args.image_width, 16, config.camera.optics.image_width_px, "--image-width")
    assignments = [f"camera.render_width_px={width}"]
    if config.autopilot == "px4":
        assignments.append(f"airframe.turn_acceleration_deg_s2={_PX4_TURN_DEG_S2:g}")
    if args.wind is not None:
        if not (0 <= args.wind <= 30):
            raise UsageError(f"--wind {args.wind}: expected 0 to 30 m/s")
        assignments.append(f"airframe.wind_m_s={args.wind}")
    if args.on_ground:
        assignments.append("airframe.in_air=false")
    return settings.changed(config, [*assignments, *args.assignments])


def checked_speedup(speedup: float) -> float:
    """The speed-up, if it is valid.

    Raises:
        UsageError: not above 0 and at most 100.
    """
    if not (0 < speedup <= _MAX_SPEEDUP and math.isfinite(speedup)):
        raise UsageError(f"--speedup {speedup:g}: expected more than 0 and at most {_MAX_SPEEDUP:g}")
    return speedup


def camera_of(optics: Camera, *, interval_s: float, exposure_s: float) -> CameraConfig:
    """A simulated camera with the optics and timing of a profile."""
    return CameraConfig(optics=optics, interval_s=interval_s, exposure_s=exposure_s)


def _within(value: int, low: int, high: int, option: str) -> int:
    if not low <= value <= high:
        raise UsageError(f"{option} {value}: expected {low} to {high}")
    return value
