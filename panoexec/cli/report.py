"""Write the report of a mission: one HTML page that opens in any browser, without a network.

The page (MISSION_DIR/report.html) shows the sphere map of what was taken, coverage and certificate, every attempt's
pointing error, retakes and their reasons, where the time went, the battery, and the panorama: the stitched one after
`panoexec stitch`, else a quick look made from the photos by their measured attitudes. Every mission writes it at its
end; run this after copying photos from the camera, or after stitching.

Exit code 1: the mission has no accepted photo, or some photos are missing or damaged; the page is written all the same.

Example:
  panoexec report missions/20260921T141320.000Z
"""

from __future__ import annotations

import argparse
from pathlib import Path

from panoexec.cli.output import note, print_json
from panoexec.report import Report, write_report
from panoexec.store.directory import existing_mission_directory

_SHOWN = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("mission", type=Path, metavar="MISSION_DIR", help="the mission's directory")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout: where the page is, problems")


def run(args: argparse.Namespace) -> int:
    """Write the page and say where it is."""
    directory = existing_mission_directory(args.mission)
    report = write_report(directory)
    _explain(report, directory.images)
    if args.json:
        print_json(
            {
                "report": str(report.path),
                "panorama": report.panorama,
                "photos": report.photos,
                "problems": [{"shot": i, "file": p.name, "problem": p.problem} for i, p in report.problems],
                "notes": list(report.notes),
            }
        )
    else:
        print(report.path)
    return 1 if report.problems or not report.photos else 0


def _explain(report: Report, images: Path) -> None:
    for text in report.notes:
        note(f"note: {text}")
    if not report.photos:
        note("the mission has no accepted photo")
    for index, photo in report.problems[:_SHOWN]:
        note(f"shot {index}: {photo.name or 'photo'} {photo.problem}")
    if len(report.problems) > _SHOWN:
        note(f"… and {len(report.problems) - _SHOWN} more")
    if any(photo.problem == "is missing" for _, photo in report.problems):
        note(f"copy missing photos from the camera into {images} and run this again")
    if report.photos and not report.panorama:
        note(f"no picture of the sphere: {report.why_none}")
