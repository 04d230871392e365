"""Mission directories for Python programs: read-only, from the manifest; the journal is not touched."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any

from panoexec.api.plans import Plan
from panoexec.errors import InputFileError
from panoexec.exports.model import local_name
from panoexec.optics import Camera
from panoexec.planning.model import Certificate, Hole, Tolerance
from panoexec.store.directory import MissionDirectory, existing_mission_directory
from panoexec.store.rebuilding import current_manifest


@dataclass(frozen=True, slots=True, kw_only=True)
class Attitude:
    """Attitude of the camera in the plan's frame.

    Attributes:
        quaternion: unit quaternion (w, x, y, z) from the camera (FRD) to the plan's frame (NED, yaw 0 = reference).
        roll_deg: about the boresight, positive when the right of the image goes down.
        pitch_deg: positive up, -90 is the nadir.
        yaw_deg: clockwise seen from above, 0 = the plan's reference direction.
    """

    quaternion: tuple[float, float, float, float]
    roll_deg: float
    pitch_deg: float
    yaw_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One attempt at a shot.

    Attributes:
        number: counts from 1 within the shot.
        verdict: `open`, `accepted`, `rejected` or `interrupted`.
        by: what accepted it: `tolerance`, `overlap`, `open_loop`, or "" if nothing did.
        code: why it was rejected, for programs (docs/mission.md); "" otherwise.
        reason: likewise, for people.
        attitude: measured at the worst sample of the exposure; None where none was measured.
        error_deg: worst pointing error of the exposure by axis, `pitch`, `roll`, `yaw` and others, degrees.
        evidence: what proves the photo, such as `capture_message` (docs/mission.md); `none` without a photo.
        captured: when, UTC; None where not known.
        photos: files of its photos, within the mission directory; they need not be there (`Path.exists`). Photos
            whose name no camera told are left out.
    """

    number: int
    verdict: str
    by: str
    code: str
    reason: str
    attitude: Attitude | None
    error_deg: Mapping[str, float]
    evidence: str
    captured: datetime | None
    photos: tuple[Path, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionShot:
    """A shot of the plan, or a patch, with all attempts at it.

    Attributes:
        index: position in the shooting order; patches follow the shots of the plan.
        row: of the plan, counted from the lowest.
        patch: whether it was added to close a hole.
        status: `accepted`, `pending`, `active`, `exposed`, `deferred`, `skipped` or `missed`.
        reason: for the status, for people.
        target: planned attitude.
        accepted: the attempt that counts; None if the shot has no accepted photo.
        attempts: in the order made.
        bridge: the two shots whose photos it was added to tie; None for other shots.
    """

    index: int
    row: int
    patch: bool
    status: str
    reason: str
    target: Attitude
    accepted: Attempt | None
    attempts: tuple[Attempt, ...]
    bridge: tuple[int, int] | None = None

    @property
    def attitude(self) -> Attitude | None:
        """Measured attitude of the accepted photo; None where there is none."""
        return None if self.accepted is None else self.accepted.attitude

    @property
    def photos(self) -> tuple[Path, ...]:
        """Files of the accepted attempt: several where exposures are bracketed."""
        return () if self.accepted is None else self.accepted.photos


@dataclass(frozen=True, slots=True, kw_only=True)
class Mission:
    """What a mission was asked for and what it took.

    Attributes:
        path: the mission directory, absolute.
        mission_id: name of the mission: when it began, as the clock told it.
        state: of the mission (docs/mission.md), such as `complete`.
        reason: for the state, for people.
        camera: as flown.
        tolerance: largest accepted pointing errors.
        reference: what yaw 0 means, `north` or `heading`.
        reference_yaw_north_deg: direction of yaw 0, clockwise from true north; None where not known.
        started: UTC; None where not known.
        finished: UTC; None while it is not over.
        certificate: of the panorama as flown; None where there is none yet.
        shots: by index.
        manifest: the whole manifest, as its JSON says it (`panoexec.manifest/1`).
    """

    path: Path
    mission_id: str
    state: str
    reason: str
    camera: Camera
    tolerance: Tolerance
    reference: str
    reference_yaw_north_deg: float | None
    started: datetime | None
    finished: datetime | None
    certificate: Certificate | None
    shots: tuple[MissionShot, ...]
    manifest: Mapping[str, Any]

    @property
    def photos(self) -> tuple[Path, ...]:
        """Files of all accepted photos, by shot."""
        return tuple(photo for shot in self.shots for photo in shot.photos)

    @property
    def missing(self) -> tuple[int, ...]:
        """Indices of the shots without an accepted photo."""
        return tuple(shot.index for shot in self.shots if shot.accepted is None)

    def plan(self) -> Plan:
        """Read the plan as it was asked for.

        Raises:
            InputFileError: `plan.json` cannot be read or is wrong.
        """
        return Plan.load(MissionDirectory(self.path).plan, camera=self.camera)


def open_mission(path: str | os.PathLike[str]) -> Mission:
    """Read the directory of a mission, finished or not; nothing in it is changed.

    Args:
        path: `<storage>/missions/<mission_id>`.

    Raises:
        UsageError: it is no directory, or holds no mission.
        InputFileError: the manifest is missing or damaged.
    """
    directory = existing_mission_directory(Path(path))
    document = current_manifest(directory)
    try:
        return _mission(document, directory.path)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        problem = f"is damaged or incomplete ({type(error).__name__}: {error})"
        raise InputFileError(str(directory.manifest), [problem]) from error


def _mission(document: Mapping[str, Any], folder: Path) -> Mission:
    tolerance, reference, times = document["tolerance_deg"], document["reference"], document["times"]
    return Mission(
        path=folder,
        mission_id=str(document["mission_id"]),
        state=str(document["state"]),
        reason=str(document["reason"]),
        camera=_camera(document["camera"]),
        tolerance=Tolerance(pitch_deg=tolerance["pitch"], roll_deg=tolerance["roll"], yaw_deg=tolerance["yaw"]),
        reference=str(reference["kind"]),
        reference_yaw_north_deg=reference["yaw_north_deg"],
        started=_time(times["started"]),
        finished=_time(times["finished"]),
        certificate=None if document["certificate"] is None else _certificate(document["certificate"]),
        shots=tuple(_shot(entry, folder) for entry in document["shots"]),
        manifest=document,
    )


def _camera(data: Mapping[str, Any]) -> Camera:
    return Camera.from_plain(data)


def _certificate(data: Mapping[str, Any]) -> Certificate:
    lists = {
        "failures": tuple(data["failures"]),
        "holes": tuple(Hole(**hole) for hole in data["holes"]),
        "weakest_h": None if data["weakest_h"] is None else tuple(data["weakest_h"]),
        "bridges": tuple((a, b) for a, b in data["bridges"]),
    }
    return Certificate(**{field.name: data[field.name] for field in fields(Certificate)} | lists)


def _shot(entry: Mapping[str, Any], folder: Path) -> MissionShot:
    attempts = tuple(_attempt(item, folder) for item in entry["attempts"])
    accepted = entry["accepted_attempt"]
    return MissionShot(
        index=int(entry["index"]),
        row=int(entry["row"]),
        patch=bool(entry["patch"]),
        status=str(entry["status"]),
        reason=str(entry["reason"]),
        target=_attitude(entry["target"]),
        accepted=None if accepted is None else next(attempt for attempt in attempts if attempt.number == accepted),
        attempts=attempts,
        bridge=None if not entry.get("bridge") else (int(entry["bridge"][0]), int(entry["bridge"][1])),
    )


def _attempt(item: Mapping[str, Any], folder: Path) -> Attempt:
    measured, errors = item["measured"], item["error_deg"] or {}
    names = [local_name(folder, str(photo["file"])) for photo in item["photos"]]
    return Attempt(
        number=int(item["number"]),
        verdict=str(item["verdict"]),
        by=str(item["by"]),
        code=str(item["code"]),
        reason=str(item["reason"]),
        attitude=None if measured is None else _attitude(measured),
        error_deg={axis: float(value) for axis, value in errors.items() if value is not None},
        evidence=str(item["evidence"]),
        captured=_time(item["capture_time"]),
        photos=tuple(folder / name for name in names if name),
    )


def _attitude(data: Mapping[str, Any]) -> Attitude:
    w, x, y, z = (float(value) for value in data["quaternion"])
    return Attitude(
        quaternion=(w, x, y, z), roll_deg=data["roll_deg"], pitch_deg=data["pitch_deg"], yaw_deg=data["yaw_deg"]
    )


def _time(stamp: str | None) -> datetime | None:
    return None if stamp is None else datetime.fromisoformat(stamp)
