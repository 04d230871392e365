"""XMP files: a sidecar per image with its attitude and position, and the GPano values of the panorama.

The photos themselves are not modified. A sidecar has the photo's name with the suffix `.xmp` and is in the same folder,
or in the folder `xmp` if the photo is not in the mission directory.
"""

from __future__ import annotations

import math
from pathlib import Path, PurePosixPath

from panoexec.angles import rotation
from panoexec.exports.hugin import canvas_px
from panoexec.exports.model import ExportSet, ExportShot
from panoexec.exports.polar import polar_angles
from panoexec.files import write_atomically
from panoexec.formats.xmp import Position, attitude_properties, gpano_properties, packet


def sidecar_text(exports: ExportSet, shot: ExportShot) -> str:
    """The XMP packet of one image; its yaw is from true north, as readers expect, near the poles too."""
    pose = rotation(exports.reference_yaw_north_deg, 0.0) @ shot.rotation
    polar = polar_angles(pose)
    if polar is not None:
        pose = rotation(*polar)
    position = None
    if math.isfinite(shot.latitude_deg) and math.isfinite(shot.longitude_deg):
        position = Position(
            latitude_deg=shot.latitude_deg, longitude_deg=shot.longitude_deg, altitude_m=shot.altitude_m
        )
    return packet(attitude_properties(pose, position=position))


def sidecar_path(folder: Path, shot: ExportShot) -> Path:
    """The path of an image's sidecar."""
    photo = folder / shot.name
    if photo.is_file():
        return photo.with_suffix(".xmp")
    return folder / "xmp" / PurePosixPath(shot.name).with_suffix(".xmp").name


def write_sidecars(exports: ExportSet, folder: Path) -> list[Path]:
    """Write all sidecars into the mission directory.

    Raises:
        UsageError: a file cannot be written.
    """
    written = []
    for shot in exports.shots:
        path = sidecar_path(folder, shot)
        path.parent.mkdir(parents=True, exist_ok=True)
        # many small files that can be written again: no fsync for each
        write_atomically(path, sidecar_text(exports, shot), sync=False)
        written.append(path)
    return written


def gpano_text(exports: ExportSet) -> str:
    """The XMP packet for the stitched panorama, whole sphere at full resolution; its heading is the plan's yaw 0."""
    width, _ = canvas_px(exports)
    return packet(gpano_properties(width, heading_deg=exports.reference_yaw_north_deg))
