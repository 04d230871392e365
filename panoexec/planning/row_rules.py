"""What rows have to satisfy, in one place: the band, the gimbal's limits, C2 in a row, C1 and C3 between rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import Constraints
from panoexec.planning.row_cover import RowCover
from panoexec.planning.row_family import NeighbourDemand, NeighbourSpacing
from panoexec.planning.row_layout import IntArray, RowLayout, reachable_pitch
from panoexec.planning.row_pairs import PairMargin, Pairs

Zone = tuple[float, float]

Loss = Callable[[FloatArray], FloatArray]
"""What errors may take from the overlap of images of pitch (k,) with the next row, fractions of an image."""

_CANDIDATES = 81
_NARROWING = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Demands:
    """What is asked of rows besides coverage.

    Attributes:
        neighbours: in a row.
        planned_v: overlap with the next row at the planned poses.
        worst_v: likewise whatever the errors; 0 for nothing.
        least_count: images in a row.
        least_rows: rows.
    """

    neighbours: NeighbourDemand
    planned_v: float
    worst_v: float = 0.0
    least_count: int = 1
    least_rows: int = 1


class RowRules:
    """The rules for the rows of one plan.

    Attributes:
        camera: the camera.
        demands: what is asked of rows besides coverage.
        pitch_deg: lowest and highest pitch that rows may have.
        band_deg: lowest and highest elevation to cover.
        layout: how the images of a row lie.
        margin: by how much pairs of rows satisfy C1 and C3.
    """

    def __init__(self, camera: Camera, constraints: Constraints, demands: Demands, loss: Loss | None = None) -> None:
        self.camera = camera
        self.demands = demands
        self.pitch_deg = reachable_pitch(constraints.gimbal)
        self.band_deg = constraints.band.elevation_min_deg, constraints.band.elevation_max_deg
        self._spacing = NeighbourSpacing(camera, demands.neighbours)
        self.layout = RowLayout(constraints, self._spacing.widest)
        self._cover = RowCover(camera, constraints.tolerance)
        self.margin = PairMargin(camera, self.layout, self._cover)
        self._loss = loss
        self.zones = lru_cache(maxsize=None)(self._zones)

    @property
    def overlap_v(self) -> float:
        """What C3 asks for at the least."""
        return max(self.demands.planned_v, self.demands.worst_v)

    def pairs(self, low_deg: FloatArray, low_count: IntArray, high_count: IntArray) -> Pairs:
        """Pairs of rows with what C3 demands of them; the pitch of the higher rows is left open."""
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

    def band(self, pitch_deg: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
        """Elevations that rows cover all round, whatever the errors: lowest and highest, each (k,)."""
        spacing, reach = self.layout.spacing_and_reach(pitch_deg, count)
        return self._cover.band(pitch_deg, spacing, reach)

    def allowed(self, pitch_deg: FloatArray, count: IntArray) -> NDArray[np.bool_]:
        """Whether C2 allows rows, (k,)."""
        out = np.zeros(len(pitch_deg), dtype=bool)
        for number in np.unique(count).tolist():
            mine = count == number
            for low, high in self.zones(number):
                out |= mine & (pitch_deg >= low) & (pitch_deg <= high)
        return out

    def _zones(self, count: int) -> list[Zone]:
        """Ranges of pitch in which C2 allows a count, the upper one first."""
        if count < self.demands.least_count:
            return []
        if not self.layout.closed:
            return [(-90.0, 90.0)]
        limit = float(self._least_steep[min(count, len(self._least_steep) - 1)])
        if limit <= 0:
            return [(-90.0, 90.0)]
        return [(limit, 90.0), (-90.0, -limit)]

    def zone_of(self, pitch_deg: float, count: int) -> Zone:
        """The range of pitches in which C2 allows a count that holds the given pitch, within the gimbal's."""
        for low, high in self.zones(count):
            if low - 1e-9 <= pitch_deg <= high + 1e-9:
                return max(low, self.pitch_deg[0]), min(high, self.pitch_deg[1])
        return pitch_deg, pitch_deg

    def fewest(self, pitch_deg: FloatArray) -> IntArray:
        """Fewest images that C2 alone asks for at pitches (k,)."""
        least = self.demands.least_count
        if not self.layout.closed:
            widest = np.maximum(self._spacing.widest(pitch_deg), 1e-3)
            return np.maximum(least, np.ceil(self.layout.span_deg / widest - 0.5).astype(np.intp))
        # the least steepness falls as the count grows: the first count whose one is not above the steepness
        ascending = self._least_steep[::-1]
        position = np.searchsorted(ascending, np.abs(pitch_deg), side="right")
        most = len(ascending) - 1
        return np.asarray(np.clip(np.where(np.abs(pitch_deg) >= 90.0, 1, most + 1 - position), least, most))

    def counts_between(self, start_deg: float, stop_deg: float) -> tuple[int, int]:
        """Fewest and most images that C2 alone asks for between two pitches."""
        pitches = np.linspace(start_deg, stop_deg, 9)
        if start_deg < 0 < stop_deg:
            pitches = np.append(pitches, 0.0)
        counts = self.fewest(pitches)
        return int(counts.min()), int(counts.max())

    @cached_property
    def _least_steep(self) -> FloatArray:
        """For each count of images of a closed row, the least |pitch| at which C2 allows it; never rising."""
        most = self._spacing.most_images(360.0 - self.layout.blind_deg) + (1 if self.layout.blind_deg else 0)
        counts = np.arange(2, max(most, 2) + 1)
        steep = self._spacing.least_steep_deg(self.layout.closing_spacing_deg(counts))
        steep = np.minimum.accumulate(np.concatenate([[90.0, 90.0], steep]))
        if self.layout.blind_deg > 0:
            steep = np.maximum(steep, self.blind_limit_deg)
        return steep

    @cached_property
    def blind_limit_deg(self) -> float:
        """The least |pitch| at which neighbours can bridge what the gimbal cannot pan to."""
        return float(self._spacing.least_steep_deg(np.array([self.layout.blind_deg]))[0])

    def widest_deg(self, pitch_deg: float) -> float:
        """The widest spacing of neighbours at a pitch."""
        return float(self._spacing.widest(np.array([pitch_deg]))[0])

    def first_rows(self, more_images: int) -> tuple[FloatArray, IntArray]:
        """Rows that cover from the band's lower end: for each count the highest pitch, (k,) each."""
        low, height = self.band_deg[0], self.camera.vfov_deg
        bottom, top = self.pitch_deg
        candidates = np.linspace(max(bottom, min(top, low - height)), max(bottom, min(top, low + height)), _CANDIDATES)
        fewest, most = self.counts_between(float(candidates[0]), float(candidates[-1]))
        counts = np.arange(fewest, most + more_images + 1)
        pitch, count = np.repeat(candidates, len(counts)), np.tile(counts, len(candidates))
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
        low, high = self.band(pitch_deg, count)
        bottom = self.band_deg[0]
        return np.asarray(self.allowed(pitch_deg, count) & (low <= bottom) & (high > max(bottom, -89.999)))
