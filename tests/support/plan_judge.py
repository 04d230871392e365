"""A second judge of certified plans: C1 to C4 by counting points and by random pointing errors, without the proofs.

C1 is judged by random directions, C2 and C3 by a raster over the images that a lens shows, C4 by the graph of the
images as they are taken. Every condition that the guarantee extends to pointing errors is judged with random ones and
with the largest ones. Lenses show what their distortion says, with their border as much nearer as `fov_margin` allows.
What is counted cannot prove a plan, but it finds what a proof that is wrong lets pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import elevation_azimuth, rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.texture import LEAST_COUNTED, MARGIN_DEG, Texture
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import Plan
from tests.unit.planning.brute import Array, Mask, in_domain, random_directions, with_errors

_DIRECTIONS = 3000
_RASTER = 96
_SLACK = 0.004
"""What a raster may be off, as a fraction of an image: five times its standard deviation."""

_IMAGES = 80
"""Images whose overlaps are counted; of larger plans as many, and those that the certificate calls the weakest."""

_EDGE = 0.05
_POINTS_BETWEEN = 60


def violations(plan: Plan, seed: int = 0) -> list[str]:
    """The conditions that a plan breaks, one line each; none if it is right."""
    return list(_Judge(plan, np.random.default_rng(seed)).lines())


class _Judge:
    def __init__(self, plan: Plan, rng: np.random.Generator) -> None:
        self._plan, self._camera, self._asked, self._rng = plan, plan.camera, plan.constraints, rng
        self._planned = rotation([s.yaw_deg for s in plan.shots], [s.pitch_deg for s in plan.shots])
        self._rows = np.array([s.row for s in plan.shots])
        self._yaw = np.array([s.yaw_deg for s in plan.shots])
        texture = Texture.of(self._camera, self._planned, self._asked.tolerance, self._asked.textured_below)
        count = len(plan.shots)
        self._tops = np.full(count, -np.inf) if texture is None else texture.tops
        self._shares = np.ones(count) if texture is None else texture.shares
        self._counts = self._shares >= LEAST_COUNTED
        self._some = self._images_judged()
        self._raster = Raster.of(plan.camera, rng)

    def _images_judged(self) -> list[int]:
        count, certificate = len(self._planned), self._plan.certificate
        if count <= _IMAGES:
            return list(range(count))
        some = set(self._rng.choice(count, _IMAGES, replace=False).tolist())
        if certificate is not None:
            some |= set(certificate.weakest_h or ()) | ({certificate.weakest_v} - {None})
        return sorted(some)

    def lines(self) -> Iterator[str]:
        for extreme in (False, True):
            taken = with_errors(self._planned, self._asked.tolerance, self._rng, extreme=extreme)
            yield from self._coverage(taken)
            yield from self._sky(taken)
            yield from self._graph(taken)
            if self._asked.guarantee == "all":
                yield from self._overlaps(taken)
            if self._asked.tolerance.is_zero:
                break
        yield from self._overlaps(self._planned)

    def _coverage(self, taken: Array) -> Iterator[str]:
        some = random_directions(40 * _DIRECTIONS, self._rng)
        left = some[in_domain(some, self._asked.band, self._asked.masks)][:_DIRECTIONS]
        for turn in taken:
            left = left[~shown(self._camera, turn, left)]
        if len(left):
            yield f"C1: {len(left)} of {_DIRECTIONS} directions are in no image"

    def _sky(self, taken: Array) -> Iterator[str]:
        """Whether what counts lies under the skyline, and the images without it are marked."""
        sky = self._asked.textured_below
        marked = [s.geometry_only for s in self._plan.shots]
        if marked != (~self._counts).tolist():
            yield "sky: images that see it alone are not those marked"
        if sky is None:
            return
        azimuths, elevations = zip(*sky.points, strict=True)
        for i in self._some:
            top, w, h = max(self._tops[i], -self._camera.half_height), self._camera.half_width, self._camera.half_height
            if top >= h:
                continue
            rays = np.stack([np.ones(200), self._rng.uniform(-w, w, 200), self._rng.uniform(top, h, 200)], axis=1)
            elevation, azimuth = elevation_azimuth(rays @ taken[i].T)
            limit = np.interp(azimuth, azimuths, elevations, period=360.0) - MARGIN_DEG
            if np.any(np.asarray(elevation) > limit + 1e-6):
                yield f"sky: of image {i} counts what is above the skyline"

    def _graph(self, taken: Array) -> Iterator[str]:
        nodes = np.nonzero(self._counts)[0]
        if len(nodes) < 2:
            return
        a, b = (nodes[side] for side in np.triu_indices(len(nodes), 1))
        near = self._may_meet(taken, a, b)
        a, b = a[near], b[near]
        tops = None if self._asked.textured_below is None else self._tops
        mutual = np.minimum(
            pairwise_overlap(self._camera, taken[a], taken[b], tops=None if tops is None else tops[a]),
            pairwise_overlap(self._camera, taken[b], taken[a], tops=None if tops is None else tops[b]),
        )
        edges = mutual >= _EDGE * np.minimum(self._shares[a], self._shares[b]) - 1e-9
        if not holds_without_any_edge(nodes.tolist(), list(zip(a[edges].tolist(), b[edges].tolist(), strict=True))):
            yield "C4: the graph falls apart, or does without one edge"

    def _may_meet(self, poses: Array, a: NDArray[np.intp], b: NDArray[np.intp]) -> Mask:
        reach = np.arctan(np.hypot(self._camera.half_width, self._camera.half_height))
        return np.asarray(np.sum(poses[a, :, 0] * poses[b, :, 0], axis=1) >= np.cos(min(2 * reach, np.pi)) - 1e-9)

    def _overlaps(self, poses: Array) -> Iterator[str]:
        rows = sorted(set(self._rows.tolist()))
        members = {row: self._in_order(row) for row in rows}
        for i in self._some:
            if not self._counts[i]:
                continue
            row = rows.index(int(self._rows[i]))
            yield from self._with_neighbours(poses, i, members[rows[row]])
            for beside in (row - 1, row + 1):
                if 0 <= beside < len(rows):
                    yield from self._with_row(poses, i, members[rows[beside]])

    def _in_order(self, row: int) -> list[int]:
        band = self._asked.band
        opposite = (band.azimuth_min_deg + band.azimuth_max_deg) / 2 - 180.0
        own = np.nonzero(self._rows == row)[0]
        return [int(i) for i in own[np.argsort((self._yaw[own] - opposite) % 360.0)]]

    def _with_neighbours(self, poses: Array, i: int, row: Sequence[int]) -> Iterator[str]:
        place, last = row.index(i), len(row) - 1
        closed = self._asked.band.is_full_circle and len(row) > 2
        beside = {(place - 1) % len(row), (place + 1) % len(row)} if closed else {place - 1, place + 1}
        for j in (row[k] for k in beside if 0 <= k <= last and k != place):
            if not self._counts[j]:
                continue
            whole = float(min(self._shares[i], self._shares[j]))
            share = self._seen(poses, i, [j])
            if share < self._asked.overlap_h * whole - _SLACK and not (share == 0 and self._masked_between(i, j)):
                yield f"C2: image {i} shares {share / whole:.4f} with image {j}"

    def _with_row(self, poses: Array, i: int, row: Sequence[int]) -> Iterator[str]:
        others = np.array(row)
        near = others[self._may_meet(self._planned, np.full(len(others), i), others)]
        counting = near[self._counts[near]]
        if len(near) and not len(counting):
            return
        whole = float(np.minimum(self._shares[i], self._shares[counting]).max(initial=0.0)) or 1.0
        share = self._seen(poses, i, counting.tolist())
        if share < self._asked.overlap_v * whole - _SLACK:
            yield f"C3: image {i} shares {share / whole:.4f} with row {int(self._rows[row[0]])}"

    def _seen(self, poses: Array, i: int, others: Sequence[int]) -> float:
        """The part of an image that counts and that one of the others shows: the least of the lenses that may be."""
        return min(
            self._raster.seen(self._camera, poses[i], poses[list(others)], top=float(self._tops[i]), scale=scale)
            for scale in ({1.0, 1 - self._camera.fov_margin} if self._camera.lens_used == "calibrated" else {1.0})
        )

    def _masked_between(self, i: int, j: int) -> bool:
        """Whether masks leave nothing on the parallel between two images."""
        if not self._asked.masks:
            return False
        pitch = (self._plan.shots[i].pitch_deg + self._plan.shots[j].pitch_deg) / 2
        turn = (self._yaw[j] - self._yaw[i] + 180.0) % 360.0 - 180.0
        yaws = self._yaw[i] + turn * np.linspace(0.0, 1.0, _POINTS_BETWEEN)
        between = rotation(yaws, np.full(len(yaws), pitch))[:, :, 0]
        for k in (i, j):
            between = between[~shown(self._camera, self._planned[k], between)]
        return not in_domain(between, self._asked.band, self._asked.masks).any()


def shown(camera: Camera, turn: Array, directions: Array, *, scale: float | None = None) -> Mask:
    """Whether an image shows directions (n, 3), with its border nearer by `scale`, by default as near as it may be."""
    nearer = scale
    if nearer is None:
        nearer = 1 - camera.fov_margin if camera.lens_used == "calibrated" else 1.0
    local = directions @ turn
    ahead = local[:, 0] > 1e-9
    ideal = local[:, 1:] / np.where(ahead, local[:, 0], 1.0)[:, None] / nearer
    across, down = camera.places(ideal[:, 0], ideal[:, 1])
    return np.asarray(ahead & (np.abs(across) <= 1 + 1e-9) & (np.abs(down) <= 1 + 1e-9))


@dataclass(frozen=True, slots=True)
class Raster:
    """Points (n, 2) of the ideal image plane that an image shows, one in each cell of it, and their areas (n,)."""

    ideal: Array
    areas: Array

    @staticmethod
    def of(camera: Camera, rng: np.random.Generator) -> Raster:
        """At random within the cells."""
        cells = (np.arange(_RASTER) * 2.0 + 1.0) / _RASTER - 1.0
        across, down = (
            grid.ravel() + rng.uniform(-1.0, 1.0, _RASTER**2) / _RASTER
            for grid in np.meshgrid(cells, cells, indexing="ij")
        )
        ideal, lens = camera.rays(across, down), camera.distortion_used
        areas = np.ones(len(ideal)) if lens is None else 1 / np.linalg.det(lens.jacobian(ideal))
        return Raster(ideal, areas / areas.sum())

    def seen(self, camera: Camera, own: Array, others: Array, *, top: float = -np.inf, scale: float = 1.0) -> float:
        """The part of an image's area, below a line of its ideal plane, that others (m, 3, 3) show."""
        ideal = self.ideal * scale
        counted = ideal[:, 1] >= top
        ideal, areas = ideal[counted], self.areas[counted]
        rays = np.concatenate([np.ones((len(ideal), 1)), ideal], axis=1) @ own.T
        seen = np.zeros(len(rays), dtype=bool)
        for other in others:
            seen[~seen] = shown(camera, other, rays[~seen], scale=scale)
        return float(areas[seen].sum())


def holds_without_any_edge(nodes: Sequence[int], edges: Sequence[tuple[int, int]]) -> bool:
    """Whether a graph is connected, and stays so without any one of its edges.

    Every edge beside a spanning tree gets a random mark, every edge of the tree the sum (XOR) of the marks of those
    that close a circle with it. An edge without any such circle, a bridge, is marked 0; another one with a probability
    of 2⁻⁶⁰.
    """
    beside: dict[int, list[tuple[int, int]]] = {node: [] for node in nodes}
    for number, (a, b) in enumerate(edges):
        beside[a].append((b, number))
        beside[b].append((a, number))
    parent, order, tree = {nodes[0]: nodes[0]}, [nodes[0]], set[int]()
    for node in order:
        for other, number in beside[node]:
            if other not in parent:
                parent[other] = node
                tree.add(number)
                order.append(other)
    if len(order) < len(nodes):
        return False
    marks = dict.fromkeys(nodes, 0)
    drawn = np.random.default_rng(60).integers(1, 1 << 60, len(edges)).tolist()
    for number, (a, b) in enumerate(edges):
        if number not in tree:
            marks[a] ^= drawn[number]
            marks[b] ^= drawn[number]
    for node in reversed(order[1:]):
        if not marks[node]:
            return False
        marks[parent[node]] ^= marks[node]
    return True
