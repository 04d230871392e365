"""Pairs of adjacent rows: whether they close the sphere between them (C1) and overlap enough (C3).

Evenly spaced rows of m and n images have only lcm(m, n) different relative positions of an image and the adjacent row,
evenly distributed. If m and n have a large common divisor these are few, and the *phase* (the rotation of one row
against the other) selects them. Both conditions are evaluated at a few positions each and combined for three phases:
the images of one row are at those of the other, halfway between, or at a quarter.

All functions are vectorised: the search evaluates hundreds of pairs at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.search.budget import SearchBudget
from panoexec.planning.search.row_cover import RowCover
from panoexec.planning.search.row_layout import IntArray, RowLayout
from panoexec.planning.search.row_overlap import seen_by_row, seen_in_columns

PHASES = (0.0, 0.25, 0.5)
"""Relative phases, in units of the period after which the relative positions repeat."""

_FEW = 12
"""With more distinct positions than this the phase is ignored, and the worst position counts."""

_POLAR_DEG = 55.0
"""Rows with images wider than this (half the azimuth extent) use more positions and the approximate method."""

_APPROXIMATION_ERROR = 3e-4
"""Subtracted from overlaps computed by the approximate method."""

_WIDEST_DEG = 100.0
"""Rows with a wider spacing than this are treated like polar ones."""

OverlapFunction = Callable[[Camera, FloatArray, FloatArray, FloatArray], FloatArray]
"""A function that computes overlaps, see `panoexec.planning.search.row_overlap.seen_by_row`."""

_OpenRows = tuple[FloatArray, FloatArray, IntArray]
"""Pitch, spacing and count of rows, each (k,)."""

_AROUND = 60
_MOST_DISTINCT = 400
"""With more distinct positions than this some seams of the two rows nearly coincide."""

_YAWS_AT_A_TIME = 1 << 16
"""Images of adjacent rows that are compared at a time with a few images of theirs: limits the memory."""

_NOT_CLOSED = -1.0
_SURE = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolution:
    """Resolution of the evaluation of pairs.

    Attributes:
        columns: number of columns of an image, see `seen_in_columns`.
        exact: whether overlaps are computed exactly where possible.
        positions: number of positions of an image in a cell of the adjacent row, from 0 to half the spacing; the same
            near a pole.
        meridians: number of meridians from the middle of an image to its row's seam.
    """

    columns: int
    exact: bool
    positions: tuple[int, int]
    meridians: int


COARSE = Resolution(columns=12, exact=False, positions=(3, 7), meridians=5)
FINE = Resolution(columns=40, exact=True, positions=(7, 13), meridians=17)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairs:
    """Rows, the rows above them, and the overlaps that the images of each row must have with the other; each (k,)."""

    low_deg: FloatArray
    low_count: IntArray
    high_deg: FloatArray
    high_count: IntArray
    low_demand: FloatArray
    high_demand: FloatArray

    def __len__(self) -> int:
        return len(self.low_deg)

    def at(self, which: IntArray, high_deg: FloatArray) -> Pairs:
        """A selection (m,) of the pairs, with other pitches (m,) of the higher row."""
        return Pairs(
            low_deg=self.low_deg[which],
            low_count=self.low_count[which],
            high_deg=high_deg,
            high_count=self.high_count[which],
            low_demand=self.low_demand[which],
            high_demand=self.high_demand[which],
        )


class PairMargin:
    """The margin by which adjacent rows satisfy C1 and C3.

    The margin is the minimum of: the surplus of overlap over the demand, as a fraction of an image, over the images of
    both rows; and the overlap in elevation of the two rows' coverage, in vertical fields of view.
    """

    def __init__(self, camera: Camera, layout: RowLayout, cover: RowCover, budget: SearchBudget | None = None) -> None:
        self._camera = camera
        self._layout = layout
        self._cover = cover
        self._budget = budget or SearchBudget()

    def margins(self, pairs: Pairs, resolution: Resolution) -> FloatArray:
        """Margins (k, 3) for each of `PHASES`."""
        return np.minimum(self.overlap_margins(pairs, resolution), self.coverage_margins(pairs, resolution))

    def overlap_margins(self, pairs: Pairs, resolution: Resolution) -> FloatArray:
        """The part of the margins (k, 3) that comes from overlap, C3.

        Raises:
            BudgetSpentError: the budget of the search is used up.
        """
        self._budget.use(len(pairs))
        low_spacing, _ = self._layout.spacing_and_reach(pairs.low_deg, pairs.low_count)
        high_spacing, _ = self._layout.spacing_and_reach(pairs.high_deg, pairs.high_count)
        low = pairs.low_deg, low_spacing, pairs.low_count
        high = pairs.high_deg, high_spacing, pairs.high_count
        if not self._layout.closed:
            least = np.minimum(
                self._shared_open(resolution, low, high) - pairs.low_demand,
                self._shared_open(resolution, high, low) - pairs.high_demand,
            )
            return _any_phase(least)
        # both directions in one call: small batches cost as much as large ones
        rows = (np.concatenate(both) for both in zip(high, low, strict=True))
        by_low, by_high = np.split(
            self._overlap_by_position(resolution, np.concatenate([pairs.low_deg, pairs.high_deg]), *rows), 2
        )
        if self._layout.is_even:
            common = np.gcd(pairs.low_count, pairs.high_count)
            least_low = _by_phase(by_low, pairs.low_count // common)
            least_high = _by_phase(by_high, pairs.high_count // common)
        else:
            least_low, least_high = _any_phase(by_low.min(axis=1)), _any_phase(by_high.min(axis=1))
        return np.minimum(least_low - pairs.low_demand[:, None], least_high - pairs.high_demand[:, None])

    def coverage_margins(self, pairs: Pairs, resolution: Resolution) -> FloatArray:
        """The part of the margins (k, 3) that comes from coverage, C1; -1 where a row itself has gaps."""
        low_spacing, low_reach = self._layout.spacing_and_reach(pairs.low_deg, pairs.low_count)
        high_spacing, high_reach = self._layout.spacing_and_reach(pairs.high_deg, pairs.high_count)
        meridians = np.linspace(0.0, 1.0, resolution.meridians)
        low_from, low_to = self._cover.row_intervals(pairs.low_deg, low_spacing, low_reach[:, None] * meridians)
        high_from, high_to = self._cover.row_intervals(pairs.high_deg, high_spacing, high_reach[:, None] * meridians)
        top = np.where(low_from <= low_to, low_to, -360.0)
        bottom = np.where(high_from <= high_to, high_from, 360.0)
        height = self._camera.vfov_deg
        worst = (top.min(axis=1) - bottom.max(axis=1)) / height
        closed = _any_phase(worst)
        best = (top.min(axis=1) - bottom.min(axis=1)) / height
        distinct = np.lcm(pairs.low_count, pairs.high_count) // np.gcd(pairs.low_count, pairs.high_count)
        unsure = np.nonzero(
            self._layout.is_even & (worst < _SURE) & (best > worst + 1e-4) & (distinct <= _MOST_DISTINCT)
        )[0]
        if len(unsure):
            closed[unsure] = self._elevation_overlap(pairs, unsure, top[unsure], bottom[unsure]) / height
        return np.maximum(closed, _NOT_CLOSED)

    def _overlap_by_position(
        self,
        resolution: Resolution,
        pitch_deg: FloatArray,
        row_deg: FloatArray,
        spacing_deg: FloatArray,
        count: IntArray,
    ) -> FloatArray:
        """Overlap (k, positions) of images with the adjacent row, by position in its cell."""
        few, many = resolution.positions
        polar = np.maximum(self._half_azimuth(pitch_deg), self._half_azimuth(row_deg)) > _POLAR_DEG
        polar |= spacing_deg > _WIDEST_DEG
        approximate: OverlapFunction = partial(seen_in_columns, columns=resolution.columns)
        usually: OverlapFunction = seen_by_row if resolution.exact else approximate

        def seen(which: NDArray[np.bool_], positions: int, overlap_function: OverlapFunction) -> FloatArray:
            row = row_deg[which], spacing_deg[which], count[which]
            return self._seen_from(positions, overlap_function, pitch_deg[which], row=row)

        if not polar.any():
            return seen(~polar, few, usually)
        out = np.empty((len(pitch_deg), many))
        out[polar] = seen(polar, many, approximate) - (_APPROXIMATION_ERROR if resolution.exact else 0.0)
        if not polar.all():
            rest = seen(~polar, few, usually)
            out[~polar] = _interpolate(rest, np.broadcast_to(np.linspace(0.0, 0.5, many), (len(rest), many)))
        return out

    def _seen_from(
        self,
        positions: int,
        seen: OverlapFunction,
        pitch_deg: FloatArray,
        *,
        row: tuple[FloatArray, FloatArray, IntArray],
    ) -> FloatArray:
        row_deg, spacing_deg, count = row
        position = np.linspace(0.0, 0.5, positions)
        # only images that can overlap, whatever the rest of the batch needs: images too far around are ambiguous
        near = self._overlapping_count(pitch_deg, row_deg, spacing_deg, count)[:, None]
        most = int(near.max(initial=1))
        steps = np.arange(most) - (most - 1) // 2
        used = (steps >= -((near - 1) // 2)) & (steps <= near // 2)
        yaws = (position[None, :, None] + np.where(used, steps, np.nan)[:, None, :]) * spacing_deg[:, None, None]
        shared = seen(
            self._camera, np.repeat(pitch_deg, positions), np.repeat(row_deg, positions), yaws.reshape(-1, most)
        )
        return shared.reshape(len(pitch_deg), positions)

    def _overlapping_count(
        self, pitch_deg: FloatArray, row_deg: FloatArray, spacing_deg: FloatArray, count: IntArray
    ) -> IntArray:
        """Upper bound of the number of images of the adjacent row that can overlap an image, (k,)."""
        reach = self._half_azimuth(pitch_deg) + self._half_azimuth(row_deg)
        near = 2 * np.maximum(np.ceil(reach / np.maximum(spacing_deg, 1e-9)) - 1, 1) + 1
        return np.asarray(np.minimum(near, count).astype(np.intp))

    def _half_azimuth(self, pitch_deg: FloatArray) -> FloatArray:
        """Half the azimuth extent of an image, degrees."""
        p = np.radians(np.abs(pitch_deg))
        w, h = self._camera.half_width, self._camera.half_height
        return np.degrees(np.arctan2(w, np.cos(p) - h * np.sin(p)))

    def _elevation_overlap(self, pairs: Pairs, which: IntArray, top: FloatArray, bottom: FloatArray) -> FloatArray:
        """Smallest overlap in elevation (k, phases) of the two rows' coverage, over sampled meridians."""
        low, high = pairs.low_count[which], pairs.high_count[which]
        common = np.gcd(low, high)
        period = 360.0 / common
        recurs = period / ((low // common) * (high // common))
        even = np.linspace(0.0, 1.0, _AROUND, endpoint=False) * period[:, None]
        # the coverage of a row has notches at its seams, where a narrow gap may be: sample these too
        low_seams, high_seams = _seams(low // common, 360.0 / low), _seams(high // common, 360.0 / high)
        out = np.empty((len(which), len(PHASES)))
        for i, phase in enumerate(PHASES):
            turn = phase * recurs[:, None]
            around = np.concatenate([even, low_seams, high_seams + turn], axis=1)
            in_low = _cell(around / (360.0 / low)[:, None])
            in_high = _cell((around - turn) / (360.0 / high)[:, None])
            gap = _interpolate(top, in_low) - _interpolate(bottom, in_high)
            out[:, i] = gap.min(axis=1)
        return out

    def _shared_open(self, resolution: Resolution, images: _OpenRows, next_rows: _OpenRows) -> FloatArray:
        """Smallest overlap (k,) of the images of one half of a sector's row with the adjacent row."""
        # a matrix of each image with all of the next row, so a few rows at a time
        step = max(1, _YAWS_AT_A_TIME // max(int(next_rows[2].max(initial=1)), 1))
        parts = [
            self._shared_open_of(resolution, _at(images, s), _at(next_rows, s))
            for s in (slice(start, start + step) for start in range(0, max(len(images[0]), 1), step))
        ]
        return np.concatenate(parts)

    def _shared_open_of(self, resolution: Resolution, images: _OpenRows, next_rows: _OpenRows) -> FloatArray:
        pitch_deg, spacing_deg, count = images
        row_deg, row_spacing_deg, row_count = next_rows
        half = int(((count + 1) // 2).max())
        probes = np.unique(
            np.concatenate([np.arange(min(half, 4)), np.linspace(0, half - 1, min(half, 8)).astype(int)])
        )
        most = int(row_count.max())
        own = (probes - (count[:, None] - 1) / 2) * spacing_deg[:, None]
        other = (np.arange(most) - (row_count[:, None] - 1) / 2) * row_spacing_deg[:, None]
        other = np.where(np.arange(most) < row_count[:, None], other, np.nan)
        yaws = other[:, None, :] - own[:, :, None]
        reaching = self._overlapping_count(pitch_deg, row_deg, np.maximum(row_spacing_deg, 1e-3), row_count)
        near = min(most, int(reaching.max(initial=1)))
        order = np.argsort(np.abs(yaws), axis=2)[:, :, :near]
        yaws = np.sort(np.take_along_axis(yaws, order, axis=2), axis=2)
        shape = yaws.shape[:2]
        shared = seen_in_columns(
            self._camera,
            np.repeat(pitch_deg, shape[1]),
            np.repeat(row_deg, shape[1]),
            yaws.reshape(-1, near),
            resolution.columns,
        ).reshape(shape)
        return np.asarray(np.where(probes < (count[:, None] + 1) // 2, shared, np.inf).min(axis=1))


def _at(rows: _OpenRows, some: slice) -> _OpenRows:
    pitch_deg, spacing_deg, count = rows
    return pitch_deg[some], spacing_deg[some], count[some]


def _seams(count: IntArray, spacing_deg: FloatArray) -> FloatArray:
    """Azimuths (k, most) of the first (k,) seams between images of rows, repeated as padding."""
    steps = np.arange(int(count.max())) % count[:, None]
    return np.asarray((steps + 0.5) * spacing_deg[:, None])


def _any_phase(values: FloatArray) -> FloatArray:
    """Values (k,) that are the same for every phase, as (k, 3)."""
    return np.repeat(values[:, None], len(PHASES), axis=1)


def _by_phase(shared: FloatArray, distinct: IntArray) -> FloatArray:
    """Minimum of overlaps (k, positions) over the positions that occur in each phase: (k, 3)."""
    out = _any_phase(shared.min(axis=1))
    for number in np.unique(distinct[distinct <= _FEW]).tolist():
        rows = np.nonzero(distinct == number)[0]
        at = _cell((np.arange(number) + np.array(PHASES)[:, None]) / number).reshape(-1)
        values = _interpolate(shared[rows], np.broadcast_to(at, (len(rows), len(at))))
        out[rows] = values.reshape(len(rows), len(PHASES), number).min(axis=2)
    return out


def _cell(turns: FloatArray) -> FloatArray:
    """Position in a cell of length 1 around its middle: [-0.5, 0.5)."""
    return np.asarray((turns + 0.5) % 1.0 - 0.5)


def _interpolate(values: FloatArray, position: FloatArray) -> FloatArray:
    """Linear interpolation (k, p) of values (k, m), sampled evenly from the middle to the border of a cell."""
    last = values.shape[1] - 1
    x = np.abs(position) * 2 * last
    i = np.minimum(x.astype(np.intp), last - 1)
    left = np.take_along_axis(values, i, axis=1)
    return np.asarray(left + (x - i) * (np.take_along_axis(values, i + 1, axis=1) - left))
