"""Number of images that see each direction, on an equirectangular grid: for plots, not for proofs.

A hole smaller than a grid cell can be missed. The proof of coverage is in `panoexec.planning.certificate`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import AngleBox, Band


def grid(width: int) -> tuple[FloatArray, FloatArray]:
    """Elevations (width // 2,) from +90 down and azimuths (width,) from -180 up, degrees, at the cells' centres."""
    height = width // 2
    elevation = 90 - (np.arange(height) + 0.5) / height * 180
    azimuth = (np.arange(width) + 0.5) / width * 360 - 180
    return elevation, azimuth


def coverage_count(camera: Camera, rotations: ArrayLike, width: int = 1440) -> NDArray[np.uint16]:
    """Number of images that contain the centre of each cell of an equirectangular grid.

    Args:
        camera: the camera.
        rotations: camera-to-world rotations (n, 3, 3).
        width: number of columns; the grid has width // 2 rows.

    Returns:
        (width // 2, width), row 0 at elevation +90, column 0 at azimuth -180.
    """
    elevation, azimuth = grid(width)
    sin_e, cos_e = np.sin(np.radians(elevation)), np.cos(np.radians(elevation))
    sin_a, cos_a = np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))
    count = np.zeros((len(elevation), len(azimuth)), dtype=np.uint16)
    half_diagonal = np.arctan(np.hypot(camera.half_width, camera.half_height))
    for matrix in np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3):
        boresight = np.arcsin(np.clip(-matrix[2, 0], -1, 1))
        rows = np.flatnonzero(np.abs(np.radians(elevation) - boresight) <= half_diagonal)
        if not len(rows):
            continue
        part = slice(rows[0], rows[-1] + 1)
        # Rᵀ·d for d = (cos e · cos a, cos e · sin a, -sin e): the direction in the camera's frame
        x, y, z = (
            np.outer(cos_e[part], matrix[0, axis] * cos_a + matrix[1, axis] * sin_a)
            - (matrix[2, axis] * sin_e[part])[:, None]
            for axis in range(3)
        )
        count[part] += (np.abs(y) <= camera.half_width * x) & (np.abs(z) <= camera.half_height * x)
    return count


def box_mask(box: Band | AngleBox, width: int) -> NDArray[np.bool_]:
    """Mask (width // 2, width) of the grid cells whose centre lies in a box of directions."""
    elevation, azimuth = grid(width)
    span = box.azimuth_span_deg
    inside = (azimuth - box.azimuth_min_deg) % 360 <= span
    high = (elevation >= box.elevation_min_deg) & (elevation <= box.elevation_max_deg)
    return np.asarray(high[:, None] & inside[None, :])


def uncovered_fraction(count: NDArray[np.uint16], required: NDArray[np.bool_]) -> float:
    """Fraction of the solid angle of the `required` cells that no image sees, [0, 1]; 0 if no cell is required.

    Args:
        count: the result of `coverage_count`.
        required: mask of the same shape.
    """
    elevation, _ = grid(count.shape[1])
    weight = np.cos(np.radians(elevation))[:, None] * required
    total = float(weight.sum())
    return float((weight * (count == 0)).sum()) / total if total else 0.0
