"""What the photos of missions tell of their lens: proposals for the camera profile (docs/content.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from panoexec.angles import rotation_from_quaternion
from panoexec.exports.from_manifest import camera_of
from panoexec.optics import Camera
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.lens import LensFit
from panoexec.pictures.model import PhotoToCheck

_UNSEEN: Final = 3.0
"""What the scatter of points does not show (pixels that are not square, k3 and tangential distortion)."""
_SIGNIFICANT: Final = 2.0
_MARGIN_SIGMAS: Final = 2.0
_MARGIN_STEP: Final = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class LensProposal:
    """A lens for a camera profile, with standard deviations.

    Attributes:
        focal_length_mm: calibrated focal length.
        k1, k2: radial distortion of Brown and Conrady, in coordinates of the ideal image at unit distance.
        principal_point_px: right and down from the upper left corner of the profile's image; None where the photos do
            not tell it from the middle.
        fov_margin: twice the standard deviations together, at the image's corner, rounded up.
        focal_sigma_mm, k1_sigma, k2_sigma: standard deviations.
        principal_sigma_px: likewise, right and down.
        points: matched points.
        missions: missions whose photos were used.
    """

    focal_length_mm: float
    k1: float
    k2: float
    principal_point_px: tuple[float, float] | None
    fov_margin: float
    focal_sigma_mm: float
    k1_sigma: float
    k2_sigma: float
    principal_sigma_px: tuple[float, float]
    points: int
    missions: int


def propose_lens(missions: Sequence[tuple[Mapping[str, Any], Path]]) -> LensProposal | None:
    """The lens from the photos of missions; None without enough of them, or if their cameras differ.

    Args:
        missions: manifest and directory of each.
    """
    cameras = {(camera_of(document).name, camera_of(document).focal_length_mm) for document, _ in missions}
    if len(cameras) != 1:
        return None
    fits = [fit for document, folder in missions if (fit := _fit(document, folder)) is not None]
    if not fits:
        return None
    camera = camera_of(missions[0][0])
    stated_mm = camera.focal_length_used_mm
    ratio, ratio_sigma = _mean([(fit.focal_ratio, fit.focal_sigma) for fit in fits])
    k1, k1_sigma = _mean([(fit.k1, fit.k1_sigma) for fit in fits])
    k2, k2_sigma = _mean([(fit.k2, fit.k2_sigma) for fit in fits])
    centres = [_mean([(fit.centre[axis], fit.centre_sigma[axis]) for fit in fits]) for axis in range(2)]
    focal_px = stated_mm * ratio * camera.image_width_px / camera.sensor_width_mm
    told = any(abs(value) > _SIGNIFICANT * sigma for value, sigma in centres)
    middle = (camera.image_width_px / 2, camera.image_height_px / 2)
    point = (middle[0] + focal_px * centres[0][0], middle[1] + focal_px * centres[1][0])
    corner = math.hypot(camera.pinhole_half_width, camera.pinhole_half_height) / ratio
    unsure = ratio_sigma / ratio + k1_sigma * corner**2 + k2_sigma * corner**4
    if told:
        unsure += max(sigma for _, sigma in centres) / min(camera.pinhole_half_width, camera.pinhole_half_height)
    return LensProposal(
        focal_length_mm=stated_mm * ratio,
        k1=k1,
        k2=k2,
        principal_point_px=_as_in_profile(point, camera) if told else None,
        fov_margin=round(math.ceil(_MARGIN_SIGMAS * unsure / _MARGIN_STEP) * _MARGIN_STEP, 3),
        focal_sigma_mm=stated_mm * ratio_sigma,
        k1_sigma=k1_sigma,
        k2_sigma=k2_sigma,
        principal_sigma_px=(focal_px * centres[0][1], focal_px * centres[1][1]),
        points=sum(fit.points for fit in fits),
        missions=len(fits),
    )


def _as_in_profile(point_px: tuple[float, float], camera: Camera) -> tuple[float, float]:
    """A point of the image as mounted, in the image of the profile, whose longer side is its width."""
    if not camera.is_portrait:
        return point_px
    # the inverse of `Camera.rotated`
    return point_px[1], camera.image_width_px - point_px[0]


def _fit(document: Mapping[str, Any], folder: Path) -> LensFit | None:
    examiner = Examiner(camera_of(document))
    for order, shot in enumerate(document["shots"]):
        attempt = next((a for a in shot["attempts"] if a["number"] == shot.get("accepted_attempt")), None)
        if attempt is None or not attempt.get("measured") or not shot.get("file"):
            continue
        path = folder / str(shot["file"])
        if not path.resolve().is_relative_to(folder.resolve()) or not path.is_file():
            continue
        rotation = rotation_from_quaternion(attempt["measured"]["quaternion"])
        taken = attempt.get("capture_time")
        time_s = datetime.fromisoformat(taken).timestamp() if taken else float(order)
        examiner.add(PhotoToCheck(shot=int(shot["index"]), rotation=rotation, time_s=time_s), path.read_bytes())
    return examiner.lens()


def _mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean of values with standard deviations, weighted by them, and its own."""
    weights = [1 / max(sigma, 1e-9) ** 2 for _, sigma in values]
    mean = sum(weight * value for weight, (value, _) in zip(weights, values, strict=True)) / sum(weights)
    return mean, _UNSEEN / math.sqrt(sum(weights))
