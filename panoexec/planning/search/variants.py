"""Demands on rows with which C4, which the search does not evaluate, is satisfied.

First the demands of C2 and C3. If C4 then fails, stronger ones, in steps: neighbours in a row must have the overlap of
an edge of the graph for every error, then adjacent rows too. Over a sector, where a single row or column is a chain in
which every edge is a bridge, also: images two apart in a row must have that overlap, or rows two apart, or there must
be at least two rows or two images in each.

With a long lens each search takes seconds. There the first step is left for last if it cannot lead to a connected graph
(`can_tie`), and the second one also asks that images of adjacent rows which face each other have an edge: rows of which
not even these have one are tied by none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.adjacency import MUTUAL_OVERLAP
from panoexec.planning.certificate.worst_overlap import ErrorCorners, worst_pair_overlaps, worst_union_overlaps
from panoexec.planning.geometry.overlap import union_overlap
from panoexec.planning.model import Constraints
from panoexec.planning.search.row_constraints import Demands, Loss, RowConstraints
from panoexec.planning.search.row_spacing import NeighbourDemand

_SURE = MUTUAL_OVERLAP + 2e-4
_BETWEEN_ROWS = (0.06, 0.1, 0.16, 0.25)
_NODES = 10
_AROUND = 4
_LOSS_STEP = 0.5
_TO_SPARE = 0.03
_MORE_OVERLAP = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08, 0.12, 0.16, 0.2)
_ASIDE = 0.1
"""How far images that nearly face each other are aside, in spacings."""

_LONG = 1000
"""Lenses of which a sphere takes at least so many images are long."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One set of demands.

    demands: on rows.
    loss: largest loss of overlap between rows by pointing errors.
    group: variants of a later group have stronger demands than those of an earlier one; within a group any may be
        the best.
    """

    demands: Demands
    loss: Loss | None
    group: int


def variants(camera: Camera, constraints: Constraints) -> Iterator[Variant]:
    """All sets of demands to try, the weakest first."""
    worst_h = constraints.overlap_h if constraints.guarantee == "all" else 0.0
    worst_v = constraints.overlap_v if constraints.guarantee == "all" else 0.0
    loss = None if constraints.tolerance.is_zero else _Loss(camera, constraints)

    def asked(
        *, edge_h: float = 0.0, second: float = 0.0, edge_v: float = 0.0, v: float = 0.0, count: int = 1, rows: int = 1
    ) -> Demands:
        neighbours = NeighbourDemand(
            planned=max(constraints.overlap_h, edge_h),
            worst=max(worst_h, edge_h),
            second=second,
            tolerance=constraints.tolerance,
        )
        return Demands(
            neighbours=neighbours,
            planned_v=max(constraints.overlap_v, v),
            worst_v=max(worst_v, edge_v),
            least_count=count,
            least_rows=rows,
        )

    yield Variant(asked(), loss, group=0)
    if _is_long(camera) and constraints.guarantee == "coverage" and loss is not None:
        yield Variant(asked(edge_h=_SURE, edge_v=_SURE), _Facing(camera, constraints), group=1)
    else:
        yield Variant(asked(edge_h=_SURE), loss, group=1)
    if not constraints.band.is_full_circle:
        twice = _chain_overlap(camera)
        for demands in (
            asked(count=2),
            asked(second=_SURE, count=3),
            asked(edge_h=_SURE, count=2, rows=2),
            asked(v=twice, edge_v=twice, rows=3),
            asked(second=_SURE, edge_h=_SURE),
            asked(second=_SURE, v=twice, edge_v=twice),
        ):
            yield Variant(demands, loss, group=2)
    for group, edge_v in enumerate(_BETWEEN_ROWS, start=3):
        if edge_v > worst_v:
            yield Variant(asked(edge_h=_SURE, edge_v=edge_v), loss, group=group)


def _chain_overlap(camera: Camera) -> float:
    """Overlap of adjacent rows at which rows two apart have the overlap of an edge of the graph."""
    half, height = camera.half_height, math.radians(camera.vfov_deg)
    twice = height / 2 + math.atan(half * (1 - 2 * (_SURE + 0.01)))
    return (half - math.tan(twice / 2 - height / 2)) / (2 * half)


def _is_long(camera: Camera) -> bool:
    return camera.solid_angle_sr * _LONG <= 4 * math.pi


def can_tie(camera: Camera, constraints: Constraints, demands: Demands) -> bool:
    """Whether rows of very many images may satisfy C4 with these demands, as far as rows at the horizon tell.

    They cannot if neither neighbours share enough for every error nor images of adjacent rows do, at the phase at which
    they share least. Of shorter lenses this is not asked: their searches take little time.
    """
    if constraints.tolerance.is_zero or not constraints.band.is_full_circle:
        return True
    if not _is_long(camera):
        return True
    rules = RowConstraints(camera, constraints, demands)
    if not rules.layout.is_even or not rules.many:
        return True
    spacing = 360.0 / int(rules.fewest(np.zeros(1))[0])
    up = camera.vfov_deg / 2 + math.degrees(math.atan(camera.half_height * (1 - 2 * rules.overlap_v)))
    poses = rotation([0.0, spacing, spacing / 2], [-up / 2, -up / 2, up / 2])
    corners = ErrorCorners.of(camera, poses, constraints.tolerance)
    shared = worst_pair_overlaps(corners, np.array([0, 1, 0, 2]), np.array([1, 0, 2, 0]))
    return bool(max(shared[:2].min(), shared[2:].min()) >= MUTUAL_OVERLAP)


def worst_loss(camera: Camera, constraints: Constraints) -> Loss:
    """The largest loss by pointing errors of the overlap with the adjacent row, as a function of the image's pitch."""
    return _Loss(camera, constraints)


class _Loss:
    """See `worst_loss`.

    Measured on first use, for rows at their usual distance at a few pitches; interpolated linearly between them, and
    mirrored above the horizon.
    """

    def __init__(self, camera: Camera, constraints: Constraints) -> None:
        self._camera = camera
        self._constraints = constraints

    def __call__(self, pitch_deg: FloatArray) -> FloatArray:
        steepness, losses = self._measured
        return np.asarray(np.interp(np.abs(pitch_deg), steepness, losses))

    @cached_property
    def _measured(self) -> tuple[FloatArray, FloatArray]:
        steepness = np.linspace(0.0, 90.0, _NODES)
        # first at a distance with some overlap to lose, then at the distance that compensates the loss
        step = _LOSS_STEP * self._camera.vfov_deg
        losses = _losses_at(self._camera, self._constraints, -steepness, step)
        overlap = self._constraints.overlap_v + 1.5 * float(losses.max()) + _TO_SPARE
        half = self._camera.half_height
        usual = self._camera.vfov_deg / 2 + math.degrees(math.atan(half * (1 - 2 * overlap)))
        if usual > step:
            return steepness, _losses_at(self._camera, self._constraints, -steepness, usual)
        return steepness, losses


def _losses_at(camera: Camera, constraints: Constraints, pitch_deg: FloatArray, step_deg: float) -> FloatArray:
    """The largest losses (k,) of images at pitches (k,) with a row at a distance above or below them."""
    image_deg, other_deg = np.repeat(pitch_deg, 4), np.tile([step_deg, step_deg, -step_deg, -step_deg], len(pitch_deg))
    other_deg += image_deg
    spacing = 0.8 * camera.hfov_deg / np.maximum(np.cos(np.radians(other_deg)), 0.05)
    count = np.clip(360 // spacing, 1, 2 * _AROUND).astype(int)
    steps = np.arange(2 * _AROUND)
    present = steps < count[:, None]
    shift = np.tile([0.0, 0.5], 2 * len(pitch_deg))[:, None]
    yaws = (steps - (count[:, None] - 1) // 2 + shift) * np.minimum(spacing, 360.0 / count)[:, None]
    poses = np.concatenate([rotation(0.0, image_deg), rotation(yaws, other_deg[:, None]).reshape(-1, 3, 3)])
    partners = len(image_deg) + np.arange(yaws.size).reshape(yaws.shape)
    real = np.nonzero(other_deg >= -90.0)[0]
    partners, present = partners[real], present[real]
    least = worst_union_overlaps(ErrorCorners.of(camera, poses, constraints.tolerance), real, partners, present)
    losses = np.zeros(len(image_deg))
    losses[real] = union_overlap(camera, poses[real], poses[partners], present) - least
    return np.asarray(losses.reshape(-1, 4).max(axis=1, initial=0.0))


class _Facing:
    """How much more than an edge images must share with the adjacent row, so that those which face each other have one.

    A function of the image's pitch, measured on first use as `_Loss` is.
    """

    def __init__(self, camera: Camera, constraints: Constraints) -> None:
        self._camera = camera
        self._constraints = constraints

    def __call__(self, pitch_deg: FloatArray) -> FloatArray:
        steepness, needed = self._measured
        return np.asarray(np.interp(np.abs(pitch_deg), steepness, needed))

    @cached_property
    def _measured(self) -> tuple[FloatArray, FloatArray]:
        camera, height = self._camera, self._camera.vfov_deg
        steepness = np.linspace(0.0, max(90.0 - 1.5 * height, 0.0), _NODES)
        overlaps = self._constraints.overlap_v + np.array(_MORE_OVERLAP)
        steps = height / 2 + np.degrees(np.arctan(camera.half_height * (1 - 2 * np.minimum(overlaps, 1.0))))
        needed = np.zeros(_NODES)
        for i, pitch in enumerate((-steepness).tolist()):
            planned, sure = self._shared(pitch, steps)
            first = int(np.argmax(sure >= _SURE)) if (sure >= _SURE).any() else len(steps) - 1
            if first > 0:
                needed[i] = max(float(planned[first]) - _SURE, 0.0)
        return steepness, needed

    def _shared(self, pitch_deg: float, steps_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What an image shares with rows at distances (k,) above and below it, and surely with one of theirs; (k,)."""
        camera, k = self._camera, len(steps_deg)
        other_deg = pitch_deg + np.concatenate([steps_deg, -steps_deg])
        spacing = 0.8 * camera.hfov_deg / np.cos(np.radians(other_deg))
        around = (np.arange(-_AROUND, _AROUND + 1)[:, None] + np.array([0.0, 0.5])).T.ravel()
        row = rotation(around * spacing[:, None], np.broadcast_to(other_deg[:, None], (2 * k, len(around))))
        image = np.broadcast_to(rotation(0.0, pitch_deg), (4 * k, 3, 3))
        planned = union_overlap(camera, image, row.reshape(4 * k, -1, 3, 3)).reshape(2, k, 2).min(axis=(0, 2))
        partners = rotation(_ASIDE * spacing, other_deg)
        corners = ErrorCorners.of(camera, np.concatenate([image[:1], partners]), self._constraints.tolerance)
        own, other = np.zeros(2 * k, dtype=np.intp), np.arange(1, 2 * k + 1)
        shared = np.minimum(worst_pair_overlaps(corners, own, other), worst_pair_overlaps(corners, other, own))
        return planned, shared.reshape(2, k).min(axis=0)
