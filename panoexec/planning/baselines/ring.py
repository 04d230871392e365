"""The interval of elevations that a row of images covers at all azimuths, for any phase of the row.

Between two images of a row the covered band is thinnest at the azimuth halfway between them or, where an edge curves
the other way, on the image's own meridian. Images of adjacent rows close the sphere between them if the intervals of
the two rows overlap; that is sufficient for all phases, and necessary for some.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera
from panoexec.planning.geometry.footprint import edge_normals


def ring(camera: Camera, pitch_deg: ArrayLike, reach_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Elevations that an image covers at every azimuth up to `reach_deg` to the left and to the right of its own.

    On the meridian at azimuth δ from its own, the border of an image is the intersection with one of the edge planes.
    The top and the bottom edge plane intersect it at tan e = t·cos δ, which is monotone over 0 to 180°; the side edge
    planes at tan e = (sin δ - w·cos p·cos δ) / (w·sin p), which is monotone at least over 0 to 90°. So the extremes are
    at the two ends of the range of δ.

    Args:
        camera: the camera.
        pitch_deg: pitch of the images, [-90, 90]; any shape.
        reach_deg: largest azimuth δ from the image's own, [0, 90]; beyond 90 the result is empty.

    Returns:
        Lowest and highest elevation, each of the arguments' common shape; lowest > highest means empty.
    """
    pitch, reach = np.broadcast_arrays(np.asarray(pitch_deg, np.float64), np.asarray(reach_deg, np.float64))
    normals = edge_normals(camera) @ np.swapaxes(rotation(0.0, pitch), -1, -2)
    low, high = _meridian(normals, np.zeros_like(reach))
    low_side, high_side = _meridian(normals, np.minimum(reach, 90.0))
    impossible = reach > 90.0 + 1e-9
    return (
        np.where(impossible, 90.0, np.maximum(low, low_side)),
        np.where(impossible, -90.0, np.minimum(high, high_side)),
    )


def cap_radius_deg(camera: Camera) -> float:
    """Radius of the largest circle about the boresight inside one image: half its smaller field of view, degrees."""
    return min(camera.hfov_deg, camera.vfov_deg) / 2


def _meridian(normals: FloatArray, azimuth_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The interval of elevations on the meridian at an azimuth (...) inside four edge planes (..., 4, 3)."""
    azimuth = np.radians(azimuth_deg)[..., None]
    # on the meridian a plane is a·cos e + b·sin e ≥ 0, true within 90° of e = atan2(b, a)
    a = normals[..., 0] * np.cos(azimuth) + normals[..., 1] * np.sin(azimuth)
    middle = np.degrees(np.arctan2(-normals[..., 2], a))
    low = np.clip(middle - 90.0, -90.0, 90.0).max(axis=-1)
    high = np.clip(middle + 90.0, -90.0, 90.0).min(axis=-1)
    return low, high
