"""Recover the longest true part of a mission whose journal is damaged, and write what is derived from it again.

Every event of a mission is sealed and chained to the one before. This command keeps the events from the first on whose
chain holds, in a new journal. The damaged files are moved into MISSION_DIR/damaged-1 (or the next free number) and are
not changed. Manifest, exports and report are then written from the new journal. A journal that is whole stays as it is.
Stop the daemon first: a mission that it has open is refused.

Exit code 0: nothing was lost. 1: something was, and is named. 2: not a mission directory, in use, or nothing can be
recovered; then nothing was changed.

Example:
  panoexec salvage missions/20260921T141320.000Z
"""

from __future__ import annotations

import argparse
from pathlib import Path

from panoexec.cli.output import note, print_json
from panoexec.errors import PanoexecError
from panoexec.files import write_atomically
from panoexec.report.mission_outputs import restore_outputs, write_mission_outputs
from panoexec.store.directory import MissionDirectory, existing_mission_directory
from panoexec.store.journal import load_journal
from panoexec.store.rebuilding import derived_manifest
from panoexec.store.salvage import Salvage, salvage_journal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("mission", type=Path, metavar="MISSION_DIR", help="mission directory")
    parser.add_argument("--json", action="store_true", help="print what was recovered as one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Recover, write again, and say what is lost."""
    directory = existing_mission_directory(args.mission)
    salvage = salvage_journal(directory)
    unwritten = _write_derived(directory, salvage)
    if args.json:
        print_json(
            {
                "mission": str(directory.path),
                "whole": salvage.whole,
                "damage": salvage.damage,
                "events": salvage.events,
                "lost": {
                    "events": salvage.lost_events,
                    "head": list(salvage.lost_head),
                    "shots": list(salvage.lost_shots),
                },
                "aside": None if salvage.aside is None else str(salvage.aside),
                "unwritten": unwritten,
                "notes": list(salvage.notes),
            }
        )
    _explain(salvage, unwritten, quiet=args.json)
    return 0 if salvage.whole and not unwritten else 1


def _write_derived(directory: MissionDirectory, salvage: Salvage) -> str:
    """Write manifest, exports and report; returns why that was not possible, "" if it was."""
    try:
        if salvage.aside is None:
            restore_outputs(directory)
        else:
            # of the new journal, although the manifest may tell more: it told of events that are lost
            write_atomically(directory.manifest, derived_manifest(directory, load_journal(directory.journal)))
            write_mission_outputs(directory)
    except (PanoexecError, ValueError, OSError) as error:
        return str(error)
    return ""


def _explain(salvage: Salvage, unwritten: str, *, quiet: bool) -> None:
    for text in salvage.notes:
        note(f"note: {text}")
    if salvage.damage:
        note(salvage.damage)
        note(f"the damaged files are in {salvage.aside}, unchanged")
    if salvage.lost_head:
        note(f"lost: {', '.join(salvage.lost_head)}{_consequence(salvage.lost_head)}")
    if salvage.lost_events is None:
        note("lost: it is not known whether more events followed")
    elif salvage.lost_events:
        note(f"lost: {salvage.lost_events} events after event {salvage.events}")
    if salvage.lost_shots:
        shots = ", ".join(map(str, salvage.lost_shots))
        note(f"lost: the evidence of shots {shots}, whose photos the former manifest names")
    if unwritten:
        note(f"not written: {unwritten}")
    if not quiet:
        kept = "whole" if salvage.whole and not salvage.damage else "recovered"
        print(f"{kept}: {salvage.events} events{'' if salvage.whole else ', something is lost'}")


def _consequence(lost: tuple[str, ...]) -> str:
    return "; the mission cannot be resumed" if {"plan", "settings"} & set(lost) else ""
