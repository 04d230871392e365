"""Small rotations that explain displacements: consensus by pairs, and a least-squares fit with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray

_PRIOR_RAD: Final = np.radians(3.0)
"""Standard deviation of a rotation before anything is known: keeps what points in a row leave open near 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A rotation that most displacements agree with.

    Attributes:
        turn: (3,) rotation vector, camera frame of the first photo, radians.
        inliers: (k,) mask.
        rms_px: of the inliers' residuals.
        sigma_deg: standard deviation of the turn about its worst axis, from residuals and geometry.
    """

    turn: FloatArray
    inliers: NDArray[np.bool_]
    rms_px: float
    sigma_deg: float


def displacement_matrix(places: FloatArray, focal_px: float) -> FloatArray:
    """Derivatives (k, 2, 3) of pixel positions by a rotation of the scene, in pixels per radian.

    Args:
        places: (k, 2) x, y relative to the principal point, pixels.
        focal_px: focal length.
    """
    x, y = places[:, 0] / focal_px, places[:, 1] / focal_px
    zero = np.zeros_like(x)
    # a ray (1, x, y) turned by w moves by w x ray; perspective division gives these rows (w about x, y, z)
    rows = np.stack([np.stack([-y, -x * y, 1 + x * x], axis=-1), np.stack([x, -1 - y * y, x * y], axis=-1)], axis=-2)
    return np.asarray(focal_px * (rows + zero[:, None, None]))


def consensus(
    matrix: FloatArray,
    moved: FloatArray,
    *,
    tolerance_px: float,
    seed_limit: int = 24,
    weights: FloatArray | None = None,
) -> Fit | None:
    """The rotation with the most displacements within a tolerance; None without three displacements.

    Args:
        matrix: (k, 2, 3) of `displacement_matrix`.
        moved: (k, 2) displacements, pixels.
        tolerance_px: largest residual of an inlier.
        seed_limit: the first displacements, of which all pairs are tried.
        weights: (k,) how much each displacement counts; None: equal.
    """
    count = len(moved)
    if count < 3:
        return None
    weight = np.ones(count) if weights is None else weights
    first, second = np.triu_indices(min(count, seed_limit), 1)
    normal = np.einsum("kij,kil->kjl", matrix, matrix)
    side = np.einsum("kij,ki->kj", matrix, moved)
    prior = np.eye(3) * (tolerance_px / _PRIOR_RAD) ** 2 * 0.1
    turns = np.linalg.solve(normal[first] + normal[second] + prior, (side[first] + side[second])[..., None])[..., 0]
    residual = np.einsum("kij,nj->nki", matrix, turns) - moved
    near = np.einsum("nki,nki->nk", residual, residual) <= tolerance_px**2
    best = int(np.argmax(near @ weight))
    inliers = near[best]
    turn = turns[best]
    for _ in range(4):
        if inliers.sum() < 3:
            return None
        turn = np.linalg.solve(normal[inliers].sum(axis=0) + prior, side[inliers].sum(axis=0))
        residual = matrix @ turn - moved
        again = np.einsum("ki,ki->k", residual, residual) <= tolerance_px**2
        if (again == inliers).all():
            break
        inliers = again
    if inliers.sum() < 3:
        return None
    errors = (matrix @ turn - moved)[inliers]
    rms = float(np.sqrt(np.mean(errors**2) * 2))
    information = normal[inliers].sum(axis=0) / max(rms, 0.3) ** 2 + np.eye(3) / _PRIOR_RAD**2
    sigma = float(np.degrees(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(information)).max())))
    return Fit(turn=turn, inliers=inliers, rms_px=rms, sigma_deg=sigma)


def rotation_of_vector(turn: FloatArray) -> FloatArray:
    """The rotation matrix (3, 3) of a rotation vector, radians (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        return np.asarray(np.eye(3) + cross)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross)
