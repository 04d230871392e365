"""Input of the stitcher: the accepted photos of a mission directory that exist and are complete."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import PIL.Image

from panoexec.exports.from_manifest import export_set
from panoexec.exports.hugin import hugin_project
from panoexec.exports.model import ExportShot
from panoexec.exports.orientation import with_believed_orientation
from panoexec.formats.hugin_pto import PtoProject
from panoexec.formats.jpeg_header import read_jpeg_header
from panoexec.inputs.plan_file import read_plan_file
from panoexec.planning.model import AngleBox, Band, Tolerance
from panoexec.stitching.place import Place, place_of
from panoexec.stitching.tools import StitchError
from panoexec.store.directory import existing_mission_directory
from panoexec.store.rebuilding import current_manifest

_WHOLE_SPHERE = Band(elevation_min_deg=-90.0, elevation_max_deg=90.0)
_USUAL_TOLERANCE = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7)


@dataclass(frozen=True, slots=True, kw_only=True)
class StitchInput:
    """The input of the stitcher.

    Attributes:
        folder: the mission directory.
        project: usable photos with measured angles, names relative to `folder`, canvas at their resolution.
        band: the requested band.
        masks: boxes that need no coverage.
        tolerance: error bound of the measured attitudes.
        left_out: unusable photos by name, with the reason.
        missing_shots: shots without an accepted photo.
        place: where and when it was taken; its heading is that of the canvas's middle.
        taken: shot and time (UTC, seconds; NaN if unknown) of each photo, by name.
    """

    folder: Path
    project: PtoProject
    band: Band
    tolerance: Tolerance
    masks: tuple[AngleBox, ...] = ()
    left_out: Mapping[str, str]
    missing_shots: tuple[int, ...] = ()
    place: Place = field(default_factory=Place)
    taken: Mapping[str, tuple[int, float]] = field(default_factory=dict)


def load_mission(path: Path) -> StitchInput:
    """Read a mission directory.

    Args:
        path: as given by the user.

    Raises:
        UsageError: it is not a mission directory, or its manifest or plan is damaged.
        StitchError: it has no usable photo.
    """
    directory = existing_mission_directory(path)
    document = current_manifest(directory)
    band, tolerance, calibrated = _WHOLE_SPHERE, _USUAL_TOLERANCE, None
    masks: tuple[AngleBox, ...] = ()
    if directory.plan.exists():
        plan = read_plan_file(directory.plan)
        calibrated = plan.camera.calibrated_focal_length_mm if plan.camera else None
        if plan.constraints is not None:
            band, masks, tolerance = plan.constraints.band, plan.constraints.masks, plan.constraints.tolerance
    exports = export_set(document, directory.path, calibrated_focal_length_mm=calibrated)
    # of an exposure bracket, the first photo is stitched
    accepted = [shot for shot in exports.shots if shot.bracket == 1]
    if not accepted:
        raise StitchError(f"{path}: the mission has no accepted photo to stitch")
    usable, left_out = _usable(accepted, directory.path)
    if not usable:
        name, reason = next(iter(left_out.items()))
        raise StitchError(
            f"{path}: none of the {len(accepted)} accepted photos is usable ({name}: {reason}); "
            f"copy them from the camera into {directory.images}"
        )
    taken = {shot.index for shot in accepted}
    missing = tuple(entry["index"] for entry in document["shots"] if entry["index"] not in taken)
    return StitchInput(
        folder=directory.path,
        project=hugin_project(replace(exports, shots=with_believed_orientation(usable, exports.camera))),
        band=band,
        masks=masks,
        tolerance=tolerance,
        left_out=left_out,
        missing_shots=missing,
        place=place_of(document, accepted),
        taken={shot.name: (shot.index, shot.time_utc_s) for shot in accepted},
    )


def _usable(shots: list[ExportShot], folder: Path) -> tuple[list[ExportShot], dict[str, str]]:
    """The shots with a complete photo of the most common size; the others with the reason."""
    found, left_out = [], {}
    for shot in shots:
        try:
            found.append(_looked_at(shot, folder))
        except FileNotFoundError:
            left_out[shot.name] = (
                "is missing" if shot.file_name else f"is missing (the file name of shot {shot.index} is unknown)"
            )
        except (OSError, ValueError) as error:
            left_out[shot.name] = getattr(error, "strerror", None) or str(error)
    if not found:
        return [], left_out
    sizes = Counter((shot.width_px, shot.height_px) for shot in found)
    usual = sizes.most_common(1)[0][0]
    for shot in found:
        if (shot.width_px, shot.height_px) != usual:
            left_out[shot.name] = f"is {shot.width_px} x {shot.height_px} px, the others {usual[0]} x {usual[1]} px"
    return [shot for shot in found if shot.name not in left_out], left_out


def _looked_at(shot: ExportShot, folder: Path) -> ExportShot:
    """The shot with the size of its photo.

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged.
    """
    path = folder / shot.name
    try:
        header = read_jpeg_header(path)
    except ValueError as error:
        if path.suffix.lower() in {".jpg", ".jpeg"}:
            raise
        # another format that Hugin's tools read, too
        try:
            with PIL.Image.open(path) as picture:
                width, height = picture.size
        except PIL.UnidentifiedImageError:
            raise ValueError("is not an image") from error
        return replace(shot, file_name=shot.name, width_px=width, height_px=height, orientation=1)
    if not header.complete:
        raise ValueError("is truncated")
    return replace(
        shot,
        file_name=shot.name,
        width_px=header.width_px,
        height_px=header.height_px,
        orientation=header.orientation,
    )
