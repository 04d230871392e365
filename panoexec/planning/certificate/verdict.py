"""The verdict on a plan: certified means C1 to C4 of docs/contract.md, for every pointing error.

* **C1, coverage.** Every direction of the band, minus its masks, is in an image for every combination of errors:
  `robust_footprint` and `coverage` contain the proof, `holes` locates failures.
* **C2, neighbours in a row** see at least `overlap_h` of each other, both ways; on a full circle the last and the first
  image of a row are neighbours. Two images that do not overlap are not neighbours if masks cover everything between
  them.
* **C3, adjacent rows.** Each image shares at least `overlap_v` of its area with the union of the row above and of the
  row below, where there is one. Rows are given by the shots' row numbers; a cap of one to three images about a pole is
  a row too.
* **C4, the graph**: see `adjacency`, which also discusses plans of one and two images.

With `textured_below` C2 to C4 count of each image only what lies below the skyline, see `texture`.

Overlaps are exact at the planned poses (`panoexec.planning.geometry.overlap`) and bounded from below over all errors
(`worst_overlap`). With the guarantee `coverage` C2 and C3 hold at the planned poses, with `all` for every combination
of errors. An overlap that misses its threshold by 1e-9 is accepted; a hole is not, whatever its size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray, wrap_180, yaw_pitch_roll
from panoexec.optics import Camera
from panoexec.planning.certificate.adjacency import MUTUAL_OVERLAP, Connection, Rows, SparseGraph, separated_by_mask
from panoexec.planning.certificate.coverage import is_covered, neighbours
from panoexec.planning.certificate.extra_images import certified_part
from panoexec.planning.certificate.holes import Uncovered, uncovered
from panoexec.planning.certificate.robust_footprint import robust_cores
from panoexec.planning.certificate.texture import Texture
from panoexec.planning.certificate.worst_overlap import (
    ErrorCorners,
    overlaps_at_least,
    worst_pair_overlaps,
    worst_union_overlaps,
)
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import NO_TOLERANCE, Certificate, Constraints, Plan

THRESHOLD_SLACK = 1e-9
"""Tolerance of the threshold comparison, for rounding errors."""

_LEVEL_DEG = 2.0
"""Images are as good as level up to this roll."""

_PAIRS_AT_A_TIME = 1 << 15
"""Pairs of images judged at a time: limits the memory."""

IntArray = NDArray[np.intp]


def certify(plan: Plan, *, go_on: Callable[[], bool] = lambda: True) -> Certificate:
    """Certify the shots of a plan for its camera and constraints; images are identified by `Shot.index`.

    Images beyond those of a part that is certified do not make a plan fail, see `extra_images`.

    Args:
        plan: the plan.
        go_on: asked before each further verdict on a part of the images; the search for such a part ends with False.
    """
    poses, rows = plan.rotations(), [shot.row for shot in plan.shots]
    certificate = certify_poses(plan.camera, plan.constraints, poses, rows)
    if not certificate.certified:

        def certify_some(which: Sequence[int]) -> Certificate:
            some = [rows[i] for i in which]
            return certify_poses(plan.camera, plan.constraints, poses[list(which)], some, explain=False)

        certificate = certified_part(certificate, rows, plan.constraints, certify_some, go_on) or certificate
    names = [shot.index for shot in plan.shots]
    if names == list(range(len(names))):
        return certificate
    pair, image = certificate.weakest_h, certificate.weakest_v
    return replace(
        certificate,
        weakest_h=None if pair is None else (names[pair[0]], names[pair[1]]),
        weakest_v=None if image is None else names[image],
        bridges=tuple((names[a], names[b]) for a, b in certificate.bridges),
    )


def certify_poses(
    camera: Camera, constraints: Constraints, rotations: ArrayLike, rows: Sequence[int], *, explain: bool = True
) -> Certificate:
    """Certify images at any attitudes, planned or measured, of any roll.

    Args:
        camera: the camera.
        constraints: thresholds, band, masks, guarantee, and the tolerance about these attitudes (for measured
            attitudes zero, or the uncertainty of the measurement).
        rotations: camera-to-world rotations (n, 3, 3).
        rows: (n,) row number of each image; adjacent rows are those with consecutive numbers among the ones that occur.
        explain: where coverage fails, find the holes and their solid angle; otherwise `uncovered_fraction` is 1.0 and
            `holes` empty in that case, which is faster.

    Returns:
        The certificate; images are identified by their position.
    """
    poses = np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)
    domain = Domain.of(constraints.band, constraints.masks)
    cores = robust_cores(camera, poses, constraints.tolerance)
    if explain:
        missing = uncovered(cores, domain)
    else:
        missing = Uncovered(fraction=0.0 if is_covered(cores, domain) else 1.0, regions=())
    overlaps = _Overlaps(camera, constraints, poses, rows, domain)
    in_row, between_rows, graph = overlaps.in_row(), overlaps.between_rows(), overlaps.graph()
    failures = _failures(constraints, missing, in_row, between_rows, graph)
    return Certificate(
        certified=not failures,
        images=len(poses),
        min_overlap_h=in_row.planned,
        min_overlap_v=between_rows.planned,
        worst_overlap_h=in_row.worst,
        worst_overlap_v=between_rows.worst,
        uncovered_fraction=missing.fraction,
        connected=graph.connected,
        two_edge_connected=graph.two_edge_connected,
        failures=tuple(failures),
        holes=tuple(region.hole for region in missing.regions),
        weakest_h=None if in_row.images is None else (in_row.images[0], in_row.images[1]),
        weakest_v=None if between_rows.images is None else between_rows.images[0],
        bridges=graph.bridges,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _LeastOverlap:
    """The smallest overlaps of one kind, and the images with the smallest overlap that the guarantee applies to."""

    planned: float | None = None
    worst: float | None = None
    images: tuple[int, ...] | None = None


class _Overlaps:
    """C2, C3 and C4 of a set of images, computed on the pairs that may overlap."""

    def __init__(
        self, camera: Camera, constraints: Constraints, poses: FloatArray, rows: Sequence[int], domain: Domain
    ) -> None:
        if len(rows) != len(poses):
            raise ValueError(f"{len(poses)} poses with {len(rows)} row numbers")
        self._camera = camera
        self._constraints = constraints
        self._poses = poses
        self._domain = domain
        self._angles = yaw_pitch_roll(poses)
        self._rows = Rows.of(rows, poses, constraints.band)
        self._texture = Texture.of(camera, poses, constraints.tolerance, constraints.textured_below)
        self._tops = None if self._texture is None else self._texture.tops
        self._corners = ErrorCorners.of(camera, poses, constraints.tolerance, self._tops)
        self._first, self._second = neighbours(robust_cores(camera, poses, NO_TOLERANCE))

    def _counting(self, *images: IntArray) -> NDArray[np.bool_]:
        """Which tuples of images (k,), (k,), … count for ties, all of them."""
        if self._texture is None:
            return np.ones(len(images[0]), dtype=bool)
        return np.asarray(np.logical_and.reduce([self._texture.counts[i] for i in images]))

    def _whole(self, a: IntArray, b: IntArray) -> FloatArray:
        """What the overlaps of pairs are fractions of: the smaller of both images' parts that count, as a fraction."""
        if self._texture is None:
            return np.ones(np.broadcast_shapes(a.shape, b.shape))
        return np.asarray(np.minimum(self._texture.shares[a], self._texture.shares[b]))

    def _tops_of(self, images: IntArray) -> FloatArray | None:
        return None if self._tops is None else self._tops[images]

    def in_row(self) -> _LeastOverlap:
        """C2: both ways for each pair of neighbours in a row."""
        first, second = self._rows.neighbours(self._constraints.band.is_full_circle)
        counting = self._counting(first, second)
        first, second = first[counting], second[counting]
        a, b = np.concatenate([first, second]), np.concatenate([second, first])
        planned, worst = self._pair_overlaps(a, b)
        if self._constraints.masks and len(first):
            apart = (planned == 0) & np.tile(self._apart(first, second), 2)
            a, b, planned, worst = a[~apart], b[~apart], planned[~apart], worst[~apart]
        if not len(a):
            return _LeastOverlap()
        least = int(np.argmin(worst if self._constraints.guarantee == "all" else planned))
        return _LeastOverlap(
            planned=float(planned.min()), worst=float(worst.min()), images=(int(a[least]), int(b[least]))
        )

    def between_rows(self) -> _LeastOverlap:
        """C3: each image with the union of the row above and of the row below."""
        planned, worst, images = [], [], []
        for step in (1, -1):
            own, partners, present = self._with_texture(*self._rows.partners(self._first, self._second, step))
            if not len(own):
                continue
            # of the smaller of the image's part that counts, and of the largest of its partners'
            whole = np.where(present, self._whole(own[:, None], partners), 0.0).max(axis=1)
            whole = np.where(present.any(axis=1), whole, 1.0)
            planned.append(self._unions(own, partners, present) / whole)
            worst.append(
                planned[-1]
                if self._constraints.tolerance.is_zero
                else np.minimum(worst_union_overlaps(self._corners, own, partners, present) / whole, planned[-1])
            )
            images.append(own)
        if not images:
            return _LeastOverlap()
        all_planned, all_worst, image = np.concatenate(planned), np.concatenate(worst), np.concatenate(images)
        least = int(np.argmin(all_worst if self._constraints.guarantee == "all" else all_planned))
        return _LeastOverlap(
            planned=float(all_planned.min()), worst=float(all_worst.min()), images=(int(image[least]),)
        )

    def _with_texture(
        self, own: IntArray, partners: IntArray, present: NDArray[np.bool_]
    ) -> tuple[IntArray, IntArray, NDArray[np.bool_]]:
        """The images that count, with their partners that do; without those whose partners are geometry only."""
        if self._texture is None:
            return own, partners, present
        counts = self._texture.counts
        left = present & counts[partners]
        kept = counts[own] & (left.any(axis=1) | ~present.any(axis=1))
        return own[kept], partners[kept], left[kept]

    def _unions(self, own: IntArray, partners: IntArray, present: NDArray[np.bool_]) -> FloatArray:
        """The part (k,) of images that at least one of their partners (k, m) sees, at the planned poses."""
        parts = [
            union_overlap(
                self._camera, self._poses[own[s]], self._poses[partners[s]], present[s], tops=self._tops_of(own[s])
            )
            for s in _slices(len(own), max(1, _PAIRS_AT_A_TIME // partners.shape[1]))
        ]
        return np.concatenate(parts)

    def graph(self) -> Connection:
        """C4: the graph of the pairs with at least 5 % mutual overlap for every error."""
        once = (self._first < self._second) & self._counting(self._first, self._second)
        a, b = self._first[once], self._second[once]
        nodes = np.nonzero(self._counting(np.arange(len(self._poses))))[0]
        sure, unsure = SparseGraph(len(self._poses), nodes), []
        for some in _slices(len(a), _PAIRS_AT_A_TIME):
            one, other = self._sharing(a[some], b[some])
            if self._constraints.tolerance.is_zero:
                sure.add(one, other)
                continue
            least = np.tile(MUTUAL_OVERLAP * self._whole(one, other), 2)
            certain = self._both_ways(one, other, partial(overlaps_at_least, self._corners, least=least)) > 0
            sure.add(one[certain], other[certain])
            unsure.append((one[~certain], other[~certain]))
        quick = sure.connection()
        if quick.two_edge_connected:  # additional edges would not change that
            return quick
        for one, other in unsure:
            worst = self._both_ways(one, other, partial(worst_pair_overlaps, self._corners))
            certain = worst / self._whole(one, other) >= MUTUAL_OVERLAP - THRESHOLD_SLACK
            sure.add(one[certain], other[certain])
        return sure.connection()

    def _sharing(self, a: IntArray, b: IntArray) -> tuple[IntArray, IntArray]:
        """Those of some pairs that share enough for an edge at the planned poses."""
        planned = self._both_ways(a, b, self._planned)
        near = planned / self._whole(a, b) >= MUTUAL_OVERLAP - THRESHOLD_SLACK
        return a[near], b[near]

    def _planned(self, a: IntArray, b: IntArray) -> FloatArray:
        """The part (k,) of images a that images b see, at the planned poses."""
        return pairwise_overlap(self._camera, self._poses[a], self._poses[b], tops=self._tops_of(a))

    @staticmethod
    def _both_ways(a: IntArray, b: IntArray, shared: Callable[[IntArray, IntArray], ArrayLike]) -> FloatArray:
        """The smaller of what the first sees of the second and the second of the first, (k,)."""
        values = np.asarray(shared(np.concatenate([a, b]), np.concatenate([b, a])), dtype=np.float64)
        return np.asarray(values.reshape(2, -1).min(axis=0))

    def _pair_overlaps(self, a: IntArray, b: IntArray) -> tuple[FloatArray, FloatArray]:
        """Planned and worst overlaps; pairs with equal attitudes and equal yaw difference are computed once."""
        yaw, pitch, roll = self._angles
        marks = np.stack([pitch[a], roll[a], pitch[b], roll[b], (yaw[b] - yaw[a]) % 360.0, self._whole(a, b)], axis=1)
        if self._tops is not None:
            marks = np.column_stack([marks, self._tops[a], self._tops[b]])
        _, first, which = np.unique(np.round(marks, 9), axis=0, return_index=True, return_inverse=True)
        a, b, which = a[first], b[first], which.reshape(-1)
        whole = self._whole(a, b)
        planned = self._planned(a, b) / whole
        if self._constraints.tolerance.is_zero:
            return planned[which], planned[which]
        return planned[which], np.minimum(worst_pair_overlaps(self._corners, a, b) / whole, planned)[which]

    def _apart(self, first: IntArray, second: IntArray) -> NDArray[np.bool_]:
        yaw, pitch, roll = self._angles
        return np.array(
            [
                separated_by_mask(
                    self._domain,
                    (pitch[i] + pitch[j]) / 2,
                    *self._between(yaw[i], yaw[j], pitch[i], max(abs(roll[i]), abs(roll[j]))),
                )
                for i, j in zip(first.tolist(), second.tolist(), strict=True)
            ]
        )

    def _between(self, from_deg: float, to_deg: float, pitch_deg: float, roll_deg: float) -> tuple[float, float]:
        """The azimuths between the facing edges of two images of a row, degrees."""
        # of a rolled image not even the boresight's parallel is counted: a mask must reach from boresight to boresight
        half = 0.0 if abs(roll_deg) > _LEVEL_DEG else _half_azimuth_deg(self._camera, pitch_deg)
        width = (to_deg - from_deg) % 360.0
        return from_deg + min(half, width / 2), from_deg + max(width - half, width / 2)


def _slices(count: int, size: int) -> list[slice]:
    return [slice(start, start + size) for start in range(0, count, size)]


def _half_azimuth_deg(camera: Camera, pitch_deg: float) -> float:
    """Half the azimuth extent of an image on the parallel of its boresight, degrees; 180 about a pole."""
    # the right edge: w·(cos²p·cos λ + sin²p) = cos p·sin λ
    p = np.radians(pitch_deg)
    w, cos_p = camera.half_width, float(np.cos(p))
    lean = float(np.arctan2(w * cos_p * cos_p, cos_p))
    sine = w * float(np.sin(p)) ** 2 / max(float(np.hypot(w * cos_p * cos_p, cos_p)), 1e-300)
    return 180.0 if sine >= 1 else float(np.degrees(lean + np.arcsin(sine)))


def _failures(
    constraints: Constraints, missing: Uncovered, in_row: _LeastOverlap, between_rows: _LeastOverlap, graph: Connection
) -> list[str]:
    """One line for each condition that fails: condition, place, amount."""
    lines = []
    if missing.fraction > 0:
        lines.append(_coverage_failure(missing))
    for name, least, threshold, whom in (
        ("C2: neighbours in a row", in_row, constraints.overlap_h, "images {} and {}"),
        ("C3: an image and the adjacent row", between_rows, constraints.overlap_v, "image {}"),
    ):
        value = least.worst if constraints.guarantee == "all" else least.planned
        if least.images is not None and value is not None and value < threshold - THRESHOLD_SLACK:
            when = "with the worst pointing errors" if constraints.guarantee == "all" else "at the planned poses"
            lines.append(
                f"{name} overlap {value:.2%} {when} ({whom.format(*least.images)}), "
                f"{threshold - value:.2%} below the required {threshold:.2%}"
            )
    if not graph.connected:
        lines.append(
            f"C4: the graph of images that always share {MUTUAL_OVERLAP:.0%} has {graph.parts} separate components"
        )
    elif graph.bridges:
        a, b = graph.bridges[0]
        others = f", and {len(graph.bridges) - 1} more pairs" if len(graph.bridges) > 1 else ""
        lines.append(f"C4: the graph depends on a single edge (bridge): images {a} and {b}{others}")
    return lines


def _coverage_failure(missing: Uncovered) -> str:
    if not missing.regions:
        return "C1: coverage of the band is not guaranteed"
    hole = missing.regions[0].hole
    count = f"{len(missing.regions)} holes, the largest" if len(missing.regions) > 1 else "a hole"
    azimuth = float(wrap_180(hole.azimuth_deg))
    return (
        f"C1: {count} {hole.size_deg:.3g}° across at elevation {hole.elevation_deg:.2f}°, azimuth {azimuth:.2f}°; "
        f"coverage is not guaranteed for {missing.fraction:.3g} of the band"
    )
