"""Lower bounds of overlaps over all pointing errors: of pairs, and of an image with the union of others.

Setting: in the image plane of A (directions d = (1, y, z), |d| ≤ L on the image) B's edge k is the half-plane
mₖ(e)·d ≥ 0, mₖ(e) = R_A(e_A)ᵀ R_B(e_B) nₖ, where the errors e of both are in the box of the tolerance (six axes).

**Corners.** Let m̃ₖ be the multilinear interpolation of mₖ between the corners of the box. About one axis mₖ moves on a
circle of radius ≤ 1, so |mₖ - m̃ₖ| ≤ r with r the sum over the six axes of τ²/2. Hence a point with m̃ₖ(e)·d ≥ r·L is
certainly seen; let p̃ₖ be m̃ₖ with r·L subtracted from its first component.

**Losses.** Let M be any part of A. B sees of it at least area(M) - Σₖ cutₖ(e), cutₖ = area of M where p̃ₖ(e)·d < 0.
Take coordinates u along B's edge k, v across it, v ≥ 0 on M. There p̃ₖ·d = α + β·u + γ·v, with α, β, γ interpolated
between the values at the corners as well. If all corners have γ ≥ g > 0 then cutₖ ≤ ∫ max(0, -(α + β·u)/g - M's lower
border at u) du. This bound is convex in (α, β), so its sum over k is largest at a corner of the box, and area(M) minus
the largest sum over the 64 corners is a lower bound of the overlap. With M = the part that B sees without error, the
bound differs from the true minimum only in second order of the tolerances (r, and where two cuts meet) and by the area
that B gains elsewhere.

**Unions.** For several B with independent errors take for each B a part M_B of what it sees of A: the directions that
are nearer to its boresight than to the others', so that the parts are disjoint. Their areas add up; for each corner of
A's error box the worst errors of each B are chosen, and then the worst corner of A.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray, rotation, yaw_pitch_roll
from panoexec.optics import Camera
from panoexec.planning.geometry.footprint import edge_normals, rectangle
from panoexec.planning.geometry.overlap import clip, cropped, half_planes, polygon_area
from panoexec.planning.model import Tolerance

_NUMBERS_AT_A_TIME = 1 << 15
"""Pairs of images, times corners of their error boxes, processed at a time: limits the memory."""

_ROUGH_AT_A_TIME = 1 << 14
"""Pairs that are judged roughly at a time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorCorners:
    """Images at the corners of the error box of a tolerance.

    Attributes:
        camera: the camera.
        rotations: (n, 3, 3) camera-to-world rotations without error.
        extreme: (n, c, 3, 3) at the c corners of the error box; c = 2^k for k axes with a tolerance above 0.
        tolerance: half the size of the box.
        tops: (n,) where the images are cropped, see `panoexec.planning.certificate.texture`; None: nowhere. The line is
            fixed in each image, so it does not move with errors.
    """

    camera: Camera
    rotations: FloatArray
    extreme: FloatArray
    tolerance: Tolerance
    tops: FloatArray | None = None

    @staticmethod
    def of(camera: Camera, rotations: FloatArray, tolerance: Tolerance, tops: FloatArray | None = None) -> ErrorCorners:
        """The images at the corners of their error boxes."""
        yaw, pitch, roll = yaw_pitch_roll(rotations)
        taus = (tolerance.yaw_deg, tolerance.pitch_deg, tolerance.roll_deg)
        signs = np.array(list(itertools.product(*((-t, t) if t else (0.0,) for t in taus))))
        extreme = rotation(yaw[:, None] + signs[:, 0], pitch[:, None] + signs[:, 1], roll[:, None] + signs[:, 2])
        return ErrorCorners(camera=camera, rotations=rotations, extreme=extreme, tolerance=tolerance, tops=tops)

    def clipped(self, images: NDArray[np.intp], planes: FloatArray) -> FloatArray:
        """Images (p,), cropped, clipped to half-planes (p, k, 3)."""
        whole = np.broadcast_to(rectangle(self.camera), (len(planes), 4, 2))
        return clip(whole if self.tops is None else cropped(whole, self.tops[images]), planes)

    @property
    def pairs_at_a_time(self) -> int:
        """Pairs of images whose error boxes are combined at a time."""
        return max(1, _NUMBERS_AT_A_TIME // int(self.extreme.shape[1]) ** 2)

    @property
    def remainder(self) -> float:
        """The bound r·L of the module docstring."""
        reach = math.sqrt(1 + self.camera.half_width**2 + self.camera.half_height**2)
        t = self.tolerance
        return reach * sum(math.radians(a) ** 2 for a in (t.pitch_deg, t.roll_deg, t.yaw_deg))

    @property
    def first_order(self) -> float:
        """Upper bound of the displacement of an edge normal, as seen from the other image."""
        t = self.tolerance
        return 2 * math.radians(t.pitch_deg + t.roll_deg + t.yaw_deg)


def worst_pair_overlaps(corners: ErrorCorners, first: NDArray[np.intp], second: NDArray[np.intp]) -> FloatArray:
    """Lower bounds (p,), over all errors, of the fraction of each first image that the second one sees."""
    whole = corners.camera.image_area
    out = np.empty(len(first))
    for start in range(0, len(first), corners.pairs_at_a_time):
        some = slice(start, start + corners.pairs_at_a_time)
        a, b = first[some], second[some]
        planes = half_planes(corners.rotations[a], corners.rotations[b], corners.camera)
        seen = corners.clipped(a, planes)
        losses = _losses(corners, a, b, planes, seen)
        out[some] = (polygon_area(seen) - losses.max(axis=(1, 2), initial=0.0)) / whole
    return np.clip(out, 0.0, 1.0)


def overlaps_at_least(
    corners: ErrorCorners, first: NDArray[np.intp], second: NDArray[np.intp], least: ArrayLike
) -> NDArray[np.bool_]:
    """Whether each first image (p,) shares at least a fraction (p,) of an image with the second, by a rough bound.

    Each edge of B moves by at most `ErrorCorners.first_order`, so it removes from the part of A that B sees at most a
    strip of that width along the whole part.
    """
    least = np.broadcast_to(np.asarray(least, dtype=np.float64), len(first))
    parts = [_surely_share(corners, first[s], second[s], least[s]) for s in _slices(len(first), _ROUGH_AT_A_TIME)]
    return np.concatenate(parts) if parts else np.empty(0, dtype=bool)


def _surely_share(
    corners: ErrorCorners, first: NDArray[np.intp], second: NDArray[np.intp], least: FloatArray
) -> NDArray[np.bool_]:
    planes = half_planes(corners.rotations[first], corners.rotations[second], corners.camera)
    seen = corners.clipped(first, planes)
    length = np.maximum(np.hypot(planes[..., 1], planes[..., 2]), 1e-12)
    reach = math.sqrt(1 + corners.camera.half_width**2 + corners.camera.half_height**2)
    strip = corners.first_order * reach / length
    y, z = seen[:, None, :, 0], seen[:, None, :, 1]
    along = (planes[..., 2:] * y - planes[..., 1:2] * z) / length[..., None]
    inside = (planes[..., :1] + planes[..., 1:2] * y + planes[..., 2:] * z) / length[..., None]
    lost = np.where(inside.min(axis=2) < strip, strip * (along.max(axis=2) - along.min(axis=2)), 0.0).sum(axis=1)
    whole = corners.camera.image_area
    return np.asarray(polygon_area(seen) - lost >= least * whole)  # false for an empty part, where `lost` is NaN


def worst_union_overlaps(
    corners: ErrorCorners, images: NDArray[np.intp], partners: NDArray[np.intp], present: NDArray[np.bool_]
) -> FloatArray:
    """Lower bounds, over all errors, of the fraction of images that at least one of their partners sees.

    Args:
        corners: error corners of all images.
        images: (k,) indices.
        partners: (k, m) indices of the partners.
        present: (k, m), False where a partner is padding.

    Returns:
        (k,), in [0, 1].
    """
    # each pair of an image and a partner is compared with all partners
    step = max(1, _ROUGH_AT_A_TIME * 8 // max(partners.shape[1], 1) ** 2)
    parts = [_worst_unions(corners, images[s], partners[s], present[s]) for s in _slices(len(images), step)]
    return np.concatenate(parts) if parts else np.empty(0)


def _worst_unions(
    corners: ErrorCorners,
    images: NDArray[np.intp],
    partners: NDArray[np.intp],
    present: NDArray[np.bool_],
) -> FloatArray:
    row, column = np.nonzero(present)
    a, b = images[row], partners[row, column]
    own = half_planes(corners.rotations[a], corners.rotations[b], corners.camera)
    boresights = corners.rotations[:, :, 0]
    nearer = (boresights[b][:, None] - boresights[partners[row]]) @ corners.rotations[a]
    nearer = np.where(present[row][..., None], nearer, np.array([1.0, 0.0, 0.0]))
    parts = corners.clipped(a, np.concatenate([own, nearer], axis=1))
    # the entry of the image itself in `nearer` is a zero row: 0 ≥ 0 removes nothing
    losses = np.concatenate(
        [
            _losses(corners, a[s], b[s], own[s], parts[s]).max(axis=2, initial=0.0)
            for s in _slices(max(len(a), 1), corners.pairs_at_a_time)
        ]
    )
    area = np.bincount(row, polygon_area(parts), len(images))
    loss = np.zeros((len(images), losses.shape[1]))
    np.add.at(loss, row, losses)
    whole = corners.camera.image_area
    return np.asarray(np.clip((area - loss.max(axis=1, initial=0.0)) / whole, 0.0, 1.0))


def _slices(count: int, size: int) -> list[slice]:
    return [slice(start, start + size) for start in range(0, count, size)]


def _losses(
    corners: ErrorCorners, a: NDArray[np.intp], b: NDArray[np.intp], planes: FloatArray, parts: FloatArray
) -> FloatArray:
    """Bounds (p, c, c) of the area that errors at each corner of A's and of B's box cut from parts (p, v, 2) of A."""
    c = corners.extreme.shape[1]
    losses = np.zeros((len(a), c, c))
    if corners.tolerance.is_zero or not len(a):
        return losses
    # only edges that are nearer to some corner of M than their largest displacement can cut
    y, z = parts[..., 0], parts[..., 1]
    inside = planes[:, :, :1] + planes[:, :, 1:2] * y[:, None] + planes[:, :, 2:] * z[:, None]
    reach = corners.first_order * np.sqrt(1 + y * y + z * z)
    pair, edge = np.nonzero(np.any(inside < reach[:, None], axis=2))  # never true for an empty part, which is NaN
    normals = edge_normals(corners.camera)[edge]
    world = np.squeeze(corners.extreme[b[pair]] @ normals[:, None, :, None], axis=3)
    moved = world[:, None] @ corners.extreme[a[pair]]
    moved[..., 0] -= corners.remainder
    np.add.at(losses, pair, _cuts(parts[pair], planes[pair, edge], moved))
    return losses


def _cuts(parts: FloatArray, baselines: FloatArray, moved: FloatArray) -> FloatArray:
    """Upper bounds of the areas that half-planes cut from parts; see the module docstring.

    Args:
        parts: (q, v, 2), in the orientation of `footprint.rectangle`.
        baselines: (q, 3) the half-planes without error.
        moved: (q, c, c, 3) the half-planes at the corners of the error boxes.

    Returns:
        (q, c, c); infinite where an edge rotates too far for the bound to hold.
    """
    length = np.hypot(baselines[:, 1], baselines[:, 2])
    across = baselines[:, 1:] / np.maximum(length, 1e-300)[:, None]
    along = np.stack([across[:, 1], -across[:, 0]], axis=1)
    u = np.einsum("qvi,qi->qv", parts, along)
    v = np.einsum("qvi,qi->qv", parts, across)
    lowest = v.min(axis=1)
    gamma = np.einsum("qabi,qi->qab", moved[..., 1:], across)
    least = gamma.min(axis=(1, 2), initial=np.inf)
    usable = (least > 1e-6) & (length > 1e-6)
    scale = -1 / np.where(usable, least, 1.0)[:, None, None]
    alpha = (moved[..., 0] + lowest[:, None, None] * gamma) * scale
    beta = np.einsum("qabi,qi->qab", moved[..., 1:], along) * scale
    # u increases along the lower border of a part and decreases along the upper one
    following = np.arange(1 - parts.shape[1], 1)
    width = u[:, following] - u
    q, side = np.nonzero(width > 0)
    start, end = (
        alpha[q] + beta[q] * u[q, k][:, None, None] - (v[q, k] - lowest[q])[:, None, None]
        for k in (side, (side + 1) % parts.shape[1])
    )
    pieces = _positive_mean(start, end) * width[q, side][:, None, None]
    cut = np.zeros(gamma.shape)
    np.add.at(cut, q, pieces)
    return np.where(usable[:, None, None], cut, np.inf)


def _positive_mean(a: FloatArray, b: FloatArray) -> FloatArray:
    """The mean of max(0, f) for f linear from a to b."""
    high, low = np.maximum(np.maximum(a, b), 0.0), np.minimum(a, b)
    crossing = low < 0
    share = np.where(crossing, high / np.maximum(high - low, 1e-300), 1.0)
    return np.asarray(np.where(crossing, high * share, high + low) / 2)
