"""The input of a report: manifest, plan, journal, photos and stitching result of one mission directory."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from panoexec.codec import decode
from panoexec.errors import UsageError
from panoexec.exports.model import local_name
from panoexec.formats.jpeg_header import read_jpeg_header
from panoexec.inputs.plan_file import PlanFile, read_plan_file
from panoexec.mission.log.events import Event
from panoexec.mission.settings import MissionSettings
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import read_journal
from panoexec.store.rebuilding import current_manifest

_ABSENT: Final = "is missing"
_UNNAMED: Final = "has no known file name"
_NAMED: Final = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoFile:
    """A photo that the manifest names.

    Attributes:
        name: path in the mission directory; "" if unknown.
        problem: why the photo is unusable, "" if it is usable.
    """

    name: str
    problem: str = ""

    @property
    def is_absent(self) -> bool:
        """Whether the photo has not reached this computer."""
        return self.problem in {_ABSENT, _UNNAMED}


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """The data of a mission.

    Attributes:
        folder: its directory.
        manifest: `panoexec.manifest/1`.
        plan: the plan; None if it is missing or cannot be read.
        settings: the mission's settings; None without a journal.
        events: of the journal; empty without one.
        simulated: whether times are those of a simulated vehicle, not wall time.
        photos: by shot index, of the accepted attempt.
        stitch: `panoexec.stitch/1` if the mission was stitched.
        notes: texts about files that could not be read.
    """

    folder: Path
    manifest: Mapping[str, Any]
    plan: PlanFile | None = None
    settings: MissionSettings | None = None
    events: tuple[Event, ...] = ()
    simulated: bool = False
    photos: Mapping[int, PhotoFile] = field(default_factory=dict)
    stitch: Mapping[str, Any] | None = None
    notes: tuple[str, ...] = ()

    @property
    def photo_problems(self) -> list[tuple[int, PhotoFile]]:
        """Accepted shots whose photo is missing or damaged, in order."""
        return [(index, photo) for index, photo in sorted(self.photos.items()) if photo.problem]

    @property
    def damaged(self) -> list[tuple[int, PhotoFile]]:
        """Accepted shots whose photo is here and cannot be used, in order."""
        return [(index, photo) for index, photo in self.photo_problems if not photo.is_absent]


def absence(problems: Sequence[tuple[int, PhotoFile]], *, photos: int, folder: Path) -> str:
    """What to do about the photos that have not reached this computer; "" if all have.

    Args:
        problems: shots with their photos.
        photos: how many accepted photos there are.
        folder: the mission directory.
    """
    shots = [index for index, photo in problems if photo.is_absent]
    if not shots:
        return ""
    how = f"copy its card and run: panoexec import {folder} CARD"
    if len(shots) == photos:
        return f"the photos are still in the camera: {how}"
    named = ", ".join(map(str, shots[:_NAMED])) + (", …" if len(shots) > _NAMED else "")
    return f"{len(shots)} of {photos} photos are still in the camera (shots {named}): {how}"


def read_source(directory: MissionDirectory) -> Source:
    """Read a mission's directory; only the manifest is required.

    Raises:
        InputFileError: the manifest is missing or damaged.
    """
    manifest = current_manifest(directory)
    notes: list[str] = []
    plan, settings, simulated = None, None, False
    events: tuple[Event, ...] = ()
    try:
        plan = read_plan_file(directory.plan)
    except UsageError as error:
        notes.append(f"the plan's constraints are missing: {error}")
    try:
        head, found = read_journal(directory.journal)
        events = tuple(found)
        settings = decode(MissionSettings, json.loads(head["settings"]))
        simulated = "simulation" in json.loads(head.get("extra", "{}"))
    except (UsageError, KeyError, TypeError, ValueError) as error:
        notes.append(f"the journal's times are missing: {error}")
    return Source(
        folder=directory.path,
        manifest=manifest,
        plan=plan,
        settings=settings,
        events=events,
        simulated=simulated,
        photos=_photos(manifest, directory.path),
        stitch=_stitch(directory.path / "stitch" / "stitch.json"),
        notes=tuple(notes),
    )


def _photos(manifest: Mapping[str, Any], folder: Path) -> dict[int, PhotoFile]:
    found = {}
    for shot in manifest["shots"]:
        if shot.get("accepted_attempt") is not None:
            found[int(shot["index"])] = _photo(local_name(folder, str(shot.get("file") or "")), folder)
    return found


def _photo(name: str, folder: Path) -> PhotoFile:
    if not name:
        return PhotoFile(name="", problem=_UNNAMED)
    path = folder / name
    if not path.is_file():
        return PhotoFile(name=name, problem=_ABSENT)
    if path.suffix.lower() not in {".jpg", ".jpeg"}:
        return PhotoFile(name=name)
    try:
        complete = read_jpeg_header(path).complete
    except (OSError, ValueError) as error:
        return PhotoFile(name=name, problem=str(error))
    return PhotoFile(name=name, problem="" if complete else "is truncated")


def _stitch(path: Path) -> Mapping[str, Any] | None:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return document if isinstance(document, dict) and document.get("format") == "panoexec.stitch/1" else None
