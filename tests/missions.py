"""Mission directories made without flying: photos of a scene, and a manifest that says how they were taken."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from panoexec.angles import FloatArray, quaternion_from_rotation, rotation, yaw_pitch_roll
from panoexec.optics import Camera
from panoexec.planfile import write_plan
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance
from panoexec.sim.jpeg import PhotoMetadata, write_jpeg
from panoexec.sim.render import Renderer
from panoexec.sim.scene import Scene

TOLERANCE = Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.667)


def ring_poses(rows: Sequence[tuple[float, int]]) -> list[tuple[int, float, float]]:
    """(row, pitch, yaw) of evenly spaced images, given (pitch, number) of each row."""
    return [(row, pitch, 360.0 * k / n - 180) for row, (pitch, n) in enumerate(rows) for k in range(n)]


def pose_json(pose: FloatArray) -> dict[str, Any]:
    """A pose as a manifest writes it."""
    yaw, pitch, roll = (float(angle) for angle in yaw_pitch_roll(pose))
    return {
        "quaternion": quaternion_from_rotation(pose).tolist(),
        "yaw_deg": yaw,
        "pitch_deg": pitch,
        "roll_deg": roll,
    }


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
    (folder / "images").mkdir(parents=True, exist_ok=True)
    renderer, rng = Renderer(scene), np.random.default_rng(seed)
    truth, shots, entries = [], [], []
    for index, (row, pitch, yaw) in enumerate(poses):
        error = rng.normal(size=3) * (0.667, 0.017, 0.017) if seed is not None else np.zeros(3)
        measured = rotation(yaw, pitch)
        truth.append(rotation(yaw + error[0], pitch + error[1], error[2]))
        name = f"images/IMG_{index:04d}.jpg"
        w, x, y, z = quaternion_from_rotation(measured).tolist()
        metadata = PhotoMetadata(
            time_utc_s=1.79e9 + index,
            exposure_s=0.002,
            focal_length_mm=camera.focal_length_mm,
            equivalent_focal_length_mm=camera.equivalent_focal_length_mm,
            q_wxyz=(w, x, y, z),
        )
        write_jpeg(folder / name, renderer.render(camera, truth[-1], width_px), metadata)
        shots.append(Shot(index=index, row=row, pitch_deg=pitch, yaw_deg=yaw))
        attempt = {
            "number": 1, "verdict": "accepted", "measured": pose_json(measured), "error_deg": None,
            "evidence": "file_seen", "capture_time": f"2026-09-21T14:{13 + index // 60:02d}:{index % 60:02d}.000Z",
            "file": name, "photos": [{"number": 1, "file": name}],
        }  # fmt: skip
        entries.append(
            {"index": index, "row": row, "target": pose_json(measured), "accepted_attempt": 1, "attempts": [attempt]}
        )
    manifest = {
        "format": "panoexec.manifest/1",
        "mission_id": folder.name,
        "state": "complete",
        "camera": asdict(camera),
        "reference": {"kind": "north", "yaw_north_deg": 30.0},
        "shots": entries,
    }
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=band, tolerance=TOLERANCE)
    write_plan(folder / "plan.json", Plan(method="foreign", camera=camera, constraints=constraints, shots=tuple(shots)))
    return np.array(truth)
