"""Photos as an ideal pinhole would have taken them: what is known of the lens is taken out before they are compared."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.pictures.decoding import Grey

_Map = NDArray[np.float32]


def is_bent(camera: Camera) -> bool:
    """Whether photos of a camera differ from those of an ideal pinhole with the focal length that counts."""
    middle = (camera.image_width_px / 2, camera.image_height_px / 2)
    return camera.distortion_used is not None or camera.principal_point_used_px != middle


def straightened(grey: Grey, camera: Camera) -> Grey:
    """The photo (h, w) of the ideal pinhole, from that of the camera; beyond its border, its border pixels."""
    if not is_bent(camera):
        return grey
    height, width = grey.shape
    column, row = _map(camera, width, height)
    left, top = np.minimum(column.astype(np.intp), width - 2), np.minimum(row.astype(np.intp), height - 2)
    across, down = column - left, row - top
    upper = grey[top, left] * (1 - across) + grey[top, left + 1] * across
    lower = grey[top + 1, left] * (1 - across) + grey[top + 1, left + 1] * across
    return np.asarray(upper * (1 - down) + lower * down + np.float32(0.5), dtype=np.uint8)


def stored_pixels(pixels: FloatArray, camera: Camera, size: tuple[int, int]) -> FloatArray:
    """Where pixels (..., 2) of the straightened photo are in the stored one, x and y, 0 at the first pixel's centre."""
    if not is_bent(camera):
        return pixels
    width, height = size
    halves = np.array([camera.pinhole_half_width, camera.pinhole_half_height])
    ideal = ((pixels + 0.5) / (width / 2, height / 2) - 1) * halves
    across, down = camera.places(ideal[..., 0], ideal[..., 1])
    return np.asarray(np.stack([(across + 1) * width / 2, (down + 1) * height / 2], axis=-1) - 0.5)


@lru_cache(maxsize=2)
def _map(camera: Camera, width: int, height: int) -> tuple[_Map, _Map]:
    """Where each pixel (h, w) of the straightened photo is in the stored one: columns and rows within it."""
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    stored = stored_pixels(np.stack([columns, rows], axis=-1), camera, (width, height))
    inside = np.clip(np.nan_to_num(stored, posinf=1e9, neginf=-1e9), 0.0, np.array([width - 1.0, height - 1.0]))
    return inside[..., 0].astype(np.float32), inside[..., 1].astype(np.float32)
