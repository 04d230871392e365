"""Fly a complete mission on a simulated vehicle: plan, point, expose, check, retake, certify.

The simulated vehicle (the embedded one, or ArduPilot SITL with a simulated payload) runs in a separate process and
communicates by MAVLink over UDP. The mission is executed by the same code as on a real vehicle. The mission directory
DIR/missions/ID contains plan, manifest, journal and photos. Exit code 1: the panorama is incomplete.

Examples:
  panoexec dry-run --camera dji-x5s-15mm --overlap 0.15 --elevation -90 30
  panoexec dry-run --fault drift=0.3 --speedup 10        some shots drift and are retaken
  panoexec dry-run --resume missions/ID                  resume after Ctrl-C
"""

from __future__ import annotations

import argparse
import asyncio
import importlib.util
import os
import signal
import tempfile
from collections.abc import Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

from panoexec.adapters.link.no_downloads import no_downloads
from panoexec.cli.dry_run_view import MissionView, show_summary
from panoexec.cli.output import note, print_json
from panoexec.cli.planning_options import (
    DEFAULT_CAMERA,
    add_camera_arguments,
    add_constraint_arguments,
    add_gimbal_arguments,
    add_method_arguments,
    profile_of,
    spec_of,
)
from panoexec.dryrun.autopilot import firmware_of, sitl_binary
from panoexec.dryrun.px4 import TURNING as PX4_TURNING
from panoexec.dryrun.run import DryRunOptions, DryRunSummary, resume_dry_run, run_dry_run
from panoexec.errors import DependencyError, UsageError, to_install
from panoexec.inputs.plan_file import read_plan_file
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.inputs.vehicle_sections import GimbalSection, GuardsSection
from panoexec.logs import configure_logs
from panoexec.mission.configured_guards import guard_settings
from panoexec.mission.log.states import MissionState
from panoexec.mission.settings import MissionSettings
from panoexec.planning.model import GimbalLimits
from panoexec.sim.config import SimConfig
from panoexec.sim.options import add_vehicle_arguments, camera_of, config_of
from panoexec.sim.photos.scene import load_scene

_MAX_PAUSE_S = 60.0
"""A dry-run that is paused for longer ends, because no operator sends `resume` (it can be resumed later)."""
_GUARDS = GuardsSection(require_in_air=True)
"""The daemon's guards; and the vehicle must fly (`settings_on` excepts one on a bench)."""
_GIMBAL = GimbalSection(when_taken="reclaim")
"""No operator can resume a dry-run whose gimbal another station took."""
_NOSE_RATE_DEG_S = 5.0
"""Rate limit while settling where the vehicle pans: the camera is only as steady as the vehicle's heading."""
_NOSE_PATIENCE_S = 10.0
"""Settle timeout where the vehicle pans: allows for heading corrections and gusts."""
_EXIT = {MissionState.COMPLETE: 0, MissionState.FAILED: 3}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    mission = parser.add_argument_group("mission")
    mission.add_argument("--plan", type=Path, metavar="PLAN.json", help="plan file to fly instead of computing a plan")
    mission.add_argument("--resume", type=Path, metavar="MISSION_DIR", help="resume an interrupted dry-run")
    mission.add_argument(
        "--output", type=Path, default=Path(), metavar="DIR", help="write missions to DIR/missions (.)"
    )
    mission.add_argument(
        "--reference", choices=("north", "heading"), default="north", help="direction of the plan's yaw 0 (north)"
    )
    mission.add_argument(
        "--accept", choices=("tolerance", "overlap"), default="tolerance", help="acceptance rule (tolerance)"
    )
    mission.add_argument("--name", default="", metavar="TEXT", help="what people call the mission")
    mission.add_argument("--no-images", action="store_true", help="do not render the photos")
    mission.add_argument(
        "--pictures",
        choices=("off", "warn", "retake"),
        default="retake",
        help="what follows from the content of the photos: nothing, a warning, a retake (retake)",
    )
    mission.add_argument("--verbose", action="store_true", help="log messages of links and devices to stderr")
    mission.add_argument("--json", action="store_true", help="print the summary as one JSON document on stdout")
    add_camera_arguments(parser, required=False)
    add_constraint_arguments(parser)
    add_gimbal_arguments(parser)
    add_method_arguments(parser)
    add_vehicle_arguments(parser)
    sitl = parser.add_argument_group("ArduPilot or PX4 SITL instead of the embedded vehicle (docs/sitl.md)")
    sitl.add_argument(
        "--sitl",
        nargs="?",
        const="",
        metavar="BINARY",
        help="start this ArduCopter or PX4 SITL binary (or $ARDUPILOT_SITL, $PX4_SITL), climb to 30 m, take the "
        "panorama, land",
    )
    sitl.add_argument(
        "--sitl-connect",
        metavar="URL",
        help="connect to a running SITL or bench vehicle, e.g. udpin://0.0.0.0:14550; it is never armed or flown",
    )
    sitl.add_argument(
        "--attach",
        metavar="URL",
        help="with --sitl-connect: attach the simulated payload to this port, e.g. tcp:127.0.0.1:5762",
    )
    parser.set_defaults(host="127.0.0.1", port=None, listen=False, on_ground=False)


def run(args: argparse.Namespace) -> int:
    """Fly the mission with a live view and print the summary."""
    if importlib.util.find_spec("pymavlink") is None:
        raise DependencyError(f"`dry-run` needs the Python package pymavlink: {to_install('sim')}")
    configure_logs("debug" if args.verbose else "warning", "human")
    if args.scene:
        load_scene(args.scene)  # a bad scene is reported before any work
    if args.sitl is not None and args.sitl_connect:
        raise UsageError("--sitl and --sitl-connect exclude each other: start a SITL, or connect to a running one")
    if args.attach and not args.sitl_connect:
        raise UsageError("--attach requires --sitl-connect; --sitl attaches the payload automatically")
    _check_storage(args.output)
    view = MissionView(live=not args.json)
    if args.resume:
        flight: Callable[[], Coroutine[Any, Any, DryRunSummary]] = lambda: resume_dry_run(  # noqa: E731
            args.resume, on_event=view.on_event, on_mission=view.on_mission, note=view.note
        )
    else:
        options = _options(args)
        view.expect(options.plan)
        flight = lambda: run_dry_run(  # noqa: E731
            options, on_event=view.on_event, on_mission=view.on_mission, note=view.note
        )
    with view, no_downloads(os.environ):  # a vehicle on a bench may have any camera
        summary = asyncio.run(_until_done(flight))
    if args.json:
        print_json(summary.to_json())
    else:
        show_summary(summary)
    if summary.vehicle.get("landed") is False:
        note("panoexec: the vehicle did not land in time")
        return 3
    return _EXIT.get(MissionState(summary.state), 1)


async def _until_done(flight: Callable[[], Coroutine[Any, Any, DryRunSummary]]) -> DryRunSummary:
    """Fly the mission; SIGTERM stops it as Ctrl-C does."""
    task = asyncio.create_task(flight(), name="dry-run")
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, task.cancel)
    try:
        return await task
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None


def _options(args: argparse.Namespace) -> DryRunOptions:
    sitl = None if args.sitl is None else sitl_binary(args.sitl or None)
    if sitl is not None:
        args.turning = firmware_of(sitl).turning
    elif args.autopilot == "px4":
        args.turning = PX4_TURNING
    spec = _spec(args)
    plan = spec.plan()
    if plan.certificate is not None and not plan.certificate.certified:
        note("note: the plan is not certified: " + "; ".join(plan.certificate.failures))
    settings = MissionSettings(
        tolerance=plan.constraints.tolerance,
        exposure_s=spec.timing.exposure_s,
        interval_s=spec.timing.interval_s,
        accept=args.accept,
        max_pause_s=_MAX_PAUSE_S,
        guards=guard_settings(_GUARDS, _GIMBAL),
        gimbal=plan.constraints.gimbal or GimbalLimits(),
        pictures="off" if args.no_images else args.pictures,
    )
    if args.yaw == "vehicle":
        settings = replace(settings, max_rate_deg_s=_NOSE_RATE_DEG_S, patience_s=_NOSE_PATIENCE_S)
    camera = camera_of(plan.camera, interval_s=settings.interval_s, exposure_s=settings.exposure_s)
    args.assignments = [*_simulated_pan(args), *args.assignments]
    simulation: SimConfig = config_of(args, camera)
    return DryRunOptions(
        plan=plan,
        settings=settings,
        simulation=simulation,
        storage=args.output,
        reference=args.reference,
        name=args.name,
        images=not args.no_images,
        sitl=sitl,
        connect=args.sitl_connect,
    )


def _simulated_pan(args: argparse.Namespace) -> list[str]:
    """Settings that limit the pan range of the simulated gimbal where the vehicle pans."""
    pan = args.gimbal_pan or ((0.0, 0.0) if args.yaw == "vehicle" else None)
    if pan is None or args.yaw == "gimbal":
        return []
    return ["gimbal.yaw_endless=false", f"gimbal.yaw.min_deg={pan[0]:g}", f"gimbal.yaw.max_deg={pan[1]:g}"]


def _spec(args: argparse.Namespace) -> PlanSpec:
    file = read_plan_file(args.plan) if args.plan else None
    if args.camera is None and (file is None or file.camera is None):
        args.camera = DEFAULT_CAMERA
    return spec_of(args, profile=profile_of(args) if args.camera else None, file=file)


def _check_storage(path: Path) -> None:
    """Check before any work that missions can be written to the folder.

    Raises:
        UsageError: the path is not a folder or is not writable.
    """
    existing = next(parent for parent in (path.absolute(), *path.absolute().parents) if parent.exists())
    if not existing.is_dir():
        raise UsageError(f"--output {path}: {existing} is not a folder")
    try:
        with tempfile.TemporaryFile(dir=existing, prefix=".panoexec-"):  # its name is its own: two may look at once
            pass
    except OSError as error:
        raise UsageError(f"--output {path}: cannot be written ({error.strerror}): give a writable folder") from error
