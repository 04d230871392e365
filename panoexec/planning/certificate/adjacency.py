"""Which images overlap: neighbours in a row, images of adjacent rows, and the overlap graph (C4).

The graph of C4 has an edge where two images see at least 5 % of each other, both ways, for every pointing error. The
graph for any particular combination of errors has at least these edges; additional edges never disconnect a graph nor
turn another edge into a bridge. So a property proven for this graph holds for all of them.

**Small plans.** A single image has no edge to lose: connected, and stays so. Two images have one edge, whose loss
disconnects them: by C4 (docs/contract.md) they are not certified, nor is a chain of images that overlap their
immediate neighbours alone, as in a single row of a sector. Three images that all overlap are the least that is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, yaw_pitch_roll
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.model import Band

MUTUAL_OVERLAP = 0.05
"""Minimum overlap, both ways, for an edge of the graph."""

IntArray = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Images grouped by row.

    Attributes:
        members: for each row number in ascending order, its images' indices, clockwise from the sector's start.
        row_of: (n,) position in `members` of each image's row.
    """

    members: tuple[IntArray, ...]
    row_of: IntArray

    @staticmethod
    def of(rows: Sequence[int], rotations: FloatArray, band: Band) -> Rows:
        """Sort images by row number and yaw."""
        numbers, row_of = np.unique(np.asarray(rows, dtype=np.int64), return_inverse=True)
        yaw, _, _ = yaw_pitch_roll(rotations)
        # a sector is cut opposite its middle, the full circle at an arbitrary azimuth
        opposite = (band.azimuth_min_deg + band.azimuth_max_deg) / 2 - 180.0
        clockwise = (yaw - opposite) % 360.0
        order = np.lexsort((clockwise, row_of))
        limits = np.searchsorted(row_of[order], np.arange(1, len(numbers)))
        return Rows(members=tuple(np.split(order, limits)) if len(order) else (), row_of=row_of.reshape(-1))

    def neighbours(self, closed: bool) -> tuple[IntArray, IntArray]:
        """Pairs of consecutive images in a row; with `closed` also the last and the first of each row."""
        firsts, seconds = [np.empty(0, dtype=np.intp)], [np.empty(0, dtype=np.intp)]
        for row in self.members:
            count = len(row) if closed and len(row) > 2 else len(row) - 1
            firsts.append(row[:count])
            seconds.append(np.roll(row, -1)[:count])
        return np.concatenate(firsts), np.concatenate(seconds)

    def partners(self, first: IntArray, second: IntArray, step: int) -> tuple[IntArray, IntArray, NDArray[np.bool_]]:
        """For each image that has an adjacent row in direction `step`, the images of that row that may overlap it.

        Args:
            first: first images of all ordered pairs that may overlap, sorted.
            second: the second images of these pairs.
            step: +1 for the next row, -1 for the previous.

        Returns:
            Images (k,), their partners (k, m), and the mask (k, m) of entries that are not padding; m ≥ 1.
        """
        target = self.row_of + step
        images = np.nonzero((target >= 0) & (target < len(self.members)))[0]
        chosen = self.row_of[second] == target[first]
        own, other = first[chosen], second[chosen]
        position = np.full(len(self.row_of), -1)
        position[images] = np.arange(len(images))
        line = position[own]
        counts = np.bincount(line, minlength=len(images))
        slot = np.arange(len(line)) - (np.cumsum(counts) - counts)[line]
        partners = np.zeros((len(images), max(int(counts.max(initial=0)), 1)), dtype=np.intp)
        present = np.zeros(partners.shape, dtype=bool)
        partners[line, slot], present[line, slot] = other, True
        return images, partners, present


def separated_by_mask(domain: Domain, pitch_deg: float, from_deg: float, to_deg: float) -> bool:
    """Whether masks remove everything on a row's parallel between two azimuths (clockwise)."""
    row = int(np.searchsorted(domain.elevations_deg, pitch_deg, side="right")) - 1
    cells = domain.inside[min(max(row, 0), len(domain.inside) - 1)]
    start = (from_deg - domain.azimuths_deg[0]) % 360.0
    stop = start + (to_deg - from_deg) % 360.0
    limits = domain.azimuths_deg - domain.azimuths_deg[0]
    meets = ((limits[:-1] < stop) & (limits[1:] > start)) | ((limits[:-1] + 360 < stop) & (limits[1:] + 360 > start))
    return not bool(np.any(cells & meets))


@dataclass(frozen=True, slots=True, kw_only=True)
class Connection:
    """Connectivity of a graph: number of components and bridges."""

    parts: int
    bridges: tuple[tuple[int, int], ...]

    @property
    def connected(self) -> bool:
        """Whether every image can be reached from every other."""
        return self.parts <= 1

    @property
    def two_edge_connected(self) -> bool:
        """Whether the graph stays connected after the removal of any one edge."""
        return self.connected and not self.bridges


class SparseGraph:
    """A graph that keeps of its edges only what decides about components and bridges: at most 2·(n - 1).

    These are a spanning forest, and a spanning forest of the other edges. A cut that one or no edge of the graph
    crosses is crossed by the same edges here, and one that more edges cross by at least two (Nagamochi and Ibaraki
    1992). So the memory does not grow with the number of edges, which may be the square of the number of images.

    Args:
        count: number of images.
        nodes: the images that are nodes of the graph; by default all. Edges must be between these.
    """

    def __init__(self, count: int, nodes: IntArray | None = None) -> None:
        self._count = count
        self._nodes = nodes
        self._forests = [list(range(count)) for _ in range(2)]
        self._first: list[int] = []
        self._second: list[int] = []

    def add(self, first: IntArray, second: IntArray) -> None:
        """Add undirected edges (k,); each must be given only once."""
        for a, b in zip(first.tolist(), second.tolist(), strict=True):
            for parent in self._forests:
                root_a, root_b = _root(parent, a), _root(parent, b)
                if root_a != root_b:
                    parent[root_a] = root_b
                    self._first.append(a)
                    self._second.append(b)
                    break

    def connection(self) -> Connection:
        """Components and bridges of the whole graph."""
        first, second = (np.array(ends, dtype=np.intp) for ends in (self._first, self._second))
        if self._nodes is None or len(self._nodes) == self._count:
            return connection(self._count, first, second)
        place = np.full(self._count, -1)
        place[self._nodes] = np.arange(len(self._nodes))
        found = connection(len(self._nodes), place[first], place[second])
        names = self._nodes.tolist()
        return replace(found, bridges=tuple((names[a], names[b]) for a, b in found.bridges))


def _root(parent: list[int], node: int) -> int:
    while parent[node] != node:
        parent[node] = node = parent[parent[node]]
    return node


def connection(count: int, first: IntArray, second: IntArray) -> Connection:
    """Components and bridges of an undirected graph (Tarjan 1974), without recursion.

    Args:
        count: number of nodes.
        first: (k,) one end of each edge; each edge is listed once, in either direction.
        second: (k,) its other end.

    Returns:
        Number of connected components, and the bridges as pairs with the lower index first.
    """
    edge_ends = np.concatenate([first, second])
    order = np.argsort(edge_ends, kind="stable")
    begin = np.searchsorted(edge_ends[order], np.arange(count + 1)).tolist()
    heads = np.concatenate([second, first])[order].tolist()
    edges = (order % max(len(first), 1)).tolist()
    reached, low = [-1] * count, [0] * count
    upcoming = begin[:-1].copy()
    bridges: list[tuple[int, int]] = []
    clock = parts = 0
    for root in range(count):
        if reached[root] >= 0:
            continue
        parts += 1
        reached[root] = low[root] = clock
        clock += 1
        path = [(root, -1)]
        while path:
            node, came_by = path[-1]
            if upcoming[node] < begin[node + 1]:
                slot = upcoming[node]
                upcoming[node] += 1
                head = heads[slot]
                if edges[slot] == came_by:
                    continue
                if reached[head] >= 0:
                    low[node] = min(low[node], reached[head])
                    continue
                reached[head] = low[head] = clock
                clock += 1
                path.append((head, edges[slot]))
                continue
            path.pop()
            if path:
                parent = path[-1][0]
                low[parent] = min(low[parent], low[node])
                if low[node] > reached[parent]:
                    bridges.append((min(parent, node), max(parent, node)))
    return Connection(parts=parts, bridges=tuple(sorted(bridges)))
