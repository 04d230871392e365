"""Which lens of a camera counts, as somebody asks for it."""

from __future__ import annotations

from panoexec.errors import UsageError
from panoexec.optics import Camera, Lens


def with_lens(camera: Camera, lens: Lens | None) -> Camera:
    """The camera with the lens that somebody asks for; None: as it is.

    Raises:
        UsageError: the calibrated lens is asked for, and nothing is known of it.
    """
    if lens == "calibrated" and not camera.is_calibrated:
        raise UsageError(
            f"{camera.name} has no calibrated lens: its profile has none of calibrated_focal_length_mm, distortion, "
            "principal_point_px and fov_margin"
        )
    return camera if lens is None else camera.with_lens(lens)
