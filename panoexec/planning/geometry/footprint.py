"""The footprint of one image: its rectangle in the image plane, its pyramid of rays, its outline.

The *image plane* is the plane at distance 1 in front of the camera, with coordinates (y right, z down): an image is the
rectangle |y| ≤ half_width, |z| ≤ half_height. On the sphere it is a convex quadrilateral whose four sides are arcs of
great circles, the intersection of four half-spaces through the centre.

Corners and edges are numbered clockwise as a viewer of the image sees them. Corners: 0 top left, 1 top right, 2 bottom
right, 3 bottom left. Edge i runs from corner i to corner i + 1: 0 top, 1 right, 2 bottom, 3 left.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import FloatArray
from panoexec.optics import Camera


@lru_cache(maxsize=64)
def edge_normals(camera: Camera) -> FloatArray:
    """Inward unit normals of the four edge planes (top, right, bottom, left), camera frame.

    A direction d is in the image exactly when `edge_normals(camera) @ d >= 0` in all four components. A fifth condition
    for "in front of the camera" is not needed: the normals of right and left are, up to length, (w, -1, 0) and
    (w, 1, 0) with w = half_width > 0; the sum of both conditions is 2·w·x ≥ 0. And x = 0 leaves only 0 ≥ ±y and
    0 ≥ ±z, the null vector. This holds for any field of view below 180°.

    Returns:
        (4, 3), read-only.
    """
    w, h = camera.half_width, camera.half_height
    normals = np.array([[h, 0.0, 1.0], [w, -1.0, 0.0], [h, 0.0, -1.0], [w, 1.0, 0.0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals.flags.writeable = False
    return normals


def corner_rays(camera: Camera) -> FloatArray:
    """Unit vectors to the four corners (top left, top right, bottom right, bottom left), camera frame, (4, 3)."""
    return _on_sphere(rectangle(camera))


def rectangle(camera: Camera) -> FloatArray:
    """The corners in the image plane, (4, 2), each (y right, z down), numbered as in the module's text."""
    w, h = camera.half_width, camera.half_height
    return np.array([[-w, -h], [w, -h], [w, h], [-w, h]])


def outline(camera: Camera, rotation: ArrayLike, points_per_edge: int = 16) -> FloatArray:
    """World directions along the borders of images, clockwise as a viewer of the image sees them, from the top left.

    Args:
        camera: the camera.
        rotation: camera-to-world rotations (..., 3, 3).
        points_per_edge: at least 1; each edge's start corner is among them, its end corner starts the next edge.

    Returns:
        (..., 4 · points_per_edge, 3) unit vectors; not closed (the first point is not repeated).
    """
    corners = rectangle(camera)
    step = np.arange(points_per_edge)[:, None] / points_per_edge
    edges = [corners[i] + step * (corners[(i + 1) % 4] - corners[i]) for i in range(4)]
    rays = _on_sphere(np.concatenate(edges))
    return np.asarray(rays @ np.swapaxes(np.asarray(rotation, dtype=np.float64), -1, -2))


def inside_margin(camera: Camera, rotation: ArrayLike, directions: ArrayLike) -> FloatArray:
    """Signed distance of directions from the image border, as the sine of the angle to the nearest edge plane.

    Args:
        camera: the camera.
        rotation: camera-to-world rotation (3, 3).
        directions: world unit vectors (..., 3).

    Returns:
        (...), ≥ 0 inside (border included), negative outside.
    """
    normals = edge_normals(camera) @ np.asarray(rotation, dtype=np.float64).T
    return np.asarray((np.asarray(directions, dtype=np.float64) @ normals.T).min(axis=-1))


def _on_sphere(points: FloatArray) -> FloatArray:
    rays = np.concatenate([np.ones((len(points), 1)), points], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
