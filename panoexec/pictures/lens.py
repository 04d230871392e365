"""The lens from the ties of a mission: focal length and radial distortion, by an adjustment of all photos together.

Unknown are a rotation of each photo, the gimbal's constant errors of pitch and roll, the focal length, k1 and k2 of
Brown and Conrady, in coordinates of the ideal image at unit distance: r_d = r · (1 + k1 r² + k2 r⁴), and the principal
point, which one row of photos hardly tells from a constant error. A ring of photos
closes at 360°, and the measured attitudes say how far apart rows are: both give the focal length a scale. Residuals are
weighted robustly (Cauchy).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from panoexec.angles import FloatArray
from panoexec.pictures.matching import Tie
from panoexec.pictures.rotations import rotation_of_vector

LEAST_POINTS: Final = 200
"""Fewer matched points tell nothing about a lens."""
_POINTS_A_TIE: Final = 24
_ROUNDS: Final = 8
_SCALE_PX: Final = 1.0
_TILT_DEG: Final = 0.08
_YAW_DEG: Final = 0.8
_BIAS_DEG: Final = 0.5
_FOCAL_SIGMA: Final = 0.03
_RADIAL_SIGMA: Final = (0.1, 0.1)
_CENTRE_SIGMA: Final = (0.02, 0.02)
_UNKNOWNS: Final = 5
"""Of the lens."""
_FLOOR_PX: Final = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class LensFit:
    """The lens as the ties see it.

    Attributes:
        focal_ratio: true focal length over the stated one.
        k1, k2: radial distortion.
        centre: principal point, from the middle of the photo to the right and down, in true focal lengths.
        focal_sigma, k1_sigma, k2_sigma, centre_sigma: their standard deviations.
        points: how many matched points it rests on.
        rms_px: their residual, pixels at the scale of the examination.
    """

    focal_ratio: float
    k1: float
    k2: float
    centre: tuple[float, float]
    focal_sigma: float
    k1_sigma: float
    k2_sigma: float
    centre_sigma: tuple[float, float]
    points: int
    rms_px: float


@dataclass(slots=True)
class _State:
    rotations: FloatArray
    bias: FloatArray
    lens: FloatArray
    """log of the focal ratio, k1, k2, principal point right and down."""


def fit_lens(
    ties: Mapping[tuple[int, int], Tie], rotations: Mapping[int, FloatArray], *, focal_px: float, centre: FloatArray
) -> LensFit | None:
    """Estimate the lens; None with fewer than `LEAST_POINTS` points. Ties with parallax do not count.

    Args:
        ties: that agree with each other, by shots.
        rotations: measured attitudes (3, 3), camera to world.
        focal_px: stated focal length at the scale of the examination.
        centre: (2,) principal point there.
    """
    used = {pair: tie for pair, tie in ties.items() if tie.tied and tie.parallax_deg == 0}
    shots = sorted({shot for pair in used for shot in pair})
    place = {shot: number for number, shot in enumerate(shots)}
    images, pixels = [], []
    for pair, tie in sorted(used.items()):
        chosen = tie.pixels[np.linspace(0, len(tie.pixels) - 1, min(_POINTS_A_TIE, len(tie.pixels))).astype(int)]
        images += [[place[shot] for shot in pair]] * len(chosen)
        pixels.append(chosen)
    if sum(map(len, pixels)) < LEAST_POINTS:
        return None
    measured = np.array([rotations[shot] for shot in shots])
    problem = _Problem(
        np.array(images), (np.concatenate(pixels).reshape(-1, 2, 2) - centre) / focal_px, measured, focal_px
    )
    return problem.solve()


class _Problem:
    def __init__(self, images: FloatArray, points: FloatArray, measured: FloatArray, focal_px: float) -> None:
        self._images, self._points, self._measured, self._focal_px = images.astype(np.intp), points, measured, focal_px
        right = measured[:, :, 1]
        level = np.stack([right[:, 1], -right[:, 0], np.zeros(len(right))], axis=1)
        level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-9)
        self._axes = np.stack([right, level], axis=1)

    def solve(self) -> LensFit:
        count = len(self._measured)
        state = _State(self._measured.copy(), np.zeros(2), np.zeros(_UNKNOWNS))
        for _ in range(_ROUNDS):
            normal, side, _ = self._equations(state)
            step = np.linalg.solve(normal, side)
            turns = step[: 3 * count].reshape(-1, 3)
            state.rotations = np.array(
                [rotation_of_vector(np.asarray(turn)) @ own for turn, own in zip(turns, state.rotations, strict=True)]
            )
            state.bias = state.bias + step[3 * count : 3 * count + 2]
            state.lens = state.lens + step[3 * count + 2 :]
        normal, _, residual = self._equations(state)
        size = np.linalg.norm(residual, axis=1)
        rms = float(np.sqrt(np.mean(size[size < 3 * _SCALE_PX] ** 2)))
        covariance = np.linalg.inv(normal)
        sigma = np.sqrt(np.diag(covariance)[-_UNKNOWNS:])
        focal, k1, k2, right, down = (float(value) for value in state.lens)
        return LensFit(
            focal_ratio=float(np.exp(focal)),
            k1=k1,
            k2=k2,
            centre=(right, down),
            focal_sigma=float(sigma[0]),
            k1_sigma=float(sigma[1]),
            k2_sigma=float(sigma[2]),
            centre_sigma=(float(sigma[3]), float(sigma[4])),
            points=len(self._points),
            rms_px=rms,
        )

    def _equations(self, state: _State) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Normal matrix and right side of the next step, and the residuals (m, 3), pixels."""
        count, size = len(self._measured), 3 * len(self._measured) + 2 + _UNKNOWNS
        first, second = self._images.T
        a, b = self._rays(state, 0), self._rays(state, 1)
        residual = (a - b) * self._focal_px
        # of a small rotation w of a photo: w x ray
        by_lens = [
            (self._rays(_shifted(state, k), 0) - self._rays(_shifted(state, k), 1) - (a - b)) / _STEP
            for k in range(_UNKNOWNS)
        ]
        sigma_px = max(_FLOOR_PX, float(np.median(np.linalg.norm(residual, axis=1))))
        scale = max(_SCALE_PX, 2 * sigma_px)
        weight = 1 / (1 + (residual**2).sum(axis=1) / scale**2) / sigma_px**2
        jacobian = np.zeros((len(residual), 3, 6 + _UNKNOWNS))
        jacobian[:, :, 0:3] = -_cross(a) * self._focal_px
        jacobian[:, :, 3:6] = _cross(b) * self._focal_px
        jacobian[:, :, 6:] = np.stack(by_lens, axis=2) * self._focal_px
        columns = np.concatenate(
            [
                3 * first[:, None] + np.arange(3),
                3 * second[:, None] + np.arange(3),
                np.broadcast_to(3 * count + 2 + np.arange(_UNKNOWNS), (len(first), _UNKNOWNS)),
            ],
            axis=1,
        )
        normal, side = np.zeros((size, size)), np.zeros(size)
        blocks = np.einsum("m,mki,mkj->mij", weight, jacobian, jacobian)
        np.add.at(normal, (columns[:, :, None], columns[:, None, :]), blocks)
        np.add.at(side, columns, -np.einsum("m,mki,mk->mi", weight, jacobian, residual))
        self._add_priors(normal, side, state)
        return normal, side, residual

    def _add_priors(self, normal: FloatArray, side: FloatArray, state: _State) -> None:
        count = len(self._measured)
        bias_at = 3 * count
        # how far each photo is from where it was measured: less the bias, small
        off = state.rotations @ np.swapaxes(self._measured, 1, 2)
        turn = (
            np.stack([off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]], axis=1)
            / 2
        )
        turn = turn + np.einsum("kaj,a->kj", self._axes, state.bias)
        information = np.radians([_TILT_DEG, _TILT_DEG, _YAW_DEG]) ** -2.0
        for k in range(count):
            rows = np.zeros((3, 5))
            rows[:, :3], rows[:, 3:] = np.eye(3), self._axes[k].T
            places = np.concatenate([3 * k + np.arange(3), bias_at + np.arange(2)])
            normal[np.ix_(places, places)] += rows.T @ (information[:, None] * rows)
            side[places] -= rows.T @ (information * turn[k])
        own = np.array([*[np.radians(_BIAS_DEG)] * 2, _FOCAL_SIGMA, *_RADIAL_SIGMA, *_CENTRE_SIGMA]) ** -2.0
        places = bias_at + np.arange(2 + _UNKNOWNS)
        normal[places, places] += own
        side[places] -= own * np.concatenate([state.bias, state.lens])

    def _rays(self, state: _State, which: int) -> FloatArray:
        """World directions (m, 3) of the points in the first or second photo."""
        focal, k1, k2 = state.lens[:3]
        stored = self._points[:, which] / np.exp(focal) - state.lens[3:]
        ideal = stored
        for _ in range(6):
            r2 = (ideal**2).sum(axis=1, keepdims=True)
            ideal = stored / (1 + k1 * r2 + k2 * r2**2)
        rays = np.concatenate([np.ones((len(ideal), 1)), ideal], axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return np.asarray(np.einsum("mij,mj->mi", state.rotations[self._images[:, which]], rays))


_STEP: Final = 1e-5


def _shifted(state: _State, number: int) -> _State:
    lens = state.lens.copy()
    lens[number] += _STEP
    return _State(state.rotations, state.bias, lens)


def _cross(rays: FloatArray) -> FloatArray:
    """Matrices (m, 3, 3) of the cross product with rays from the left."""
    x, y, z = rays.T
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], axis=1)
