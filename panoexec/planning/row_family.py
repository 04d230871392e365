"""How far apart the images of one row may stand: what C2, and where it binds C4, ask of neighbours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import NO_TOLERANCE, Tolerance
from panoexec.planning.roots import last_nonnegative
from panoexec.planning.row_overlap import neighbour_overlap

HAIR = 1e-7
"""Overlap asked for beyond the threshold: more than rounding, less than an image."""

MOST_IN_A_ROW = 5000

_NODES = 33
_STEPS = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class NeighbourDemand:
    """What neighbours in a row have to share: at the planned poses, and whatever the errors (0: nothing)."""

    planned: float
    worst: float
    tolerance: Tolerance

    def surplus(self, camera: Camera, pitch_deg: FloatArray, spacing_deg: FloatArray) -> FloatArray:
        """How much more images of pitch (k,) share than they have to, when (k,) apart."""
        surplus = neighbour_overlap(camera, pitch_deg, spacing_deg, NO_TOLERANCE)
        if self.tolerance.is_zero:
            return surplus - max(self.planned, self.worst) - HAIR
        surplus = surplus - self.planned
        if self.worst > 0:
            surplus = np.minimum(surplus, neighbour_overlap(camera, pitch_deg, spacing_deg, self.tolerance) - self.worst)
        return surplus - HAIR


class NeighbourSpacing:
    """How far apart neighbours in a row may be, for one camera and demand."""

    def __init__(self, camera: Camera, demand: NeighbourDemand) -> None:
        self._camera = camera
        self._demand = demand
        self._precision = 1e-7 if demand.worst == 0 or demand.tolerance.is_zero else 1e-4

    def surplus(self, pitch_deg: FloatArray, spacing_deg: FloatArray) -> FloatArray:
        """See `NeighbourDemand.surplus`."""
        return self._demand.surplus(self._camera, pitch_deg, spacing_deg)

    def widest(self, pitch_deg: FloatArray) -> FloatArray:
        """The widest spacing allowed at pitches (...), degrees, a hair on the safe side; 0 where none is."""
        steepness, widest = self._table
        return np.asarray(np.interp(np.abs(pitch_deg), steepness, widest) * (1 - 1e-4))

    @cached_property
    def most_images(self) -> int:
        """The number of images that closes a row at any pitch; `MOST_IN_A_ROW` if not even that many do."""
        at_horizon = float(self._widest_spacing(np.zeros(1))[0])
        return MOST_IN_A_ROW if at_horizon * MOST_IN_A_ROW <= 360 else math.ceil(360 / at_horizon)

    @cached_property
    def least_steep_deg(self) -> FloatArray:
        """For each number of images from 0 to `most_images`, the least |pitch| at which that many close a row.

        90 where only a cap would; never NaN.
        """
        counts = np.arange(2, self.most_images + 1)
        spacing = 360.0 / counts
        flatness = last_nonnegative(
            lambda which, x: self.surplus(90.0 - x, spacing[which]),
            np.full(len(counts), 0.1),
            np.full(len(counts), 90.0),
            self._precision,
            _STEPS,
        )
        return np.concatenate([[90.0, 90.0], np.where(np.isnan(flatness), 90.0, 90.0 - flatness)])

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray]:
        steepness = np.linspace(0.0, 90.0, _NODES)
        return steepness, self._widest_spacing(steepness)

    def _widest_spacing(self, steepness_deg: FloatArray) -> FloatArray:
        count = len(steepness_deg)
        found = last_nonnegative(
            lambda which, spacing: self.surplus(steepness_deg[which], spacing),
            np.full(count, 360.0 / MOST_IN_A_ROW),
            np.full(count, 180.0),
            self._precision,
            _STEPS,
        )
        return np.where(np.isnan(found), 0.0, found)
