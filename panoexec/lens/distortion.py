"""Lens distortion of Brown and Conrady, as OpenCV has it, in coordinates of the ideal image at unit distance.

A direction (1, y, z) of the camera frame (y right, z down) meets the ideal image plane at x = (y, z), r = |x|, and the
distorted one at

    D(x) = x · g(r²) + 2 (q·x) x + r² q,    g(s) = 1 + k1 s + k2 s² + k3 s³,    q = (p2, p1),

which is OpenCV's model (y: 2 p1 y z + p2 (r² + 2 y²), z: p1 (r² + 2 z²) + 2 p2 y z). The Jacobian is symmetric: the
radial part has the eigenvalues g and h = g + 2 s g', the tangential part 2 (x qᵀ + (q·x) I + q xᵀ) none beyond
6 |q| r. So on a disc where the least of g and h is above 6 |q| r, D is one to one: its Jacobian is positive definite on
a convex set.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

_SLACK = 1e-9
_ROUNDS = 60
_CONVERGED = 1e-12


@dataclass(frozen=True, slots=True)
class Distortion:
    """Coefficients: radial k1, k2, k3, tangential p1 (down), p2 (right); see the module docstring."""

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def is_none(self) -> bool:
        """Whether the lens does not distort."""
        return not any(astuple(self))

    @property
    def tangential(self) -> float:
        """The length of q."""
        return math.hypot(self.p1, self.p2)

    def rotated(self) -> Distortion:
        """Of the same lens in a camera turned by 90°: what was at the right of the image is at its bottom."""
        return Distortion(self.k1, self.k2, self.k3, p1=self.p2, p2=-self.p1)

    def apply(self, ideal: ArrayLike) -> FloatArray:
        """Distorted points (..., 2) of ideal ones (..., 2)."""
        x = np.asarray(ideal, dtype=np.float64)
        q = np.array([self.p2, self.p1])
        s = (x * x).sum(axis=-1, keepdims=True)
        g = 1 + s * (self.k1 + s * (self.k2 + s * self.k3))
        return np.asarray(x * (g + 2 * (x @ q)[..., None]) + s * q)

    def jacobian(self, ideal: ArrayLike) -> FloatArray:
        """Derivatives (..., 2, 2) of `apply`; symmetric."""
        x = np.asarray(ideal, dtype=np.float64)
        q = np.array([self.p2, self.p1])
        s = (x * x).sum(axis=-1)
        g = 1 + s * (self.k1 + s * (self.k2 + s * self.k3))
        slope = self.k1 + s * (2 * self.k2 + s * 3 * self.k3)
        outer = x[..., :, None] * x[..., None, :]
        mixed = x[..., :, None] * q + q[:, None] * x[..., None, :]
        return np.asarray(
            (g + 2 * (x @ q))[..., None, None] * np.eye(2) + 2 * slope[..., None, None] * outer + 2 * mixed
        )

    def undo(self, distorted: ArrayLike) -> FloatArray:
        """Ideal points (..., 2) of distorted ones (..., 2), by Newton's method; inverse to 1e-12 where D is one to one.

        Points that the lens images from nowhere near (beyond where D turns back) come out as NaN.
        """
        target = np.asarray(distorted, dtype=np.float64)
        if self.is_none:
            return target.copy()
        x = target.copy()
        with np.errstate(all="ignore"):
            for _ in range(_ROUNDS):
                residual = self.apply(x) - target
                if float(np.max(np.abs(residual), initial=0.0)) < _CONVERGED:
                    break
                slope = self.jacobian(x)
                a, b, d = slope[..., 0, 0], slope[..., 0, 1], slope[..., 1, 1]
                u, v = residual[..., 0], residual[..., 1]
                step = np.stack([d * u - b * v, a * v - b * u], axis=-1) / (a * d - b * b)[..., None]
                size = np.linalg.norm(step, axis=-1, keepdims=True)
                x = x - step * np.minimum(1.0, 0.3 / np.maximum(size, 1e-300))
            missed = np.abs(self.apply(x) - target).max(axis=-1) > 1e3 * _CONVERGED
        return np.asarray(np.where(missed[..., None], np.nan, x))

    def least_slope(self, radius: float) -> float:
        """Lower bound of the Jacobian's eigenvalues on the disc of a radius; ≤ 0 where the lens may turn back."""
        end = radius * radius
        radial = min(
            _least((1.0, self.k1, self.k2, self.k3), end), _least((1.0, 3 * self.k1, 5 * self.k2, 7 * self.k3), end)
        )
        return radial - 6 * self.tangential * radius - _SLACK

    def most_curved(self, radius: float) -> float:
        """Upper bound of the second derivative of D along any unit vector, on the disc of a radius."""
        s = radius * radius
        slope = abs(self.k1) + 2 * abs(self.k2) * s + 3 * abs(self.k3) * s * s
        bend = 2 * abs(self.k2) + 6 * abs(self.k3) * s
        return 6 * slope * radius + 4 * bend * radius * s + 6 * self.tangential

    def radius_for(self, distorted_radius: float) -> float:
        """The radius of a disc on which D is one to one and that D maps onto all of a disc of a distorted radius.

        Raises:
            ValueError: the lens turns back before.
        """
        radius = 0.5 * distorted_radius
        while self.least_slope(radius) > 0 and radius < 50 * distorted_radius:
            if self._reached(radius) >= distorted_radius:
                return radius
            radius *= 1.01
        raise ValueError(
            f"the distortion turns back within the image, {radius:.3g} focal lengths from its middle: "
            "it is not that of a lens (k1, k2, k3 belong to coordinates in focal lengths)"
        )

    def _reached(self, radius: float) -> float:
        """Lower bound of the distorted radius at a radius."""
        s = radius * radius
        g = 1 + s * (self.k1 + s * (self.k2 + s * self.k3))
        return radius * g - 3 * self.tangential * s - _SLACK


def _least(coefficients: tuple[float, float, float, float], end: float) -> float:
    """The smallest value on [0, end] of the cubic with the given coefficients, lowest first."""
    c0, c1, c2, c3 = coefficients
    candidates = [0.0, end]
    if c3 == 0:
        candidates += [-c1 / (2 * c2)] if c2 else []
    else:
        root = c2 * c2 - 3 * c1 * c3
        if root >= 0:
            candidates += [(-c2 + sign * math.sqrt(root)) / (3 * c3) for sign in (1, -1)]
    inside = [s for s in candidates if 0 <= s <= end]
    return min(c0 + s * (c1 + s * (c2 + s * c3)) for s in inside)
