"""HDRpano's column-and-row grid, inferred from the two plans in the paper's Table 1 that were made with it."""

from __future__ import annotations

import math

from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.baselines.grid import Row, evenly_spaced, shots_by_row
from panoexec.planning.model import Constraints, Plan
from panoexec.planning.reach import check_reachable
from panoexec.planning.request import MAX_IMAGES, check_request


def plan_hdrpano(camera: Camera, constraints: Constraints, columns: int, rows: int) -> Plan:
    """A grid without overlap or coverage constraints: `columns` images at the horizon, fewer towards the poles.

    The band's elevations are the *pitches* of the highest and of the lowest row, `rows` equal steps apart; so the
    panorama extends half a field of view further. A row has round(columns · cos(pitch)) images; the count of the
    highest row is taken at its inner edge, half a step nearer to the horizon. With 8 columns and 4 rows, or 21 and 10,
    from pitch 30° to -90°, these are the paper's plans of Scenarios 1 and 2.

    Args:
        camera: the camera.
        constraints: only its band and the gimbal's limits are used; the certificate checks the others.
        columns: images of a full circle at the horizon, at least 1.
        rows: steps between rows, at least 1.

    Raises:
        PlanningError: invalid numbers, or a row beyond the gimbal's limits.
    """
    check_request(camera, constraints)
    for name, value in (("columns", columns), ("rows", rows)):
        if not 1 <= value <= MAX_IMAGES:
            raise PlanningError(f"{name} {value} is out of range: give a whole number from 1 to {MAX_IMAGES}")
    if columns * rows > MAX_IMAGES:
        raise PlanningError(f"{columns} columns times {rows} rows are too many: at most {MAX_IMAGES} images")
    band = constraints.band
    low, high = float(band.elevation_min_deg), float(band.elevation_max_deg)
    step = (high - low) / rows
    share = band.azimuth_span_deg / 360.0
    grid: list[Row] = []
    for i in range(rows + 1):
        pitch = low + i * step if i < rows else high
        inner = pitch if i < rows else _towards_horizon(pitch, step / 2)
        count = max(1, round(columns * share * math.cos(math.radians(inner))))
        grid.append(evenly_spaced(pitch, 1 if abs(pitch) == 90.0 else count, band))
    shots = shots_by_row(grid, band)
    check_reachable(shots, constraints.gimbal)
    return Plan(method="hdrpano", camera=camera, constraints=constraints, shots=shots)


def _towards_horizon(pitch_deg: float, by_deg: float) -> float:
    return math.copysign(max(0.0, abs(pitch_deg) - by_deg), pitch_deg)
