"""Rows that a plan in closed rows may have, in cells of pitch, and the chains of them that C2 and C3 allow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import Constraints
from panoexec.planning.search.parallels import core_shown_deg
from panoexec.planning.search.row_layout import reachable_pitch
from panoexec.planning.search.row_limits import (
    fewest_images,
    highest_after_caps,
    highest_next,
    lowest_shown,
    useful_caps,
)

IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

_PARALLELS = 12
"""Parallels per vertical field of view."""
_POLE_DEG = 89.9
_EPS = 1e-6

ROW, FIRST, LAST, LOW, TOP = range(5)
"""Kinds of rows: between others, the lowest, the highest, and caps as the lowest and as the highest."""


@dataclass(frozen=True, slots=True)
class Cells:
    """Cells of pitch (k,) and what rows in them can do at most; degrees."""

    middle: FloatArray
    bottom: FloatArray
    top: FloatArray
    images: FloatArray
    """Fewest images of a closed row."""
    lowest: FloatArray
    """What rows in this cell and above show at the lowest."""
    highest: FloatArray
    """What rows in this cell and below show at the highest."""
    reach: IntArray
    """The highest cell of the next row; non-decreasing."""
    after_caps: tuple[float, float]
    """The highest pitches of closed rows after caps of one image and of two."""
    elevations: FloatArray
    """(m,) parallels of the band."""
    shown: FloatArray
    """(k, m) what one image shows of them."""
    low_caps: BoolArray
    top_caps: BoolArray
    begins: BoolArray
    ends: BoolArray


def cells_of(camera: Camera, constraints: Constraints, per_vfov: int) -> Cells:
    """The cells, so many per vertical field of view, of a request for a full circle without masks and skyline."""
    asked = camera.image_area / (4 * camera.half_width * camera.half_height)
    across, upwards = constraints.overlap_h * asked, constraints.overlap_v * asked
    band, vfov = constraints.band, camera.vfov_deg
    low, high = reachable_pitch(constraints.gimbal)
    count = max(2, math.ceil((high - low) * per_vfov / vfov))
    edges = np.linspace(low, high, count + 1)
    middle, half = (edges[1:] + edges[:-1]) / 2, (high - low) / count / 2 * (1 + 1e-9)
    if across > 0:
        images, _ = fewest_images(camera, across, middle, half)
    else:
        widest = closing_deg(camera, np.minimum(np.abs(middle) + half, 90.0))
        images = np.maximum(3.0, np.ceil(360.0 / widest - _EPS))
    lowest = np.minimum.accumulate(lowest_shown(camera, middle)[::-1])[::-1] - half
    highest = np.maximum.accumulate(-lowest_shown(camera, -middle)) + half
    begins, ends = lowest <= band.elevation_min_deg, highest >= band.elevation_max_deg
    # what is neither shown from below nor from above must be outside the band
    shown_to = np.where(ends, np.inf, np.maximum(highest, band.elevation_min_deg))
    reach = np.searchsorted(lowest, shown_to, side="right") - 1
    if upwards > 0:
        reach = np.minimum(reach, highest_next(camera, upwards, middle, half))
    polar = 90.0 - np.abs(middle) <= vfov / 2 + half
    low_caps, top_caps = useful_caps(camera, band, middle, half + constraints.tolerance.pitch_deg)
    low_caps, top_caps = polar & low_caps & begins, polar & top_caps & ends
    after_caps = 180.0, 180.0
    if across > 0 and upwards > 0 and np.any(low_caps | top_caps):
        one, two = highest_after_caps(camera, across, upwards)
        after_caps = one + half, two + half
    ends_deg = np.array([band.elevation_min_deg, band.elevation_max_deg])
    between = np.arange(math.ceil(ends_deg[0] * _PARALLELS / vfov), ends_deg[1] * _PARALLELS / vfov) * vfov / _PARALLELS
    elevations = np.unique(np.concatenate([between, ends_deg]))
    elevations = elevations[np.abs(elevations) < _POLE_DEG]
    return Cells(
        middle=middle,
        bottom=edges[:-1],
        top=edges[1:],
        images=images,
        lowest=lowest,
        highest=highest,
        reach=np.maximum.accumulate(reach),
        after_caps=after_caps,
        elevations=elevations,
        shown=core_shown_deg(camera, constraints.tolerance, middle, half, elevations),
        low_caps=low_caps,
        top_caps=top_caps,
        begins=begins,
        ends=ends,
    )


def closing_deg(camera: Camera, pitch_deg: FloatArray) -> FloatArray:
    """Azimuths (k,) between the sides of images on the parallels of their pitches, which grow with |pitch|; degrees."""
    # the right side: w·(cos²p·cos λ + sin²p) = cos p·sin λ
    p, w = np.radians(pitch_deg), camera.half_width
    flat = w * np.cos(p)
    sine = w * np.sin(p) ** 2 / np.hypot(1.0, flat) / np.maximum(np.cos(p), 1e-12)
    return np.where(sine >= 1, 360.0, np.degrees(2 * (np.arctan(flat) + np.arcsin(np.minimum(sine, 1.0)))))


@dataclass(frozen=True, slots=True)
class Nodes:
    """Rows that a chain may have, by ascending cell: of a kind, in a cell, of so many images at least; (n,) each."""

    kind: IntArray
    cell: IntArray
    images: FloatArray
    before: FloatArray
    """Fewest images of a chain up to this row, with it, under C2 and C3."""
    after: FloatArray
    """Likewise from this row on."""

    @property
    def count(self) -> int:
        """How many."""
        return len(self.kind)

    @staticmethod
    def of(cells: Cells) -> Nodes:
        """All of them, caps of one and of two images among them."""
        which = [
            (ROW, np.ones(len(cells.middle), dtype=bool), None),
            (FIRST, cells.begins, None),
            (LAST, cells.ends, None),
            *((LOW, cells.low_caps, images) for images in (1.0, 2.0)),
            *((TOP, cells.top_caps, images) for images in (1.0, 2.0)),
        ]
        where = [np.nonzero(mask)[0] for _, mask, _ in which]
        kind = np.concatenate([np.full(len(w), k) for w, (k, _, _) in zip(where, which, strict=True)])
        cell = np.concatenate(where)
        images = np.concatenate(
            [cells.images[w] if n is None else np.full(len(w), n) for w, (_, _, n) in zip(where, which, strict=True)]
        )
        order = np.argsort(cell, kind="stable")
        kind, cell, images = kind[order], cell[order], images[order]
        before = _shortest(kind, cell, images, cells.reach, backwards=False)
        after = _shortest(kind, cell, images, cells.reach, backwards=True)
        return Nodes(kind, cell, images, before, after)

    def through(self) -> FloatArray:
        """Fewest images (n,) of a chain with this row under C2 and C3."""
        return self.before + self.after - self.images

    def within(self, most: float) -> Nodes:
        """Those that are in a chain of at most so many images."""
        kept = self.through() <= most
        return Nodes(self.kind[kept], self.cell[kept], self.images[kept], self.before[kept], self.after[kept])


def _shortest(kind: IntArray, cell: IntArray, images: FloatArray, reach: IntArray, *, backwards: bool) -> FloatArray:
    """Fewest images (n,) of the chains that lead to each row, or that follow it, with the row itself."""
    ends, others = ((LAST, TOP), (FIRST, LOW)) if backwards else ((FIRST, LOW), (LAST, TOP))
    total = np.full(len(kind), np.inf)
    count = len(reach)
    # per cell, the best of the rows that others may be joined to
    best = np.full(count, np.inf)
    near = np.searchsorted(reach, np.arange(count))
    begin = np.searchsorted(cell, np.arange(count + 1))
    for c in range(count - 1, -1, -1) if backwards else range(count):
        joined = best[c + 1 : reach[c] + 1] if backwards else best[near[c] : c]
        least = joined.min(initial=np.inf)
        for node in range(begin[c], begin[c + 1]):
            total[node] = images[node] + (0.0 if kind[node] in ends else least)
            if kind[node] not in others and total[node] < best[c]:
                best[c] = total[node]
    return total
