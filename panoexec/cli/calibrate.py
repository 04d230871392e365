"""Estimate the gimbal's own errors from flights: measured attitudes against those that the photos' content implies.

The missions need photos that were examined in flight ([pictures] check) and tied to each other. Printed are, for each
axis, the bias and the spread of the measurement, the largest pointing error as measured, and the tolerance τ that
contains both together, for the next plan. Ties tell nothing about a heading error that all photos share.

Exit code 1: too few tied photos.

Example:
  panoexec calibrate missions/20260921T141320.000Z missions/20260921T153110.000Z
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path

from panoexec.cli.output import note, print_json, print_table
from panoexec.exports.calibration import LEAST_PHOTOS, calibrate
from panoexec.store.directory import existing_mission_directory
from panoexec.store.rebuilding import current_manifest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("missions", type=Path, nargs="+", metavar="MISSION_DIR", help="mission directories")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Print the figures."""
    found = calibrate([current_manifest(existing_mission_directory(path)) for path in args.missions])
    if args.json:
        axes = {} if found is None else {axis: _plain(dataclasses.asdict(own)) for axis, own in found.axes.items()}
        print_json({"missions": len(args.missions), "photos": 0 if found is None else found.photos, "axes": axes})
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
    return 0


def _plain(values: dict[str, float]) -> dict[str, float | None]:
    return {name: None if math.isnan(value) else round(value, 4) for name, value in values.items()}
