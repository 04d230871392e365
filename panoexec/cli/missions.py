"""List the missions of a storage: id, name, state, shots, photos present, size. The newest is the last one.

Exit code 2: there is no such storage.

Examples:
  panoexec missions
  panoexec missions --storage flown --json
"""

from __future__ import annotations

import argparse

from panoexec.cli.output import local_time, note, print_json, print_table
from panoexec.cli.storage_options import add_storage_arguments, storage_of
from panoexec.store.listing import list_missions


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_storage_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the list as one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Print the list."""
    storage = storage_of(args)
    found = list_missions(storage)
    if args.json:
        print_json([entry.document() for entry in found])
        return 0
    if not found:
        note(f"{storage}: no missions")
        return 0
    began = {entry.mission_id: local_time(entry.mission_id, "%Y-%m-%d %H:%M") for entry in found}
    local = ("local time",) if any(began.values()) else ()
    print_table(
        "",
        ("mission", *local, "name", "state", "shots", "photos", "MB"),
        [
            (
                entry.mission_id,
                *(began[entry.mission_id] for _ in local),
                entry.name,
                entry.state,
                f"{entry.shots_done}/{entry.shots_total}",
                str(entry.photos),
                f"{entry.size_bytes / 1e6:.1f}",
            )
            for entry in found
        ],
        left=("mission", "local time", "name", "state"),
    )
    for entry in found:
        if entry.problem:
            note(f"{entry.mission_id}: {entry.problem}")
    return 0
