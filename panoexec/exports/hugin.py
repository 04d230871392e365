"""Hugin project: one line per image with its attitude, one shared lens, an equirectangular canvas at full size."""

from __future__ import annotations

import math

from panoexec.errors import UsageError
from panoexec.exports.model import ExportSet, ExportShot
from panoexec.formats.hugin_pto import PtoProject, pto_image, render_pto, turn_of_orientation


def stored_size_px(exports: ExportSet) -> tuple[int, int]:
    """Width and height of the stored photos: of the first file with a known size, else of the camera profile.

    All photos come from one camera and have the same size.
    """
    seen = next((shot for shot in exports.shots if shot.width_px and shot.height_px), None)
    if seen is not None:
        return seen.width_px, seen.height_px
    return exports.camera.image_width_px, exports.camera.image_height_px


def canvas_px(exports: ExportSet) -> tuple[int, int]:
    """Size of the whole sphere at the photos' resolution; even, as Hugin's tools require."""
    camera = exports.camera
    scale = max(stored_size_px(exports)) / max(camera.image_width_px, camera.image_height_px)
    half = math.ceil(camera.panorama_px()[0] * scale / 2)
    return 2 * half, half


def hugin_project(exports: ExportSet) -> PtoProject:
    """The project: azimuth 0, the middle of the canvas, is the plan's yaw reference.

    Raises:
        UsageError: there are no images.
    """
    if not exports.shots:
        raise UsageError("a Hugin project needs at least one image; there is no accepted photo yet")
    camera = exports.camera
    width, height = stored_size_px(exports)
    turned = width != height and (height > width) != camera.is_portrait
    images = tuple(
        pto_image(shot.name, width, height, shot.rotation, turn_deg=_turn(shot, turned)) for shot in exports.shots
    )
    return PtoProject(
        images=images,
        # across the stored width, which is the upright image's height if the pixels are rotated
        hfov_deg=camera.pinhole_vfov_deg if turned else camera.pinhole_hfov_deg,
        canvas_px=canvas_px(exports),
    )


def hugin_text(exports: ExportSet) -> str:
    """The `.pto` file's text.

    Raises:
        UsageError: see `hugin_project`.
    """
    try:
        return render_pto(hugin_project(exports))
    except ValueError as error:
        raise UsageError(str(error)) from error


def _turn(shot: ExportShot, turned: bool) -> float:
    """Rotation of the stored pixels, degrees: from EXIF, or from their aspect ratio if there is no EXIF."""
    turn = turn_of_orientation(shot.orientation)
    return turn if turn or not turned else 90.0
