"""Where photos really looked: corrections of the measured attitudes from ties, robustly, with time in mind.

Unknown is a small rotation of each photo in the world frame. Each tie says how two photos' corrections differ. Each
measured attitude says that its own correction is small: tilt (about horizontal axes) within a tenth of a degree, yaw
within the error of the heading, which drifts slowly, so that photos taken one after the other share it; and all photos
share the gimbal's constant errors of pitch and roll. Ties and attitudes are believed robustly (Cauchy weights,
re-weighted least squares): one photo whose attitude is wrong is moved to where its neighbours see it, instead of
pulling them along.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray

IntArray = NDArray[np.intp]

_SCALES: Final = tuple(np.geomspace(30.0, 3.0, 12))
"""From almost quadratic to robust: the first rounds find a place for everybody."""
_BIASED_PHOTOS: Final = 5
"""Fewer tied photos do not tell a bias from a wrong attitude."""
_TIE_DEG: Final = 0.03
"""Least standard deviation of a tie."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeErrors:
    """Standard deviations of measured attitudes.

    Attributes:
        tilt_deg: about horizontal axes.
        heading_deg: about the vertical, shared by photos taken at about the same time.
        jitter_deg: about the vertical, of a single photo.
        drift_deg_s: how fast the shared part changes.
        bias_deg: of the gimbal's pitch and roll, shared by all photos.
    """

    tilt_deg: float = 0.08
    heading_deg: float = 0.7
    jitter_deg: float = 0.08
    drift_deg_s: float = 0.05
    bias_deg: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class TieEquation:
    """What a tie says of two photos.

    Attributes:
        first, second: their places in the list.
        turn_deg: (3,) measured minus true attitude of the second, if the first's were right; world frame.
        sigma_deg: its standard deviation.
    """

    first: int
    second: int
    turn_deg: FloatArray
    sigma_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Corrections:
    """The result.

    Attributes:
        error_deg: (n, 3) measured minus true attitude of each photo, world frame (north, east, down).
        odd_deg: (n,) the part of it that neither the gimbal's bias nor the drift of the heading explains.
        tie_deg: (m,) what remains of each tie.
        bias_deg: measured minus true pitch and roll that all photos share; 0 where too few are tied.
    """

    error_deg: FloatArray
    odd_deg: FloatArray
    tie_deg: FloatArray
    bias_deg: tuple[float, float] = (0.0, 0.0)


def corrections(
    times_s: Sequence[float],
    ties: Sequence[TieEquation],
    errors: AttitudeErrors | None = None,
    *,
    gimbal_axes: FloatArray | None = None,
) -> Corrections:
    """Estimate the errors of measured attitudes.

    Args:
        times_s: when each photo was taken.
        ties: between them.
        errors: what to expect of the attitudes.
        gimbal_axes: (n, 2, 3) of each photo, the axes of the gimbal's pitch and roll, world frame; None: no bias is
            estimated.
    """
    errors = errors or AttitudeErrors()
    count = len(times_s)
    if not count:
        return Corrections(error_deg=np.zeros((0, 3)), odd_deg=np.zeros(0), tie_deg=np.zeros(0))
    times = np.asarray(times_s, dtype=np.float64)
    first = np.array([tie.first for tie in ties], dtype=np.intp)
    second = np.array([tie.second for tie in ties], dtype=np.intp)
    turns = np.array([tie.turn_deg for tie in ties]).reshape(-1, 3)
    sigma = np.hypot(_TIE_DEG, np.array([tie.sigma_deg for tie in ties]))
    shots = np.arange(count)
    none = np.full(count, -1)
    own = np.zeros((count, 3))
    linked = np.zeros(count, dtype=bool)
    linked[first] = linked[second] = True
    axes = np.zeros((count, 2, 3)) if gimbal_axes is None or linked.sum() < _BIASED_PHOTOS else gimbal_axes
    bias = np.zeros(2)
    tilts = [_System(count), _System(count)]
    for axis, system in enumerate(tilts):
        system.add(shots, none, 0.0, errors.tilt_deg, robust=True)
        system.add(second, first, turns[:, axis], sigma, robust=True)
    for scale in _SCALES:
        for axis, system in enumerate(tilts):
            own[:, axis] = system.solve(scale, own[:, axis], {0: axes[:, :, axis] @ bias})
        bias = _bias(own, axes, linked, errors, scale)
    # about the vertical: beside each photo's own error, the heading's shared error at its time
    order = np.argsort(times, kind="stable")
    gaps = np.maximum(np.nan_to_num(np.diff(times[order]), nan=60.0), 0.5)
    headings = _System(2 * count)
    headings.add(shots, count + shots, axes[:, :, 2] @ bias, errors.jitter_deg, robust=True)
    headings.add(count + shots, none, 0.0, errors.heading_deg, robust=False)
    headings.add(count + order[1:], count + order[:-1], 0.0, errors.drift_deg_s * gaps, robust=False)
    headings.add(second, first, turns[:, 2], sigma, robust=True)
    found: FloatArray = np.zeros(2 * count)
    for scale in _SCALES:
        found = headings.solve(scale, found)
    own[:, 2] = found[:count]
    rest = own - axes.transpose(0, 2, 1) @ bias
    rest[:, 2] -= found[count:]
    left = own[second] - own[first] - turns
    return Corrections(
        error_deg=own,
        odd_deg=np.linalg.norm(rest, axis=1),
        tie_deg=np.linalg.norm(left, axis=1),
        bias_deg=(float(bias[0]), float(bias[1])),
    )


def _bias(
    own: FloatArray, axes: FloatArray, linked: NDArray[np.bool_], errors: AttitudeErrors, scale: float
) -> FloatArray:
    """The pitch and roll errors (2,) that the tilts of all tied photos share, robustly."""
    bias = np.zeros(2)
    design, tilt = axes[linked][:, :, :2], own[linked][:, :2]
    for _ in range(3):
        residual = np.linalg.norm(tilt - np.einsum("kaj,a->kj", design, bias), axis=1) / errors.tilt_deg
        weight = 1 / (1 + (residual / scale) ** 2) / errors.tilt_deg**2
        normal = np.einsum("k,kaj,kbj->ab", weight, design, design) + np.eye(2) / errors.bias_deg**2
        bias = np.linalg.solve(normal, np.einsum("k,kaj,kj->a", weight, design, tilt))
    return np.asarray(bias)


class _System:
    """Equations x[a] - x[b] = value ± sigma; without b, x[a] = value."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._parts: list[tuple[IntArray, IntArray, FloatArray, FloatArray, NDArray[np.bool_]]] = []

    def add(self, a: IntArray, b: IntArray, value: ArrayLike, sigma: ArrayLike, *, robust: bool) -> None:
        """Add equations; b is -1 where there is none."""
        shape = a.shape
        self._parts.append(
            (a, b, np.broadcast_to(np.asarray(value, np.float64), shape),
             np.broadcast_to(np.asarray(sigma, np.float64), shape), np.full(shape, robust))
        )  # fmt: skip

    def solve(self, scale: float, found: FloatArray, values: Mapping[int, FloatArray] | None = None) -> FloatArray:
        """The unknowns, re-weighted once.

        Args:
            scale: residuals, in their standard deviations, from which equations count less.
            found: the unknowns before.
            values: other values of the equations that were added first (0), second, …
        """
        parts = [
            (a, b, value if values is None else values.get(number, value), sigma, robust)
            for number, (a, b, value, sigma, robust) in enumerate(self._parts)
        ]
        a, b, value, sigma, robust = (np.concatenate(column) for column in zip(*parts, strict=True))
        pair = b >= 0
        partner = np.where(pair, b, a)
        residual = (found[a] - np.where(pair, found[partner], 0.0) - value) / sigma
        weight = np.where(robust, 1 / (1 + (residual / scale) ** 2), 1.0) / sigma**2
        normal, side = 1e-9 * np.eye(self._size), np.zeros(self._size)
        np.add.at(normal, (a, a), weight)
        np.add.at(side, a, weight * value)
        both = weight * pair
        np.add.at(normal, (partner, partner), both)
        np.add.at(normal, (a, partner), -both)
        np.add.at(normal, (partner, a), -both)
        np.add.at(side, partner, -both * value)
        return np.asarray(np.linalg.solve(normal, side))


def connected_groups(count: int, edges: Sequence[tuple[int, int]]) -> list[list[int]]:
    """Connected groups of a graph, the largest first."""
    group = list(range(count))

    def root(k: int) -> int:
        while group[k] != k:
            group[k] = group[group[k]]
            k = group[k]
        return k

    for a, b in edges:
        group[root(a)] = root(b)
    members: dict[int, list[int]] = {}
    for k in range(count):
        members.setdefault(root(k), []).append(k)
    return sorted(members.values(), key=lambda found: (-len(found), found))


def bridges(count: int, edges: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """The edges without which a group falls apart."""
    neighbours: Mapping[int, list[int]] = {k: [] for k in range(count)}
    for a, b in edges:
        neighbours[a].append(b)
        neighbours[b].append(a)
    reached, low = [-1] * count, [0] * count
    found, clock = [], 0
    for start in range(count):
        if reached[start] >= 0:
            continue
        reached[start] = low[start] = clock
        clock += 1
        stack = [(start, -1, iter(neighbours[start]))]
        while stack:
            node, parent, rest = stack[-1]
            for other in rest:
                if other == parent:
                    continue
                if reached[other] >= 0:
                    low[node] = min(low[node], reached[other])
                    continue
                reached[other] = low[other] = clock
                clock += 1
                stack.append((other, node, iter(neighbours[other])))
                break
            else:
                stack.pop()
                if stack:
                    above = stack[-1][0]
                    low[above] = min(low[above], low[node])
                    if low[node] > reached[above]:
                        found.append((min(above, node), max(above, node)))
    return sorted(found)
