"""Data of an export: the images of a panorama, planned or taken, with their attitudes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Final
from urllib.parse import unquote, urlsplit

import numpy as np

from panoexec.angles import FloatArray, quaternion_from_rotation, rotation_from_quaternion
from panoexec.devices import Quaternion
from panoexec.optics import Camera
from panoexec.planning.model import Constraints, Plan

PLACEHOLDER: Final = "shot_{index:04d}.jpg"
"""Name of an image whose file name is unknown; the operator can rename the photos accordingly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportShot:
    """One image.

    Attributes:
        index: position in the plan's shooting order.
        row: the plan's row.
        file_name: its file, relative to the mission directory; "" if unknown.
        q_wxyz: attitude, camera (FRD) to the plan's frame (NED, yaw 0 = the plan's reference); measured if `measured`.
        target_pitch_deg: planned pitch.
        target_yaw_deg: planned yaw, in the plan's frame.
        measured: whether the attitude was measured; else it is the planned one.
        time_utc_s: when it was taken; NaN if not taken or unknown.
        width_px: width of the stored pixels, 0 if unknown (then the camera profile's applies).
        height_px: height of the stored pixels, likewise.
        orientation: EXIF orientation, 1 = upright.
        latitude_deg: position, NaN if unknown.
        longitude_deg: likewise.
        altitude_m: above mean sea level, likewise.
        attempt: number of the attempt at the shot, from 1; 0 for a plan.
        bracket: number of the photo within its exposure bracket, from 1.
        evidence: evidence level of the photo; "" for a plan.
        refined_wxyz: attitude that the content of the photos implies, likewise; None if unknown.
        errors_deg: pointing errors by axis ("pitch", "roll", "yaw"), the largest over the exposure.
    """

    index: int
    row: int
    q_wxyz: Quaternion
    target_pitch_deg: float
    target_yaw_deg: float
    file_name: str = ""
    measured: bool = False
    time_utc_s: float = math.nan
    width_px: int = 0
    height_px: int = 0
    orientation: int = 1
    latitude_deg: float = math.nan
    longitude_deg: float = math.nan
    altitude_m: float = math.nan
    attempt: int = 0
    bracket: int = 1
    evidence: str = ""
    refined_wxyz: Quaternion | None = None
    errors_deg: Mapping[str, float] = field(default_factory=dict)

    @property
    def rotation(self) -> FloatArray:
        """Camera-to-plan rotation (3, 3) of the upright image."""
        return rotation_from_quaternion(self.q_wxyz)

    @property
    def name(self) -> str:
        """The file's name, or the placeholder."""
        return self.file_name or PLACEHOLDER.format(index=self.index)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportSet:
    """All images of a panorama, in the order in which they were (or will be) taken.

    Attributes:
        title: for headers.
        camera: the camera.
        shots: at least one for most formats.
        reference_yaw_north_deg: direction of the plan's yaw 0, clockwise from true north.
        constraints: the plan's constraints, if known.
        settle_s: settle time, for formats that state one.
    """

    title: str
    camera: Camera
    shots: tuple[ExportShot, ...]
    reference_yaw_north_deg: float = 0.0
    constraints: Constraints | None = None
    settle_s: float = 0.0

    def refined(self) -> ExportSet | None:
        """The images with the attitudes that their content implies, where it does; None if no image has one."""
        if not any(shot.refined_wxyz for shot in self.shots):
            return None
        shots = tuple(replace(shot, q_wxyz=shot.refined_wxyz or shot.q_wxyz) for shot in self.shots)
        return replace(self, title=f"{self.title}, attitudes refined by content", shots=shots)

    def rotations(self) -> FloatArray:
        """Camera-to-plan rotations (n, 3, 3)."""
        if not self.shots:
            return np.empty((0, 3, 3))
        return rotation_from_quaternion(np.array([shot.q_wxyz for shot in self.shots]))


def from_plan(plan: Plan, *, settle_s: float = 0.3) -> ExportSet:
    """The planned poses as images to be taken.

    Args:
        plan: the plan.
        settle_s: settle time for formats that contain one.
    """
    quaternions = quaternion_from_rotation(plan.rotations()) if plan.shots else np.empty((0, 4))
    shots = tuple(
        ExportShot(
            index=shot.index,
            row=shot.row,
            q_wxyz=_quaternion(q),
            target_pitch_deg=shot.pitch_deg,
            target_yaw_deg=shot.yaw_deg,
        )
        for shot, q in zip(plan.shots, quaternions, strict=True)
    )
    return ExportSet(
        title=f"{plan.camera.name}, {len(shots)} images",
        camera=plan.camera,
        shots=shots,
        constraints=plan.constraints,
        settle_s=settle_s,
    )


def _quaternion(q: Sequence[float] | FloatArray) -> Quaternion:
    w, x, y, z = (float(v) for v in q)
    return w, x, y, z


def local_name(folder: Path, reported: str) -> str:
    """The name of a photo relative to the mission directory.

    Cameras report a path on their card (`/DCIM/100MEDIA/DJI_0042.JPG`) or a URL; a copied photo is in the mission
    directory or in its folder `images`.

    Args:
        folder: the mission directory.
        reported: the name reported by the camera, or "".

    Returns:
        The relative path of an existing file, with forward slashes, else the base name; "" for "".
    """
    if not reported:
        return ""
    path = unquote(urlsplit(reported).path) if "://" in reported else reported
    base = PurePosixPath(path.replace("\\", "/")).name
    relative = PurePosixPath(path)
    candidates = [] if relative.is_absolute() or ".." in relative.parts else [str(relative)]
    if Path(path).is_absolute() and Path(path).is_relative_to(folder):
        candidates.append(str(PurePosixPath(Path(path).relative_to(folder))))
    for candidate in (*candidates, f"images/{base}", base):
        if (folder / candidate).is_file():
            return candidate
    return base
