"""The proof of coverage (C1): it detects every hole, of any size.

Given are convex spherical polygons Kᵢ (the robust cores, see `robust_footprint`) and a closed domain D (see
`panoexec.planning.geometry.domain`) with finitely many connected components.

**Theorem.** If (a) every point of every border ∂Kᵢ that lies in D is in the interior of some other Kⱼ, and (b) each
connected component of D has at least one point in some Kᵢ, then D is covered by the union of the Kᵢ.

*Proof.* C = D ∩ ∪Kᵢ is closed in D, as a finite union of closed sets. It is also open in D: a point of C is in the
interior of some Kᵢ, or on a border, and then by (a) in the interior of some Kⱼ; in both cases C contains a
neighbourhood of it in D. So C is a union of connected components of D, and by (b) it contains all of them. ∎

So the question about a surface reduces to one about arcs. An edge of Kᵢ is the arc of directions of (1 - s)·p + s·q,
s in [0, 1]; each half-space of Kⱼ is linear in s, so Kⱼ covers one interval of s, computed by divisions alone. The
intervals outside the domain need no cover. The edge passes if all these intervals together cover [0, 1].

**Error bound.** "In the interior" is tested as "at least `MARGIN_RAD` = 1e-9 rad inside all edges", four orders of
magnitude above the rounding error. So a cover that passes is proven, and a true cover fails only if some direction is
less than 1e-9 rad (6e-8°) inside every core. In particular, images that merely touch do not pass.

Cost: each core is compared only with cores whose caps overlap its own, found with a grid of cells: about O(n log n).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.planning.certificate.robust_footprint import Cores
from panoexec.planning.geometry.domain import Domain

MARGIN_RAD = 1e-9
"""Depth inside a core from which a direction counts as covered."""

_SLACK = 1e-12
"""Gaps in the chord parameter up to this size are rounding errors; it is far below the margin."""

_MEET = 1e-9
"""Rounding error of the cosine that tells whether two caps overlap."""

_DENSE = 300
_AT_A_TIME = 1 << 18


@dataclass(frozen=True, slots=True, kw_only=True)
class Gaps:
    """Arcs of the cores' borders in the domain that no other core covers.

    Attributes:
        images: (k,) index of the core.
        edges: (k,) index of its edge.
        starts: (k, 3) unit vectors; from start to end the core lies on the left, as seen from outside the sphere.
        ends: (k, 3) unit vectors.
    """

    images: NDArray[np.intp]
    edges: NDArray[np.intp]
    starts: FloatArray
    ends: FloatArray

    def __len__(self) -> int:
        return len(self.images)


def is_covered(cores: Cores, domain: Domain) -> bool:
    """Whether the cores provably cover the domain (theorem of the module docstring)."""
    if np.any(cores.depth(domain.cell_centres()) < MARGIN_RAD):
        return False
    return len(border_gaps(cores, domain)) == 0


def border_gaps(cores: Cores, domain: Domain, margin_rad: float = MARGIN_RAD) -> Gaps:
    """All border arcs in the domain that are not `margin_rad` inside another core: violations of condition (a)."""
    first, second = neighbours(cores)
    begin = np.searchsorted(first, np.arange(len(cores) + 1))
    most = int(np.diff(begin).max(initial=0))
    corners = cores.vertices.shape[1]
    # compared are all corners of a core with all of a neighbour, and all its edges with all boxes outside the domain
    block = max(1, _AT_A_TIME // max(1, most * corners**2, corners * len(domain.outside_boxes)))
    found = []
    for start in range(0, len(cores), block):
        stop = min(start + block, len(cores))
        pairs = slice(begin[start], begin[stop])
        found.append(_gaps_of(cores, domain, range(start, stop), (first[pairs], second[pairs]), margin_rad))
    return Gaps(
        images=np.concatenate([g.images for g in found]) if found else np.empty(0, dtype=np.intp),
        edges=np.concatenate([g.edges for g in found]) if found else np.empty(0, dtype=np.intp),
        starts=np.concatenate([g.starts for g in found]) if found else np.empty((0, 3)),
        ends=np.concatenate([g.ends for g in found]) if found else np.empty((0, 3)),
    )


def neighbours(cores: Cores) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """All ordered pairs of different cores whose bounding caps overlap, sorted by the first.

    Near-linear: cores are sorted into cubes whose edge is the largest relevant distance of two centres, and only cores
    in the same or in adjacent cubes are compared.
    """
    some = np.nonzero(~cores.empty)[0]
    centres, radii = cores.centres[some], cores.radii[some]
    widest = float(radii.max(initial=0.0))
    if len(some) <= _DENSE or widest > math.pi / 6:
        first, second = _all_that_meet(centres, radii)
        return some[first], some[second]
    first, second = _pairs_by_cell(centres, 2 * math.sin(widest) + 1e-6)
    meet = np.concatenate(
        [
            np.sum(centres[first[s]] * centres[second[s]], axis=1)
            >= np.cos(np.minimum(radii[first[s]] + radii[second[s]], math.pi)) - _MEET
            for s in (slice(start, start + _AT_A_TIME) for start in range(0, max(len(first), 1), _AT_A_TIME))
        ]
    )
    first, second = some[first[meet]], some[second[meet]]
    order = np.argsort(first, kind="stable")
    return first[order], second[order]


def _all_that_meet(centres: FloatArray, radii: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Ordered pairs of different caps that overlap, sorted by the first; a block of caps at a time with all others."""
    n = len(centres)
    step = max(1, _AT_A_TIME // max(n, 1))
    firsts, seconds = [np.empty(0, dtype=np.intp)], [np.empty(0, dtype=np.intp)]
    for start in range(0, n, step):
        own = slice(start, start + step)
        meet = centres[own] @ centres.T >= np.cos(np.minimum(radii[own, None] + radii, math.pi)) - _MEET
        first, second = np.nonzero(meet)
        other = first + start != second
        firsts.append(first[other] + start)
        seconds.append(second[other])
    return np.concatenate(firsts), np.concatenate(seconds)


def _pairs_by_cell(centres: FloatArray, size: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Ordered pairs of different points in the same or in adjacent cubes of edge `size`."""
    cell = np.floor((centres + 1.0) / size).astype(np.int64) + 1
    base = int(2.0 / size) + 4
    key = (cell[:, 0] * base + cell[:, 1]) * base + cell[:, 2]
    order = np.argsort(key, kind="stable")
    in_order = key[order]
    firsts, seconds = [], []
    for shift_x in (-1, 0, 1):
        for shift_y in (-1, 0, 1):
            wanted = key + (shift_x * base + shift_y) * base
            # three cubes along z have consecutive keys, so one range of the sorted keys holds them
            begin = np.searchsorted(in_order, wanted - 1, side="left")
            count = np.searchsorted(in_order, wanted + 1, side="right") - begin
            first = np.repeat(np.arange(len(key)), count)
            offset = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
            firsts.append(first)
            seconds.append(order[np.repeat(begin, count) + offset])
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    other = first != second
    return first[other], second[other]


def _gaps_of(
    cores: Cores, domain: Domain, some: range, pairs: tuple[NDArray[np.intp], NDArray[np.intp]], margin_rad: float
) -> Gaps:
    """The gaps of the images in `some`, given all ordered pairs with their neighbours."""
    first, second = pairs
    start, count = some.start, len(some)
    own = first - start
    counts = np.bincount(own, minlength=count)
    slot = np.arange(len(own)) - (np.cumsum(counts) - counts)[own]
    v = cores.vertices.shape[1]
    low, high = _covered_intervals(cores.vertices[first], cores.normals[second], margin_rad)
    lows = np.full((count, max(int(counts.max(initial=0)), 1), v), 2.0)
    highs = np.full(lows.shape, -1.0)
    lows[own, slot], highs[own, slot] = low, high
    image, edge = np.nonzero(cores.is_edge[start : start + count])
    starts = cores.vertices[start + image, edge]
    ends = cores.vertices[start + image, (edge + 1) % v]
    outside_low, outside_high = domain.outside_intervals(starts, ends)
    arc, s_0, s_1 = _uncovered(
        np.concatenate([lows[image, :, edge], outside_low], axis=1),
        np.concatenate([highs[image, :, edge], outside_high], axis=1),
    )
    return Gaps(
        images=start + image[arc],
        edges=edge[arc],
        starts=_on_arc(starts[arc], ends[arc], s_0),
        ends=_on_arc(starts[arc], ends[arc], s_1),
    )


def _covered_intervals(vertices: FloatArray, normals: FloatArray, margin_rad: float) -> tuple[FloatArray, FloatArray]:
    """The interval of each edge that is deep enough inside another core.

    Args:
        vertices: (p, v, 3) corners of the polygons whose edges are tested.
        normals: (p, w, 3) edge normals of the cores that may cover them.
        margin_rad: required depth.

    Returns:
        Limits (p, v) of the chord parameter; lower > upper where nothing is covered.
    """
    at_start = vertices @ np.swapaxes(normals, 1, 2) - margin_rad
    at_end = np.roll(at_start, -1, axis=1)
    # points of the chord have length ≤ 1, so a distance of at least the margin from a plane is sufficient
    span = at_start - at_end
    zero = at_start / np.where(span == 0, 1.0, span)
    starts_in, ends_in = at_start >= 0, at_end >= 0
    low = np.where(starts_in, 0.0, np.where(ends_in, zero, 2.0)).max(axis=2, initial=0.0)
    high = np.where(ends_in, 1.0, np.where(starts_in, zero, -1.0)).min(axis=2, initial=1.0)
    return low, high


def _uncovered(low: FloatArray, high: FloatArray) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """The parts of [0, 1] that the intervals (m, k) of a row leave uncovered: row indices, lower and upper limits."""
    nothing = low > high
    low, high = np.where(nothing, 0.0, low), np.where(nothing, 0.0, high)
    order = np.argsort(low, axis=1)
    ends = np.zeros((len(low), 1))
    low = np.concatenate([np.take_along_axis(low, order, axis=1), ends + 1.0], axis=1)
    reached = np.maximum.accumulate(np.concatenate([ends, np.take_along_axis(high, order, axis=1)], axis=1), axis=1)
    row, column = np.nonzero(low - reached > _SLACK)
    return row, reached[row, column], low[row, column]


def _on_arc(starts: FloatArray, ends: FloatArray, s: FloatArray) -> FloatArray:
    points = (1.0 - s[:, None]) * starts + s[:, None] * ends
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))
