"""Dense sampling, as a judge that shares nothing with the planners but the footprint's definition."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import direction
from panoexec.planning.model import Band, Plan


def directions_in(band: Band, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Random directions of a band, evenly spread over its solid angle, some of them on its borders; (count, 3)."""
    low, high = np.sin(np.radians([band.elevation_min_deg, band.elevation_max_deg]))
    elevation = np.degrees(np.arcsin(rng.uniform(low, high, count)))
    azimuth = rng.uniform(band.azimuth_min_deg, band.azimuth_max_deg, count)
    edge = count // 50
    elevation[:edge], elevation[edge : 2 * edge] = band.elevation_max_deg, band.elevation_min_deg
    azimuth[2 * edge : 3 * edge], azimuth[3 * edge : 4 * edge] = band.azimuth_min_deg, band.azimuth_max_deg
    return direction(elevation, azimuth)


def uncovered(plan: Plan, directions: NDArray[np.float64], slack: float = 1e-9) -> NDArray[np.float64]:
    """Those of the directions (n, 3) that no image of the plan has in its rectangle; (k, 3)."""
    left = directions
    for turn in plan.rotations():
        # a pinhole by the book: divide by the depth, compare with the sensor's half sizes
        in_camera = left @ turn
        depth = in_camera[:, 0]
        seen = (depth > 0) & (np.abs(in_camera[:, 1]) <= depth * plan.camera.half_width + slack)
        seen &= np.abs(in_camera[:, 2]) <= depth * plan.camera.half_height + slack
        left = left[~seen]
    return left
