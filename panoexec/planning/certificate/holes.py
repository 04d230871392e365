"""Where coverage fails: the connected holes, each with a direction in it, its extent, its solid angle and its outline.

A hole is bounded by the arcs of cores' borders that no other core covers (`coverage.border_gaps`) and by arcs of the
domain's border. Its solid angle follows from these arcs alone (Stokes): with z down and λ the azimuth, a region to the
left of its border has the area ∮ (1 - z) dλ, where the zenith, if uncovered, counts as a parallel of length 0. An arc
of a great circle contributes the signed area of its triangle with the nadir, a parallel (1 - z)·Δλ, a meridian 0.
Whatever the size and number of holes, the error of the uncovered solid angle is at most 2e-7 rad times the length of
the holes' borders: all cores are first shrunk by that angle, so that none of them merely touch.

Arcs belong to the same hole if their ends meet, or if a ray from one into the hole ends on the other. The proof of
coverage does not use this module; it only locates the failures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray, direction, elevation_azimuth
from panoexec.optics import Camera
from panoexec.planning.certificate.coverage import Gaps, border_gaps, is_covered
from panoexec.planning.certificate.robust_footprint import Cores, robust_cores
from panoexec.planning.geometry.domain import GROWTH_RAD, Border, Domain
from panoexec.planning.model import Constraints, Hole

_ZENITH_DEG = 90.0 - 1e-7
_SHRINK_RAD = 1e-7
_MEET_RAD = 1e-6
_MOST_RAYS = 200
_MOST_POINTS = 1000
_RAY_RAD = 3.0
_STEP_DEG = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HoleRegion:
    """One connected part of the domain without guaranteed coverage.

    Attributes:
        hole: a direction in it and a bound of its angular diameter.
        solid_angle_sr: its solid angle, steradians.
        outline: (k, 3) world unit vectors, unordered. A convex footprint (or core) that contains them all contains the
            hole, if the hole is smaller than a hemisphere.
    """

    hole: Hole
    solid_angle_sr: float
    outline: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncovered:
    """All parts without guaranteed coverage: fraction of the domain's solid angle, and holes, largest first."""

    fraction: float
    regions: tuple[HoleRegion, ...]


def coverage_holes(camera: Camera, constraints: Constraints, rotations: ArrayLike) -> tuple[HoleRegion, ...]:
    """The holes that images leave in the band, largest first; empty if and only if coverage is proven.

    Args:
        camera: the camera.
        constraints: band, masks and tolerance.
        rotations: camera-to-world rotations (n, 3, 3), planned or measured.
    """
    domain = Domain.of(constraints.band, constraints.masks)
    return uncovered(robust_cores(camera, rotations, constraints.tolerance), domain).regions


def uncovered(cores: Cores, domain: Domain) -> Uncovered:
    """The parts of the domain that the cores do not cover, by the same test as `coverage.is_covered`."""
    if is_covered(cores, domain):
        return Uncovered(fraction=0.0, regions=())
    cores = _shrunk(cores)
    pieces = _pieces(cores, domain, border_gaps(cores, domain, margin_rad=0.0))
    owner = _joined(pieces)
    middles, depths, hits = _rays(cores, domain, pieces, owner)
    for piece, other in hits:
        owner[owner == owner[other]] = owner[piece]
    # a covered island inside a hole is an inner border of it: by itself its area is negative
    areas = {label: pieces.areas[owner == label].sum() for label in np.unique(owner)}
    largest = max(areas, key=lambda label: areas[label])
    for label, area in areas.items():
        if area < -_MEET_RAD:
            owner[owner == label] = largest
    regions = [
        _region(pieces.select(owner == label), middles[owner == label], depths[owner == label])
        for label in np.unique(owner)
    ]
    fraction = float(pieces.areas.sum()) / domain.solid_angle_sr
    # images that only touch leave a hole of area 0, which still counts as a hole
    fraction = min(max(fraction, float(np.finfo(np.float64).eps)), 1.0)
    return Uncovered(
        fraction=fraction, regions=tuple(sorted(regions, key=lambda r: (-r.hole.size_deg, -r.solid_angle_sr)))
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pieces:
    """Arcs of the border of the uncovered region.

    Attributes:
        starts, ends: (p, 3) unit vectors.
        middles: (p, 3) unit vectors.
        inward: (p, 3) unit vectors at the middles, perpendicular to the arc, into the hole.
        areas: (p,) contributions to the solid angle, steradians.
        lengths: (p,) radians.
        images: (p,) index of the core whose border it is; -1 for the domain's border.
        parallels: (p, 3) elevation, from and to azimuth, degrees; NaN for other arcs.
    """

    starts: FloatArray
    ends: FloatArray
    middles: FloatArray
    inward: FloatArray
    areas: FloatArray
    lengths: FloatArray
    images: NDArray[np.intp]
    parallels: FloatArray

    def __len__(self) -> int:
        return len(self.starts)

    def select(self, which: NDArray[np.bool_]) -> _Pieces:
        return _Pieces(**{name: getattr(self, name)[which] for name in self.__slots__})


def _shrunk(cores: Cores) -> Cores:
    """Cores with each edge plane rotated inwards by one to two times `_SHRINK_RAD`, by a different angle for each core.

    So no two borders coincide, and where images merely touch there is a hole with an interior. The angle is far larger
    than the margin of the proof, so every failure of the proof leaves a hole here, too.
    """
    cores = cores.select(~cores.empty)
    amount = _SHRINK_RAD * (1 + (np.arange(len(cores)) * 0.6180339887498949) % 1.0)
    normals = cores.normals - amount[:, None, None] * cores.centres[:, None]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    # corner k is the intersection of edges k - 1 and k; before the first edge comes the last one that is not padding
    v = normals.shape[1]
    last = cores.is_edge.sum(axis=1) - 1
    before = np.where(np.arange(v) == 0, last[:, None], np.arange(v) - 1)
    vertices = np.cross(np.take_along_axis(normals, before[..., None], axis=1), normals)
    vertices /= np.maximum(np.linalg.norm(vertices, axis=2, keepdims=True), 1e-300)
    vertices = np.where(cores.is_edge[..., None], vertices, vertices[:, :1])
    return replace(cores, vertices=vertices, normals=np.where(cores.is_edge[..., None], normals, normals[:, :1]))


def _pieces(cores: Cores, domain: Domain, gaps: Gaps) -> _Pieces:
    middles = gaps.starts + gaps.ends
    middles = middles / np.linalg.norm(middles, axis=1, keepdims=True)
    normals = cores.normals[gaps.images, gaps.edges]
    parts = [
        _Pieces(
            starts=gaps.starts,
            ends=gaps.ends,
            middles=middles,
            inward=-normals,
            areas=-_triangles_with_nadir(gaps.starts, gaps.ends),
            lengths=_angles(gaps.starts, gaps.ends),
            images=gaps.images,
            parallels=np.full((len(gaps), 3), np.nan),
        )
    ]
    parts += [piece for border in domain.borders() if (piece := _border_pieces(cores, border)) is not None]
    return _Pieces(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in _Pieces.__slots__})


def _triangles_with_nadir(starts: FloatArray, ends: FloatArray) -> FloatArray:
    """Signed areas of spherical triangles (nadir, start, end), (p,); 0 for an arc through the zenith."""
    turn = starts[:, 0] * ends[:, 1] - starts[:, 1] * ends[:, 0]
    turn = np.where(np.abs(turn) < 1e-15, 0.0, turn)
    rest = 1.0 + starts[:, 2] + ends[:, 2] + np.sum(starts * ends, axis=1)
    return np.where(turn == 0, 0.0, 2 * np.arctan2(turn, rest))


def _border_pieces(cores: Cores, border: Border) -> _Pieces | None:
    """The uncovered arcs of a segment of the domain's border."""
    at = border.at_deg
    if border.is_parallel:
        if at <= -90.0:
            return None
        at = min(at - border.inner * math.degrees(GROWTH_RAD), _ZENITH_DEG)
        height = np.degrees(np.arcsin(np.clip(-cores.centres[:, 2], -1, 1)))
        near = cores.select(np.abs(height - at) <= np.degrees(cores.radii) + 1e-6)
        cuts = _cuts_of_parallel(near, at)
    else:
        azimuth = math.radians(at)
        aside = cores.centres @ np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
        near = cores.select(np.abs(np.arcsin(np.clip(aside, -1, 1))) <= cores.radii + 1e-9)
        cuts = _cuts_of_meridian(near, azimuth)
    if border.is_parallel:
        cuts = border.from_deg + (cuts - border.from_deg) % 360.0
    cuts = np.unique(cuts[(cuts > border.from_deg) & (cuts < border.to_deg)])
    limits = np.concatenate([[border.from_deg], cuts, [border.to_deg]])
    middles = (limits[:-1] + limits[1:]) / 2
    bare = near.depth(_at(border, at, middles)) < 0
    # merge adjacent uncovered intervals, then split them so that each is short
    begins = limits[:-1][bare & ~np.concatenate([[False], bare[:-1]])]
    stops = limits[1:][bare & ~np.concatenate([bare[1:], [False]])]
    if not len(begins):
        return None
    pieces = np.ceil((stops - begins) / _STEP_DEG).astype(int)
    share = np.concatenate([np.arange(k) / k for k in pieces])
    width = np.repeat(stops - begins, pieces)
    lower = np.repeat(begins, pieces) + share * width
    upper = lower + width / np.repeat(pieces, pieces)
    return _as_pieces(border, at, lower, upper)


def _as_pieces(border: Border, at: float, lower: FloatArray, upper: FloatArray) -> _Pieces:
    middle = (lower + upper) / 2
    n = len(lower)
    if border.is_parallel:
        inward = direction(np.full(n, at + 90.0 * border.inner), middle)
        # azimuth increases along the border if the hole is below, as the hole is on the left
        areas = -border.inner * (1 + math.sin(math.radians(at))) * np.radians(upper - lower)
        parallels = np.stack([np.full(n, at), lower, upper], axis=1)
    else:
        azimuth = math.radians(at)
        aside = border.inner * np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
        inward, areas, parallels = np.tile(aside, (n, 1)), np.zeros(n), np.full((n, 3), np.nan)
    starts, ends = _at(border, at, lower), _at(border, at, upper)
    return _Pieces(
        starts=starts,
        ends=ends,
        middles=_at(border, at, middle),
        inward=inward,
        areas=areas,
        lengths=_angles(starts, ends),
        images=np.full(n, -1),
        parallels=parallels,
    )


def _at(border: Border, at: float, along: FloatArray) -> FloatArray:
    return direction(at, along) if border.is_parallel else direction(along, at)


def _cuts_of_parallel(cores: Cores, elevation_deg: float) -> FloatArray:
    """Azimuths, degrees, at which edge planes intersect a parallel."""
    normals = cores.normals.reshape(-1, 3)
    elevation = math.radians(elevation_deg)
    reach = math.cos(elevation) * np.hypot(normals[:, 0], normals[:, 1])
    offset = -math.sin(elevation) * normals[:, 2]
    cut = (reach > 0) & (np.abs(offset) <= reach)
    half = np.arccos(-offset[cut] / reach[cut])
    middle = np.arctan2(normals[cut, 1], normals[cut, 0])
    return np.asarray(np.degrees(np.concatenate([middle - half, middle + half])))


def _cuts_of_meridian(cores: Cores, azimuth: float) -> FloatArray:
    """Elevations, degrees, at which edge planes intersect a meridian (azimuth in radians)."""
    normals = cores.normals.reshape(-1, 3)
    level = normals[:, 0] * math.cos(azimuth) + normals[:, 1] * math.sin(azimuth)
    elevation = np.degrees(np.arctan2(level, normals[:, 2]))
    return np.asarray((elevation + 90.0) % 180.0 - 90.0)


def _joined(pieces: _Pieces) -> NDArray[np.intp]:
    """Labels (p,) of arcs, equal for arcs connected by a chain of common ends."""
    count = len(pieces)
    ends = np.concatenate([pieces.starts, pieces.ends])
    along = ends @ np.array([0.4863, -0.3177, 0.8140])
    order = np.argsort(along, kind="stable")
    parent = list(range(count))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for step in range(1, 2 * count):
        a, b = order[:-step], order[step:]
        close = along[b] - along[a] <= _MEET_RAD
        if not close.any():
            break
        meet = close & (np.linalg.norm(ends[a] - ends[b], axis=1) <= _MEET_RAD)
        for i, j in zip((a[meet] % count).tolist(), (b[meet] % count).tolist(), strict=True):
            parent[root(i)] = root(j)
    return np.array([root(i) for i in range(count)], dtype=np.intp)


def _rays(
    cores: Cores, domain: Domain, pieces: _Pieces, owner: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray, list[tuple[int, int]]]:
    """Shoot rays across the holes from arcs of their borders.

    Returns:
        For each arc, the middle of its ray (p, 3) and the ray's length in radians (p,), 0 where none was shot; and the
        pairs of arcs at the two ends of a ray.
    """
    middles, depths = pieces.middles.copy(), np.zeros(len(pieces))
    by_length = np.argsort(-pieces.lengths, kind="stable")
    _, first = np.unique(owner[by_length], return_index=True)
    # the longest arc of each chain first, then the others by length
    chosen = list(dict.fromkeys([*by_length[np.sort(first)].tolist(), *by_length.tolist()]))[:_MOST_RAYS]
    hits = []
    for piece in chosen:
        start, ahead = pieces.middles[piece], pieces.inward[piece]
        length, core = _first_core(cores, start, ahead)
        nudged = math.cos(_MEET_RAD / 10) * start + math.sin(_MEET_RAD / 10) * ahead
        leave = _leaves(domain, nudged, ahead)
        if leave < length:
            length, core = leave, -1
        end = math.cos(length) * start + math.sin(length) * ahead
        middles[piece] = math.cos(length / 2) * start + math.sin(length / 2) * ahead
        depths[piece] = length
        other = _piece_at(pieces, end, core)
        if other is not None:
            hits.append((piece, other))
    return middles, depths, hits


def _first_core(cores: Cores, start: FloatArray, ahead: FloatArray) -> tuple[float, int]:
    """Length in radians at which a ray enters a core, at most `_RAY_RAD`, and the core's index."""
    if not len(cores):
        return _RAY_RAD, -1
    a, b = cores.normals @ start, cores.normals @ ahead
    # a·cos u + b·sin u ≥ 0 within a quarter turn of u = atan2(b, a); u runs over (0, π)
    peak = np.arctan2(b, a)
    low = np.maximum(peak - math.pi / 2, 0.0).max(axis=1)
    high = np.minimum(peak + math.pi / 2, math.pi).min(axis=1)
    entered = np.where((high > low) & (high > 2e-9), low, np.inf)
    core = int(np.argmin(entered))
    return (float(entered[core]), core) if entered[core] < _RAY_RAD else (_RAY_RAD, -1)


def _leaves(domain: Domain, start: FloatArray, ahead: FloatArray) -> float:
    """Length in radians at which a ray leaves the domain, at most `_RAY_RAD`."""
    end = math.cos(_RAY_RAD) * start + math.sin(_RAY_RAD) * ahead
    low, high = domain.outside_intervals(start[None], end[None])
    some = low[low < high]
    if not len(some):
        return _RAY_RAD
    s = float(some.min())
    point = (1 - s) * start + s * end
    return float(np.arctan2(np.linalg.norm(np.cross(start, point)), start @ point))


def _piece_at(pieces: _Pieces, point: FloatArray, core: int) -> int | None:
    """The arc of a core's border (or with -1 of a parallel of the domain's border) that a point lies on."""
    if core >= 0:
        detour = _angles(pieces.starts, point) + _angles(pieces.ends, point) - pieces.lengths
        on = (pieces.images == core) & (detour < _MEET_RAD)
    else:
        elevation, azimuth = elevation_azimuth(point)
        at, lower, upper = np.moveaxis(pieces.parallels, -1, 0)
        on = (np.abs(at - elevation) < 1e-4) & ((azimuth - lower) % 360.0 <= upper - lower)
    found = np.nonzero(on)[0]
    return int(found[0]) if len(found) else None


def _angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles (p,) in radians between unit vectors (p, 3), accurate for small angles too."""
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=1) / 2, 0.0, 1.0)))


def _region(pieces: _Pieces, middles: FloatArray, depths: FloatArray) -> HoleRegion:
    deepest = int(np.argmax(depths))
    place = middles[deepest]
    outline = _outline(pieces)
    solid_angle = max(float(pieces.areas.sum()), 0.0)
    elevation, azimuth = elevation_azimuth(place)
    return HoleRegion(
        hole=Hole(elevation_deg=float(elevation), azimuth_deg=float(azimuth), size_deg=_size_deg(outline, solid_angle)),
        solid_angle_sr=solid_angle,
        outline=outline,
    )


def _size_deg(outline: FloatArray, solid_angle_sr: float) -> float:
    """Bound of a hole's angular diameter, degrees, from points whose convex hull contains it if it is not too large."""
    centre = outline.mean(axis=0)
    norm = float(np.linalg.norm(centre))
    radius = float(_angles(outline, centre / norm).max()) if norm > 1e-9 else math.pi
    # the region beyond the cap about the outline is wholly in the hole or wholly outside; inside means a huge hole
    if radius >= math.pi / 2 or solid_angle_sr > 2 * math.pi:
        return 180.0
    if radius > math.pi / 4 or len(outline) > _MOST_POINTS:
        return min(2 * math.degrees(radius), 180.0)
    # in such a small cap the diameter of a convex set is the distance of its farthest corners
    return math.degrees(max(float(_angles(outline, point).max()) for point in outline))


def _outline(pieces: _Pieces) -> FloatArray:
    """Ends of all arcs, and for parallels the intersections of the great circles tangent to them at their ends."""
    at, lower, upper = np.moveaxis(pieces.parallels[~np.isnan(pieces.parallels[:, 0])], -1, 0)
    half = np.radians(upper - lower) / 2
    apex = np.degrees(np.arctan(np.tan(np.radians(at)) / np.cos(half)))
    return np.unique(np.concatenate([pieces.starts, pieces.ends, direction(apex, (lower + upper) / 2)]), axis=0)
