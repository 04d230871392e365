"""Run the simulated vehicle alone, in the foreground, to try `panoexec serve` or any ground station against it.

It sends MAVLink to the UDP ports that MAVSDK and ground stations listen on (14540 and 14550), as the autopilots' own
simulators do; with --listen it waits on a port instead. With --attach it is only the payload, gimbal and camera, of a
real ArduPilot (MNT1_TYPE 6), in SITL or on a bench. Ctrl-C ends it.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from typing import TYPE_CHECKING

from panoexec.cli.output import note
from panoexec.cli.planning_options import add_camera_arguments
from panoexec.errors import DependencyError, to_install
from panoexec.inputs.camera_profiles import load_profile
from panoexec.sim.config import DEFAULT_PORTS, CameraConfig, SimConfig
from panoexec.sim.options import add_arguments as add_simulation_arguments
from panoexec.sim.options import config_of

if TYPE_CHECKING:
    from panoexec.sim.server import Ready

EXIT_INTERRUPTED = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_camera_arguments(parser, required=False)
    add_simulation_arguments(parser)
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout when it is ready")


def run(args: argparse.Namespace) -> int:
    """Run until interrupted; the exit code."""
    config = config_of(args, simulated_camera(args))
    for package in ("pymavlink", "PIL"):
        if importlib.util.find_spec(package) is None:
            raise DependencyError(f"`simulate` needs the Python package {package}: {to_install('sim')}")
    from panoexec.sim.server import run_simulation  # noqa: PLC0415  (imports pymavlink)

    def ready(state: Ready) -> None:
        if args.json:
            print(json.dumps(state.document()), flush=True)
        for line in _how_to_connect(config, state.connect):
            note(line)

    summary = run_simulation(config, on_ready=ready, note=note)
    sys.stdout.flush()
    if config.output is not None:
        note(f"{summary.written} of {summary.photos} photos written to {config.output}")
    for failure in summary.failures:
        note(failure)
    return EXIT_INTERRUPTED if summary.interrupted else 0


def simulated_camera(args: argparse.Namespace) -> CameraConfig | None:
    """The camera that the options name, None if they name none.

    Raises:
        InputFileError: no such profile, or one that is wrong.
    """
    if args.camera is None:
        return None
    profile = load_profile(args.camera, orientation=args.orientation, focal_length_mm=args.focal_length)
    exposure_s = min(CameraConfig().exposure_s, profile.max_exposure_s)
    return CameraConfig(optics=profile.camera, interval_s=profile.min_interval_s, exposure_s=exposure_s)


def _how_to_connect(config: SimConfig, connect: str) -> list[str]:
    if config.attach_url is not None:
        return [
            f"payload attached to {config.attach_url}: gimbal = component 154, camera = component 100",
            "the autopilot needs MNT1_TYPE 6; it adopts the gimbal 10 s after its boot",
        ]
    what = "ArduPilot copter" if config.autopilot == "ardupilot" else "PX4 copter"
    # it waits on one port, and sends to two
    default = str(DEFAULT_PORTS[0]) if config.listen else " and ".join(map(str, DEFAULT_PORTS))
    ports = config.port or default
    lines = [f"simulated {what}, system {config.system_id}: MAVLink on UDP, {config.host}:{ports}"]
    if config.listen:
        lines.append(f'MAVSDK and `panoexec serve`: connection = "{connect}"; it answers whoever talks first')
    else:
        lines.append(f'MAVSDK, `panoexec serve`: connection = "{connect}"; ground station: listen on UDP {ports}')
    if config.output is None:
        lines.append("photos are taken but not written; --output DIR writes them")
    return lines
