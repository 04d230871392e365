"""Exact overlap of images, for many pairs at once: the paper's equation (5) in the limit of infinitely many pixels.

The overlap of image A with image B is the fraction of A's image-plane area that B sees too. It is not symmetric: two
equal cameras that differ by a rotation share the same solid angle, but that part covers a different area in each image
plane, because a pixel near the corners covers a smaller angle.

Method: in A's image plane (see `footprint`) A is a rectangle, and each edge plane of B, which passes through the common
centre, cuts it in a straight line. So the part of A that B sees is the rectangle clipped to B's four edge planes: a
convex polygon of at most eight corners, whose area is exact up to rounding. The four half-spaces need no fifth one for
"in front of B" (proof: `footprint.edge_normals`).

Polygons are arrays (n, v, 2) of image-plane corners (y right, z down) in order. A polygon with fewer than v corners
repeats its first one; an empty one is all NaN. Half-planes are rows (c, a, b) that keep c + a·y + b·z ≥ 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.geometry.footprint import edge_normals, rectangle

_FEW = 4
"""Up to this number of pairs, plain Python is faster than numpy with its overhead."""
_AT_A_TIME = 4096
"""Pairs processed at a time: limits the memory and fits the processor's cache."""


def pairwise_overlap(
    camera_a: Camera,
    rotations_a: ArrayLike,
    rotations_b: ArrayLike,
    camera_b: Camera | None = None,
    tops: FloatArray | None = None,
) -> FloatArray:
    """Fraction of the area of each image A that its image B sees too.

    Args:
        camera_a: the camera of images A.
        rotations_a: camera-to-world rotations (..., 3, 3).
        rotations_b: likewise; broadcasts with `rotations_a`.
        camera_b: the camera of images B; by default the same camera.
        tops: (n,) where images A are cropped: only what lies below this line (z down) counts; by default nowhere.

    Returns:
        (...), in [0, 1].
    """
    planes = half_planes(rotations_a, rotations_b, camera_b or camera_a)
    shape = planes.shape[:-2]
    planes = planes.reshape(-1, 4, 3)
    if len(planes) <= _FEW and tops is None:
        return np.array([_overlap_of_one(camera_a, own) for own in planes.tolist()]).reshape(shape)
    areas = [
        polygon_area(clip(_rectangles(camera_a, len(planes[some]), None if tops is None else tops[some]), planes[some]))
        for some in (slice(start, start + _AT_A_TIME) for start in range(0, len(planes), _AT_A_TIME))
    ]
    area = np.concatenate(areas) if areas else np.empty(0)
    return np.minimum(area / camera_a.image_area, 1.0).reshape(shape)


def clip_footprint(
    camera_a: Camera, rotations_a: ArrayLike, rotations_b: ArrayLike, camera_b: Camera | None = None
) -> FloatArray:
    """What B sees of A, as polygons in the image plane of A.

    Args:
        camera_a: the camera of images A.
        rotations_a: camera-to-world rotations (n, 3, 3), or (3, 3).
        rotations_b: likewise; broadcasts with `rotations_a`.
        camera_b: the camera of images B; by default the same camera.

    Returns:
        (n, v, 2), v ≤ 8; see the module docstring.
    """
    return clip_footprints(camera_a, half_planes(rotations_a, rotations_b, camera_b or camera_a).reshape(-1, 4, 3))


def clip_footprints(camera: Camera, planes: FloatArray) -> FloatArray:
    """Clip images to half-planes (n, k, 3) of their image planes: polygons (n, v, 2), v ≤ 4 + k."""
    return clip(_rectangles(camera, len(planes)), planes)


def union_overlap(
    camera_a: Camera,
    rotations_a: ArrayLike,
    rotations_b: ArrayLike,
    present: ArrayLike | None = None,
    camera_b: Camera | None = None,
    *,
    tops: FloatArray | None = None,
) -> FloatArray:
    """Fraction of the area of each image A that at least one of its partners B sees.

    Args:
        camera_a: the camera of images A.
        rotations_a: camera-to-world rotations (n, 3, 3).
        rotations_b: of each image's m partners, (n, m, 3, 3).
        present: (n, m), False where a partner is padding.
        camera_b: the camera of images B; by default the same camera.
        tops: (n,) where images A are cropped, as in `pairwise_overlap`.

    Returns:
        (n,), in [0, 1].
    """
    r_a = np.asarray(rotations_a, dtype=np.float64)
    planes = half_planes(r_a[:, None], rotations_b, camera_b or camera_a)
    own = _rectangles(camera_a, len(r_a), tops)
    pieces, owners = subtract(own, planes, present)
    missing = np.bincount(owners, polygon_area(pieces), len(r_a))
    whole = polygon_area(own)
    return np.clip((whole - missing) / camera_a.image_area, 0.0, 1.0)


def half_planes(rotations_a: ArrayLike, rotations_b: ArrayLike, camera_b: Camera) -> FloatArray:
    """The four edge planes of images B as half-planes of the image planes of A.

    Args:
        rotations_a: camera-to-world rotations (..., 3, 3).
        rotations_b: likewise; broadcasts with `rotations_a`.
        camera_b: the camera of images B.

    Returns:
        (..., 4, 3): rows (c, a, b), which keep c + a·y + b·z ≥ 0.
    """
    to_world_a = np.asarray(rotations_a, dtype=np.float64)
    to_camera_b = np.swapaxes(np.asarray(rotations_b, dtype=np.float64), -1, -2)
    return np.asarray(edge_normals(camera_b) @ (to_camera_b @ to_world_a))


def clip(polygons: FloatArray, planes: FloatArray) -> FloatArray:
    """Clip convex polygons to half-planes (Sutherland and Hodgman, vectorised over all polygons).

    Args:
        polygons: (n, v, 2).
        planes: (n, k, 3); polygon i is clipped to all k half-planes of row i.

    Returns:
        (n, w, 2), w ≤ v + k.
    """
    for i in range(planes.shape[1]):
        distance = _distances(polygons, planes[:, i])
        inside = distance >= 0
        whole: NDArray[np.bool_] = np.logical_and.reduce(inside, axis=1)
        if whole.all():
            continue
        partly: NDArray[np.bool_] = np.logical_or.reduce(inside, axis=1) & ~whole
        if partly.all():
            polygons = _cut(polygons, distance, inside)
            continue
        cut = _cut(polygons[partly], distance[partly], inside[partly])
        polygons = _scatter(polygons, whole, partly, cut)
    return polygons


def subtract(
    polygons: FloatArray, planes: FloatArray, present: ArrayLike | None = None
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Subtract convex polygons from convex polygons; the difference is returned as convex pieces.

    A minus B is split into the pieces "inside the first i half-planes of B, outside the next", which are disjoint.

    Args:
        polygons: (n, v, 2).
        planes: (n, m, k, 3); the m polygons subtracted from polygon i, each the intersection of k half-planes.
        present: (n, m), False where the polygon to subtract is padding.

    Returns:
        Pieces (p, w, 2), none empty, and for each the index (p,) of its polygon.
    """
    count, m, k = planes.shape[:3]
    wanted = np.ones((count, m), dtype=bool) if present is None else np.asarray(present, dtype=bool)
    pieces = polygons
    owners: NDArray[np.intp] = np.arange(count)
    for j in range(m):
        own_planes = planes[owners, j]
        touched = wanted[owners, j] & ~_outside_one(pieces, own_planes)
        left, left_owners = [pieces[~touched]], [owners[~touched]]
        rest, rest_owners, rest_planes = pieces[touched], owners[touched], own_planes[touched]
        for i in range(k):
            outside = clip(rest, -rest_planes[:, i : i + 1])
            kept = polygon_area(outside) > 0
            left.append(outside[kept])
            left_owners.append(rest_owners[kept])
            rest = clip(rest, rest_planes[:, i : i + 1])
            some = ~np.isnan(rest[:, 0, 0])
            rest, rest_owners, rest_planes = rest[some], rest_owners[some], rest_planes[some]
        pieces, owners = _stack(left), np.concatenate(left_owners)
    return pieces, owners


def union_area(polygons: Sequence[ArrayLike]) -> float:
    """Area of the union of convex polygons, each (v, 2) with at least three corners in either orientation."""
    total = 0.0
    edges = [_polygon_planes(np.asarray(p, dtype=np.float64)) for p in polygons]
    for i, polygon in enumerate(polygons):
        pieces = np.asarray(polygon, dtype=np.float64)[None]
        for planes in edges[:i]:
            if not len(pieces):
                break
            repeated = np.broadcast_to(planes, (len(pieces), 1, *planes.shape))
            pieces, _ = subtract(pieces, repeated)
        total += float(polygon_area(pieces).sum())
    return total


def polygon_area(polygons: FloatArray) -> FloatArray:
    """Areas (n,) of polygons (n, v, 2); 0 for an empty one."""
    # relative to the first corner, to avoid cancellation for a small polygon far from the centre
    y, z = np.moveaxis(polygons[:, 1:] - polygons[:, :1], -1, 0)
    area = np.abs((y[:, :-1] * z[:, 1:] - y[:, 1:] * z[:, :-1]).sum(axis=1)) / 2
    return np.asarray(np.where(np.isnan(area), 0.0, area))


def _overlap_of_one(camera: Camera, planes: list[list[float]]) -> float:
    """`pairwise_overlap` for one pair, in plain Python: the fraction of the image inside four half-planes."""
    w, h = camera.half_width, camera.half_height
    corners = [(-w, -h), (w, -h), (w, h), (-w, h)]
    for c, a, b in planes:
        distances = [c + a * y + b * z for y, z in corners]
        if min(distances) >= 0:
            continue
        kept: list[tuple[float, float]] = []
        y0, z0 = corners[-1]
        d0 = distances[-1]
        for (y1, z1), d1 in zip(corners, distances, strict=True):
            if (d0 >= 0) != (d1 >= 0):
                share = d0 / (d0 - d1)
                kept.append((y0 + share * (y1 - y0), z0 + share * (z1 - z0)))
            if d1 >= 0:
                kept.append((y1, z1))
            y0, z0, d0 = y1, z1, d1
        if len(kept) < 3:
            return 0.0
        corners = kept
    y0, z0 = corners[0]
    twice = 0.0
    for i in range(1, len(corners) - 1):
        (y1, z1), (y2, z2) = corners[i], corners[i + 1]
        twice += (y1 - y0) * (z2 - z0) - (y2 - y0) * (z1 - z0)
    return min(1.0, abs(twice) / (2 * camera.image_area))


def _cut(polygons: FloatArray, distance: FloatArray, inside: NDArray[np.bool_]) -> FloatArray:
    """Clip each polygon to the half-plane to which its corners have the given signed distances (n, v)."""
    n, v = distance.shape
    following = np.arange(1 - v, 1)  # the index of the next corner, cyclic
    crossing = inside != inside[:, following]
    span = distance - distance[:, following]
    share = distance / np.where(crossing, span, 1.0)
    emitted = np.empty((n, v, 2), dtype=bool)
    emitted[:, :, 0] = inside
    emitted[:, :, 1] = crossing
    candidates = np.empty((n, v, 2, 2))
    candidates[:, :, 0] = polygons
    candidates[:, :, 1] = polygons + share[..., None] * (polygons[:, following] - polygons)
    slot = np.cumsum(emitted.reshape(n, 2 * v), axis=1) - 1
    counts = slot[:, -1] + 1
    width = max(int(counts.max(initial=0)), 1)
    row, column = np.nonzero(emitted.reshape(n, 2 * v))
    out = np.full((n, width, 2), np.nan)
    out[row, slot[row, column]] = candidates.reshape(n, 2 * v, 2)[row, column]
    padding = np.arange(width) >= counts[:, None]
    return np.where(padding[..., None], out[:, :1], out)


def _scatter(polygons: FloatArray, whole: NDArray[np.bool_], partly: NDArray[np.bool_], cut: FloatArray) -> FloatArray:
    """Polygons (n, v, 2): unchanged where `whole`, clipped where `partly`, empty elsewhere."""
    n, v = polygons.shape[:2]
    out = np.full((n, max(v, cut.shape[1]), 2), np.nan)
    out[whole, :v] = polygons[whole]
    out[whole, v:] = polygons[whole, :1]
    out[partly, : cut.shape[1]] = cut
    out[partly, cut.shape[1] :] = cut[:, :1]
    return out


def _distances(polygons: FloatArray, planes: FloatArray) -> FloatArray:
    """Signed distances (n, v), up to a positive factor, of the corners of polygons (n, v, 2) to half-planes (n, 3)."""
    return np.asarray(planes[:, :1] + planes[:, 1:2] * polygons[..., 0] + planes[:, 2:] * polygons[..., 1])


def _outside_one(polygons: FloatArray, planes: FloatArray) -> NDArray[np.bool_]:
    """Whether each polygon (n, v, 2) is completely outside at least one of its half-planes (n, k, 3)."""
    distance = planes[:, :, :1] + planes[:, :, 1:] @ np.swapaxes(polygons, 1, 2)
    return np.asarray(np.any(np.all(distance <= 0, axis=2), axis=1))


def _polygon_planes(polygon: FloatArray) -> FloatArray:
    """The half-planes (v, 3) whose intersection is the convex polygon (v, 2)."""
    following = np.roll(polygon, -1, axis=0)
    edge = following - polygon
    a, b = -edge[:, 1], edge[:, 0]
    planes = np.stack([-(a * polygon[:, 0] + b * polygon[:, 1]), a, b], axis=1)
    centre = polygon.mean(axis=0)
    inside = planes[:, 0] + planes[:, 1:] @ centre
    return np.asarray(planes * np.where(inside.sum() >= 0, 1.0, -1.0))


def _rectangles(camera: Camera, n: int, tops: FloatArray | None = None) -> FloatArray:
    whole = np.broadcast_to(rectangle(camera), (n, 4, 2))
    return whole if tops is None else cropped(whole, tops)


def cropped(rectangles: FloatArray, tops: FloatArray) -> FloatArray:
    """Images as polygons (n, 4, 2) without what lies above the lines (n,)."""
    out = rectangles.copy()
    out[:, :2, 1] = tops[:, None]
    return out


def _stack(groups: Sequence[FloatArray]) -> FloatArray:
    """Concatenate polygons of different widths; narrower ones repeat their first corner."""
    width = max(group.shape[1] for group in groups)
    out = np.empty((sum(len(group) for group in groups), width, 2))
    start = 0
    for group in groups:
        stop = start + len(group)
        out[start:stop, : group.shape[1]] = group
        out[start:stop, group.shape[1] :] = group[:, :1]
        start = stop
    return out
