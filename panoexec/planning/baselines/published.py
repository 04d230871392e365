"""The five plans of the paper's Table 1 as data, for verification and comparison.

This is the only reading of the table whose sums agree with the stated totals. The paper's tilt is positive down, so
pitch = -tilt. Images are evenly spaced in a row; the rows' phases are not published and are set to 0. "From tilt -30°"
means that the sky above is not captured: each plan's band ends where its top row still covers all azimuths.
The paper planned for the nominal focal lengths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from panoexec.errors import UsageError
from panoexec.optics import Camera
from panoexec.planning.baselines.grid import evenly_spaced, shots_by_row
from panoexec.planning.model import Band, Constraints, Plan, Tolerance

X5S_15MM = Camera(
    name="dji-x5s-15mm",
    sensor_width_mm=17.3,
    sensor_height_mm=13.0,
    image_width_px=5280,
    image_height_px=3956,
    focal_length_mm=15.0,
    calibrated_focal_length_mm=14.87,
    lens="nominal",
)
X5S_45MM = Camera(
    name="dji-x5s-45mm",
    sensor_width_mm=17.3,
    sensor_height_mm=13.0,
    image_width_px=5280,
    image_height_px=3956,
    focal_length_mm=45.0,
    calibrated_focal_length_mm=46.0,
    lens="nominal",
)
A6000_35MM = Camera(
    name="sony-a6000-35mm",
    sensor_width_mm=23.5,
    sensor_height_mm=15.6,
    image_width_px=6000,
    image_height_px=4000,
    focal_length_mm=35.0,
    calibrated_focal_length_mm=35.0,
    lens="nominal",
)

PAPER_TOLERANCE = Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.667)
"""The paper's τ_p and τ_y."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedPlan:
    """One plan of Table 1: tilts (positive down) with the number of images, as printed."""

    camera: Camera
    elevation_max_deg: float
    images_by_tilt: Mapping[float, int]

    @property
    def images(self) -> int:
        """Total number of images."""
        return sum(self.images_by_tilt.values())


PUBLISHED: Mapping[str, PublishedPlan] = MappingProxyType(
    {
        "scenario-1-proposed": PublishedPlan(
            camera=X5S_15MM, elevation_max_deg=50.5, images_by_tilt={-30: 7, 5: 8, 39: 6, 70: 3, 90: 1}
        ),
        "scenario-1-hdrpano": PublishedPlan(
            camera=X5S_15MM, elevation_max_deg=50.5, images_by_tilt={-30: 8, 0: 8, 30: 7, 60: 4, 90: 1}
        ),
        "scenario-2-proposed": PublishedPlan(
            camera=X5S_45MM,
            elevation_max_deg=37.7,
            images_by_tilt={-30: 18, -18: 20, -5: 21, 7: 21, 20: 20, 32: 16, 43: 14, 55: 11, 66: 8, 78: 5, 90: 1},
        ),
        "scenario-2-hdrpano": PublishedPlan(
            camera=X5S_45MM,
            elevation_max_deg=37.7,
            images_by_tilt={-30: 19, -18: 20, -6: 21, 6: 21, 18: 20, 30: 18, 42: 16, 54: 12, 66: 9, 78: 4, 90: 1},
        ),
        "scenario-3-proposed": PublishedPlan(
            camera=A6000_35MM, elevation_max_deg=12.2, images_by_tilt={0: 15, 21: 12, 40: 10, 57: 7, 75: 4, 90: 1}
        ),
    }
)


def published_plan(name: str) -> Plan:
    """One of the five plans of Table 1, with the paper's thresholds and tolerances.

    Raises:
        UsageError: no such plan; the message lists them.
    """
    published = PUBLISHED.get(name)
    if published is None:
        raise UsageError(f"unknown published plan {name!r}: choose from {', '.join(PUBLISHED)}")
    band = Band(elevation_min_deg=-90.0, elevation_max_deg=published.elevation_max_deg)
    rows = [evenly_spaced(float(-tilt), count, band) for tilt, count in published.images_by_tilt.items()]
    constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=band, tolerance=PAPER_TOLERANCE)
    shots = shots_by_row(rows, band)
    return Plan(method="published", camera=published.camera, constraints=constraints, shots=shots)
