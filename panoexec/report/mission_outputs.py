"""The outputs of a mission, written at its end by the daemon and the dry-run: exports and report.

They are derived from the manifest and the photos, and can be written again at any time. `outputs.json`, written last,
says from which event of the journal on nothing is missing: a process that was killed before left something to be
written again (`restore_outputs`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, Final

from panoexec.errors import InputFileError, PanoexecError, UsageError
from panoexec.exports import export_set, write_exports
from panoexec.files import write_atomically
from panoexec.report import QUICK_LOOK_CPU_S, write_report
from panoexec.store.catalogue import Glance, glance
from panoexec.store.directory import MissionDirectory
from panoexec.store.manifest import manifest_events, read_manifest
from panoexec.store.rebuilding import restore_manifest

FORMAT: Final = "panoexec.outputs/1"
_LEAST: Final = ("shots.csv", "report.html")
"""Outputs that every mission has."""
_EXPORTS: Final = (*_LEAST, "panorama.pto", "papywizard.xml", "panorama.xmp")
_STEMS: Final = frozenset({"manifest", "outputs", *(name.partition(".")[0] for name in _EXPORTS)})


def write_mission_outputs(directory: MissionDirectory) -> None:
    """Write all outputs; a failure of one does not prevent the others.

    Blocks: call it in a thread. Also used for interrupted missions, with the data so far.

    Args:
        directory: with a manifest.

    Raises:
        UsageError: lists all outputs that could not be written; or the manifest is missing or damaged.
    """
    problems: list[str] = []
    for name, write in MISSION_OUTPUTS.items():
        try:
            write(directory)
        except InputFileError:
            raise
        except PanoexecError as error:
            problems.append(f"{name}: {error}")
    if problems:
        raise UsageError("; ".join(problems))
    _note_written(directory)


def restore_outputs(directory: MissionDirectory) -> bool:
    """Write manifest and outputs again if one is missing or older than the journal; blocks.

    Args:
        directory: of a mission that no process flies.

    Returns:
        Whether something was written.

    Raises:
        UsageError: the journal cannot be read or lost its end, or something cannot be written.
    """
    seen = glance(directory.journal)
    if not seen.events or _are_current(directory, seen):
        return False
    restore_manifest(directory)
    write_mission_outputs(directory)
    for path in directory.path.glob(".*-????????.*"):  # temporary files of the process that was killed
        if path.is_file() and path.name[1:].rpartition("-")[0] in _STEMS:
            path.unlink(missing_ok=True)
    return True


def _are_current(directory: MissionDirectory, seen: Glance) -> bool:
    """Whether nothing has to be written again; decided by small files only, because a storage has many missions."""
    try:
        document: Any = json.loads(directory.outputs.read_text(encoding="utf-8"))
        told, names = int(document["events"]), [str(name) for name in document["files"]]
    except (OSError, ValueError, TypeError, KeyError):
        told, names = -1, []
    if told == -1 and not seen.number:  # an earlier version wrote no such file
        try:
            state = read_manifest(directory.manifest).get("state")
        except InputFileError:
            return False
        told, names = (seen.events if state == seen.state.value else -1), list(_LEAST)
    return told == seen.events and all((directory.path / name).is_file() for name in ("manifest.json", *names))


def _note_written(directory: MissionDirectory) -> None:
    events = manifest_events(read_manifest(directory.manifest))
    if events is not None:
        names = [name for name in _EXPORTS if (directory.path / name).is_file()]
        write_atomically(directory.outputs, json.dumps({"format": FORMAT, "events": events, "files": names}) + "\n")


def _exports(directory: MissionDirectory) -> None:
    """Hugin project, Papywizard file, CSV table, XMP sidecars."""
    write_exports(export_set(read_manifest(directory.manifest), directory.path), directory.path)


def _report(directory: MissionDirectory) -> None:
    """The HTML report."""
    write_report(directory, max_cpu_s=QUICK_LOOK_CPU_S)


MISSION_OUTPUTS: Final[Mapping[str, Callable[[MissionDirectory], None]]] = {"exports": _exports, "report": _report}
"""The writers by name (for messages); a writer raises a PanoexecError on failure."""
