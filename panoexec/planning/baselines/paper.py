"""The paper's planner: Algorithms 1 and 2 with exact overlap, extended to close the gaps that they leave.

As published (Zhang, Liu, Zhou), with these interpretations:

* "max O_i" is the largest angle whose overlap is still at least the threshold.
* Algorithm 1 decreases the tilt in steps to the nadir. The overlap of two images that differ only in tilt depends only
  on the difference, so all steps are equal except the last one, which ends at the nadir with a single image, the cap.
* Algorithm 2 takes n = ⌈360° / α⌉ images in a row, evenly spaced, so the closing pair overlaps as much as the rest.

The algorithms consider pairs of neighbours only and therefore leave holes: halfway between two images of a row the
covered band is thinnest, and near the nadir a row of two or three images covers almost nothing there. Extensions:

* the first row is as low as possible while the band's upper end is covered at all azimuths, halfway between images too;
* a row gets more images than Algorithm 2 gives where its ring would not meet the ring of the next row; where no number
  of images closes the gap, all steps are reduced slightly.

So the plan covers the band at the planned poses. Pointing errors are not considered: see `--method certified`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from panoexec.angles import FloatArray, rotation
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.baselines.grid import Row, evenly_spaced, shots_by_row
from panoexec.planning.baselines.ring import cap_radius_deg, ring
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import Constraints, Plan
from panoexec.planning.reach import check_reachable
from panoexec.planning.request import MAX_IMAGES, check_request

_LEAST_OVERLAP = 1e-9
"""Smaller thresholds are replaced by this one: any angle has an overlap of at least 0."""
_MARGIN_DEG = 1e-3
"""Minimum overlap of rings with each other and with the band's ends, far above the rounding error of their borders."""
_COUNTS_TRIED = 120
_SHRINK = 0.97
_SHRINKS = 60


def plan_paper(camera: Camera, constraints: Constraints) -> Plan:
    """Plan with the paper's Algorithms 1 and 2, without gaps at the planned poses.

    Raises:
        PlanningError: the request cannot be satisfied.
    """
    check_request(camera, constraints)
    tilt_step = tilt_step_deg(camera, constraints.overlap_v)
    for shrinks in range(_SHRINKS):
        layout = _Layout(camera=camera, constraints=constraints, tilt_step_deg=tilt_step, shrink=_SHRINK**shrinks)
        rows = layout.rows()
        if rows is not None:
            break
    else:
        raise PlanningError(
            f"overlaps of {constraints.overlap_h:g} and {constraints.overlap_v:g} leave gaps between rows of "
            f"{camera.name} that this method cannot close: ask for more overlap or use --method certified"
        )
    images = sum(row.count for row in rows)
    if images > MAX_IMAGES:
        raise PlanningError(f"the plan needs {images} images, more than {MAX_IMAGES}: ask for less overlap or band")
    shots = shots_by_row(rows, constraints.band)
    check_reachable(shots, constraints.gimbal)
    notes = _notes(rows, layout, shrinks)
    return Plan(method="paper", camera=camera, constraints=constraints, shots=shots, notes=notes)


def tilt_step_deg(camera: Camera, overlap_v: float) -> float:
    """Algorithm 1: the largest tilt difference of two images with an overlap of at least `overlap_v`, degrees."""

    def overlap(angles_deg: FloatArray) -> FloatArray:
        return pairwise_overlap(camera, np.eye(3), rotation(0.0, angles_deg))

    return _largest_angle(overlap, max(overlap_v, _LEAST_OVERLAP), camera.vfov_deg, 33)


def pan_step_deg(camera: Camera, pitch_deg: float, overlap_h: float) -> float:
    """Algorithm 2: the largest pan difference, up to 180°, of two images at `pitch_deg` that overlap by `overlap_h`.

    Near the nadir the overlap may increase again beyond some pan; the result is the first angle of the threshold.
    """
    fixed = rotation(0.0, pitch_deg)

    def overlap(angles_deg: FloatArray) -> FloatArray:
        return pairwise_overlap(camera, fixed, rotation(angles_deg, pitch_deg))

    # the overlap increases again only where an image is as large as its distance from the pole: not within 1° of pan
    return _largest_angle(overlap, max(overlap_h, _LEAST_OVERLAP), 180.0, 181)


_pan_step_deg = lru_cache(maxsize=1024)(pan_step_deg)
"""Cached: the same rows are evaluated repeatedly while the gaps of a layout are closed."""


def _largest_angle(
    overlap: Callable[[FloatArray], FloatArray], threshold: float, up_to_deg: float, points: int
) -> float:
    """First angle at which the overlap falls below the threshold, or `up_to_deg`; each step narrows it 33-fold."""
    low, high = 0.0, up_to_deg
    while high - low > 1e-9:
        angles = np.linspace(low, high, points)
        passed = overlap(angles) >= threshold
        if passed.all():
            return high
        first = max(int(np.argmin(passed)), 1)
        low, high, points = float(angles[first - 1]), float(angles[first]), 33
    return low


@dataclass(frozen=True, slots=True, kw_only=True)
class _Layout:
    """The rows for one tilt step; `rows` returns None where gaps remain for any number of images."""

    camera: Camera
    constraints: Constraints
    tilt_step_deg: float
    shrink: float = 1.0

    @property
    def step_deg(self) -> float:
        """Pitch difference of consecutive rows."""
        return self.tilt_step_deg * self.shrink

    def rows(self) -> list[Row] | None:
        """Rows from the top down."""
        band = self.constraints.band
        first = self._end_row(band.elevation_max_deg, 1.0)
        if not first.is_cap and self.ring(first)[0] <= band.elevation_min_deg:
            return [first]
        last = self._end_row(band.elevation_min_deg, -1.0)
        rows = [first, *(self.paper_row(pitch) for pitch in self._pitches_between(first, last)), last]
        rows.sort(key=lambda row: -row.pitch_deg)
        for i in range(len(rows) - 1):
            closed = self._closed(rows[i], rows[i + 1])
            if closed is None:
                return None
            rows[i], rows[i + 1] = closed
        return rows

    def paper_row(self, pitch_deg: float) -> Row:
        """The row at a pitch according to Algorithm 2."""
        if abs(pitch_deg) == 90.0:
            return self._row(pitch_deg, 1)
        band = self.constraints.band
        step = _pan_step_deg(self.camera, pitch_deg, self.constraints.overlap_h)
        least = 2 if band.is_full_circle else 1
        return self._row(pitch_deg, max(least, math.ceil(band.azimuth_span_deg / step - 1e-9)))

    def ring(self, row: Row) -> tuple[float, float]:
        """Elevations that the row covers at all azimuths of the band."""
        if row.is_cap:
            radius = cap_radius_deg(self.camera)
            return (90.0 - radius, 90.0) if row.pitch_deg > 0 else (-90.0, -90.0 + radius)
        low, high = ring(self.camera, row.pitch_deg, row.spacing_deg / 2)
        return float(low), float(high)

    def _row(self, pitch_deg: float, count: int) -> Row:
        return evenly_spaced(pitch_deg, count, self.constraints.band)

    def _pitches_between(self, first: Row, last: Row) -> list[float]:
        """Algorithm 1: pitches below the first row, in equal steps, until one more step reaches the last row."""
        pitches: list[float] = []
        pitch, step = first.pitch_deg, self._cap_step if first.is_cap else self.step_deg
        last_step = self._cap_step if last.is_cap else self.step_deg
        while pitch - last_step > last.pitch_deg + 1e-9:
            pitch = max(pitch - step, last.pitch_deg + last_step) if pitch - step <= last.pitch_deg else pitch - step
            pitches.append(pitch)
            step = self.step_deg
        return pitches

    @property
    def _cap_step(self) -> float:
        """The step between a row and a cap: smaller than others for narrow images, as a cap covers only a circle."""
        reach = self.camera.vfov_deg / 2 + cap_radius_deg(self.camera)
        return min(self.step_deg, _SHRINK * self.shrink * reach)

    def _end_row(self, elevation_deg: float, side: float) -> Row:
        """The row that covers the band up to its upper (side 1) or down to its lower (side -1) end.

        A row of more images covers more halfway between them, and so can be further from the end. The count is the one
        with the most solid angle covered per image, and at least that of Algorithm 2. At a pole, or if no row reaches
        the end, it is a cap, as in the paper.
        """
        cap = self._row(90.0 * side, 1)
        natural = elevation_deg - side * self.camera.vfov_deg / 2
        if abs(elevation_deg) == 90.0:
            return cap
        usual = max(self.paper_row(max(-89.9, min(89.9, pitch))).count for pitch in (natural, elevation_deg))
        tried = np.linspace(1, 2 * usual + 7, min(2 * usual + 7, _COUNTS_TRIED))
        options = []
        for count in sorted({round(float(number)) for number in tried}):
            pitch = self._end_pitch(elevation_deg, side, count)
            if pitch is not None:
                row = self._row(pitch, count)
                options.append((self._gain(row) / count, row))
        options.sort(key=lambda option: -option[0])
        return next((row for _, row in options if row.count >= self.paper_row(row.pitch_deg).count), cap)

    def _gain(self, row: Row) -> float:
        """Extent of the band that the row covers at all azimuths, in units of sin(elevation) (∝ solid angle)."""
        band = self.constraints.band
        low, high = self.ring(row)
        low, high = max(low, band.elevation_min_deg), min(high, band.elevation_max_deg)
        return math.sin(math.radians(high)) - math.sin(math.radians(low))

    def _end_pitch(self, elevation_deg: float, side: float, count: int) -> float | None:
        """The pitch furthest from the band's end at which a row of `count` images still covers that end."""
        reach = self._row(0.0, count).spacing_deg / 2
        fov = self.camera.vfov_deg
        first, last = elevation_deg - side * fov / 2, elevation_deg + side * fov / 2 + side * 2 * _MARGIN_DEG
        pitches = np.linspace(first, last, 257)
        for _ in range(8):
            pitches = np.clip(pitches, -90.0, 90.0)
            low, high = ring(self.camera, pitches, reach)
            reaches = (high if side > 0 else -low) >= side * elevation_deg + _MARGIN_DEG
            reaches &= low < high
            if not reaches.any():
                return None
            index = int(np.argmax(reaches))
            if index == 0 or abs(pitches[index] - pitches[index - 1]) < 1e-9:
                return float(pitches[index])
            pitches = np.linspace(pitches[index - 1], pitches[index], 33)
        return float(pitches[-1])

    def _closed(self, above: Row, below: Row) -> tuple[Row, Row] | None:
        """The two rows with images added until their rings meet; None if they never do."""
        gap = self._gap(above, below)
        most = 4 * max(above.count, below.count) + 16
        while gap > -_MARGIN_DEG:
            more = []
            if not above.is_cap:
                wider = self._row(above.pitch_deg, above.count + 1)
                more.append((self._gap(wider, below), wider.count, wider, below))
            if not below.is_cap:
                wider = self._row(below.pitch_deg, below.count + 1)
                more.append((self._gap(above, wider), wider.count, above, wider))
            gap, count, above, below = min(more, key=lambda option: option[:2])
            if count > most:
                return None
        return above, below

    def _gap(self, above: Row, below: Row) -> float:
        (low_above, high_above), (low_below, high_below) = self.ring(above), self.ring(below)
        hollow = max(0.0, low_above - high_above) + max(0.0, low_below - high_below)
        return low_above - high_below + hollow


def _notes(rows: list[Row], layout: _Layout, shrinks: int) -> tuple[str, ...]:
    notes = []
    if shrinks:
        notes.append(f"rows {1 - _SHRINK**shrinks:.0%} closer than Algorithm 1 gives, to avoid gaps")
    for row in rows:
        published = layout.paper_row(row.pitch_deg).count
        if row.count > published:
            notes.append(
                f"row at {row.pitch_deg:.1f}°: {row.count} images instead of Algorithm 2's {published}, "
                "to avoid a gap to the next row or the band's end"
            )
    return tuple(notes)
