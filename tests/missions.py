"""Mission directories made without flying: photos of a scene, and a manifest that says how they were taken."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from panoexec.angles import FloatArray
from panoexec.experiment.capture import PointingErrors, write_capture
from panoexec.optics import Camera
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance
from panoexec.sim.photos.scene import Scene

CAMERA = Camera(
    name="test",
    sensor_width_mm=16.0,
    sensor_height_mm=12.0,
    image_width_px=4000,
    image_height_px=3000,
    focal_length_mm=9.0,
)
"""83° x 67°: few images cover much."""
BAND = Band(elevation_min_deg=-90, elevation_max_deg=-4)
TOLERANCE = Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.667)


def ring_poses(rows: Sequence[tuple[float, int]]) -> list[tuple[int, float, float]]:
    """(row, pitch, yaw) of evenly spaced images, given (pitch, number) of each row."""
    return [(row, pitch, 360.0 * k / n - 180) for row, (pitch, n) in enumerate(rows) for k in range(n)]


def write_mission(
    folder: Path,
    camera: Camera,
    poses: Sequence[tuple[int, float, float]],
    scene: Scene,
    *,
    width_px: int,
    band: Band,
    seed: int | None = None,
) -> FloatArray:
    """Photograph a scene; the manifest holds the poses aimed at, the photos are taken with the paper's errors.

    Args:
        folder: the mission directory, made if needed.
        camera: the camera.
        poses: (row, pitch, yaw) in shooting order.
        scene: what there is to see.
        width_px: of the photos.
        band: what the plan asked for.
        seed: of the pointing errors; None for none.

    Returns:
        The true camera-to-world rotations (n, 3, 3).
    """
    constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=band, tolerance=TOLERANCE)
    shots = tuple(Shot(index=i, row=row, pitch_deg=pitch, yaw_deg=yaw) for i, (row, pitch, yaw) in enumerate(poses))
    plan = Plan(method="foreign", camera=camera, constraints=constraints, shots=shots)
    errors = None if seed is None else PointingErrors(size=TOLERANCE, spread="normal", seed=seed)
    return write_capture(folder, plan, scene, width_px=width_px, errors=errors, reference_yaw_north_deg=30.0)
