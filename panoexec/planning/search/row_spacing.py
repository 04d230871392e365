"""Widest spacing of the images of one row: the demands of C2, and of C4 where it is stronger, on neighbours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.geometry.root_finding import last_nonnegative
from panoexec.planning.model import NO_TOLERANCE, Tolerance
from panoexec.planning.search.budget import SearchBudget
from panoexec.planning.search.row_cover import CoreEdges
from panoexec.planning.search.row_overlap import neighbour_overlap

HAIR = 1e-7
"""Overlap demanded above the threshold: more than the rounding error, less than an image."""

MOST_IN_A_ROW = 5000

_MOST_ABREAST = 200
"""Images of a row that see one direction: a spacing that would show it in more counts as none at all."""

_HOPELESS = 100
"""Number of counts tried towards the poles if no count is feasible at the horizon."""

_NODES = 33
_STEEPNESS_DEG = np.linspace(0.0, 90.0, _NODES)
_STEPS = 60
_COSTLY_PRECISION_DEG, _PRECISION_DEG = 1e-4, 1e-7
_WIDEST_PRECISION_DEG = 1e-6
"""Precision of angles; spacings are rounded to the safe side by more than theirs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NeighbourDemand:
    """Required overlaps of the images of one row, as fractions of an image.

    Attributes:
        planned: of neighbours, at the planned poses.
        worst: of neighbours, for every error; 0 for none.
        second: of images two apart, for every error; 0 for none.
        tolerance: the largest errors.
        seam: part of the meridian between neighbours that both see for every error, in vertical fields of view.
    """

    planned: float
    worst: float
    tolerance: Tolerance
    second: float = 0.0
    seam: float = 0.0

    @property
    def is_costly(self) -> bool:
        """Whether it takes bounds over all errors to evaluate."""
        return max(self.worst, self.second) > 0 and not self.tolerance.is_zero

    def surplus(self, camera: Camera, pitch_deg: FloatArray, spacing_deg: FloatArray) -> FloatArray:
        """Surplus of overlap over the demand for images of pitch (k,) at spacing (k,).

        Or, if that is less, the surplus of the part of the meridian between them that both see for every error, in
        vertical fields of view: a row that is not closed is useless.
        """
        surplus = neighbour_overlap(camera, pitch_deg, spacing_deg, NO_TOLERANCE) - self.planned
        if self.worst > 0:
            surplus = np.minimum(
                surplus, neighbour_overlap(camera, pitch_deg, spacing_deg, self.tolerance) - self.worst
            )
        if self.second > 0:
            twice = np.minimum(2 * spacing_deg, 180.0)
            surplus = np.minimum(surplus, neighbour_overlap(camera, pitch_deg, twice, self.tolerance) - self.second)
        if not self.tolerance.is_zero:
            low, high = CoreEdges(camera, self.tolerance).intervals(pitch_deg, spacing_deg[:, None] / 2)
            surplus = np.minimum(surplus, (high - low)[:, 0] / camera.vfov_deg - self.seam)
        return surplus - HAIR


class NeighbourSpacing:
    """Permitted spacing of neighbours in a row, for one camera and demand."""

    def __init__(self, camera: Camera, demand: NeighbourDemand, budget: SearchBudget | None = None) -> None:
        self._camera = camera
        self._demand = demand
        self._budget = budget or SearchBudget()
        self._precision = _COSTLY_PRECISION_DEG if demand.is_costly else _PRECISION_DEG

    def surplus(self, pitch_deg: FloatArray, spacing_deg: FloatArray) -> FloatArray:
        """See `NeighbourDemand.surplus`.

        Raises:
            BudgetSpentError: the budget of the search is used up.
        """
        self._budget.use()
        return self._demand.surplus(self._camera, pitch_deg, spacing_deg)

    def widest(self, pitch_deg: FloatArray) -> FloatArray:
        """The widest permitted spacing at pitches (...), degrees, rounded to the safe side; 0 where none is."""
        steepness, widest = self._table
        return np.asarray(np.interp(np.abs(pitch_deg), steepness, widest) * (1 - 1e-4))

    def most_images(self, around_deg: float) -> int:
        """Number of spacings that fill the given angle at any pitch, at most `MOST_IN_A_ROW`."""
        at_horizon = float(self._table[1][0])
        if at_horizon == 0:
            return _HOPELESS
        return MOST_IN_A_ROW if at_horizon * MOST_IN_A_ROW <= around_deg else math.ceil(around_deg / at_horizon)

    def least_steep_deg(self, spacing_deg: FloatArray) -> FloatArray:
        """The minimum |pitch| at which neighbours may have the spacing (k,); 90 where they never may, NaN for none."""
        flatness = last_nonnegative(
            lambda which, x: self.surplus(90.0 - x, spacing_deg[which]),
            np.full(len(spacing_deg), 0.1),
            np.full(len(spacing_deg), 90.0),
            self._precision,
            _STEPS,
        )
        return np.where(np.isnan(flatness), 90.0, 90.0 - flatness)

    @property
    def _table(self) -> tuple[FloatArray, FloatArray]:
        self._budget.use()
        return _STEEPNESS_DEG, _widest_spacing(self._camera, self._demand)


@lru_cache(maxsize=64)
def _widest_spacing(camera: Camera, demand: NeighbourDemand) -> FloatArray:
    """The widest spacing that a demand permits at each of `_STEEPNESS_DEG`, 0 where none; one for many sets of rows."""
    found = last_nonnegative(
        lambda which, spacing: demand.surplus(camera, _STEEPNESS_DEG[which], spacing),
        np.full(_NODES, max(360.0 / MOST_IN_A_ROW, camera.hfov_deg / _MOST_ABREAST)),
        np.full(_NODES, 180.0),
        _COSTLY_PRECISION_DEG if demand.is_costly else _WIDEST_PRECISION_DEG,
        _STEPS,
    )
    found = np.where(np.isnan(found), 0.0, found)
    found.setflags(write=False)
    return found
