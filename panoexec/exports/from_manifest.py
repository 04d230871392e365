"""The accepted photos of a mission, read from its manifest (`panoexec.manifest/1`)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from panoexec.angles import quaternion_from_rotation, rotation
from panoexec.errors import InputFileError
from panoexec.exports.model import ExportSet, ExportShot, local_name
from panoexec.exports.orientation import with_believed_orientation
from panoexec.formats.jpeg_header import read_jpeg_header
from panoexec.optics import Camera


def export_set(
    document: Mapping[str, Any], folder: Path, *, calibrated_focal_length_mm: float | None = None
) -> ExportSet:
    """The accepted photos in the order taken, with their names in the mission directory.

    Args:
        document: a manifest's JSON.
        folder: the mission directory; the size of photos in it is read from their headers.
        calibrated_focal_length_mm: the camera's, if known; a manifest does not contain it.

    Raises:
        InputFileError: the manifest is incomplete or damaged.
    """
    try:
        shots = [shot for entry in sorted(document["shots"], key=_order) for shot in _photos(entry, folder)]
        camera = _camera(document["camera"], calibrated_focal_length_mm)
        reference = document.get("reference", {}).get("yaw_north_deg")
        if any(_order(entry) < 0 for entry in document["shots"]):
            # of an earlier version: by time; photos without a time come last, by index
            shots.sort(key=lambda shot: (shot.time_utc_s if math.isfinite(shot.time_utc_s) else math.inf, shot.index))
        return ExportSet(
            title=f"panoexec mission {document.get('mission_id', '')}".strip(),
            camera=camera,
            shots=with_believed_orientation(shots, camera),
            reference_yaw_north_deg=0.0 if reference is None else float(reference),
        )
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        where = f"{type(error).__name__}: {error}"
        raise InputFileError(str(folder / "manifest.json"), [f"is damaged or incomplete ({where})"]) from error


def camera_of(document: Mapping[str, Any]) -> Camera:
    """The camera of a manifest."""
    return _camera(document["camera"], None)


def _camera(data: Mapping[str, Any], calibrated_mm: float | None) -> Camera:
    known_mm = data.get("calibrated_focal_length_mm")
    sizes = ("sensor_width_mm", "sensor_height_mm", "focal_length_mm")
    return Camera.from_plain(
        dict(data)
        | {"name": str(data["name"]), "calibrated_focal_length_mm": known_mm or calibrated_mm}
        | {key: float(data[key]) for key in sizes}
        | {key: int(data[key]) for key in ("image_width_px", "image_height_px")}
    )


def _order(entry: Mapping[str, Any]) -> int:
    """The number of the event that began the accepted attempt, 0 without one; -1 if an earlier version wrote it.

    The order does not depend on capture times: the clock may be set in the middle of a mission.
    """
    number = entry.get("accepted_attempt")
    return next((int(a.get("seq", -1)) for a in entry["attempts"] if a["number"] == number), 0)


def _photos(entry: Mapping[str, Any], folder: Path) -> Iterator[ExportShot]:
    """The photos of a shot's accepted attempt, if there is one."""
    number = entry.get("accepted_attempt")
    if number is None:
        return
    attempt = {a["number"]: a for a in entry["attempts"]}[number]
    measured, target = attempt.get("measured"), entry["target"]
    pose = measured or target
    quaternion = pose.get("quaternion")
    if quaternion is None:
        quaternion = quaternion_from_rotation(rotation(pose["yaw_deg"], pose["pitch_deg"])).tolist()
    w, x, y, z = (float(v) for v in quaternion)
    errors = attempt.get("error_deg") or {}
    base = ExportShot(
        index=int(entry["index"]),
        row=int(entry["row"]),
        q_wxyz=(w, x, y, z),
        target_pitch_deg=float(target["pitch_deg"]),
        target_yaw_deg=float(target["yaw_deg"]),
        measured=measured is not None,
        refined_wxyz=_quaternion(entry.get("refined")),
        attempt=int(number),
        evidence=str(attempt.get("evidence", "")),
        errors_deg={axis: float(errors[axis]) for axis in ("pitch", "roll", "yaw") if errors.get(axis) is not None},
    )
    for position, photo in enumerate(attempt.get("photos") or [{}], start=1):
        named = replace(
            base,
            file_name=local_name(folder, str(photo.get("file") or attempt.get("file") or "")),
            bracket=int(photo.get("number", position)),
            time_utc_s=_seconds(photo.get("capture_time") or attempt.get("capture_time")),
            latitude_deg=_number(photo.get("latitude_deg")),
            longitude_deg=_number(photo.get("longitude_deg")),
            altitude_m=_number(photo.get("altitude_m")),
        )
        yield _seen(named, folder)


def _quaternion(pose: Mapping[str, Any] | None) -> tuple[float, float, float, float] | None:
    if not pose:
        return None
    w, x, y, z = (float(v) for v in pose["quaternion"])
    return w, x, y, z


def _seen(shot: ExportShot, folder: Path) -> ExportShot:
    """The shot with the size of the stored pixels if the file is a readable JPEG."""
    if not shot.file_name:
        return shot
    try:
        header = read_jpeg_header(folder / shot.file_name)
    except (OSError, ValueError):
        return shot
    return replace(shot, width_px=header.width_px, height_px=header.height_px, orientation=header.orientation)


def _seconds(stamp: object) -> float:
    return datetime.fromisoformat(stamp).timestamp() if isinstance(stamp, str) and stamp else math.nan


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
