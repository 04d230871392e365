"""The outputs of a mission, written at its end by the daemon and the dry-run: exports and report.

They are derived from the manifest and the photos, and can be written again at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from panoexec.errors import InputFileError, PanoexecError, UsageError
from panoexec.exports import export_set, write_exports
from panoexec.report import QUICK_LOOK_CPU_S, write_report
from panoexec.store.directory import MissionDirectory
from panoexec.store.manifest import read_manifest


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


def _exports(directory: MissionDirectory) -> None:
    """Hugin project, Papywizard file, CSV table, XMP sidecars."""
    write_exports(export_set(read_manifest(directory.manifest), directory.path), directory.path)


def _report(directory: MissionDirectory) -> None:
    """The HTML report."""
    write_report(directory, max_cpu_s=QUICK_LOOK_CPU_S)


MISSION_OUTPUTS: Final[Mapping[str, Callable[[MissionDirectory], None]]] = {"exports": _exports, "report": _report}
"""The writers by name (for messages); a writer raises a PanoexecError on failure."""
