"""Displacements that no rotation explains: the camera was elsewhere, and near ground moved before the distance.

A ray of unit depth that points g downwards meets flat ground at the distance h / g. A camera that is t heights away
sees the same ground along the ray less g · t: the displacement by t is g times that of the ray shifted by t, and
nothing above the horizon. Rotation and t together are six unknowns, linear in pixels for small ones; a consensus over
triples of corners finds them, with priors that keep what few corners leave open near zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.pictures.rotations import displacement_matrix

_TURN_PRIOR_RAD: Final = np.radians(1.0)
_SHIFT_PRIOR: Final = 0.05
"""Standard deviation of t before anything is known: 1.5 m at 30 m height."""
_SEEDS: Final = 16
"""The first displacements, of which all triples are tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundFit:
    """A rotation and a displacement of the camera that most displacements agree with.

    Attributes:
        turn: (3,) rotation vector, camera frame of the first photo, radians.
        shift: (3,) where the second camera is, from the first, heights, camera frame of the first photo.
        inliers: (k,) mask.
        rms_px: of the inliers' residuals.
        sigma_deg: standard deviation of the turn about its worst axis.
        information: (3, 3) inverse covariance of the shift.
    """

    turn: FloatArray
    shift: FloatArray
    inliers: NDArray[np.bool_]
    rms_px: float
    sigma_deg: float
    information: FloatArray

    def sigmas(self, shift: FloatArray) -> float:
        """Size of a shift, of which this is the last correction, in its standard deviations."""
        return float(np.sqrt(shift @ self.information @ shift))


def downward(places: FloatArray, focal_px: float, rotation: FloatArray) -> FloatArray:
    """How far down rays (k,) of unit depth point, 0 at and above the horizon.

    Args:
        places: (k, 2) x, y relative to the principal point, pixels.
        focal_px: focal length.
        rotation: (3, 3) camera to world.
    """
    down = rotation[2, 0] + places @ rotation[2, 1:] / focal_px
    return np.asarray(np.maximum(down, 0.0))


def ground_matrix(places: FloatArray, focal_px: float, rotation: FloatArray) -> FloatArray:
    """Derivatives (k, 2, 6) of pixel positions by a rotation of the scene and by a shift of the camera.

    Args:
        places: (k, 2) x, y relative to the principal point, pixels.
        focal_px: focal length.
        rotation: (3, 3) camera to world.
    """
    x, y = places[:, 0] / focal_px, places[:, 1] / focal_px
    one, zero = np.ones_like(x), np.zeros_like(x)
    shifted = np.stack([np.stack([x, -one, zero], axis=-1), np.stack([y, zero, -one], axis=-1)], axis=-2)
    scale = focal_px * downward(places, focal_px, rotation)
    return np.concatenate([displacement_matrix(places, focal_px), scale[:, None, None] * shifted], axis=2)


def ground_consensus(matrix: FloatArray, moved: FloatArray, *, tolerance_px: float) -> GroundFit | None:
    """The rotation and shift with the most displacements within a tolerance; None without six displacements.

    Args:
        matrix: (k, 2, 6) of `ground_matrix`, the most certain displacements first.
        moved: (k, 2) displacements, pixels.
        tolerance_px: largest residual of an inlier.
    """
    if len(moved) < 6:
        return None
    prior = np.diag(np.array([_TURN_PRIOR_RAD] * 3 + [_SHIFT_PRIOR] * 3) ** -2.0)
    normal = np.einsum("kij,kil->kjl", matrix, matrix)
    side = np.einsum("kij,ki->kj", matrix, moved)
    seeds = _triples(min(len(moved), _SEEDS))
    weak = prior * tolerance_px**2 * 0.1
    found = np.linalg.solve(normal[seeds].sum(axis=1) + weak, side[seeds].sum(axis=1)[..., None])[..., 0]
    residual = np.einsum("kij,nj->nki", matrix, found) - moved
    near = np.einsum("nki,nki->nk", residual, residual) <= tolerance_px**2
    inliers = near[int(np.argmax(near.sum(axis=1)))]
    for _ in range(5):
        if inliers.sum() < 6:
            return None
        best = np.linalg.solve(normal[inliers].sum(axis=0) + weak, side[inliers].sum(axis=0))
        left = matrix @ best - moved
        again = np.einsum("ki,ki->k", left, left) <= tolerance_px**2
        if (again == inliers).all():
            break
        inliers = again
    if inliers.sum() < 6:
        return None
    errors = (matrix @ best - moved)[inliers]
    rms = float(np.sqrt(np.mean(errors**2) * 2))
    covariance = np.linalg.inv(normal[inliers].sum(axis=0) / max(rms, 0.3) ** 2 + prior)
    sigma = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3]).max())))
    return GroundFit(
        turn=best[:3],
        shift=best[3:],
        inliers=inliers,
        rms_px=rms,
        sigma_deg=sigma,
        information=np.linalg.inv(covariance[3:, 3:]),
    )


@lru_cache(maxsize=16)
def _triples(count: int) -> NDArray[np.intp]:
    return np.array(list(combinations(range(count), 3)), dtype=np.intp)
