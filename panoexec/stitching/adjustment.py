"""Aligns the images: attitudes (and the lens) from control points, starting from the measured attitudes.

A least-squares bundle adjustment of all images. Each attitude is corrected by a small rotation vector in the camera's
frame, which has no singularity at the nadir (Hugin's yaw, pitch and roll have). The measured attitude of each image is
a prior: an image without control points keeps its measured attitude, and the panorama stays level and oriented. Control
points are weighted robustly (Cauchy), with a scale that decreases from a hundredth of a radian to pixels during
convergence.

The lens is the focal length and Hugin's radial term b: r_stored = r · (b · r² + 1 - b), r in units of half the shorter
side. Both have priors too (the camera profile, no distortion).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray

IntArray = NDArray[np.intp]

_FINAL_SCALE_PX: Final = 2.0
_MAX_ROUNDS: Final = 40
_CONVERGED_RAD: Final = 1e-8
_FOCAL_SIGMA: Final = 0.02
"""Relative standard deviation of a nominal focal length."""
_DISTORTION_SIGMA: Final = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class Points:
    """Control points.

    Attributes:
        images: (m, 2) image numbers.
        pixels: (m, 4) x, y in the first image and in the second, 0 at the first pixel's centre.
    """

    images: IntArray
    pixels: FloatArray

    def __len__(self) -> int:
        return len(self.images)

    def only(self, keep: NDArray[np.bool_] | IntArray) -> Points:
        """The points selected by a mask or by numbers."""
        return Points(images=self.images[keep], pixels=self.pixels[keep])


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """A rectilinear lens with one radial term, and the stored images' size."""

    width_px: int
    height_px: int
    focal_length_px: float
    distortion: float = 0.0

    def rays(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Unit vectors (..., 3), camera frame, of stored pixels."""
        dx, dy = x + 0.5 - self.width_px / 2, y + 0.5 - self.height_px / 2
        unit = min(self.width_px, self.height_px) / 2
        stored = np.hypot(dx, dy) / unit
        ideal = stored.copy()
        # Newton's method; three rounds are exact to 1e-9 for |b| < 0.1
        for _ in range(4 if self.distortion else 0):
            b = self.distortion
            ideal -= (ideal * (b * ideal**2 + 1 - b) - stored) / (3 * b * ideal**2 + 1 - b)
        factor = np.where(stored > 0, ideal / np.where(stored > 0, stored, 1.0), 1.0)
        rays = np.stack([np.full(dx.shape, self.focal_length_px), dx * factor, dy * factor], axis=-1)
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))

    def changed(self, log_focal: float, distortion: float) -> Lens:
        """The lens with its focal length scaled by exp(log_focal) and distortion added."""
        return Lens(
            width_px=self.width_px,
            height_px=self.height_px,
            focal_length_px=self.focal_length_px * float(np.exp(log_focal)),
            distortion=self.distortion + distortion,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Standard deviations of the measured attitudes, degrees."""

    tilt_deg: float = 0.3
    """About any horizontal axis (pitch and roll)."""
    yaw_deg: float = 1.0
    """About the vertical."""

    def information(self, rotations: FloatArray) -> FloatArray:
        """Inverse covariances (n, 3, 3) of the rotation vectors, in each camera's frame, radians^-2."""
        down = rotations[:, 2, :]
        outer = down[:, :, None] * down[:, None, :]
        tilt, yaw = np.radians(self.tilt_deg) ** -2, np.radians(self.yaw_deg) ** -2
        return np.asarray(tilt * (np.eye(3) - outer) + yaw * outer)


@dataclass(frozen=True, slots=True, kw_only=True)
class Adjustment:
    """The aligned images.

    Attributes:
        rotations: camera-to-world (n, 3, 3).
        lens: as adjusted.
        residual_px: of each given point, pixels of the stored images at their centre.
        kept: mask of the points that were used in the end.
    """

    rotations: FloatArray
    lens: Lens
    residual_px: FloatArray
    kept: NDArray[np.bool_]

    @property
    def rms_px(self) -> float:
        """Root mean square residual of the points kept; NaN without points."""
        kept = self.residual_px[self.kept]
        return float(np.sqrt(np.mean(kept**2))) if len(kept) else float("nan")


def separation_deg(points: Points, rotations: FloatArray, lens: Lens) -> FloatArray:
    """Angle between the two directions of each point (m,), degrees."""
    first, second = _directions(points, rotations, lens)
    chord = np.linalg.norm(first - second, axis=-1)
    return np.asarray(np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1))))


def adjust(
    points: Points, rotations: FloatArray, lens: Lens, *, prior: Prior | None = None, refine_lens: bool = True
) -> Adjustment:
    """Align images.

    Args:
        points: control points, possibly with outliers.
        rotations: measured camera-to-world rotations (n, 3, 3).
        lens: the nominal lens.
        prior: standard deviations of the measured attitudes.
        refine_lens: whether focal length and distortion may change.
    """
    information = (prior or Prior()).information(rotations)
    kept = np.ones(len(points), dtype=bool)
    current = _State(rotations, lens)
    for _ in range(2):
        current = _settle(_Problem(points.only(kept), rotations, information, lens, refine_lens), current)
        residual = np.radians(separation_deg(points, current.rotations, current.lens)) * current.lens.focal_length_px
        inside = residual[kept]
        # three pixels, the usual default of stitchers, unless the residuals are larger throughout
        spread = 4 * 1.4826 * float(np.median(inside)) if len(inside) else 0.0
        kept = residual <= max(3.0, min(spread, 12.0))
    return Adjustment(rotations=current.rotations, lens=current.lens, residual_px=residual, kept=kept)


@dataclass(frozen=True, slots=True)
class _State:
    rotations: FloatArray
    lens: Lens


@dataclass(frozen=True, slots=True)
class _Problem:
    """The input: points, measured attitudes with their information, the nominal lens and whether it is refined."""

    points: Points
    measured: FloatArray
    information: FloatArray
    nominal: Lens
    refine_lens: bool


def _settle(problem: _Problem, start: _State) -> _State:
    """Gauss-Newton iterations with a decreasing robust scale until convergence."""
    state = start
    scale = max(_FINAL_SCALE_PX, 0.01 * problem.nominal.focal_length_px)
    for _ in range(_MAX_ROUNDS):
        step = _step(problem, state, scale)
        turns = step[:-2].reshape(-1, 3)
        state = _State(state.rotations @ _rotation_of_vector(turns), state.lens.changed(step[-2], step[-1]))
        if scale == _FINAL_SCALE_PX and np.abs(step).max() < _CONVERGED_RAD:
            break
        scale = max(_FINAL_SCALE_PX, scale / 2)
    return state


def _step(problem: _Problem, state: _State, scale: float) -> FloatArray:
    """Solve the normal equations once.

    Returns:
        (3 n + 2,): rotation vectors in the cameras' frames, change of log focal length, change of distortion.
    """
    points, measured, nominal = problem.points, problem.measured, problem.nominal
    n = len(measured)
    blocks = np.zeros((n, n, 3, 3))
    side = np.zeros((n, 3))
    border = np.zeros((n, 3, 2))
    corner, corner_side = np.zeros((2, 2)), np.zeros(2)
    # the prior: the current attitude relative to the measured one
    away = _vector_of_rotation(np.swapaxes(measured, -1, -2) @ state.rotations)
    blocks[np.arange(n), np.arange(n)] += problem.information
    side -= np.einsum("nij,nj->ni", problem.information, away)
    if len(points):
        error, by_first, by_second, by_lens = _derivatives(points, state)
        weight = 1 / (1 + np.sum(error**2, axis=-1) / scale**2)
        first, second = points.images[:, 0], points.images[:, 1]
        for a, ja in ((first, by_first), (second, by_second)):
            weighted = ja * weight[:, None, None]
            np.add.at(side, a, -np.einsum("mki,mk->mi", weighted, error))
            np.add.at(border, a, np.einsum("mki,mkl->mil", weighted, by_lens))
            for b, jb in ((first, by_first), (second, by_second)):
                np.add.at(blocks, (a, b), np.einsum("mki,mkj->mij", weighted, jb))
        corner += np.einsum("m,mki,mkj->ij", weight, by_lens, by_lens)
        corner_side -= np.einsum("m,mki,mk->i", weight, by_lens, error)
    lens_information = np.array([_FOCAL_SIGMA**-2, _DISTORTION_SIGMA**-2])
    moved = np.array([np.log(state.lens.focal_length_px / nominal.focal_length_px), state.lens.distortion])
    corner += np.diag(lens_information)
    corner_side -= lens_information * moved
    matrix = np.zeros((3 * n + 2, 3 * n + 2))
    matrix[:-2, :-2] = blocks.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)
    matrix[-2:, -2:] = corner
    if problem.refine_lens:
        matrix[:-2, -2:] = border.reshape(3 * n, 2)
        matrix[-2:, :-2] = matrix[:-2, -2:].T
    else:
        corner_side[:] = 0.0
    return np.asarray(np.linalg.solve(matrix, np.concatenate([side.ravel(), corner_side])))


def _derivatives(points: Points, state: _State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Errors (m, 3), pixels; their derivatives by both images' rotation vectors (m, 3, 3) and by the lens (m, 3, 2)."""
    rotations, lens = state.rotations, state.lens
    focal = lens.focal_length_px
    turned = [rotations[points.images[:, k]] for k in (0, 1)]

    def rays(of: Lens) -> list[FloatArray]:
        return [of.rays(points.pixels[:, 2 * k], points.pixels[:, 2 * k + 1]) for k in (0, 1)]

    def difference(pair: Sequence[FloatArray]) -> FloatArray:
        return focal * np.asarray(
            np.einsum("mij,mj->mi", turned[0], pair[0]) - np.einsum("mij,mj->mi", turned[1], pair[1])
        )

    base = rays(lens)
    error = difference(base)
    # d(R exp(w) x)/dw = -R [x]x
    by_first, by_second = (
        sign * focal * (r @ _cross_matrix(x)) for sign, r, x in zip((-1, 1), turned, base, strict=True)
    )
    tiny = 1e-6
    by_lens = np.stack(
        [
            (difference(rays(lens.changed(tiny, 0))) - difference(rays(lens.changed(-tiny, 0)))) / (2 * tiny),
            (difference(rays(lens.changed(0, tiny))) - difference(rays(lens.changed(0, -tiny)))) / (2 * tiny),
        ],
        axis=-1,
    )
    return error, by_first, by_second, by_lens


def _directions(points: Points, rotations: FloatArray, lens: Lens) -> tuple[FloatArray, FloatArray]:
    first, second = (
        np.asarray(
            np.einsum(
                "mij,mj->mi",
                rotations[points.images[:, k]],
                lens.rays(points.pixels[:, 2 * k], points.pixels[:, 2 * k + 1]),
            )
        )
        for k in (0, 1)
    )
    return first, second


def _cross_matrix(v: FloatArray) -> FloatArray:
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def _rotation_of_vector(v: FloatArray) -> FloatArray:
    """Rodrigues' formula for rotation vectors (n, 3), radians."""
    angle = np.linalg.norm(v, axis=-1)[:, None, None]
    k = _cross_matrix(v)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1.0, np.sin(safe) / safe)
    cosine = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + sine * k + cosine * (k @ k))


def _vector_of_rotation(m: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3) of rotations by less than half a turn."""
    twice = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=-1)
    sine = np.linalg.norm(twice, axis=-1) / 2
    angle = np.arctan2(sine, (np.trace(m, axis1=1, axis2=2) - 1) / 2)
    factor = np.where(sine > 1e-9, angle / np.maximum(2 * sine, 1e-300), 0.5)
    return np.asarray(twice * factor[:, None])


def spread_points(points: Points, most: int = 16) -> Points:
    """At most `most` points of each pair of images, spread as far as they go (farthest-point sampling)."""
    keep: list[int] = []
    for numbers in _by_pair(points).values():
        if len(numbers) <= most:
            keep.extend(numbers.tolist())
            continue
        places = points.pixels[numbers, :2]
        # the first is the farthest from the centre; each next one is the farthest from all chosen ones
        distance = np.full(len(numbers), np.inf)
        chosen = int(np.argmax(np.linalg.norm(places - places.mean(axis=0), axis=1)))
        for _ in range(most):
            keep.append(int(numbers[chosen]))
            distance = np.minimum(distance, np.linalg.norm(places - places[chosen], axis=1))
            chosen = int(np.argmax(distance))
    return points.only(np.array(sorted(keep), dtype=np.intp))


def tied_group(points: Points, count: int, least: int = 3) -> frozenset[int]:
    """The largest group of images connected by pairs with at least `least` points; empty without any pair.

    Args:
        points: accepted control points.
        count: number of images.
        least: points that a pair needs to count as tied.
    """
    group = list(range(count))

    def root(k: int) -> int:
        while group[k] != k:
            group[k] = group[group[k]]
            k = group[k]
        return k

    for (a, b), numbers in _by_pair(points).items():
        if len(numbers) >= least:
            group[root(a)] = root(b)
    members: dict[int, list[int]] = {}
    for k in range(count):
        members.setdefault(root(k), []).append(k)
    largest = max(members.values(), key=len, default=[])
    return frozenset(largest) if len(largest) > 1 else frozenset()


def _by_pair(points: Points) -> dict[tuple[int, int], IntArray]:
    pairs = np.sort(points.images, axis=1)
    out: dict[tuple[int, int], list[int]] = {}
    for number, (a, b) in enumerate(pairs.tolist()):
        out.setdefault((a, b), []).append(number)
    return {pair: np.array(numbers, dtype=np.intp) for pair, numbers in out.items()}
