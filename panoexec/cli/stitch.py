"""Stitch the photos of a mission into one panorama and measure its completeness.

Each photo is examined first: readable, exposed, sharp, and tied to its neighbours where its attitude says it is. Photos
that are not are named and left out. Hugin's nona remaps the others (and cpfind finds control points with --matcher
cpfind); install them with
  apt-get install hugin-tools
The alignment starts from the measured attitudes, which bound it; photos without control points keep their measured
attitude. The results are written to MISSION_DIR/stitch: panorama.tif (whole sphere, with alpha), panorama.jpg (with
GPano tags), aligned.pto (a Hugin project) and stitch.json. An interrupted run continues where it stopped.

Exit code 1: the panorama has holes in the ground, photos are missing, or the content of some does not count.

Example:
  panoexec stitch missions/20260921T141320.000Z
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from panoexec.cli.output import completeness, console, note, print_facts, print_json, print_table
from panoexec.errors import UsageError
from panoexec.store.directory import MissionDirectory

if TYPE_CHECKING:
    from panoexec.stitching.mission import StitchInput
    from panoexec.stitching.pipeline import StitchOptions
    from panoexec.stitching.result import StitchResult

_SHOWN = 12


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("mission", type=Path, metavar="MISSION_DIR", help="mission directory")
    parser.add_argument(
        "--width", type=_width, metavar="PX", help="width of the whole sphere (default: resolution of the photos)"
    )
    parser.add_argument(
        "--horizon",
        type=_elevation,
        default=0.0,
        metavar="DEG",
        help="elevation of the horizon, for completeness (0)",
    )
    parser.add_argument("--fixed-lens", action="store_true", help="keep focal length and distortion fixed")
    parser.add_argument("--memory", type=_memory, default=1024, metavar="MIB", help="memory for blending in MiB (1024)")
    parser.add_argument(
        "--matcher",
        choices=("own", "cpfind"),
        default="own",
        help="what finds control points: the ties of the examination, or Hugin's cpfind (own)",
    )
    parser.add_argument("--restart", action="store_true", help="discard the results of an earlier run")
    parser.add_argument("--json", action="store_true", help="print stitch.json as one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Stitch the photos and print the result."""
    from panoexec.stitching.mission import load_mission  # noqa: PLC0415
    from panoexec.stitching.pipeline import ContentRefusedError, StitchOptions  # noqa: PLC0415
    from panoexec.stitching.tools import check_tools  # noqa: PLC0415

    check_tools(cpfind=args.matcher == "cpfind")  # before bars of steps that never begin
    mission = load_mission(args.mission)
    for name, reason in mission.left_out.items():
        note(f"left out: {name} {reason}")
    options = StitchOptions(
        width_px=args.width,
        horizon_deg=args.horizon,
        refine_lens=not args.fixed_lens,
        memory_bytes=args.memory << 20,
        restart=args.restart,
        matcher=args.matcher,
    )
    try:
        result = _stitch(mission, options)
    except ContentRefusedError as error:
        note(f"panoexec: {error}")
        content = error.examined.to_json()
        _name_bad(content["bad"])
        if args.json:
            print_json({"format": "panoexec.stitch/1", "completeness": None, "content": content})
        return 1
    _show_in_report(mission)
    if args.json:
        print_json(result.to_json())
    else:
        show(result, mission)
    _name_bad(result.bad)
    whole = result.completeness.hole_px == 0 and not result.left_out and not mission.missing_shots and not result.bad
    return 0 if whole else 1


def _name_bad(bad: list[dict[str, Any]]) -> None:
    for photo in bad:
        note(f"does not count: shot {photo['shot']} ({photo['file']}): {photo['code']}: {photo['reason']}")


def _show_in_report(mission: StitchInput) -> None:
    """Rewrite the mission report with the panorama; a failure to write the report is not an error."""
    from panoexec.report import write_report  # noqa: PLC0415

    try:
        report = write_report(MissionDirectory(mission.folder))
    except UsageError as error:
        note(f"the report was not updated: {error}")
    else:
        note(f"report: {report.path}")


def _stitch(mission: StitchInput, options: StitchOptions) -> StitchResult:
    """Run the steps with a progress bar on stderr."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn  # noqa: PLC0415

    from panoexec.stitching.pipeline import STEPS, Stitcher  # noqa: PLC0415

    columns = (
        TextColumn("{task.fields[step]:<7}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=console(stderr=True)) as bar:
        tasks = {step: bar.add_task("", total=1.0, start=False, step=step) for step in STEPS}

        def progress(step: str, fraction: float, text: str) -> None:
            bar.start_task(tasks[step])
            bar.update(tasks[step], completed=fraction, description=text)

        return Stitcher(mission, options, progress).run()


def show(result: StitchResult, mission: StitchInput) -> None:
    """Print the result."""
    verdict = result.completeness
    width, height = result.canvas_px
    print_facts(
        [
            ("completeness", f"{completeness(verdict.fraction)} of the ground (equation 8)"),
            ("", f"{completeness(verdict.solid_angle_fraction)} by solid angle; {verdict.hole_px} px missing"),
            (
                "photos",
                (
                    f"{result.images} stitched, {len(result.left_out) + len(result.bad)} left out, "
                    f"{len(result.untied)} unconnected"
                ),
            ),
            (
                "alignment",
                f"{result.points} points, {result.rms_px:.2f} px rms, corrected by up to {result.correction_deg:.2f}°",
            ),
            ("lens", f"{result.hfov_deg:.3f}° horizontal field of view"),
            ("panorama", f"{width} x {height} px ({width * height / 1e9:.2f} gigapixel): {result.panorama}"),
            ("preview", str(result.preview)),
            ("time", ", ".join(f"{name} {seconds:.1f} s" for name, seconds in result.seconds.items())),
        ]
    )
    if result.untied:
        shown = ", ".join(result.untied[:_SHOWN]) + (" …" if len(result.untied) > _SHOWN else "")
        note(f"not connected by control points, measured attitude kept: {shown}")
    if mission.missing_shots:
        note(f"shots without an accepted photo: {', '.join(str(index) for index in mission.missing_shots)}")
    if verdict.holes:
        print_table(
            f"{len(verdict.holes)} holes, largest first",
            ("elevation °", "azimuth °", "diameter °", "pixels"),
            (
                (f"{h.elevation_deg:+.2f}", f"{h.azimuth_deg:+.2f}", f"{h.size_deg:.2f}", str(h.pixels))
                for h in verdict.holes[:_SHOWN]
            ),
        )


def _width(text: str) -> int:
    value = int(text) if text.isdecimal() else 0
    if not 256 <= value <= 1_000_000:
        raise argparse.ArgumentTypeError(f"{text}: the accepted range is 256 to 1000000 px")
    return value


def _elevation(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not -90 < value <= 90:
        raise argparse.ArgumentTypeError(f"{text}: the accepted range is above -90 and at most 90 degrees")
    return value


def _memory(text: str) -> int:
    value = int(text) if text.isdecimal() else 0
    if not 128 <= value <= 1_000_000:
        raise argparse.ArgumentTypeError(f"{text}: the accepted range is 128 to 1000000 MiB")
    return value
