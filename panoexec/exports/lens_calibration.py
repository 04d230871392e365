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
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.lens import LensFit
from panoexec.pictures.model import PhotoToCheck

_UNSEEN: Final = 3.0
"""What the scatter of points does not show (pixels that are not square, a principal point beside the centre)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensProposal:
    """A lens for a camera profile, with standard deviations.

    Attributes:
        focal_length_mm: calibrated focal length.
        k1, k2: radial distortion of Brown and Conrady, in coordinates of the ideal image at unit distance.
        focal_sigma_mm, k1_sigma, k2_sigma: standard deviations.
        points: matched points.
        missions: missions whose photos were used.
    """

    focal_length_mm: float
    k1: float
    k2: float
    focal_sigma_mm: float
    k1_sigma: float
    k2_sigma: float
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
    nominal_mm = camera_of(missions[0][0]).focal_length_mm
    ratio, ratio_sigma = _mean([(fit.focal_ratio, fit.focal_sigma) for fit in fits])
    k1, k1_sigma = _mean([(fit.k1, fit.k1_sigma) for fit in fits])
    k2, k2_sigma = _mean([(fit.k2, fit.k2_sigma) for fit in fits])
    return LensProposal(
        focal_length_mm=nominal_mm * ratio,
        k1=k1,
        k2=k2,
        focal_sigma_mm=nominal_mm * ratio_sigma,
        k1_sigma=k1_sigma,
        k2_sigma=k2_sigma,
        points=sum(fit.points for fit in fits),
        missions=len(fits),
    )


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
