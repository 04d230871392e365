"""Write the report of a mission as one HTML page that opens in any browser without network access.

The page (MISSION_DIR/report.html) shows the sphere map of the photos, coverage and certificate, the pointing error of
every attempt, retakes with their reasons, a time breakdown, the battery, and the panorama: the stitched panorama after
`panoexec stitch`, otherwise a preview rendered from the photos and their measured attitudes. Every mission writes the
report at its end. Run this command after stitching.

With --embed, copies of the photos are written that carry attitude and position inside as XMP, for programs that read no
sidecars (OpenDroneMap); their picture data are not touched.

With a tour (its file <storage>/tours/TOUR.json, or its name with --storage), one page of all its stations is written
beside it: a map, what became of each, and hops from panorama to panorama.

Exit code 1: the mission has no accepted photo, or photos are missing or damaged. The page is written nevertheless.

Example:
  panoexec report missions/20260921T141320.000Z
  panoexec report tour-20261130T181739.545Z --storage /var/lib/panoexec
"""

from __future__ import annotations

import argparse
from pathlib import Path

from panoexec.cli.output import note, print_json
from panoexec.errors import UsageError
from panoexec.exports import export_set
from panoexec.exports.odm import write_embedded
from panoexec.inputs.service_sections import StorageSection
from panoexec.report import Report, write_report
from panoexec.report.tour import write_tour_report
from panoexec.store.directory import MissionDirectory, existing_mission_directory
from panoexec.store.rebuilding import current_manifest
from panoexec.store.tours import find_tour

STORAGE = StorageSection().path
_SHOWN = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("mission", type=Path, metavar="MISSION_DIR|TOUR", help="mission directory, or a tour")
    parser.add_argument("--storage", type=Path, default=STORAGE, metavar="DIR", help=f"where tours are ({STORAGE})")
    parser.add_argument("--embed", type=Path, metavar="DIR", help="write copies of the photos with XMP inside to DIR")
    parser.add_argument(
        "--json", action="store_true", help="print the path of the page and the problems as one JSON document on stdout"
    )


def run(args: argparse.Namespace) -> int:
    """Write the page and print its path."""
    tour = find_tour(str(args.mission), [args.storage])
    if tour is not None:
        return _tour(tour, as_json=args.json, embed=args.embed)
    directory = existing_mission_directory(args.mission)
    report = write_report(directory)
    _explain(report)
    failed = _embed(directory, args.embed) if args.embed is not None else False
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
    return 1 if report.problems or not report.photos or failed else 0


def _tour(path: Path, *, as_json: bool, embed: Path | None) -> int:
    if embed is not None:
        raise UsageError("--embed: is for one mission, not for a tour")
    report = write_tour_report(path)
    for text in report.notes:
        note(f"note: {text}")
    note(f"{report.complete} of {report.stops} stops complete, {report.panoramas} panoramas on the page")
    if report.missed:
        note(f"no stop at waypoints {', '.join(map(str, report.missed))}")
    if as_json:
        print_json(
            {
                "report": str(report.path),
                "missed": list(report.missed),
                "stops": report.stops,
                "complete": report.complete,
                "panoramas": report.panoramas,
                "notes": list(report.notes),
            }
        )
    else:
        print(report.path)
    return 0 if report.stops and report.complete == report.stops and not report.missed else 1


def _embed(directory: MissionDirectory, target: Path) -> bool:
    """Write copies with XMP inside; returns whether some could not be written."""
    exports = export_set(current_manifest(directory), directory.path)
    written, problems = write_embedded(exports, directory.path, target)
    note(f"{len(written)} photos with XMP inside: {target}")
    for name, reason in list(problems.items())[:_SHOWN]:
        note(f"{name}: not embedded: {reason}")
    return bool(problems)


def _explain(report: Report) -> None:
    for text in report.notes:
        note(f"note: {text}")
    if not report.photos:
        note("the mission has no accepted photo")
    damaged = [(index, photo) for index, photo in report.problems if not photo.is_absent]
    for index, photo in damaged[:_SHOWN]:
        note(f"shot {index}: {photo.name} {photo.problem}")
    if len(damaged) > _SHOWN:
        note(f"… and {len(damaged) - _SHOWN} more")
    if report.absent:
        note(report.absent)
    if report.photos and not report.panorama:
        note(f"no panorama: {report.why_none}")
