"""How much of a parallel an image shows, and the robust core of an image at most."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import Tolerance

_FULL_DEG = 1e-6
_ROUNDING_DEG = 1e-9


def shown_deg(half_width: float, half_height: float, pitch_deg: ArrayLike, elevation_deg: ArrayLike) -> FloatArray:
    """Azimuths of parallels that images of roll 0 show, in all; 0 to 360°.

    With azimuth λ from the image, the borders above and below are linear in cos λ, and so leave λ one interval; the
    side leaves sin(λ - δ) ≤ w·tan e·sin p / √(1 + w²·cos²p), tan δ = w·cos p.

    Args:
        half_width: of the image, in its plane at distance 1.
        half_height: likewise.
        pitch_deg: of the images; any shape.
        elevation_deg: of the parallels, not a pole; any shape that goes with it.
    """
    w, h = half_width, half_height
    p, e = np.broadcast_arrays(np.radians(pitch_deg), np.radians(elevation_deg))
    sin_p, cos_p, sin_e, cos_e = np.sin(p), np.cos(p), np.sin(e), np.cos(e)
    least, most = np.full(p.shape, -1.0), np.full(p.shape, 1.0)
    for factor, limit in (
        (cos_e * (sin_p - h * cos_p), sin_e * (cos_p + h * sin_p)),
        (-cos_e * (sin_p + h * cos_p), sin_e * (h * sin_p - cos_p)),
    ):
        # factor·cos λ ≤ limit
        flat = np.abs(factor) < 1e-15
        quotient = limit / np.where(flat, 1.0, factor)
        most = np.where(~flat & (factor > 0), np.minimum(most, quotient), most)
        least = np.where(~flat & (factor < 0), np.maximum(least, quotient), least)
        most = np.where(flat & (limit < -1e-15), -2.0, most)
    begin, end = np.arccos(np.clip(most, -1.0, 1.0)), np.arccos(np.clip(least, -1.0, 1.0))
    lean = np.arctan(w * cos_p)
    sine = w * np.tan(e) * sin_p / np.hypot(1.0, w * cos_p)
    turn = np.arcsin(np.clip(sine, -1.0, 1.0))
    near = np.minimum(end, lean + turn) - begin
    far = end - np.maximum(begin, lean + math.pi - turn)
    half = np.where(sine >= 1, end - begin, np.maximum(near, 0.0) + np.maximum(far, 0.0))
    half = np.where((sine <= -1) | (most < least), 0.0, np.maximum(half, 0.0))
    return np.asarray(np.degrees(2 * half))


def core_shown_deg(
    camera: Camera, tolerance: Tolerance, pitch_deg: FloatArray, grown_deg: float, elevation_deg: FloatArray
) -> FloatArray:
    """Azimuths (k, m) of parallels that the robust core of an image of a pitch near to each given one shows at most.

    The core is in the images of both extreme pitch errors. It is what is left of its azimuths when they are moved by
    the yaw's error either way, so that it lacks at least twice that error, unless it is all the parallel.

    Args:
        camera: the camera.
        tolerance: of the pose.
        pitch_deg: (k,).
        grown_deg: how far the pitch may be from these. An image turned by so much is in one that is larger by it.
        elevation_deg: (m,), no poles.
    """
    errors = {-tolerance.pitch_deg, tolerance.pitch_deg}
    shown = [
        grown_shown_deg(camera, pitch_deg[:, None] + error, grown_deg, elevation_deg[None]) for error in sorted(errors)
    ]
    least = np.minimum.reduce(shown)
    less = np.maximum(least - 2 * tolerance.yaw_deg, 0.0)
    return np.where(least >= 360.0 - _FULL_DEG, 360.0, less) + _ROUNDING_DEG


def grown_shown_deg(camera: Camera, pitch_deg: FloatArray, grown_deg: float, elevation_deg: ArrayLike) -> FloatArray:
    """As `shown_deg`, the most that images show whose pitch is nearer to the given one than `grown_deg`."""
    grown = math.radians(grown_deg)
    h = math.tan(math.atan(camera.half_height) + grown)
    w = camera.half_width / (math.cos(grown) - camera.half_height * math.sin(grown))
    return shown_deg(w, h, pitch_deg, elevation_deg)
