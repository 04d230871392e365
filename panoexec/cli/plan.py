"""Compute the gimbal poses that cover a panorama, with a certificate.

The default method searches for the smallest number of images whose coverage holds for all pointing errors within the
tolerances. The certificate states the result. Exit code 1: a plan was found, but it is not certified.

Example:
  panoexec plan --camera dji-x5s-15mm --overlap 0.15 --elevation -90 30 --output plan.json --plot plan.png
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from panoexec.cli.numbers import count, positive
from panoexec.cli.output import counted, in_words, note, percent, print_facts, print_json, print_table
from panoexec.cli.plan_map import check_plot_path, plot_plan
from panoexec.cli.planning_options import (
    add_camera_arguments,
    add_constraint_arguments,
    add_duration_arguments,
    add_gimbal_arguments,
    add_method_arguments,
    lens_in_words,
    profile_of,
    spec_of,
)
from panoexec.errors import UsageError
from panoexec.exports import FORMATS, export_plan
from panoexec.inputs.camera_profiles import CameraProfile
from panoexec.inputs.plan_file import plan_to_data, write_plan
from panoexec.planning.fit import what_would_fit
from panoexec.planning.model import Certificate, Constraints, Estimate, Plan
from panoexec.planning.order.duration import budget_problems, check_budget
from panoexec.planning.rows import row_table

_DISTANCES_M = (10.0, 50.0, 100.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_camera_arguments(parser, required=True)
    add_constraint_arguments(parser)
    add_gimbal_arguments(parser)
    add_method_arguments(parser)
    add_duration_arguments(parser)
    budget = parser.add_argument_group("budget")
    budget.add_argument("--max-images", type=count, metavar="N", help="maximum number of images")
    budget.add_argument("--max-duration", type=positive, metavar="S", help="maximum duration of the mission (s)")
    budget.add_argument(
        "--fit", action="store_true", help="if a maximum is exceeded, suggest an overlap or elevation range that fits"
    )
    output = parser.add_argument_group("output")
    output.add_argument("--output", type=Path, metavar="PLAN.json", help="write the plan file")
    output.add_argument(
        "--plot", type=Path, metavar="FILE.png|.svg", help="plot the image footprints on a map of the sphere"
    )
    output.add_argument(
        "--export",
        action="append",
        default=[],
        metavar="FORMAT=FILE",
        help=f"export the plan for another program: {', '.join(FORMATS)} (repeatable)",
    )
    output.add_argument(
        "--distance",
        type=positive,
        nargs="+",
        metavar="M",
        help="distances in m at which ground resolution is printed (10 50 100)",
    )
    output.add_argument("--json", action="store_true", help="print the plan file as one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Compute the plan, write the requested files and print the plan."""
    exports = [_export_target(text) for text in args.export]
    check_targets([args.output, args.plot, *(path for _, path in exports)])
    if args.plot:
        check_plot_path(args.plot)
    profile = profile_of(args)
    spec = spec_of(args, profile=profile)
    plan = spec.plan()
    _check_budget(args, plan, lambda changed: replace(spec, constraints=changed).plan())
    if args.output:
        write_plan(args.output, plan)
    if args.plot:
        plot_plan(plan, args.plot)
    for name, path in exports:
        export_plan(name, plan, path)
    if args.json:
        print_json(plan_to_data(plan))
    else:
        show_plan(plan, profile, args.distance or _DISTANCES_M, hover_min=args.hover_min)
    for path in [args.output, args.plot, *(path for _, path in exports)]:
        if path:
            note(f"wrote {path}")
    return 0 if plan.certificate is not None and plan.certificate.certified else 1


def show_plan(
    plan: Plan, profile: CameraProfile, distances_m: Sequence[float], *, hover_min: float | None = None
) -> None:
    """Print rows, certificate, duration and size of a plan."""
    camera = plan.camera
    fov = f"{camera.hfov_deg:.2f}° × {camera.vfov_deg:.2f}°"
    print(f"{counted(len(plan.shots), 'image')} of {camera.name} ({fov}, {profile.orientation}), method {plan.method}")
    print_table(
        "",
        ("row", "pitch °", "images", "spacing °", "overlap in row", "with row below"),
        (
            (
                str(row.number),
                f"{row.pitch_deg:+.2f}",
                str(row.images),
                "-" if row.spacing_deg is None else f"{row.spacing_deg:.2f}",
                percent(row.overlap_h),
                percent(row.overlap_below),
            )
            for row in reversed(row_table(plan))
        ),
    )
    facts = [("lens", lens_in_words(camera))]
    if plan.certificate is not None:
        facts += certificate_facts(plan.certificate)
    if plan.lower_bound is not None:
        facts.append(("lower bound", f"{counted(plan.lower_bound, 'image')} (solid angle; overlaps, for closed rows)"))
    if plan.estimate is not None:
        facts += _estimate_facts(plan.estimate, hover_min)
    sky_alone = sum(shot.geometry_only for shot in plan.shots)
    if sky_alone:
        facts.append(("geometry only", f"{sky_alone} images see as good as sky alone: only their angles place them"))
    facts.append(("resolution", ", ".join(f"{camera.ground_resolution_cm(d):.2g} cm at {d:g} m" for d in distances_m)))
    if profile.min_interval_s:
        facts.append(("camera interval", f"{profile.min_interval_s:g} s at least"))
    print_facts(facts)
    for text in plan.notes:
        note(f"note: {text}")


def _estimate_facts(estimate: Estimate, hover_min: float | None) -> list[tuple[str, str]]:
    after = f", of which {in_words(estimate.after_s)} for files and their examination" if estimate.after_s else ""
    facts = [("duration", f"{in_words(estimate.duration_s)} ({estimate.slew_deg:.0f}° of slews){after}")]
    if hover_min is not None:
        need = estimate.duration_s / (60 * hover_min)
        facts.append(("battery", f"{percent(need, 0)} of a full one, of {hover_min:g} min of hovering"))
    for name, (width, height) in (("panorama", estimate.band_px), ("whole sphere", estimate.panorama_px)):
        facts.append((name, f"{width} × {height} px ({width * height / 1e9:.2f} gigapixel)"))
    return facts


def certificate_facts(certificate: Certificate) -> list[tuple[str, str]]:
    """A certificate as labelled lines of text."""
    graph = (
        "two-edge-connected"
        if certificate.two_edge_connected
        else "connected, but one image pair is a single point of failure"
    )
    facts = [
        ("certificate", "CERTIFIED" if certificate.certified else "NOT CERTIFIED"),
        (
            "coverage",
            "proven for all errors within the tolerances"
            if certificate.uncovered_fraction == 0
            else f"{percent(certificate.uncovered_fraction, 4)} of the band is not proven to be covered",
        ),
        (
            "overlap in rows",
            f"at least {percent(certificate.min_overlap_h)} (worst case {percent(certificate.worst_overlap_h)})",
        ),
        *_row_overlap(certificate),
        ("image graph", graph if certificate.connected else "not connected"),
    ]
    facts += [("  fails", failure) for failure in certificate.failures]
    facts += [
        (
            "  hole",
            f"{hole.size_deg:.3g}° across at elevation {hole.elevation_deg:.2f}°, azimuth {hole.azimuth_deg:.2f}°",
        )
        for hole in certificate.holes[:5]
    ]
    return facts


def _row_overlap(certificate: Certificate) -> list[tuple[str, str]]:
    """The overlap of neighbouring rows; nothing where there is one row."""
    least, worst = certificate.min_overlap_v, certificate.worst_overlap_v
    if least is None:
        return []
    return [("overlap of rows", f"at least {percent(least)} (worst case {percent(worst)})")]


def _check_budget(args: argparse.Namespace, plan: Plan, plan_with: Callable[[Constraints], Plan]) -> None:
    limits = {"max_images": args.max_images, "max_duration_s": args.max_duration}
    if budget_problems(plan, **limits):
        hint = "--fit suggests an overlap or elevation range that fits"
        if args.fit:
            hint = what_would_fit(plan.constraints, plan_with, **limits)
        check_budget(plan, **limits, hint=hint)


def _export_target(text: str) -> tuple[str, Path]:
    name, equals, file = text.partition("=")
    if not equals or not file or name not in FORMATS:
        raise UsageError(f"--export {text}: expected FORMAT=FILE with a format of {', '.join(FORMATS)}")
    return name, Path(file)


def check_targets(paths: Sequence[Path | None]) -> None:
    """Check before any work that the output files can be written."""
    for path in paths:
        if path is None:
            continue
        if path.is_dir():
            raise UsageError(f"{path} is a folder: give the name of a file")
        if not path.parent.is_dir():
            raise UsageError(f"{path}: folder {path.parent} does not exist: create it first")
