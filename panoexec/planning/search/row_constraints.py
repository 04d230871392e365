"""The constraints on rows, in one place: band, gimbal limits, C2 within a row, C1 and C3 between rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import Constraints
from panoexec.planning.search.budget import SearchBudget
from panoexec.planning.search.row_cover import RowCover
from panoexec.planning.search.row_layout import IntArray, RowLayout, reachable_pitch
from panoexec.planning.search.row_pairs import PairMargin, Pairs
from panoexec.planning.search.row_spacing import MOST_IN_A_ROW, NeighbourDemand, NeighbourSpacing

Zone = tuple[float, float]

Loss = Callable[[FloatArray], FloatArray]
"""Largest loss by pointing errors of the overlap with the adjacent row, for images at pitch (k,): fractions (k,)."""

_CANDIDATES = 81
_NARROWING = 10
"""Bisections of the pitch of the first row: to a hundredth of the precision of the rows above it."""
_TURNED = 60
_MOST_TURNED = 60
"""Up to this number of images, rows near a pole are checked for excessive rotation between neighbours."""

_STEEP_DEG = 45.0
_MANY = 40
_ZONE_NODES = 46
_TURN_NODES = 8
_SIGNATURE_NODES = 121
_MANY_COUNTS = 60
"""With more counts of images than this for the first row, not all of them are tried at every pitch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Demands:
    """Demands on rows in addition to coverage.

    Attributes:
        neighbours: overlap within a row.
        planned_v: overlap with the adjacent row at the planned poses.
        worst_v: overlap with the adjacent row for every error; 0 for none.
        least_count: minimum number of images in a row.
        least_rows: minimum number of rows.
    """

    neighbours: NeighbourDemand
    planned_v: float
    worst_v: float = 0.0
    least_count: int = 1
    least_rows: int = 1


class RowConstraints:
    """The constraints on the rows of one plan.

    Attributes:
        camera: the camera.
        demands: demands in addition to coverage.
        pitch_deg: lowest and highest pitch of rows.
        band_deg: lowest and highest elevation to cover.
        layout: the yaws of the images of a row.
        margin: the margin by which pairs of rows satisfy C1 and C3.
    """

    def __init__(
        self,
        camera: Camera,
        constraints: Constraints,
        demands: Demands,
        loss: Loss | None = None,
        *,
        budget: SearchBudget | None = None,
        within_band: bool = False,
    ) -> None:
        self.camera = camera
        self._budget = budget
        self.demands = demands
        self._constraints = constraints
        self.pitch_deg = reachable_pitch(constraints.gimbal)
        self.band_deg = constraints.band.elevation_min_deg, constraints.band.elevation_max_deg
        self._within_band = within_band
        inside = max(self.pitch_deg[0], self.band_deg[0]), min(self.pitch_deg[1], self.band_deg[1])
        if within_band and inside[0] <= inside[1]:
            self.pitch_deg = inside
        self._spacing = NeighbourSpacing(camera, demands.neighbours, budget)
        self.layout = RowLayout(constraints, self._spacing.widest)
        self._cover = RowCover(camera, constraints.tolerance)
        self.margin = PairMargin(camera, self.layout, self._cover, budget)
        self._loss = loss
        self.zones = lru_cache(maxsize=None)(self._zones)

    @property
    def overlap_v(self) -> float:
        """Minimum overlap with the adjacent row that C3 demands."""
        return max(self.demands.planned_v, self.demands.worst_v)

    @property
    def at_limits(self) -> bool:
        """Whether the band extends beyond the gimbal's pitch limits, so that its end rows must see beyond them."""
        return self.band_deg[0] < self.pitch_deg[0] or self.band_deg[1] > self.pitch_deg[1]

    @cached_property
    def many(self) -> bool:
        """Whether rows have so many images that one more or less hardly changes the pitch of the next row."""
        return int(self.fewest(np.zeros(1))[0]) >= _MANY

    def pairs(self, low_deg: FloatArray, low_count: IntArray, high_count: IntArray) -> Pairs:
        """Pairs of rows with their C3 demands; the pitch of the higher rows is not set."""
        return Pairs(
            low_deg=low_deg,
            low_count=low_count,
            high_deg=low_deg,
            high_count=high_count,
            low_demand=self._demand_v(low_deg),
            high_demand=self._demand_v(low_deg + 0.85 * self.camera.vfov_deg),
        )

    def _demand_v(self, pitch_deg: FloatArray) -> FloatArray:
        planned = np.full(len(pitch_deg), self.demands.planned_v)
        if self.demands.worst_v == 0:
            return planned
        loss = np.zeros(len(pitch_deg)) if self._loss is None else self._loss(pitch_deg)
        return np.asarray(np.maximum(planned, self.demands.worst_v + loss))

    def signature(self) -> tuple[object, ...]:
        """What decides a search: two sets of demands with equal signatures give the same rows."""
        pitch = np.linspace(*self.pitch_deg, _SIGNATURE_NODES)
        demands, asked = self.demands, self._constraints
        return (
            asked.band,
            asked.tolerance,
            self.pitch_deg,
            self.fewest(pitch).tobytes(),
            self._demand_v(pitch).round(9).tobytes(),
            demands.least_count,
            demands.least_rows,
        )

    def with_seam(self, seam: float) -> RowConstraints:
        """A copy with another demand on the seam: the part of the meridian between neighbours that both see."""
        return self._with_neighbours(replace(self.demands.neighbours, seam=seam))

    def with_more_overlap(self, more: float, *, worst: bool) -> RowConstraints:
        """A copy in which neighbours in a row overlap by more, at the planned poses or for every error (`worst`)."""
        asked = self.demands.neighbours
        changed = replace(asked, worst=asked.worst + more) if worst else replace(asked, planned=asked.planned + more)
        return self._with_neighbours(changed)

    def _with_neighbours(self, neighbours: NeighbourDemand) -> RowConstraints:
        demands = replace(self.demands, neighbours=neighbours)
        return RowConstraints(
            self.camera, self._constraints, demands, self._loss, budget=self._budget, within_band=self._within_band
        )

    def band(self, pitch_deg: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest elevation that rows cover at all azimuths for every error, each (k,)."""
        spacing, reach = self.layout.spacing_and_reach(pitch_deg, count)
        return self._cover.band(pitch_deg, spacing, reach)

    def allowed(self, pitch_deg: FloatArray, count: IntArray) -> NDArray[np.bool_]:
        """Whether C2 permits rows, (k,)."""
        if not self.layout.closed:
            # images at the spacing of the layout may be rotated too far against each other near a pole
            spacing, _ = self.layout.spacing_and_reach(pitch_deg, count)
            out = (count == 1) & (count >= self.demands.least_count)
            several = np.nonzero((count > 1) & (count >= self.demands.least_count) & (spacing > 0))[0]
            out[several] = self._spacing.surplus(pitch_deg[several], spacing[several]) >= 0
            return np.asarray(out)
        out = np.zeros(len(pitch_deg), dtype=bool)
        for number in np.unique(count).tolist():
            mine = count == number
            for low, high in self.zones(number):
                out |= mine & (pitch_deg >= low) & (pitch_deg <= high)
        return out

    def _zones(self, count: int) -> list[Zone]:
        """Ranges of pitch in which C2 permits a count, the upper one first."""
        if count < self.demands.least_count:
            return []
        if not self.layout.closed:
            return [(-90.0, 90.0)]
        limit = float(self._least_steep[min(count, len(self._least_steep) - 1)])
        turned = self._turns_too_far and 1 < count <= _TURNED
        steep = self._steep_zones(count, limit) if turned else [(limit, 90.0)]
        if steep == [(0.0, 90.0)]:
            return [(-90.0, 90.0)]
        return [*reversed(steep), *((-high, -low) for low, high in steep)]

    def _steep_zones(self, count: int, limit_deg: float) -> list[Zone]:
        """Ranges of |pitch| above a limit in which C2 permits a count of a few images.

        Near a pole they are rotated against each other so much that long images may overlap less than further out.
        """
        spacing = float(self.layout.closing_spacing_deg(np.array([count]))[0])
        steep = np.union1d(np.linspace(limit_deg, 90.0, _ZONE_NODES), limit_deg)
        good = self._spacing.surplus(steep, np.full(len(steep), spacing)) >= 0
        good[0] = good[0] or limit_deg < 90.0
        zones: list[Zone] = []
        start: float | None = None
        for s, fine in zip(steep.tolist(), good.tolist(), strict=True):
            if fine:
                start = s if start is None else start
                zones = [*zones[:-1], (start, s)] if zones and zones[-1][0] == start else [*zones, (start, s)]
            else:
                start = None
        return zones

    def zone_of(self, pitch_deg: float, count: int) -> Zone:
        """The range of pitches around a given one in which C2 permits a count, within the gimbal's limits."""
        for low, high in self.zones(count):
            if low - 1e-9 <= pitch_deg <= high + 1e-9:
                return max(low, self.pitch_deg[0]), min(high, self.pitch_deg[1])
        return pitch_deg, pitch_deg

    def fewest(self, pitch_deg: FloatArray) -> IntArray:
        """Minimum number of images by C2 alone at pitches (k,)."""
        least = self.demands.least_count
        if not self.layout.closed:
            allowed = self._spacing.widest(pitch_deg)
            widest = np.maximum(allowed, 360.0 / MOST_IN_A_ROW)
            fewest = np.ceil(self.layout.span_deg / widest - 0.5)
            # what the gimbal cannot pan to needs no images
            fewest = np.minimum(fewest, 1.0 + np.ceil(self.layout.usable_deg / widest))
            # where neighbours never overlap enough only a single image remains
            return np.maximum(least, np.where(allowed > 0, fewest, 1.0).astype(np.intp))
        most = len(self._least_steep) - 1
        if self._most_turned > most:
            nodes, fewest = self._fewest_turned
            index = np.minimum(np.searchsorted(nodes, np.abs(pitch_deg)), len(nodes) - 1)
            return np.asarray(np.where(np.abs(pitch_deg) >= 90.0, least, np.maximum(fewest[index], least)))
        # the minimum |pitch| decreases with the count: take the first count whose minimum is not above |pitch|
        ascending = self._least_steep[::-1]
        position = np.searchsorted(ascending, np.abs(pitch_deg), side="right")
        return np.asarray(np.clip(np.where(np.abs(pitch_deg) >= 90.0, 1, most + 1 - position), least, most))

    def counts_between(self, start_deg: float, stop_deg: float) -> tuple[int, int]:
        """Smallest and largest minimum number of images by C2 alone, over the pitches between two limits."""
        pitches = np.linspace(start_deg, stop_deg, 9)
        if start_deg < 0 < stop_deg:
            pitches = np.append(pitches, 0.0)
        counts = self.fewest(pitches)
        if not self.layout.closed:
            # the outer images of a row may see more beyond them than half the spacing
            counts = np.maximum(counts - 1, self.demands.least_count)
        most = int(counts.max())
        if self.layout.closed and max(-start_deg, stop_deg) > _STEEP_DEG:
            most = max(most, self._most_turned)
        return int(counts.min()), most

    @cached_property
    def _fewest_turned(self) -> tuple[FloatArray, IntArray]:
        """Minimum number of images by C2, by |pitch|, where more are needed near a pole than further out."""
        nodes = np.linspace(0.0, 90.0, 361)
        fewest = np.full(len(nodes), self._most_turned, dtype=np.intp)
        for count in range(self._most_turned, 1, -1):
            for low, high in self.zones(count):
                fewest[(nodes >= low) & (nodes <= high)] = count
        return nodes, fewest

    @cached_property
    def _turns_too_far(self) -> bool:
        """Whether C2 forbids some count near a pole that it permits further out."""
        counts = np.arange(2, min(len(self._least_steep), _TURNED + 1))
        spacing = self.layout.closing_spacing_deg(counts)
        limit = self._least_steep[counts]
        share = np.linspace(0.05, 1.0, _TURN_NODES)[:, None]
        steep = limit + share * (90.0 - limit)
        surplus = self._spacing.surplus(steep.ravel(), np.broadcast_to(spacing, steep.shape).ravel())
        return bool(np.any((surplus.reshape(steep.shape) < 0) & (limit < 90.0)))

    @cached_property
    def _most_turned(self) -> int:
        """Smallest count that C2 permits at every pitch; larger than that of the horizon for long images."""
        if not self._turns_too_far:
            return len(self._least_steep) - 1
        steep = np.linspace(0.0, 89.9, _ZONE_NODES)
        most = len(self._least_steep) - 1
        for count in range(most, min(4 * most + 40, _MOST_TURNED)):
            spacing = float(self.layout.closing_spacing_deg(np.array([count]))[0])
            if self._spacing.surplus(steep[1:], np.full(len(steep) - 1, spacing)).min() >= 0:
                return count
        return most

    @cached_property
    def _least_steep(self) -> FloatArray:
        """For each count of images of a closed row, the minimum |pitch| at which C2 permits it; non-increasing."""
        most = self._spacing.most_images(360.0 - self.layout.blind_deg) + (1 if self.layout.blind_deg else 0)
        counts = np.arange(2, max(most, 2) + 1)
        steep = self._spacing.least_steep_deg(self.layout.closing_spacing_deg(counts))
        steep = np.minimum.accumulate(np.concatenate([[90.0, 90.0], steep]))
        if self.layout.blind_deg > 0:
            steep = np.maximum(steep, self.blind_limit_deg)
        return steep

    @cached_property
    def blind_limit_deg(self) -> float:
        """The minimum |pitch| at which neighbours overlap enough across the yaws that the gimbal cannot reach."""
        return float(self._spacing.least_steep_deg(np.array([self.layout.blind_deg]))[0])

    def widest(self, pitch_deg: FloatArray) -> FloatArray:
        """The widest spacing of neighbours at pitches (k,), degrees."""
        return self._spacing.widest(pitch_deg)

    def first_rows(self, more_images: int) -> tuple[FloatArray, IntArray]:
        """Candidates for the first row, which covers the band's lower end: highest pitch and count, (k,) each."""
        low, height = self.band_deg[0], self.camera.vfov_deg
        bottom, top = self.pitch_deg
        candidates = np.linspace(max(bottom, min(top, low - height)), max(bottom, min(top, low + height)), _CANDIDATES)
        fewest, most = self.counts_between(float(candidates[0]), float(candidates[-1]))
        counts = np.arange(fewest, most + more_images + 1)
        pitch, count = np.repeat(candidates, len(counts)), np.tile(counts, len(candidates))
        if len(counts) > _MANY_COUNTS:
            # of the long rows of a band near a pole only those that C2 asks for at a pitch, and a few longer ones
            needed = np.repeat(self.fewest(candidates), len(counts))
            useful = (count >= needed - 1) & (count <= needed + more_images)
            pitch, count = pitch[useful], count[useful]
        good = self._begins(pitch, count)
        highest = np.array([pitch[good & (count == c)].max(initial=-np.inf) for c in counts.tolist()])
        counts, highest = counts[np.isfinite(highest)], highest[np.isfinite(highest)]
        step = float(candidates[1] - candidates[0])
        lower, upper = highest, np.minimum(highest + step, top)
        for _ in range(_NARROWING):
            middle = (lower + upper) / 2
            fine = self._begins(middle, counts)
            lower, upper = np.where(fine, middle, lower), np.where(fine, upper, middle)
        fine = self._begins(upper, counts)
        return np.where(fine, upper, lower), counts

    def _begins(self, pitch_deg: FloatArray, count: IntArray) -> NDArray[np.bool_]:
        if self._budget is not None:
            self._budget.use()
        low, high = self.band(pitch_deg, count)
        bottom = self.band_deg[0]
        out = (low <= bottom) & (high > max(bottom, -89.999))
        some = np.nonzero(out)[0]
        if len(some):
            out[some] = self.allowed(pitch_deg[some], count[some])
        return np.asarray(out)
