"""Creates a mission directory without a flight: a plan's images of a scene, rendered with random pointing errors.

The manifest contains the target attitudes, the photos have the errors. Stitching them shows how a plan performs without
verification of the pointing.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from panoexec.angles import FloatArray, quaternion_from_rotation, rotation, yaw_pitch_roll
from panoexec.files import write_atomically
from panoexec.inputs.plan_file import camera_to_data, write_plan
from panoexec.planning.model import Plan, Shot, Tolerance
from panoexec.sim.photos.jpeg import PhotoMetadata, write_jpeg
from panoexec.sim.photos.render import Renderer
from panoexec.sim.photos.scene import Scene

Spread: TypeAlias = Literal["uniform", "normal"]
_START_UTC_S: Final = 1.79e9
_JPEG_EXPOSURE_S: Final = 0.002


@dataclass(frozen=True, slots=True, kw_only=True)
class PointingErrors:
    """Random pointing errors, independent for each image and axis.

    Attributes:
        size: error bound of each axis.
        spread: `uniform` within ± the size (like a tolerance), or `normal` with the size as standard deviation.
        seed: random seed.
    """

    size: Tolerance
    spread: Spread
    seed: int

    def draw(self, count: int) -> FloatArray:
        """Errors in yaw, pitch, roll (count, 3), degrees."""
        rng = np.random.default_rng(self.seed)
        sizes = np.array([self.size.yaw_deg, self.size.pitch_deg, self.size.roll_deg])
        drawn = rng.normal(size=(count, 3)) if self.spread == "normal" else rng.uniform(-1, 1, size=(count, 3))
        return np.asarray(drawn * sizes)


def write_capture(
    folder: Path,
    plan: Plan,
    scene: Scene,
    *,
    width_px: int,
    errors: PointingErrors | None,
    reference_yaw_north_deg: float = 0.0,
) -> FloatArray:
    """Render the images of a plan into a mission directory.

    Args:
        folder: created if needed.
        plan: shots in shooting order.
        scene: the scene to render.
        width_px: width of the photos.
        errors: pointing errors; None for none.
        reference_yaw_north_deg: direction of the plan's yaw 0, for the manifest.

    Returns:
        The true camera-to-world rotations (n, 3, 3).

    Raises:
        UsageError: a file cannot be written.
    """
    (folder / "images").mkdir(parents=True, exist_ok=True)
    renderer, camera = Renderer(scene), plan.camera
    truth = true_rotations(plan, errors)
    entries = []
    for number, shot in enumerate(plan.shots):
        aimed = rotation(shot.yaw_deg, shot.pitch_deg)
        name = f"images/IMG_{shot.index:04d}.jpg"
        w, x, y, z = quaternion_from_rotation(aimed).tolist()
        metadata = PhotoMetadata(
            time_utc_s=_START_UTC_S + number,
            exposure_s=_JPEG_EXPOSURE_S,
            focal_length_mm=camera.focal_length_mm,
            equivalent_focal_length_mm=camera.equivalent_focal_length_mm,
            q_wxyz=(w, x, y, z),
        )
        write_jpeg(folder / name, renderer.render(camera, truth[number], width_px), metadata)
        entries.append(_entry(shot, aimed, name, _START_UTC_S + number))
    tolerance = plan.constraints.tolerance
    manifest = {
        "format": "panoexec.manifest/1",
        "mission_id": folder.name,
        "state": "complete",
        "camera": camera_to_data(camera),
        "reference": {"kind": "north", "yaw_north_deg": reference_yaw_north_deg},
        "tolerance_deg": {"pitch": tolerance.pitch_deg, "roll": tolerance.roll_deg, "yaw": tolerance.yaw_deg},
        "shots": entries,
    }
    write_plan(folder / "plan.json", plan)
    # written last: a folder with a manifest is complete
    write_atomically(folder / "manifest.json", json.dumps(manifest, indent=1) + "\n")
    return truth


def true_rotations(plan: Plan, errors: PointingErrors | None) -> FloatArray:
    """The camera's attitudes for a plan with pointing errors, camera-to-world (n, 3, 3)."""
    off = np.zeros((len(plan.shots), 3)) if errors is None else errors.draw(len(plan.shots))
    yaw = np.array([shot.yaw_deg for shot in plan.shots]) + off[:, 0]
    pitch = np.array([shot.pitch_deg for shot in plan.shots]) + off[:, 1]
    return rotation(yaw, pitch, off[:, 2])


def pose_json(pose: FloatArray) -> dict[str, Any]:
    """A pose in the manifest's format."""
    yaw, pitch, roll = (float(angle) for angle in yaw_pitch_roll(pose))
    return {
        "quaternion": quaternion_from_rotation(pose).tolist(),
        "yaw_deg": yaw,
        "pitch_deg": pitch,
        "roll_deg": roll,
    }


def _entry(shot: Shot, aimed: FloatArray, name: str, time_utc_s: float) -> dict[str, Any]:
    stamp = datetime.fromtimestamp(time_utc_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    attempt = {
        "number": 1,
        "verdict": "accepted",
        "measured": pose_json(aimed),
        "error_deg": None,
        "evidence": "file_seen",
        "capture_time": stamp,
        "file": name,
        "photos": [{"number": 1, "file": name}],
    }
    return {
        "index": shot.index,
        "row": shot.row,
        "target": pose_json(aimed),
        "accepted_attempt": 1,
        "file": name,
        "attempts": [attempt],
    }
