"""Robust cores: the part of an image that is in the picture for every pointing error within the tolerance.

An image commanded to yaw ψ, roll ρ, pitch θ is taken at R(e) = Rz(ψ + e_yaw) · Rx(ρ + e_roll) · Ry(θ + e_pitch), the
error model of `planning.geometry.pose_error`, with each |e| within its tolerance. Its *core* is the set of directions
that it sees for every error, K = { d : d · R(e) nₖ ≥ 0 for every e in the box and each edge normal nₖ }.

**Independent errors.** If the errors of the images are independent, coverage depends on the cores alone: the union of
the images covers a direction d for *every* combination of errors exactly when d is in some core. For if d is in no
core, each image has an error that loses d, and all these errors can occur together; the converse is immediate.

**A convex polygon inside K.** The inequality is linear in the matrix, so it holds for all R(e) if it holds for matrices
whose convex hull contains them all. The rotations about one axis through [φ - t, φ + t] lie in the hull of the two
extreme rotations and of the *apexes* of m equal parts: the rotation by each part's middle angle with the plane
perpendicular to the axis scaled by 1/cos(t/m). (Tangents at the ends of a part meet at its apex, so a part lies in the
triangle of its ends and its apex; the point between two parts is the middle of their apexes, so only the outer ends are
needed.) The product of the hulls of three factors lies in the hull of the products, as a product is linear in each
factor. So K contains the convex polygon that is the intersection of the half-spaces of all products: an inner bound
whose loss is at most (t/m)²/2 radians for an axis, 0.004° for a yaw tolerance of 0.667°, and 0 for a tolerance of 0.

Corners that protrude by less than 1e-5 rad are then cut off, which only makes the polygon smaller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray, rotation, yaw_pitch_roll
from panoexec.optics import Camera
from panoexec.planning.geometry.footprint import edge_normals, rectangle
from panoexec.planning.geometry.overlap import clip
from panoexec.planning.model import Tolerance

_PART_DEG = 0.7
"""Largest half part of an axis's error range; a larger range is split into more parts."""

_MOST_PARTS = 3

_THIN = 1e-5
"""Corners that protrude less than this in the image plane (so at most as many radians) are cut off."""

_SAME_DEG = 1e-9
"""Attitudes that agree to this angle share a core (1.7e-11 rad, far below the certificate's margin)."""

_AT_A_TIME = 1 << 17
"""Pairs of a direction and a core processed at a time: limits the memory."""

_REMEMBERED = 64
"""Up to this number of different attitudes, cores are taken from a cache."""

_MOST_REMEMBERED = 4096
"""Cores kept in it for a lens and a tolerance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cores:
    """Convex spherical polygons, one for each image, in the world frame.

    Attributes:
        vertices: (n, v, 3) unit vectors, clockwise as a viewer of the image sees them; a polygon with fewer than v
            corners repeats its first one at the end. An empty core has all its corners at the boresight.
        normals: (n, v, 3) unit inward normals of the planes through corners k and k + 1 (cyclic). The padding repeats
            one of the polygon's own normals, so all half-spaces may be used without checking for padding.
        is_edge: (n, v) whether corners k and k + 1 span an edge; False in the padding and in empty cores.
        centres: (n, 3) boresights.
        radii: (n,) angle from the boresight to the farthest corner, radians; 0 where empty.
        empty: (n,) whether the core is empty: no direction is seen for every error.
    """

    vertices: FloatArray
    normals: FloatArray
    is_edge: NDArray[np.bool_]
    centres: FloatArray
    radii: FloatArray
    empty: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.vertices)

    def select(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Cores:
        """The cores of some images, by mask or index."""
        return Cores(
            vertices=self.vertices[which],
            normals=self.normals[which],
            is_edge=self.is_edge[which],
            centres=self.centres[which],
            radii=self.radii[which],
            empty=self.empty[which],
        )

    def depth(self, directions: ArrayLike) -> FloatArray:
        """Depth of each direction in the core that contains it most deeply.

        Args:
            directions: (m, 3) world unit vectors.

        Returns:
            (m,) sine of the angle to that core's nearest edge plane: ≥ 0 covered, < 0 not; -1 far from all cores.
        """
        points = np.asarray(directions, dtype=np.float64)
        best = np.full(len(points), -1.0)
        reach = np.where(self.empty, 2.0, np.cos(self.radii) - 1e-9)
        step = max(1, _AT_A_TIME // max(len(self), 1))
        for start in range(0, len(points), step):
            near, core = np.nonzero(points[start : start + step] @ self.centres.T >= reach)
            near += start
            depth = np.einsum("kvc,kc->kv", self.normals[core], points[near]).min(axis=1, initial=1.0)
            np.maximum.at(best, near, depth)
        return best


def robust_cores(camera: Camera, rotations: ArrayLike, tolerance: Tolerance) -> Cores:
    """The robust cores of images.

    Args:
        camera: the camera.
        rotations: camera-to-world rotations (n, 3, 3), commanded or measured, of any roll.
        tolerance: largest error of each axis about these attitudes.

    Returns:
        The cores; the module docstring states their guarantee.
    """
    to_world = np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)
    n = len(to_world)
    if tolerance.is_zero or n == 0:
        polygons = np.broadcast_to(rectangle(camera), (n, 4, 2))
        return _on_sphere(polygons, np.full(n, 4), to_world)
    _, pitch, roll = yaw_pitch_roll(to_world)
    attitudes = np.round(np.stack([pitch, roll], axis=1) / _SAME_DEG)
    unique, which = np.unique(attitudes, axis=0, return_inverse=True)
    pitch, roll = np.moveaxis(unique * _SAME_DEG, -1, 0)
    if len(unique) <= _REMEMBERED:
        polygons, counts = _padded(_remembered(camera, pitch, roll, tolerance))
    else:
        polygons, counts = _core_polygons(camera, pitch, roll, tolerance)
    which = which.reshape(-1)
    return _on_sphere(polygons[which], counts[which], to_world)


def _remembered(camera: Camera, pitch_deg: FloatArray, roll_deg: FloatArray, tolerance: Tolerance) -> list[FloatArray]:
    """Cores in their image planes, (v, 2) each; remembered, as the search needs the same rows repeatedly."""
    memory = _memory(camera, tolerance)
    attitudes = list(zip(pitch_deg.tolist(), roll_deg.tolist(), strict=True))
    known = {attitude: memory[attitude] for attitude in attitudes if attitude in memory}
    unknown = [attitude for attitude in attitudes if attitude not in known]
    if unknown:
        pitch, roll = np.array(unknown).T
        for attitude, polygon, count in zip(unknown, *_core_polygons(camera, pitch, roll, tolerance), strict=True):
            known[attitude] = polygon[:count].copy()
            known[attitude].setflags(write=False)
        if len(memory) + len(unknown) > _MOST_REMEMBERED:
            memory.clear()
        memory.update((attitude, known[attitude]) for attitude in unknown)
    return [known[attitude] for attitude in attitudes]


@lru_cache(maxsize=16)
def _memory(camera: Camera, tolerance: Tolerance) -> dict[tuple[float, float], FloatArray]:  # noqa: ARG001
    """The cores of a lens and a tolerance that were computed so far, by pitch and roll."""
    return {}


def _padded(polygons: list[FloatArray]) -> tuple[FloatArray, NDArray[np.intp]]:
    counts = np.array([len(p) for p in polygons], dtype=np.intp)
    out = np.zeros((len(polygons), max(int(counts.max(initial=0)), 3), 2))
    for i, polygon in enumerate(polygons):
        out[i, : len(polygon)] = polygon
    return out, counts


def _core_polygons(
    camera: Camera, pitch_deg: FloatArray, roll_deg: FloatArray, tolerance: Tolerance
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Cores in the image planes of the attitudes without error: polygons (u, v, 2) and their corner counts (u,)."""
    planes = core_half_planes(camera, pitch_deg, roll_deg, tolerance)
    start = np.broadcast_to(rectangle(camera), (len(planes), 4, 2))
    return _thinned(clip(start, planes))


def core_half_planes(camera: Camera, pitch_deg: FloatArray, roll_deg: FloatArray, tolerance: Tolerance) -> FloatArray:
    """The half-planes (u, k, 3) of the image planes whose intersection bounds the cores from inside (see `overlap`)."""
    nominal = rotation(0.0, pitch_deg, roll_deg)
    hull = _axis_hull(2, np.zeros(1), tolerance.yaw_deg)[:, :, None, None]
    hull = hull @ _axis_hull(0, roll_deg, tolerance.roll_deg)[:, None, :, None]
    hull = hull @ _axis_hull(1, pitch_deg, tolerance.pitch_deg)[:, None, None, :]
    relative = np.swapaxes(nominal, -1, -2)[:, None, None, None] @ hull
    normals = edge_normals(camera) @ np.swapaxes(relative, -1, -2)
    return np.asarray(normals.reshape(len(nominal), -1, 3))


def _axis_hull(axis: int, angle_deg: FloatArray, tolerance_deg: float) -> FloatArray:
    """Matrices (u, p, 3, 3) whose convex hull contains the rotations about an axis by every angle ± tolerance."""
    if tolerance_deg == 0:
        return _turn(axis, angle_deg)[:, None]
    parts = max(min(_MOST_PARTS, math.ceil(tolerance_deg / _PART_DEG)), math.ceil(tolerance_deg / 60.0))
    half = tolerance_deg / parts
    middles = -tolerance_deg + half * (1 + 2 * np.arange(parts))
    stretch = np.full(3, 1 / math.cos(math.radians(half)))
    stretch[axis] = 1.0
    ends = _turn(axis, angle_deg[:, None] + np.array([-tolerance_deg, tolerance_deg]))
    apexes = _turn(axis, angle_deg[:, None] + middles) * stretch
    return np.concatenate([ends, apexes], axis=1)


def _turn(axis: int, angle_deg: FloatArray) -> FloatArray:
    if axis == 0:
        return rotation(0.0, 0.0, angle_deg)
    return rotation(0.0, angle_deg) if axis == 1 else rotation(angle_deg, 0.0)


def _thinned(polygons: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Polygons (u, v, 2) without corners that hardly protrude, and their corner counts (u,), 0 for an empty one."""
    u, v = polygons.shape[:2]
    following = polygons[:, np.arange(1 - v, 1)]
    # padding, and rounding in the clipping, may repeat corners: keep the first of equal neighbours
    keep = np.any(polygons != following, axis=2) & ~np.isnan(polygons[:, :, 0])
    while True:
        order = np.argsort(~keep, axis=1, kind="stable")
        polygons = np.take_along_axis(polygons, order[..., None], axis=1)
        counts = keep.sum(axis=1)
        column = np.arange(v)
        inside = column < counts[:, None]
        before = np.where(column == 0, counts[:, None] - 1, column - 1)
        after = np.where(column + 1 >= counts[:, None], 0, column + 1)
        corner_before = np.take_along_axis(polygons, np.clip(before, 0, v - 1)[..., None], axis=1)
        corner_after = np.take_along_axis(polygons, after[..., None], axis=1)
        chord, arm = corner_after - corner_before, polygons - corner_before
        twice_area = np.abs(chord[..., 0] * arm[..., 1] - chord[..., 1] * arm[..., 0])
        sticks_out = np.where(inside, twice_area / np.maximum(np.hypot(chord[..., 0], chord[..., 1]), 1e-300), np.inf)
        worst = np.argmin(np.nan_to_num(sticks_out, nan=0.0), axis=1)
        drop = (sticks_out[np.arange(u), worst] < _THIN) & (counts >= 3)
        if not drop.any():
            width = max(int(counts.max(initial=0)), 3)
            return polygons[:, :width], np.where(counts >= 3, counts, 0)
        keep = inside
        keep[np.nonzero(drop)[0], worst[drop]] = False


def _on_sphere(polygons: FloatArray, counts: NDArray[np.intp], to_world: FloatArray) -> Cores:
    """Cores from image-plane polygons (n, v, 2) with `counts` corners each (0: empty)."""
    n, v = polygons.shape[:2]
    empty = counts < 3
    column = np.arange(v)
    is_edge = column < counts[:, None]
    corners = np.where(is_edge[..., None], polygons, np.where(empty[:, None, None], 0.0, polygons[:, :1]))
    rays = np.concatenate([np.ones((n, v, 1)), corners], axis=2)
    following = np.where(column + 1 >= counts[:, None], 0, column + 1)
    normals = np.cross(rays, np.take_along_axis(rays, following[..., None], axis=1))
    normals = np.where(is_edge[..., None], normals, normals[:, :1])
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    normals = normals / np.where(length > 0, length, 1.0)
    rays = rays / np.linalg.norm(rays, axis=2, keepdims=True)
    turned = np.swapaxes(to_world, -1, -2)
    return Cores(
        vertices=rays @ turned,
        normals=normals @ turned,
        is_edge=is_edge & ~empty[:, None],
        centres=to_world[:, :, 0],
        radii=np.arccos(np.clip(rays[:, :, 0].min(axis=1, initial=1.0), -1.0, 1.0)),
        empty=empty,
    )
