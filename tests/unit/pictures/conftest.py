"""A small panorama with known truth, rendered once."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("PIL")

from panoexec.optics import Camera
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance

CAMERA = Camera(
    name="small",
    sensor_width_mm=17.3,
    sensor_height_mm=13.0,
    image_width_px=5280,
    image_height_px=3956,
    focal_length_mm=15.0,
)
SCENE: Any = {"scene_seed": 11, "scene_px": 2048, "width_px": 420}


def plan_of(rows: dict[float, int]) -> Plan:
    """Rows of equally spaced shots: pitch and count."""
    poses = [(row, pitch, 360.0 * k / count) for row, (pitch, count) in enumerate(rows.items()) for k in range(count)]
    return Plan(
        method="certified",
        camera=CAMERA,
        constraints=Constraints(
            overlap_h=0.1,
            overlap_v=0.1,
            band=Band(elevation_min_deg=-50.0, elevation_max_deg=0.0),
            tolerance=Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7),
        ),
        shots=tuple(
            Shot(index=number, row=row, pitch_deg=pitch, yaw_deg=(yaw + 180) % 360 - 180)
            for number, (row, pitch, yaw) in enumerate(poses)
        ),
    )


@pytest.fixture(scope="session")
def two_rows() -> Plan:
    return plan_of({-28.0: 8, -60.0: 6})
