"""What a mission leaves in its directory for others, written at each end: by the daemon and the dry-run alike.

The manifest is there already; from it and the photos beside it everything here can be made anew at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from panoexec.errors import InputFileError, PanoexecError, UsageError
from panoexec.exports import export_set, write_exports
from panoexec.report import AT_ONCE_S, write_report
from panoexec.store.directory import MissionDirectory
from panoexec.store.manifest import read_manifest


def write_mission_outputs(directory: MissionDirectory) -> None:
    """Write all of them; what cannot be written does not keep the others from being written.

    Blocks: use it in a thread. Missions that were interrupted leave them too, of what there is.

    Args:
        directory: with a manifest.

    Raises:
        UsageError: with everything that could not be written, or because the manifest is not there or is damaged.
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
    """Hugin project, Papywizard file, table, sidecars."""
    write_exports(export_set(read_manifest(directory.manifest), directory.path), directory.path)


def _report(directory: MissionDirectory) -> None:
    """The page for people."""
    write_report(directory, patience_s=AT_ONCE_S)


MISSION_OUTPUTS: Final[Mapping[str, Callable[[MissionDirectory], None]]] = {"exports": _exports, "report": _report}
"""Each by a name for messages; a writer raises a PanoexecError if it cannot."""
