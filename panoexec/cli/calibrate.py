"""Estimate the gimbal's own errors from flights: measured attitudes against those that the photos' content implies.

The missions need photos that were examined in flight ([pictures] check) and tied to each other. Printed are, for each
axis, the bias and the spread of the measurement, the largest pointing error as measured, and the tolerance τ that
contains both together, for the next plan. Ties tell nothing about a heading error that all photos share.

If the photos are still in the mission directories, they are matched again and the lens is adjusted with them:
calibrated focal length, radial distortion, principal point where they tell it, and the margin for what stays unknown,
as keys for the camera profile.

Exit code 1: too few tied photos.

Example:
  panoexec calibrate missions/20260921T141320.000Z missions/20260921T153110.000Z
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from panoexec.cli.output import note, print_json, print_table
from panoexec.exports.calibration import LEAST_PHOTOS, calibrate
from panoexec.store.directory import existing_mission_directory
from panoexec.store.rebuilding import current_manifest

if TYPE_CHECKING:
    from panoexec.exports.lens_calibration import LensProposal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("missions", type=Path, nargs="+", metavar="MISSION_DIR", help="mission directories")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Print the figures."""
    directories = [existing_mission_directory(path) for path in args.missions]
    documents = [current_manifest(directory) for directory in directories]
    found = calibrate(documents)
    lens = None if found is None else _lens([(doc, at.path) for doc, at in zip(documents, directories, strict=True)])
    if args.json:
        axes = {} if found is None else {axis: _plain(dataclasses.asdict(own)) for axis, own in found.axes.items()}
        photos = 0 if found is None else found.photos
        print_json({"missions": len(args.missions), "photos": photos, "axes": axes, "lens": _lens_json(lens)})
    if found is None:
        note(f"panoexec: fewer than {LEAST_PHOTOS} photos of these missions are tied to others: nothing can be said")
        return 1
    if not args.json:
        print_table(
            f"{found.photos} tied photos of {found.missions} missions",
            ("axis", "bias °", "spread °", "pointing °", "τ °"),
            (
                (
                    axis,
                    "–" if math.isnan(own.bias_deg) else f"{own.bias_deg:+.3f}",
                    f"{own.spread_deg:.3f}",
                    f"{own.pointing_deg:.3f}",
                    f"{own.tolerance_deg:.2f}",
                )
                for axis, own in found.axes.items()
            ),
            left=("axis",),
        )
        _print_lens(lens)
    return 0


def _lens(missions: Sequence[tuple[Mapping[str, Any], Path]]) -> LensProposal | None:
    from panoexec.exports.lens_calibration import propose_lens  # noqa: PLC0415  (it imports Pillow)

    return propose_lens(missions)


def _lens_json(lens: LensProposal | None) -> dict[str, Any] | None:
    if lens is None:
        return None
    point = lens.principal_point_px
    return {
        "calibrated_focal_length_mm": round(lens.focal_length_mm, 4),
        "focal_sigma_mm": round(lens.focal_sigma_mm, 4),
        "distortion": {"k1": round(lens.k1, 5), "k2": round(lens.k2, 5)},
        "k1_sigma": round(lens.k1_sigma, 5),
        "k2_sigma": round(lens.k2_sigma, 5),
        "principal_point_px": None if point is None else [round(value, 1) for value in point],
        "principal_sigma_px": [round(value, 1) for value in lens.principal_sigma_px],
        "fov_margin": lens.fov_margin,
        "points": lens.points,
        "missions": lens.missions,
    }


def _print_lens(lens: LensProposal | None) -> None:
    if lens is None:
        note("the lens: nothing, without the photos of one camera in the mission directories")
        return
    print_table(
        f"lens, from {lens.points} points of {lens.missions} missions",
        ("proposal for the profile", "value", "±"),
        (
            ("calibrated_focal_length_mm", f"{lens.focal_length_mm:.3f}", f"{lens.focal_sigma_mm:.3f}"),
            ("distortion k1", f"{lens.k1:+.4f}", f"{lens.k1_sigma:.4f}"),
            ("distortion k2", f"{lens.k2:+.4f}", f"{lens.k2_sigma:.4f}"),
            ("principal_point_px", *_point(lens)),
            ("fov_margin", f"{lens.fov_margin:.3f}", ""),
        ),
        left=("proposal for the profile",),
    )
    print(f"calibrated_focal_length_mm = {lens.focal_length_mm:.3f}")
    print(f"distortion = {{ k1 = {lens.k1:.4f}, k2 = {lens.k2:.4f} }}")
    if lens.principal_point_px is not None:
        print("principal_point_px = [{:.1f}, {:.1f}]".format(*lens.principal_point_px))
    print(f"fov_margin = {lens.fov_margin:.3f}")


def _point(lens: LensProposal) -> tuple[str, str]:
    sigma = "{:.1f}, {:.1f}".format(*lens.principal_sigma_px)
    if lens.principal_point_px is None:
        return "the middle", sigma
    return "{:.1f}, {:.1f}".format(*lens.principal_point_px), sigma


def _plain(values: dict[str, float]) -> dict[str, float | None]:
    return {name: None if math.isnan(value) else round(value, 4) for name, value in values.items()}
