"""Rows of evenly spaced images as shots: shared by the paper's and HDRpano's planners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from panoexec.angles import FloatArray, wrap_180
from panoexec.planning.model import Band, Shot


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Images of one pitch, evenly spaced: over the full circle from yaw 0, over a sector about its middle.

    Attributes:
        pitch_deg: pitch of all images of the row.
        count: number of images.
        spacing_deg: yaw difference of neighbours; the images divide the band's azimuths into equal parts.
    """

    pitch_deg: float
    count: int
    spacing_deg: float

    @property
    def is_cap(self) -> bool:
        """Whether this is a single image at the zenith or nadir."""
        return self.count == 1 and abs(self.pitch_deg) == 90.0

    def yaws(self, band: Band) -> FloatArray:
        """Yaws (count,) of the row's images, clockwise, in [-180, 180)."""
        if band.is_full_circle:
            return wrap_180(np.arange(self.count) * self.spacing_deg)
        return wrap_180(band.azimuth_min_deg + (np.arange(self.count) + 0.5) * self.spacing_deg)


def evenly_spaced(pitch_deg: float, count: int, band: Band) -> Row:
    """A row of `count` images, evenly spaced over the band's azimuths."""
    return Row(pitch_deg=pitch_deg, count=count, spacing_deg=band.azimuth_span_deg / count)


def shots_by_row(rows: Sequence[Row], band: Band) -> tuple[Shot, ...]:
    """Shots row by row from the top down in a serpentine, so that the start of a row never needs a large pan.

    Args:
        rows: in any order.
        band: gives the start and the end of a row.
    """
    ordered = sorted(rows, key=lambda row: row.pitch_deg)
    shots: list[Shot] = []
    for turn, (number, row) in enumerate(reversed(list(enumerate(ordered)))):
        yaws = row.yaws(band)
        if band.is_full_circle:
            yaws = np.sort(yaws)
        for yaw in yaws[::-1] if turn % 2 else yaws:
            shots.append(Shot(index=len(shots), row=number, pitch_deg=row.pitch_deg, yaw_deg=float(yaw)))
    return tuple(shots)
