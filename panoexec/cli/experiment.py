"""Reproduce the paper's simulation: render the images of each plan with pointing errors, stitch and evaluate them.

For each scenario of the paper, the command evaluates the published plans (proposed, HDRpano) and panoexec's certified
plan for the same camera, band, overlaps and tolerances. Photos are rendered from a scene at a reduced width, with the
paper's pointing errors (0.017° in roll and pitch, 0.667° in yaw), and stitched as by `panoexec stitch`. The stitcher
gets the commanded attitude of each image, not the true one. Completeness is equation (8). The table includes the values
of the paper's Table 2.

Needs Hugin's tools:  apt-get install hugin-tools
Finished cases are kept in the output folder; an interrupted experiment continues where it stopped.

Exit code 1: a certified plan was not stitched completely.

Examples:
  panoexec experiment --scenario 1                          25, 28 and 21 images; takes minutes
  panoexec experiment --scenario all --plans certified --seeds 5
  panoexec experiment --geometry --seeds 100                exact holes of 100 flights per plan, without Hugin
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from panoexec.cli.output import completeness, console, note, percent, print_json, print_table

if TYPE_CHECKING:
    from panoexec.experiment.capture import Spread
    from panoexec.experiment.cases import Case
    from panoexec.experiment.running import Outcome, Setting

_PLANS = ("proposed", "hdrpano", "certified")
_FORMAT = "panoexec.experiment/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("--scenario", choices=("1", "2", "3", "all"), default="all", help="scenario of the paper (all)")
    parser.add_argument(
        "--plans",
        nargs="+",
        choices=_PLANS,
        default=list(_PLANS),
        metavar="PLAN",
        help="plans: proposed, hdrpano, certified (all)",
    )
    parser.add_argument(
        "--seeds", type=_count, default=1, metavar="N", help="number of runs with different pointing errors (1)"
    )
    parser.add_argument(
        "--repeats", type=_count, default=1, metavar="N", help="number of runs with the same pointing errors (1)"
    )
    parser.add_argument(
        "--errors",
        choices=("uniform", "normal"),
        default="uniform",
        help="error distribution: uniform within ± the paper's values, or normal with them as deviations (uniform)",
    )
    parser.add_argument(
        "--geometry",
        action="store_true",
        help="compute the exact holes at the true attitudes, without rendering or stitching",
    )
    parser.add_argument("--width", type=_width, metavar="PX", help="photo width (640, 420, 520 for scenarios 1, 2, 3)")
    parser.add_argument(
        "--scene", type=Path, metavar="EQUIRECT", help="equirectangular image instead of the generated landscape"
    )
    parser.add_argument(
        "--output", type=Path, default=Path("experiment"), metavar="DIR", help="output folder (experiment)"
    )
    parser.add_argument("--keep", action="store_true", help="keep photos and panoramas as well as previews")
    parser.add_argument("--restart", action="store_true", help="discard the results of earlier runs")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Run the cases and print the table."""
    from panoexec.experiment.cases import cases  # noqa: PLC0415
    from panoexec.experiment.running import Setting  # noqa: PLC0415

    scenarios = (1, 2, 3) if args.scenario == "all" else (int(args.scenario),)
    wanted = cases(scenarios, tuple(dict.fromkeys(args.plans)), args.seeds, args.repeats)
    if args.geometry:
        return _geometry(wanted, args.errors, as_json=args.json)
    setting = Setting(
        output=args.output,
        width_px=args.width,
        spread=args.errors,
        scene=args.scene,
        keep=args.keep,
        restart=args.restart,
    )
    outcomes = _run(wanted, setting)
    if args.json:
        print_json({"format": _FORMAT, "errors": args.errors, "outcomes": [asdict(outcome) for outcome in outcomes]})
    else:
        show(outcomes, args.errors)
    return 1 if any(outcome.plan == "certified" and outcome.hole_px for outcome in outcomes) else 0


def _geometry(wanted: Sequence[Case], spread: Spread, *, as_json: bool) -> int:
    """Compute and print the uncovered ground, without photos."""
    from panoexec.experiment.geometry import fly  # noqa: PLC0415

    found = fly(wanted, spread)
    if as_json:
        print_json({"format": _FORMAT, "errors": spread, "flights": [asdict(flights) for flights in found]})
    else:
        print_table(
            "Coverage of the ground at the true attitudes",
            ("scenario", "plan", "images", "flights", "complete", "most holes", "largest", "at elevation"),
            [
                (
                    str(f.scenario),
                    f.plan,
                    str(f.images),
                    str(f.runs),
                    str(f.complete),
                    str(f.holes),
                    f"{f.largest_deg:.2f}°" if f.holes else "-",
                    "-" if f.elevation_deg is None else f"{f.elevation_deg:+.1f}°",
                )
                for f in found
            ],
            left=("plan",),
            caption=_errors_text(spread),
        )
    return 1 if any(f.plan == "certified" and f.complete < f.runs for f in found) else 0


def _errors_text(spread: Spread) -> str:
    how = "uniform within ±" if spread == "uniform" else "normal with deviations of "
    return f"pointing errors {how}0.017° in pitch and roll, 0.667° in yaw"


def _run(wanted: Sequence[Case], setting: Setting) -> list[Outcome]:
    """Run the cases with a progress bar on stderr and one line per case."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn  # noqa: PLC0415

    from panoexec.experiment.running import run_cases  # noqa: PLC0415

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    out = console(stderr=True)
    with Progress(*columns, console=out, disable=not out.is_terminal) as bar:
        task = bar.add_task("", total=len(wanted))
        begun: set[Case] = set()

        def progress(case: Case, step: str, fraction: float, text: str) -> None:
            if case not in begun:
                begun.add(case)
                bar.update(task, completed=len(begun) - 1)
                out.print(f"{case.name}{': already done' if step == 'done' else ''}", markup=False, highlight=False)
            bar.update(task, description=f"{step} {100 * fraction:.0f} % {text}")

        outcomes = run_cases(wanted, setting, progress)
        bar.update(task, completed=len(wanted), description="")
    return outcomes


def show(outcomes: Sequence[Outcome], spread: Spread) -> None:
    """Print the results next to the paper's Table 2."""
    from panoexec.experiment.running import merged  # noqa: PLC0415

    groups = merged(outcomes)
    columns = (
        "scenario", "plan", "images", "Table 2", "completeness", "Table 2 ", "runs", "holes", "unconnected",
        "misalignment", "photo", "s per run",
    )  # fmt: skip
    print_table(
        "The paper's simulation case (Table 2), reproduced",
        columns,
        [_row(group) for group in groups],
        left=("plan",),
        caption=f"{_errors_text(spread)}; completeness of the worst run",
    )
    worst = [min(group, key=lambda outcome: outcome.completeness) for group in groups]
    for outcome in worst:
        if outcome.hole_px:
            where = ", ".join(f"{elevation:+.1f}°" for elevation in outcome.hole_elevations_deg)
            note(
                f"scenario {outcome.scenario}, {outcome.plan}, seed {outcome.seed}: {outcome.holes} holes"
                f" ({outcome.hole_px} of {outcome.ground_px} px), at elevation {where}"
            )


def _row(group: Sequence[Outcome]) -> tuple[str, ...]:
    from panoexec.experiment.cases import TABLE_2  # noqa: PLC0415

    first = group[0]
    paper: Any = TABLE_2.get((first.scenario, first.plan))
    worst = min(outcome.completeness for outcome in group)
    return (
        str(first.scenario),
        first.plan,
        str(first.images) + _saved(first),
        "-" if paper is None else str(paper.images),
        completeness(worst),
        "-" if paper is None else percent(paper.completeness, 0 if paper.completeness == 1 else 2),
        str(len(group)),
        _span([outcome.holes for outcome in group]),
        _span([outcome.untied for outcome in group]),
        f"{max(outcome.misalignment_deg for outcome in group):.3f}°",
        f"{first.photo_width_px} px",
        f"{sum(outcome.seconds for outcome in group) / len(group):.0f}",
    )


def _saved(outcome: Outcome) -> str:
    """Relative difference to the published number of images."""
    from panoexec.experiment.cases import TABLE_2  # noqa: PLC0415

    if outcome.plan != "certified":
        return ""
    published = TABLE_2[outcome.scenario, "proposed"].images
    return f" ({100 * (outcome.images / published - 1):+.0f} %)"


def _span(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return str(low) if low == high else f"{low}-{high}"


def _count(text: str) -> int:
    value = int(text) if text.isdecimal() else 0
    if not 1 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"{text}: the accepted range is 1 to 1000")
    return value


def _width(text: str) -> int:
    value = int(text) if text.isdecimal() else 0
    if not 128 <= value <= 20_000:
        raise argparse.ArgumentTypeError(f"{text}: the accepted range is 128 to 20000 px")
    return value
