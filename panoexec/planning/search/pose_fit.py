"""Rows whose images leave their common pitch and their even spacing: poses of single images that satisfy C1 to C3.

In a row of even images the one that meets the next row at the worst place decides the step for all. Where each image
may stand a little lower, higher or aside, the rows take steps near the mean of all places. So rows that lack a little
overlap, with a margin down to that of `row_search` less 0.02, can often be made to hold image by image.

**Method.** Unknown are yaw and pitch of every image. A residual is what a condition lacks of its threshold and a
little more: C2 for each pair of neighbours both ways, C3 for each image with the row above and below, C1 as the depth,
in the nearest other core, of points of the borders that are not deep in another core (`coverage.border_gaps`). A step
minimises the sum of squared residuals, linearised, plus a damping term (Levenberg and Marquardt); conditions that the
step would break count too, so the active ones are found by a few repetitions. Derivatives are differences of the exact
overlaps. Nothing is proven here: the certificate judges what results.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.coverage import is_covered, neighbours
from panoexec.planning.certificate.robust_footprint import Cores, robust_cores
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import Constraints
from panoexec.planning.search.budget import SearchBudget

IntArray = NDArray[np.intp]

_STEP_DEG = 1e-4
_AIM = 2e-4
"""Overlap beyond the threshold that is aimed at."""
_ENOUGH = 1e-6
_ACTIVE = 0.1
"""Images with so much more overlap than asked for with the next row are left out of a step."""
_DEPTH_RAD = 2e-5
"""Depth of borders in another core that is aimed at."""
_NEAR = 0.03
"""Points of borders count that are less deep than this, in vertical fields of view: a step may bare them."""
_ROUNDING = 1e-9
_MOST_PARTNERS = 4
_DAMPING, _LEAST_DAMPING = 1e-3, 1e-7
_ACTIVE_ROUNDS = 6
_LONGEST_DEG = 2.0
_SLOW, _MOST_SLOW = 0.85, 5
"""So many steps in a row that each leave more than this part of the sum of squares end the search."""
_POOR = 0.5
_FORECAST_BY, _SMALL = 6, 1e-5
"""The last steps by which the sum of squares is forecast, and what it must be at the end to go on."""


@dataclass(frozen=True, slots=True)
class Poses:
    """Yaw and pitch (n,) of images, degrees, and their row numbers (n,)."""

    yaw_deg: FloatArray
    pitch_deg: FloatArray
    rows: IntArray


@dataclass(frozen=True, slots=True)
class _Conditions:
    """What conditions have beyond their aim (m,), and the derivatives (m, 2n) by yaw and pitch in degrees."""

    surplus: FloatArray
    by_pose: FloatArray


def fit_poses(
    camera: Camera,
    constraints: Constraints,
    start: Poses,
    *,
    pitch_deg: tuple[float, float],
    steps: int,
    budget: SearchBudget,
) -> Poses | None:
    """Poses near the given ones that satisfy C1 to C3; None if none are found.

    Args:
        camera: the camera.
        constraints: of a full circle; C2 and C3 are satisfied at the planned poses.
        start: images row by row, clockwise in each.
        pitch_deg: the gimbal's limits.
        steps: the most steps to take.
        budget: of the search.

    Raises:
        BudgetSpentError: the budget is used up.
    """
    fit = _Fit(camera, constraints, start.rows)
    x = np.concatenate([start.yaw_deg, start.pitch_deg])
    count = len(start.rows)
    damping, slow, history = _DAMPING, 0, list[float]()
    now = fit.conditions(x)
    for taken in range(steps):
        if now.surplus.min(initial=0.0) >= _ENOUGH - _AIM and fit.covers(x):
            return Poses(x[:count], x[count:], start.rows)
        budget.use(count)
        before = _squares(now.surplus)
        history.append(before)
        if _is_hopeless(history, steps - taken):
            return None
        step = _step(now, damping)
        # near a pole a yaw hardly moves an image
        weight = np.concatenate([np.cos(np.radians(np.minimum(np.abs(x[count:]), 88.0))), np.ones(count)])
        step *= min(1.0, _LONGEST_DEG / max(float(np.abs(step * weight).max()), 1e-9))
        following = x + step
        following[count:] = np.clip(following[count:], *pitch_deg)
        new = fit.conditions(following)
        after = _squares(new.surplus)
        if after >= before:
            damping *= 10
            slow += 1
        else:
            # where the linear forecast was poor, a longer step would be worse
            damping = max(damping / 3, _LEAST_DAMPING) if after <= _POOR * before else damping
            x, now = following, new
            slow = slow + 1 if after > _SLOW * before else 0
        if slow >= _MOST_SLOW:
            return None
    return None


def _is_hopeless(history: Sequence[float], left: int) -> bool:
    """Whether sums of squares that go on falling as they did last are not small after the steps that are left."""
    if len(history) <= _FORECAST_BY:
        return False
    rate = (history[-1] / max(history[-1 - _FORECAST_BY], 1e-300)) ** (1 / _FORECAST_BY)
    return bool(history[-1] * min(rate, 1.0) ** left > _SMALL)


def _squares(surplus: FloatArray) -> float:
    return float((np.minimum(surplus, 0.0) ** 2).sum())


def _step(now: _Conditions, damping: float) -> FloatArray:
    """The step (2n,) that minimises what is lacking after it, as far as it is linear."""
    step: FloatArray = np.zeros(now.by_pose.shape[1])
    active = np.zeros(len(now.surplus), dtype=bool)
    for _ in range(_ACTIVE_ROUNDS):
        wanted = now.surplus + now.by_pose @ step < 0
        if np.array_equal(wanted, active):
            break
        active = wanted
        some = now.by_pose[active]
        normal = some.T @ some
        scale = damping * max(float(np.trace(normal)) / len(normal), 1e-12)
        step = np.asarray(
            np.linalg.solve(normal + scale * np.eye(len(normal)), -some.T @ now.surplus[active]), dtype=np.float64
        )
    return step


class _Fit:
    def __init__(self, camera: Camera, constraints: Constraints, rows: IntArray) -> None:
        self._camera, self._asked = camera, constraints
        self._members = [np.nonzero(rows == row)[0] for row in np.unique(rows)]
        self._count = len(rows)
        self._domain = Domain.of(constraints.band, constraints.masks)
        self._reach = math.cos(min(2 * math.atan(math.hypot(camera.half_width, camera.half_height)), math.pi))
        self._first, self._second = _neighbours(self._members)

    def covers(self, x: FloatArray) -> bool:
        """Whether the cores cover the band."""
        return is_covered(self._cores(self._poses(x)), self._domain)

    def conditions(self, x: FloatArray) -> _Conditions:
        """C1 to C3 at poses (2n,)."""
        n, here = self._count, self._poses(x)
        turned = self._poses(x + np.repeat([_STEP_DEG, 0.0], n)), self._poses(x + np.repeat([0.0, _STEP_DEG], n))
        found = [self._in_rows(here, turned), self._between_rows(here, turned), self._borders(here, turned)]
        return _Conditions(
            np.concatenate([each.surplus for each in found]), np.concatenate([each.by_pose for each in found])
        )

    def _poses(self, x: FloatArray) -> FloatArray:
        return rotation(x[: self._count], x[self._count :])

    def _cores(self, poses: FloatArray) -> Cores:
        return robust_cores(self._camera, poses, self._asked.tolerance)

    def _in_rows(self, here: FloatArray, turned: Sequence[FloatArray]) -> _Conditions:
        a, b = self._first, self._second
        shared = pairwise_overlap(self._camera, here[a], here[b])
        slopes = np.zeros((len(a), 2 * self._count))
        line = np.arange(len(a))
        for axis, other in enumerate(turned):
            for images, moved in ((a, (other[a], here[b])), (b, (here[a], other[b]))):
                change = (pairwise_overlap(self._camera, *moved) - shared) / _STEP_DEG
                slopes[line, images + axis * self._count] += change
        return _Conditions(shared - self._asked.overlap_h - _AIM, slopes)

    def _between_rows(self, here: FloatArray, turned: Sequence[FloatArray]) -> _Conditions:
        own, partners, present = self._partners(here)
        shared = union_overlap(self._camera, here[own], here[partners], present)
        near = shared < self._asked.overlap_v + _ACTIVE
        own, partners, present, shared = own[near], partners[near], present[near], shared[near]
        others = here[partners]
        slopes = np.zeros((len(own), 2 * self._count))
        # the image itself turned, then each of its partners: all in one call, as small batches cost as much as large
        images, seers, lines, places = [], [], [], []
        line = np.arange(len(own))
        for axis, other in enumerate(turned):
            images.append(other[own])
            seers.append(others)
            lines.append(line)
            places.append(own + axis * self._count)
            for k in range(partners.shape[1]):
                some = np.nonzero(present[:, k])[0]
                moved = others[some]
                moved[:, k] = other[partners[some, k]]
                images.append(here[own[some]])
                seers.append(moved)
                lines.append(some)
                places.append(partners[some, k] + axis * self._count)
        which = np.concatenate(lines)
        seen = union_overlap(self._camera, np.concatenate(images), np.concatenate(seers), present[which])
        slopes[which, np.concatenate(places)] = (seen - shared[which]) / _STEP_DEG
        return _Conditions(shared - self._asked.overlap_v - _AIM, slopes)

    def _partners(self, here: FloatArray) -> tuple[IntArray, IntArray, NDArray[np.bool_]]:
        """Images (k,) with the nearest images (k, m) of the row above or below them, and which of these may meet."""
        near = here[:, :, 0] @ here[:, :, 0].T
        owns, partners = [], []
        for row, members in enumerate(self._members):
            for beside in (row - 1, row + 1):
                if 0 <= beside < len(self._members):
                    others = self._members[beside]
                    order = np.argsort(-near[np.ix_(members, others)], axis=1)[:, :_MOST_PARTNERS]
                    some = others[order]
                    owns.append(members)
                    partners.append(np.pad(some, ((0, 0), (0, _MOST_PARTNERS - some.shape[1])), mode="edge"))
        if not owns:
            nothing = np.empty((0, 1), dtype=np.intp)
            return np.empty(0, dtype=np.intp), nothing, nothing.astype(bool)
        own, other = np.concatenate(owns), np.concatenate(partners)
        present = near[own[:, None], other] > self._reach
        # what pads a short row repeats its last image
        present[:, 1:] &= np.cumsum(other[:, 1:] == other[:, :-1], axis=1) == 0
        return own, other, present

    def _borders(self, here: FloatArray, turned: Sequence[FloatArray]) -> _Conditions:
        """Corners of cores, and places where the borders of two cores cross, by their depth in yet another core.

        A cover is without holes where all of these are in one, or outside the band. Cores are turned as they are: the
        little by which their shape depends on the pitch is left to the next step.
        """
        cores = self._cores(here)
        i, j, edges = self._crossings(cores)
        own = np.arange(cores.vertices.shape[1])
        corner_of = np.repeat(np.arange(len(cores)), len(own))
        corners = np.tile(own, len(cores))
        i, j = np.concatenate([i, corner_of]), np.concatenate([j, corner_of])
        # of a corner the planes of the edges that meet there
        edges = np.concatenate([edges, np.stack([corners - 1, corners], axis=1)])
        points = _meeting(cores.normals[i, edges[:, 0]], cores.normals[j, edges[:, 1]], cores.centres[i])
        depth = np.stack([(points @ normals.T).min(axis=1) for normals in cores.normals], axis=1)
        line = np.arange(len(points))
        depth[line, i] = depth[line, j] = -1.0
        best = depth.argmax(axis=1)
        outside = self._outside(points)
        height = 2 * math.atan(self._camera.half_height)
        some = np.nonzero(np.maximum(depth[line, best], outside) < _NEAR * height)[0]
        if not len(some):
            return _Conditions(np.empty(0), np.empty((0, 2 * self._count)))
        i, j, best, edges = i[some], j[some], best[some], edges[some]
        ends = outside[some] > depth[some, best]

        def reached(of_i: FloatArray, of_j: FloatArray, of_best: FloatArray) -> FloatArray:
            at = _meeting(_turned(of_i, first), _turned(of_j, second), of_i[:, :, 0])
            inside = np.einsum("pki,pi->pk", np.einsum("pij,pkj->pki", of_best, third), at).min(axis=1)
            return np.where(ends, self._outside(at), inside)

        # normals in the frames of the images
        first = _turned(np.swapaxes(here[i], 1, 2), cores.normals[i, edges[:, 0]])
        second = _turned(np.swapaxes(here[j], 1, 2), cores.normals[j, edges[:, 1]])
        third = np.einsum("pji,pkj->pki", here[best], cores.normals[best])
        now = reached(here[i], here[j], here[best])
        slopes = np.zeros((len(some), 2 * self._count))
        line = np.arange(len(some))
        for axis, other in enumerate(turned):
            same = (i == j)[:, None, None]
            moves = (
                (i, (other[i], np.where(same, other[j], here[j]), here[best])),
                (j, (here[i], np.where(same, here[j], other[j]), here[best])),
                (best, (here[i], here[j], other[best])),
            )
            for images, moved in moves:
                slopes[line, images + axis * self._count] += (reached(*moved) - now) / _STEP_DEG
        # as fractions of an image's height, like overlaps
        return _Conditions((now - _DEPTH_RAD) / height, slopes / height)

    def _crossings(self, cores: Cores) -> tuple[IntArray, IntArray, IntArray]:
        """Pairs of cores (k,), (k,) and of their edges (k, 2) that cross."""
        first, second = neighbours(cores)
        once = first < second
        first, second = first[once], second[once]
        count = cores.normals.shape[1]
        a, b = (side.ravel() for side in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
        i, j = np.repeat(first, len(a)), np.repeat(second, len(a))
        edges = np.stack([np.tile(a, len(first)), np.tile(b, len(first))], axis=1)
        spanned = cores.is_edge[i, edges[:, 0]] & cores.is_edge[j, edges[:, 1]]
        i, j, edges = i[spanned], j[spanned], edges[spanned]
        points = _meeting(cores.normals[i, edges[:, 0]], cores.normals[j, edges[:, 1]], cores.centres[i])
        on = np.ones(len(points), dtype=bool)
        for images in (i, j):
            on &= np.einsum("pki,pi->pk", cores.normals[images], points).min(axis=1) > -_ROUNDING
        return i[on], j[on], edges[on]

    def _outside(self, points: FloatArray) -> FloatArray:
        """How far points (k, 3) are outside the band, radians; negative inside."""
        elevation = np.arcsin(np.clip(-points[:, 2], -1.0, 1.0))
        band = self._asked.band
        below = math.radians(band.elevation_min_deg) - elevation if band.elevation_min_deg > -90.0 else -np.inf
        above = elevation - math.radians(band.elevation_max_deg) if band.elevation_max_deg < 90.0 else -np.inf
        return np.asarray(np.maximum(np.maximum(below, above), np.full(len(points), -10.0)))


def _turned(turns: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (k, 3) by rotations (k, 3, 3)."""
    return np.asarray(np.einsum("pij,pj->pi", turns, vectors))


def _meeting(first: FloatArray, second: FloatArray, near: FloatArray) -> FloatArray:
    """Directions (k, 3) in both of two planes (k, 3), (k, 3), on the side of others (k, 3)."""
    along = np.cross(first, second)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return np.asarray(along * np.where(np.sum(along * near, axis=1) < 0, -1.0, 1.0)[:, None])


def _neighbours(members: Sequence[IntArray]) -> tuple[IntArray, IntArray]:
    """Ordered pairs of neighbours in closed rows, both ways."""
    first, second = [np.empty(0, dtype=np.intp)], [np.empty(0, dtype=np.intp)]
    for row in members:
        count = len(row) if len(row) > 2 else len(row) - 1
        a, b = row[:count], np.roll(row, -1)[:count]
        first += [a, b]
        second += [b, a]
    return np.concatenate(first), np.concatenate(second)
