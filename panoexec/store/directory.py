"""The directory of a mission, `<storage>/missions/<mission_id>/`, and the names of its files."""

from __future__ import annotations

import contextlib
import re
import shutil
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from panoexec.errors import UsageError

_ID = re.compile(r"\d{8}T\d{6}\.\d{3}Z")


@dataclass(frozen=True, slots=True)
class MissionDirectory:
    """The files of one mission."""

    path: Path

    @property
    def mission_id(self) -> str:
        """The mission id: the name of the directory."""
        return self.path.name

    @property
    def plan(self) -> Path:
        """The plan."""
        return self.path / "plan.json"

    @property
    def manifest(self) -> Path:
        """The manifest: what was requested and what was taken."""
        return self.path / "manifest.json"

    @property
    def journal(self) -> Path:
        """The journal, from which a mission is resumed."""
        return self.path / "journal.sqlite"

    @property
    def report(self) -> Path:
        """The HTML report."""
        return self.path / "report.html"

    @property
    def outputs(self) -> Path:
        """What exports and report were written from."""
        return self.path / "outputs.json"

    @property
    def images(self) -> Path:
        """The folder of the photos."""
        return self.path / "images"


def new_mission_directory(storage: Path, *, now_utc_s: float) -> MissionDirectory:
    """Create the directory of a new mission; its name is the UTC time to the millisecond, or the next free one.

    A clock that was set back gives an earlier name: the order of missions is that of `panoexec.store.catalogue`.

    Raises:
        UsageError: it cannot be created; the message names the directory and the system's reason.
    """
    missions = storage / "missions"
    try:
        missions.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unusable(missions, error) from error
    moment = datetime.fromtimestamp(now_utc_s, UTC)
    while True:
        path = missions / _name(moment)
        try:
            path.mkdir()
        except FileExistsError:
            moment += timedelta(milliseconds=1)
            continue
        except OSError as error:
            raise _unusable(path, error) from error
        return MissionDirectory(path)


def discard_mission_directory(directory: MissionDirectory) -> None:
    """Remove the directory of a mission that never began, and the folder `missions` if it is then empty."""
    shutil.rmtree(directory.path, ignore_errors=True)
    with contextlib.suppress(OSError):  # not empty
        directory.path.parent.rmdir()


def existing_mission_directory(path: Path) -> MissionDirectory:
    """The mission directory at a path given by the user.

    Raises:
        UsageError: it is not a directory, or has no mission.
    """
    directory = MissionDirectory(path.resolve())
    if not path.is_dir():
        raise UsageError(f"{path}: no such directory; expected a mission directory, <storage>/missions/<mission_id>")
    if not directory.journal.exists() and not directory.manifest.exists():
        raise UsageError(f"{path}: not a mission directory (neither journal.sqlite nor manifest.json)")
    return directory


def mission_directories(storage: Path) -> list[MissionDirectory]:
    """All mission directories of a storage, by name."""
    missions = storage / "missions"
    if not missions.is_dir():
        return []
    return [MissionDirectory(path) for path in sorted(missions.iterdir()) if _ID.fullmatch(path.name) and path.is_dir()]


def _name(moment: datetime) -> str:
    return f"{moment:%Y%m%dT%H%M%S}.{moment.microsecond // 1000:03d}Z"


def _unusable(path: Path, error: OSError) -> UsageError:
    return UsageError(f"{path}: cannot be created ({error.strerror}); use a folder that is writable")
