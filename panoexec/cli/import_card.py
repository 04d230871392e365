"""Put the photos of a memory card into a mission: each with the attempt that took it.

For cameras that keep their files. The photos are paired with the attempts of the mission's journal by their EXIF times:
one offset between the camera's clock and that of the computer on board explains all of them, however wrong the camera's
clock was. Where photos overlap, their content confirms it. Photos that belong to no attempt stay where they are; RAW
files come along with their JPEGs. If two pairings are nearly as good, nothing is changed. Manifest, exports and report
are then written anew.

Exit code 0: every accepted shot has its photo. 1: photos are missing, or could not be stored. 2: the pairing is
ambiguous or contradicted, or the card or the mission cannot be read; then nothing was changed.

Examples:
  panoexec import missions/20260921T141320.000Z /media/card --dry-run
  panoexec import missions/20260921T141320.000Z /media/card
"""

from __future__ import annotations

import argparse
from pathlib import Path

from panoexec.cli.output import note, print_json
from panoexec.errors import PanoexecError
from panoexec.importing.card_import import CardImport, How, carry_out, plan_import
from panoexec.report.mission_outputs import restore_outputs
from panoexec.store.directory import existing_mission_directory

_SHOWN = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("mission", type=Path, metavar="MISSION", help="mission directory")
    parser.add_argument("card", type=Path, metavar="CARD", help="folder of the memory card, or of its copy")
    parser.add_argument("--dry-run", action="store_true", help="show the pairing and change nothing")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--copy", dest="how", action="store_const", const="copy", help="copy the files (default)")
    how.add_argument(
        "--link", dest="how", action="store_const", const="link", help="hard links, where the file system has them"
    )
    how.add_argument("--move", dest="how", action="store_const", const="move", help="remove the files from the card")
    parser.add_argument("--json", action="store_true", help="print the pairing as one JSON document on stdout")
    parser.set_defaults(how="copy")


def run(args: argparse.Namespace) -> int:
    """Pair, show, store, write anew."""
    directory = existing_mission_directory(args.mission)
    plan = plan_import(directory, args.card)
    troubles: list[str] = []
    stored = 0
    if not args.dry_run:
        how: How = args.how
        stored = carry_out(plan, how=how, told=troubles.append)
        try:
            restore_outputs(directory)
        except (PanoexecError, ValueError, OSError) as error:
            troubles.append(f"not written: {error}")
    if args.json:
        print_json(_document(plan, stored, troubles))
    _explain(plan, stored, troubles, dry=args.dry_run, quiet=args.json)
    return 1 if plan.missing or troubles else 0


def _document(plan: CardImport, stored: int, troubles: list[str]) -> dict[str, object]:
    found = plan.pairing
    return {
        "mission": str(plan.directory.path),
        "card": str(plan.card.folder),
        "clock_offset_s": round(found.offset_s, 3),
        "rms_s": round(found.rms_s, 3),
        "margin": None if found.margin == float("inf") else round(found.margin, 2),
        "content": plan.content,
        "stored": stored,
        "pairs": [
            {
                "shot": item.shot,
                "attempt": item.attempt,
                "photo": item.photo,
                "accepted": item.accepted,
                "file": str(photo.path),
                "raw": None if photo.raw is None else str(photo.raw),
                "off_s": round(photo.taken_s - item.time_s - found.offset_s, 3),
            }
            for item, photo in found.of_mission
        ],
        "missing": [{"shot": one.shot, "attempt": one.attempt, "photo": one.photo} for one in plan.missing],
        "strangers": [str(photo.path) for photo in plan.strangers],
        "problems": [{"file": str(path), "problem": problem} for path, problem in plan.card.problems],
        "troubles": troubles,
    }


def _explain(plan: CardImport, stored: int, troubles: list[str], *, dry: bool, quiet: bool) -> None:
    found = plan.pairing
    pairs = found.of_mission
    if dry and not quiet:
        for item, photo in pairs:
            state = "" if item.accepted else ", rejected"
            off_s = photo.taken_s - item.time_s - found.offset_s
            raw = "" if photo.raw is None else f" + {photo.raw.suffix}"
            print(f"shot {item.shot}, attempt {item.attempt}{state}: {photo.path.name}{raw} ({off_s:+.2f} s)")
    for path, problem in plan.card.problems[:_SHOWN]:
        note(f"{path}: {problem}")
    if len(plan.card.problems) > _SHOWN:
        note(f"… and {len(plan.card.problems) - _SHOWN} more files that cannot be paired")
    for one in plan.missing[:_SHOWN]:
        note(f"no photo of shot {one.shot}, attempt {one.attempt}")
    if len(plan.missing) > _SHOWN:
        note(f"… and {len(plan.missing) - _SHOWN} more shots without a photo")
    for trouble in troubles:
        note(trouble)
    if quiet:
        return
    margin = "no other pairing fits" if found.margin == float("inf") else f"the next best costs {found.margin:.0f} more"
    print(
        f"{len(pairs)} photos paired, {plan.rejected} of rejected attempts; {len(plan.strangers)} of no attempt;"
        f" {len(plan.missing)} missing"
    )
    print(
        f"the camera's clock is {_signed(found.offset_s)} from this computer's (within {found.rms_s:.2f} s; {margin})"
    )
    print(plan.content)
    print("nothing was changed" if dry else f"{stored} photos stored in {plan.directory.images}")


def _signed(seconds: float) -> str:
    """An offset as hours, minutes and seconds."""
    whole = abs(seconds)
    hours, rest = divmod(whole, 3600)
    minutes, rest = divmod(rest, 60)
    return f"{'-' if seconds < 0 else '+'}{hours:.0f}:{minutes:02.0f}:{rest:05.2f}"
