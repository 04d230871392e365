"""Run only the simulated vehicle, in the foreground, as a peer for `panoexec serve` or any ground station.

The simulator sends MAVLink to the UDP ports on which MAVSDK and ground stations listen (14540 and 14550), as the
simulators of the autopilots do. With --listen it waits for a client on a port instead. With --attach it simulates only
the payload (gimbal and camera) of a real ArduPilot (MNT1_TYPE 6), in SITL or on a bench. Ctrl-C ends it.
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
    from panoexec.sim.run_documents import Ready

EXIT_INTERRUPTED = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_camera_arguments(parser, required=False, lens=False)
    add_simulation_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout when ready")


def run(args: argparse.Namespace) -> int:
    """Run until interrupted and return the exit code."""
    config = config_of(args, simulated_camera(args))
    if importlib.util.find_spec("pymavlink") is None:
        raise DependencyError(f"`simulate` needs the Python package pymavlink: {to_install('sim')}")
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
    """The camera selected by the options; None if none is selected.

    Raises:
        InputFileError: the profile is invalid.
        UsageError: there is no such profile.
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
            "ArduPilot needs MNT1_TYPE 6; it searches for the gimbal from 10 s after its boot until it is armed",
            "PX4 needs MNT_MODE_IN 4, MNT_MODE_OUT 2 and here a MAVLink link of mode gimbal that forwards",
        ]
    what = "ArduPilot copter" if config.autopilot == "ardupilot" else "PX4 copter"
    # with --listen there is one default port, otherwise there are two
    default = str(DEFAULT_PORTS[0]) if config.listen else " and ".join(map(str, DEFAULT_PORTS))
    ports = config.port or default
    lines = [f"simulated {what}, system {config.system_id}: MAVLink on UDP, {config.host}:{ports}"]
    if config.listen:
        lines.append(
            f'MAVSDK and `panoexec serve`: connection = "{connect}"; the simulator replies to the first client'
        )
    else:
        lines.append(f'MAVSDK, `panoexec serve`: connection = "{connect}"; ground station: listen on UDP {ports}')
    if config.camera_link == "gphoto2":
        at = "" if config.camera_port == 15740 else f":{config.camera_port}:{config.camera_port}"
        lines.append(f'camera: [camera] trigger = "gphoto2", port = "ptpip:127.0.0.1{at}"')
    if config.output is None:
        lines.append("photos are taken but not written; --output DIR writes them")
    return lines
