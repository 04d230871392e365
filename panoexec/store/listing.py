"""The missions of a storage, as people list them: name, state, photos present, size."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panoexec.errors import InputFileError
from panoexec.store.catalogue import StoredJournal, catalogue
from panoexec.store.manifest import read_manifest


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionEntry:
    """One mission.

    Attributes:
        mission_id: its id.
        name: what people call it, "" for none.
        state: `complete`, `paused`, …; `damaged` if neither its journal nor its manifest can be read.
        shots_total: shots of the plan and its patches.
        shots_done: shots with an accepted photo.
        photos: accepted shots whose photo is in the mission directory.
        size_bytes: of all files of the mission.
        path: its directory.
        problem: why it is damaged, "" if it is not.
    """

    mission_id: str
    name: str
    state: str
    shots_total: int
    shots_done: int
    photos: int
    size_bytes: int
    path: Path
    problem: str = ""

    def document(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "mission_id": self.mission_id,
            "name": self.name,
            "state": self.state,
            "shots_total": self.shots_total,
            "shots_done": self.shots_done,
            "photos": self.photos,
            "size_bytes": self.size_bytes,
            "path": str(self.path),
            "problem": self.problem,
        }


def list_missions(storage: Path, *, newest: int | None = None) -> list[MissionEntry]:
    """The missions of a storage, oldest first; blocks.

    Args:
        storage: the storage root.
        newest: only so many of the newest; None for all.
    """
    found = catalogue(storage)
    return [_entry(one) for one in (found if newest is None else found[-newest:])]


def _entry(stored: StoredJournal) -> MissionEntry:
    directory = stored.directory
    try:
        manifest: Mapping[str, Any] = read_manifest(directory.manifest)
        problem = ""
    except InputFileError as error:
        manifest, problem = {}, stored.problem or str(error)
    counts, shots = manifest.get("counts", {}), manifest.get("shots", [])
    state = str(manifest.get("state", "damaged"))
    if stored.glance is not None:
        state = stored.glance.state.value  # the manifest may be older
    return MissionEntry(
        mission_id=directory.mission_id,
        name=str(manifest.get("name") or ""),
        state=state,
        shots_total=int(counts.get("shots_total", 0)),
        shots_done=int(counts.get("shots_done", 0)),
        photos=sum(1 for shot in shots if _is_present(shot, directory.path)),
        size_bytes=sum(_sizes(directory.path)),
        path=directory.path,
        problem=problem,
    )


def _is_present(shot: Mapping[str, Any], folder: Path) -> bool:
    file = str(shot.get("file") or "")
    return shot.get("accepted_attempt") is not None and bool(file) and (folder / file).is_file()


def _sizes(folder: Path) -> Iterator[int]:
    for parent, _, names in os.walk(folder):
        for name in names:
            try:
                yield os.lstat(Path(parent) / name).st_size
            except OSError:  # it was just removed
                continue
