"""The paper's ray casting, equations (4) to (6): a slow reference for tests, comparisons and benchmarks.

One ray is cast through the centre of each pixel of image A; the overlap is the fraction of rays that hit image B.
Planning and certification use `panoexec.planning.geometry.overlap`, the limit of infinitely many pixels.

Three notes about the paper (Zhang, Liu, Zhou: "UAV-Based Gigapixel Panoramic Image Acquisition Planning with Ray
Casting-Based Overlap Constraints"):

* With the printed signs of its equation (1) the image plane is not perpendicular to the optical axis when an angle is
  not 0; the intended camera, an ordinary pinhole rotated about its centre of projection, is used here.
* A pixel's ray never passes exactly through the centre of a pixel of another image, so "collinear" in equation (4) is
  read as: the ray hits image B anywhere in its rectangle.
* Equation (6) accepts rays that miss by an angle that grows with the gimbal's inaccuracy: the less accurate the gimbal,
  the *more* overlap it reports. It is implemented for comparison only; no plan or guarantee uses it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.geometry.footprint import corner_rays, edge_normals

PAPER_TAU_PITCH_DEG = 0.017
"""The paper's accuracy of roll and pitch, degrees, which also defines its pixel grid."""
PAPER_TAU_YAW_DEG = 0.667
"""The paper's accuracy of yaw, degrees."""

_RAYS_AT_A_TIME = 1 << 16


def paper_grid(camera: Camera, tau_pitch_deg: float = PAPER_TAU_PITCH_DEG) -> tuple[int, int]:
    """The paper's virtual image size (w, h): w = ψ_h / τ_p, h = ψ_v / τ_p, rounded up, pixels."""
    return math.ceil(camera.hfov_deg / tau_pitch_deg), math.ceil(camera.vfov_deg / tau_pitch_deg)


def relaxation_deg(tau_pitch_deg: float = PAPER_TAU_PITCH_DEG, tau_yaw_deg: float = PAPER_TAU_YAW_DEG) -> float:
    """The angle arccos ξ = √(2·τ_p² + τ_y²) by which two rays may differ in equation (6), degrees."""
    return math.sqrt(2 * tau_pitch_deg**2 + tau_yaw_deg**2)


def raycast_overlap(
    camera_a: Camera,
    rotation_a: ArrayLike,
    rotation_b: ArrayLike,
    *,
    grid: tuple[int, int] | None = None,
    relaxed_by_deg: float = 0.0,
    camera_b: Camera | None = None,
) -> float:
    """Overlap of image A with image B by equations (4) and (5), or (6) and (5).

    Args:
        camera_a: the camera of image A.
        rotation_a: its camera-to-world rotation (3, 3).
        rotation_b: that of image B.
        grid: pixels (w, h) of image A; the paper's own by default.
        relaxed_by_deg: equation (6): largest angle by which a counted ray may miss image B, [0, 90).
        camera_b: the camera of image B; by default the same camera.

    Returns:
        The fraction of A's pixels, [0, 1]. It differs from the exact overlap by at most 1/w + 1/h: the overlap is
        convex, so it cuts a line of w pixels in one piece, whose pixel count is off by less than one pixel, and the
        lengths of these pieces increase and decrease only once over the h lines.
    """
    columns, rows = grid or paper_grid(camera_a)
    other = camera_b or camera_a
    turn = np.asarray(rotation_b, dtype=np.float64).T @ np.asarray(rotation_a, dtype=np.float64)
    y = ((np.arange(columns) + 0.5) / columns * 2 - 1) * camera_a.half_width
    z = ((np.arange(rows) + 0.5) / rows * 2 - 1) * camera_a.half_height
    lines = max(1, _RAYS_AT_A_TIME // columns)
    met = 0
    for start in range(0, rows, lines):
        rays = _rays(y, z[start : start + lines]) @ turn.T
        met += int(np.count_nonzero(_meets(other, rays, relaxed_by_deg)))
    return met / (columns * rows)


def _rays(y: FloatArray, z: FloatArray) -> FloatArray:
    """Rays (n, 3) in the camera frame through all points (y, z) of the image plane."""
    rays = np.ones((len(z), len(y), 3))
    rays[:, :, 1] = y
    rays[:, :, 2] = z[:, None]
    return rays.reshape(-1, 3)


def _meets(camera: Camera, rays: FloatArray, relaxed_by_deg: float) -> NDArray[np.bool_]:
    """Whether rays (n, 3), in the camera frame, pass through its image or miss it by at most an angle."""
    x, y, z = rays[:, 0], rays[:, 1], rays[:, 2]
    inside = (np.abs(y) <= camera.half_width * x) & (np.abs(z) <= camera.half_height * x)
    if relaxed_by_deg <= 0:
        return np.asarray(inside)
    missed = ~inside
    inside[missed] = _angle_to_border(camera, rays[missed]) <= math.radians(relaxed_by_deg)
    return np.asarray(inside)


def _angle_to_border(camera: Camera, rays: FloatArray) -> FloatArray:
    """Angles (n,), radians, from rays (n, 3) in the camera frame, outside its image, to the image's border."""
    units = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    normals, corners = edge_normals(camera), corner_rays(camera)
    nearest = np.arccos(np.clip(units @ corners.T, -1, 1)).min(axis=1)
    for i in range(4):
        # the foot of the perpendicular on the edge's great circle is on the edge if it is between the two corners
        after_start = units @ np.cross(normals[i], corners[i]) >= 0
        before_end = units @ np.cross(corners[(i + 1) % 4], normals[i]) >= 0
        off_circle = np.arcsin(np.clip(np.abs(units @ normals[i]), 0, 1))
        nearest = np.where(after_start & before_end, np.minimum(nearest, off_circle), nearest)
    return np.asarray(nearest)
