"""Overlap of images with the row above or below: exact, and fast enough for tens of thousands of evaluations.

At one elevation an image covers an interval of azimuths about its own yaw. So among images of one pitch, sorted by yaw,
those that see a given direction are consecutive, and the area of another image A that their union sees is

    Σᵢ area(A ∩ Bᵢ) - Σᵢ area(A ∩ Bᵢ ∩ Bᵢ₊₁),

because a direction seen by k of them is counted k times and subtracted k - 1 times. Each term is an intersection of
half-planes. By Green's theorem its area is half the sum, over its border lines, of distance from the origin times
length, where the length is the part of the line inside the other half-planes. The far edge of the Bᵢ, which A does not
reach, is omitted. This does not hold about a pole, where images overlap again on the far side.

For any row, and faster if an error of 1e-3 is acceptable, A is cut into narrow columns (at Gauss-Legendre abscissae):
in a column every other image is one interval, and the union of intervals is computed exactly.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.worst_overlap import ErrorCorners, worst_pair_overlaps
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import Tolerance

_AT_A_TIME = 1 << 15
"""Pairs of lines processed at a time, so that they fit the processor's cache."""

_PARALLEL = 1e-12


def seen_by_row(camera: Camera, pitch_deg: FloatArray, row_pitch_deg: FloatArray, yaws_deg: FloatArray) -> FloatArray:
    """Fraction of images that at least one image of the adjacent row sees; the row must not be about a pole.

    Args:
        camera: the camera of all images.
        pitch_deg: (k,) pitch of the images, at yaw 0.
        row_pitch_deg: (k,) pitch of the adjacent row, all above or all below the images.
        yaws_deg: (k, m) yaws of the adjacent row's images relative to the image, ascending; NaN is padding.

    Returns:
        (k,), in [0, 1].
    """
    k, m = yaws_deg.shape
    step = max(1, _AT_A_TIME // (m * 64))
    parts = [
        _seen(camera, pitch_deg[s], row_pitch_deg[s], yaws_deg[s])
        for s in (slice(i, i + step) for i in range(0, max(k, 1), step))
    ]
    return np.clip(np.concatenate(parts) / camera.image_area, 0.0, 1.0)


def seen_in_columns(
    camera: Camera, pitch_deg: FloatArray, row_pitch_deg: FloatArray, yaws_deg: FloatArray, columns: int
) -> FloatArray:
    """The same as `seen_by_row` for any row, approximately, with the given number of columns."""
    k, m = yaws_deg.shape
    step = max(1, _AT_A_TIME // (m * columns))
    parts = [
        _columns_seen(camera, pitch_deg[s], row_pitch_deg[s], yaws_deg[s], columns)
        for s in (slice(i, i + step) for i in range(0, max(k, 1), step))
    ]
    return np.concatenate(parts)


def _columns_seen(
    camera: Camera, pitch_deg: FloatArray, row_pitch_deg: FloatArray, yaws_deg: FloatArray, columns: int
) -> FloatArray:
    w, h = camera.half_width, camera.half_height
    nodes, weights = _quadrature(columns)
    across = nodes * w
    lows = np.full((*yaws_deg.shape, columns), -h)
    highs = np.full((*yaws_deg.shape, columns), h)
    border = np.empty_like(lows)
    ahead, right, down = _axes(pitch_deg, row_pitch_deg, yaws_deg)
    for plane in (h * ahead + down, h * ahead - down, w * ahead + right, w * ahead - right):
        # constant + slope·z ≥ 0 in the column: a border below where the slope is positive, and else above
        slope = np.where(np.abs(plane[..., 2]) > _PARALLEL, plane[..., 2], _PARALLEL)
        inclined, constant = plane[..., 1] / -slope, plane[..., 0] / -slope
        np.multiply(inclined[..., None], across, out=border)
        np.maximum(lows, border + np.where(slope > 0, constant, -np.inf)[..., None], out=lows)
        border += np.where(slope < 0, constant, np.inf)[..., None]
        np.minimum(highs, border, out=highs)
    seen = highs > lows
    lows, highs = np.where(seen, lows, h), np.where(seen, highs, h)
    if yaws_deg.shape[1] > 1:
        order = np.argsort(lows, axis=1)
        lows, highs = np.take_along_axis(lows, order, axis=1), np.take_along_axis(highs, order, axis=1)
    reached = np.full(lows[:, 0].shape, -h)
    length = np.zeros_like(reached)
    for j in range(lows.shape[1]):
        length += np.maximum(highs[:, j] - np.maximum(lows[:, j], reached), 0.0)
        reached = np.maximum(reached, highs[:, j])
    return np.asarray(length @ weights * w / camera.image_area)


@lru_cache(maxsize=8)
def _quadrature(columns: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(columns)
    return nodes, weights


def _seen(camera: Camera, pitch_deg: FloatArray, row_pitch_deg: FloatArray, yaws_deg: FloatArray) -> FloatArray:
    """Areas (k,) in the image plane that the union of a row sees."""
    w, h = camera.half_width, camera.half_height
    ahead, right, down = _axes(pitch_deg, row_pitch_deg, yaws_deg)
    near = h * ahead + np.where(row_pitch_deg < pitch_deg, 1.0, -1.0)[:, None, None] * down
    other = np.stack([near, w * ahead + right, w * ahead - right], axis=2)
    other /= np.maximum(np.hypot(other[..., 1], other[..., 2]), _PARALLEL)[..., None]
    own = np.array([[h, 0.0, 1.0], [h, 0.0, -1.0], [w, 1.0, 0.0], [w, -1.0, 0.0]])
    k, m = yaws_deg.shape
    alone = np.concatenate([other, np.broadcast_to(own, (k, m, 4, 3))], axis=2)
    seen = np.nansum(_area(alone), axis=1)
    if m > 1:
        # the right edge of the left image, the left edge of the right image, and both near edges
        both = [other[:, :-1, ::2], other[:, 1:, :2], np.broadcast_to(own, (k, m - 1, 4, 3))]
        seen = seen - np.nansum(_area(np.concatenate(both, axis=2)), axis=1)
    return np.asarray(seen)


def _area(planes: FloatArray) -> FloatArray:
    """Areas (...) of intersections of half-planes (..., l, 3), c + a·y + b·z ≥ 0 with a² + b² = 1; NaN for NaN."""
    c, a, b = planes[..., 0], planes[..., 1], planes[..., 2]
    # points of line i: -c·(a, b) + t·(-b, a); half-plane j contains those with start + t·slope ≥ 0
    slope = b[..., None, :] * a[..., :, None]
    slope -= np.swapaxes(slope, -1, -2)
    start = a[..., None, :] * a[..., :, None]
    start += b[..., None, :] * b[..., :, None]
    start *= -c[..., :, None]
    start += c[..., None, :]
    slope[np.abs(slope) < _PARALLEL] = _PARALLEL / 10
    with np.errstate(invalid="ignore"):
        crossing = np.divide(start, slope, out=start)
    np.negative(crossing, out=crossing)
    upper = np.where(slope < 0, crossing, np.inf).min(axis=-1)
    lower = np.where(slope > 0, crossing, -np.inf)
    # a line is parallel to itself and on its own border: it must not be cut by its own half-plane
    diagonal = np.arange(planes.shape[-2])
    lower[..., diagonal, diagonal] = -np.inf
    length = np.maximum(upper - lower.max(axis=-1), 0.0)
    return np.asarray((c * length).sum(axis=-1) / 2)


def _axes(
    pitch_deg: FloatArray, row_pitch_deg: FloatArray, yaws_deg: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The other images' x, y, z coordinates as linear forms of this image's, each (k, m, 3)."""
    p, q, y = np.radians(pitch_deg)[:, None], np.radians(row_pitch_deg)[:, None], np.radians(yaws_deg)
    cp, sp, cq, sq, cy, sy = np.cos(p), np.sin(p), np.cos(q), np.sin(q), np.cos(y), np.sin(y)
    ahead = np.stack([cq * cy * cp + sq * sp, cq * sy, cq * cy * sp - sq * cp], axis=-1)
    right = np.stack([-sy * cp, cy, -sy * sp], axis=-1)
    down = np.stack([sq * cy * cp - cq * sp, sq * sy, sq * cy * sp + cq * cp], axis=-1)
    return ahead, right, down


def neighbour_overlap(
    camera: Camera, pitch_deg: FloatArray, spacing_deg: FloatArray, tolerance: Tolerance
) -> FloatArray:
    """Overlap of two images of one pitch, the minimum over all errors in the tolerance; exact for a tolerance of 0.

    Args:
        camera: the camera.
        pitch_deg: (k,).
        spacing_deg: (k,) yaw difference.
        tolerance: largest errors of both images.

    Returns:
        (k,).
    """
    here, there = rotation(0.0, pitch_deg), rotation(spacing_deg, pitch_deg)
    if tolerance.is_zero:
        return pairwise_overlap(camera, here, there)
    k = len(pitch_deg)
    corners = ErrorCorners.of(camera, np.concatenate([here, there]), tolerance)
    index: NDArray[np.intp] = np.arange(k)
    one_way = worst_pair_overlaps(corners, index, index + k)
    other_way = worst_pair_overlaps(corners, index + k, index)
    return np.minimum(one_way, other_way)
