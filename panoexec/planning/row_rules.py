"""What rows have to satisfy, in one place: the band, the gimbal's limits, C2 in a row, C1 and C3 between rows."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

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

NextRowDemand = Callable[[FloatArray], FloatArray]
"""Overlap asked of images with the next row, by the pitch (k,) of the images."""

_CANDIDATES = 81
_NARROWING = 24


class RowRules:
    """The rules for the rows of one plan.

    Attributes:
        camera: the camera.
        pitch_deg: lowest and highest pitch that rows may have.
        band_deg: lowest and highest elevation to cover.
        layout: how the images of a row lie.
        spacing: how far apart they may be.
        cover: what rows cover.
        margin: by how much pairs of rows satisfy C1 and C3.
        overlap_v: what C3 asks for.
    """

    def __init__(
        self,
        camera: Camera,
        constraints: Constraints,
        neighbours: NeighbourDemand,
        overlap_v: float,
        extra_v: NextRowDemand | None = None,
    ) -> None:
        self.camera = camera
        self.pitch_deg = reachable_pitch(constraints.gimbal)
        self.band_deg = constraints.band.elevation_min_deg, constraints.band.elevation_max_deg
        self.spacing = NeighbourSpacing(camera, neighbours)
        self.layout = RowLayout(constraints, self.spacing.widest)
        self.cover = RowCover(camera, constraints.tolerance)
        self.margin = PairMargin(camera, self.layout, self.cover)
        self.overlap_v = overlap_v
        self._extra_v = extra_v
        self.zones = lru_cache(maxsize=None)(self._zones)

    def pairs(self, low_deg: FloatArray, low_count: IntArray, high_count: IntArray) -> Pairs:
        """Pairs of rows with what C3 demands of them; the pitch of the higher rows is left open."""
        demand = np.full(len(low_deg), self.overlap_v)
        low, high = demand, demand
        if self._extra_v is not None:
            low = demand + self._extra_v(low_deg)
            high = demand + self._extra_v(low_deg + 0.85 * self.camera.vfov_deg)
        return Pairs(
            low_deg=low_deg,
            low_count=low_count,
            high_deg=low_deg,
            high_count=high_count,
            low_demand=low,
            high_demand=high,
        )

    def band(self, pitch_deg: FloatArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
        """Elevations that rows cover all round, whatever the errors: lowest and highest, each (k,)."""
        spacing, reach = self.layout.spacing_and_reach(pitch_deg, count)
        return self.cover.band(pitch_deg, spacing, reach)

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
        if not self.layout.closed:
            return [(-90.0, 90.0)]
        least_steep = self.spacing.least_steep_deg
        limit = float(least_steep[min(count, len(least_steep) - 1)])
        if count > 1 and self.layout.blind_deg > 0:
            limit = max(limit, self.blind_limit_deg)
        if limit <= 0:
            return [(-90.0, 90.0)]
        return [(limit, 90.0), (-90.0, -limit)]

    def zone_of(self, pitch_deg: float, count: int) -> Zone:
        """The range of pitches in which C2 allows a count that holds the given pitch, within the gimbal's."""
        for low, high in self.zones(count):
            if low - 1e-9 <= pitch_deg <= high + 1e-9:
                return max(low, self.pitch_deg[0]), min(high, self.pitch_deg[1])
        return pitch_deg, pitch_deg

    @property
    def blind_limit_deg(self) -> float:
        """The least |pitch| at which neighbours can bridge what the gimbal cannot pan to."""
        steepness = np.linspace(0.0, 90.0, 721)
        fine = self.spacing.widest(steepness) >= self.layout.blind_deg
        return float(steepness[np.argmax(fine)]) if fine.any() else 90.0

    def counts_between(self, start_deg: float, stop_deg: float) -> tuple[int, int]:
        """Fewest and most images that C2 alone asks for between two pitches."""
        if not self.layout.closed:
            pitches = np.linspace(start_deg, stop_deg, 9)
            widest = np.maximum(self.spacing.widest(pitches), 1e-3)
            counts = np.ceil(self.layout.span_deg / widest).astype(int)
            return max(1, int(counts.min()) - 1), max(1, int(counts.max()))
        steepest = max(abs(start_deg), abs(stop_deg))
        flattest = 0.0 if start_deg <= 0 <= stop_deg else min(abs(start_deg), abs(stop_deg))
        if self.layout.blind_deg > 0:
            return self._fewest_at(steepest), self._fewest_at(flattest) + 2
        return self._fewest_at(steepest), self._fewest_at(flattest)

    def _fewest_at(self, steepness_deg: float) -> int:
        if steepness_deg >= 90.0:
            return 1
        return max(1, int(np.argmax(self.spacing.least_steep_deg <= steepness_deg)))

    def fewest(self, pitch_deg: FloatArray) -> IntArray:
        """Fewest images that C2 alone asks for at pitches (k,)."""
        if not self.layout.closed:
            widest = np.maximum(self.spacing.widest(pitch_deg), 1e-3)
            return np.maximum(1, np.ceil(self.layout.span_deg / widest).astype(np.intp) - 1)
        # least_steep falls with the count: the first that is not above the steepness
        ascending = self.spacing.least_steep_deg[::-1]
        position = np.searchsorted(ascending, np.abs(pitch_deg), side="right")
        return np.asarray(np.where(np.abs(pitch_deg) >= 90.0, 1, np.maximum(len(ascending) - position, 1)))

    def first_rows(self, more_images: int) -> tuple[FloatArray, IntArray]:
        """Rows that cover from the band's lower end: for each count the highest pitch, (k,) each."""
        low, height = self.band_deg[0], self.camera.vfov_deg
        bottom, top = self.pitch_deg
        candidates = np.linspace(max(bottom, low - height), max(bottom, min(top, low + height)), _CANDIDATES)
        fewest, most = self.counts_between(float(candidates[0]), float(candidates[-1]))
        counts = np.arange(fewest, most + more_images + 1)
        pitch, count = (a.ravel() for a in np.meshgrid(candidates, counts, indexing="ij"))
        good = self._begins(pitch, count)
        highest = np.array([pitch[good & (count == c)].max(initial=-np.inf) for c in counts.tolist()])
        counts, highest = counts[np.isfinite(highest)], highest[np.isfinite(highest)]
        step = float(candidates[1] - candidates[0])
        lower, upper = highest, np.minimum(highest + step, top)
        fine = self._begins(upper, counts)
        lower = np.where(fine, upper, lower)
        for _ in range(_NARROWING):
            middle = (lower + upper) / 2
            fine = self._begins(middle, counts)
            lower, upper = np.where(fine, middle, lower), np.where(fine, upper, middle)
        return lower, counts

    def _begins(self, pitch_deg: FloatArray, count: IntArray) -> NDArray[np.bool_]:
        low, high = self.band(pitch_deg, count)
        bottom = self.band_deg[0]
        return np.asarray(self.allowed(pitch_deg, count) & (low <= bottom) & (high > max(bottom, -89.999)))
