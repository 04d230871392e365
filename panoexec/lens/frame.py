"""What of an image certainly shows: the largest rectangle about the boresight that is proven to lie in the image.

In the ideal image plane at unit distance an image with distortion has curved borders, and with a principal point beside
its centre the boresight is not in its middle. Planning and certificate count the *frame* only: a rectangle |y| ≤ a,
|z| ≤ b in that plane, wholly inside the image.

**Proof that the frame is inside.** Let S be the rectangle of the sensor in the distorted plane, D the distortion
(`distortion`), one to one on a disc that contains the frame F. D(F) is compact, and its border is the image of F's
border. If D(∂F) is in S, then D(F) is: else some point of D(F) outside the convex S could be joined with infinity
outside S, and the path would leave D(F) through its border. On each side of F both coordinates of D are polynomials of
degree 7 of the place along the side, which on each of many parts lie between the smallest and the largest of their
Bernstein coefficients. These are compared with the sides of S.

**Area.** Overlaps are shares of the image's whole area in the ideal plane, D⁻¹(S), of which an upper bound is
computed, so that no share is stated too large: the polygon through D⁻¹ of points of the border of S, and the area that
its sides can miss. D⁻¹ along a straight line has a second derivative of at most c = M/λ³, with λ the least eigenvalue
of D's Jacobian and M a bound of D's second derivative, so a side for a step h misses at most δ = c·h²/8, and all sides
together δ times the length of the border of S over λ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from panoexec.lens.distortion import Distortion, FloatArray

_DEGREE = 7
_PARTS = 64
_ROUNDING = 1e-11
_ON_A_SIDE = 512
_SIDE_POINTS = 33
_SHRINKS = (1e-10, 1e-8, 1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 1e-3, 1e-2)
_RATIOS = 0.4
_GOLDEN = (math.sqrt(5) - 1) / 2


@dataclass(frozen=True, slots=True)
class Sides:
    """Where the image ends in the distorted plane at unit distance, from the boresight, all positive."""

    left: float
    right: float
    top: float
    bottom: float

    @property
    def corner(self) -> float:
        """The distance of the farthest corner."""
        return math.hypot(max(self.left, self.right), max(self.top, self.bottom))

    def hold(self, points: FloatArray) -> bool:
        """Whether all points (n, 2) are inside."""
        y, z = points[..., 0], points[..., 1]
        return bool(y.max() <= self.right and y.min() >= -self.left and z.max() <= self.bottom and z.min() >= -self.top)


@dataclass(frozen=True, slots=True)
class Frame:
    """Half width and half height of the rectangle that certainly shows, and an upper bound of the image's area."""

    half_width: float
    half_height: float
    image_area: float


@lru_cache(maxsize=64)
def frame_of(sides: Sides, distortion: Distortion) -> Frame:
    """The frame of an image; see the module docstring.

    Raises:
        ValueError: the distortion turns back within the image, or leaves no such rectangle.
    """
    if distortion.is_none:
        return Frame(
            half_width=min(sides.left, sides.right),
            half_height=min(sides.top, sides.bottom),
            image_area=(sides.left + sides.right) * (sides.top + sides.bottom),
        )
    radius = distortion.radius_for(sides.corner)
    a, b = _largest(sides, distortion, radius)
    for shrink in _SHRINKS:
        wide, high = a * (1 - shrink), b * (1 - shrink)
        if is_inside(wide, high, sides, distortion):
            return Frame(wide, high, _most_area(sides, distortion, radius))
    raise ValueError("the distortion leaves no rectangle about the boresight that the image shows")


def is_inside(half_width: float, half_height: float, sides: Sides, distortion: Distortion) -> bool:
    """Whether the rectangle is proven to be inside the image; False says nothing.

    Raises:
        ValueError: the distortion turns back within the image.
    """
    if math.hypot(half_width, half_height) > distortion.radius_for(sides.corner):
        return False
    inner = Sides(*(side - _ROUNDING for side in (sides.left, sides.right, sides.top, sides.bottom)))
    starts = np.linspace(-1.0, 1.0, _PARTS + 1)[:-1, None]
    along = starts + _NODES * (2.0 / _PARTS)
    return inner.hold(np.swapaxes(_TO_BERNSTEIN @ distortion.apply(_border(half_width, half_height, along)), 0, 1))


def _border(half_width: float, half_height: float, along: FloatArray) -> FloatArray:
    """Points (4, ..., 2) of the right, left, bottom and top sides, at places (...) in [-1, 1]."""
    one = np.ones_like(along)
    return np.stack(
        [
            np.stack([half_width * y, half_height * z], axis=-1)
            for y, z in ((one, along), (-one, along), (along, one), (along, -one))
        ]
    )


def _bernstein() -> tuple[FloatArray, FloatArray]:
    """Nodes (8,) in [0, 1], and the matrix that takes a polynomial's values there to its Bernstein coefficients."""
    nodes = (1 - np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE)) / 2
    powers = np.arange(_DEGREE + 1)
    binomials = np.array([math.comb(_DEGREE, k) for k in powers])
    values = binomials * nodes[:, None] ** powers * (1 - nodes[:, None]) ** (_DEGREE - powers)
    return nodes, np.asarray(np.linalg.inv(values), dtype=np.float64)


_NODES, _TO_BERNSTEIN = _bernstein()


def _largest(sides: Sides, distortion: Distortion, radius: float) -> tuple[float, float]:
    """The rectangle of largest area, by samples: a proposal."""
    wide, high = min(sides.left, sides.right), min(sides.top, sides.bottom)
    border = _border(wide, high, np.linspace(-1.0, 1.0, _SIDE_POINTS)).reshape(-1, 2)

    def size(stretch: float) -> float:
        points = border * np.array([math.exp(stretch), math.exp(-stretch)])
        low, far = 0.0, radius / float(np.linalg.norm(points, axis=1).max())
        for _ in range(40):
            middle = (low + far) / 2
            low, far = (middle, far) if sides.hold(distortion.apply(points * middle)) else (low, middle)
        return low

    left, right = -_RATIOS, _RATIOS
    for _ in range(30):
        step = _GOLDEN * (right - left)
        left, right = (left, left + step) if size(right - step) >= size(left + step) else (right - step, right)
    best = (left + right) / 2
    scale = size(best)
    return scale * wide * math.exp(best), scale * high * math.exp(-best)


def _most_area(sides: Sides, distortion: Distortion, radius: float) -> float:
    """Upper bound of the area of the image in the ideal plane."""
    corners = np.array(
        [
            [-sides.left, -sides.top],
            [sides.right, -sides.top],
            [sides.right, sides.bottom],
            [-sides.left, sides.bottom],
        ]
    )
    step = np.arange(_ON_A_SIDE)[:, None] / _ON_A_SIDE
    border = np.concatenate([corners[i] + step * (corners[(i + 1) % 4] - corners[i]) for i in range(4)])
    ideal = distortion.undo(border)
    if not np.isfinite(ideal).all():
        raise ValueError("the distortion cannot be undone within the image")
    following = np.roll(ideal, -1, axis=0)
    area = abs(float((ideal[:, 0] * following[:, 1] - ideal[:, 1] * following[:, 0]).sum())) / 2
    slope = distortion.least_slope(radius)
    longest = max(sides.left + sides.right, sides.top + sides.bottom) / _ON_A_SIDE
    missed = distortion.most_curved(radius) / slope**3 * longest**2 / 8 + _ROUNDING / slope
    length = 2 * (sides.left + sides.right + sides.top + sides.bottom) / slope
    return area + missed * length
