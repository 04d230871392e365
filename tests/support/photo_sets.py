"""Sets of photos with known truth, rendered without flying: the poses of a plan plus errors, with faults put in."""

from __future__ import annotations

import io
import math
import random
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import PIL.Image
import PIL.ImageFilter

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera
from panoexec.planning.model import Plan
from panoexec.sim.photos.render import Renderer
from panoexec.sim.photos.scene import procedural_scene

ENCODER_DEG = 0.017
HEADING_DEG = 0.667
SHOT_S = 2.0


@dataclass(frozen=True, kw_only=True)
class TakenPhoto:
    """A photo as it reached the companion.

    Attributes:
        shot: its number.
        content: of the file.
        measured: attitude that was reported (3, 3).
        truth: attitude of the camera when the shutter was open (3, 3).
        time_s: when.
        fault: what was put in; "" for a clean photo.
    """

    shot: int
    content: bytes
    measured: FloatArray
    truth: FloatArray
    time_s: float
    fault: str = ""


@dataclass(frozen=True, kw_only=True)
class PhotoSet:
    """The photos of one mission, in the order in which they were taken."""

    camera: Camera
    photos: list[TakenPhoto]
    faults: dict[int, str] = field(default_factory=dict)


@lru_cache(maxsize=1)
def renderer(seed: int, width_px: int, kind: str = "city") -> Renderer:
    """The renderer of a scene; only the last one is kept."""
    return Renderer(procedural_scene(seed, width_px, kind))


def photo_set(
    plan: Plan,
    *,
    scene_seed: int,
    seed: int,
    width_px: int = 800,
    scene_px: int = 4096,
    kind: str = "city",
    faults: dict[int, str] | None = None,
    quality: int = 90,
    shifts: dict[int, tuple[float, float, float]] | None = None,
    bias_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> PhotoSet:
    """Photograph a plan.

    Args:
        plan: camera and shots.
        scene_seed: chooses the landscape.
        seed: of the errors.
        width_px: of the photos.
        scene_px: of the scene, around the horizon.
        kind: of the scene.
        faults: by place in the shooting order: a name of the simulator's faults, `attitude-lie=DEG`, `photo-blur=PX`.
        quality: of the JPEGs.
        shifts: by place in the shooting order: where the camera was, as shares of its height (`Renderer.render`).
        bias_deg: constant error of the measured yaw, pitch and roll.
    """
    from panoexec.sim.photos.spoiling import spoiled_file, spoiled_image  # noqa: PLC0415

    rng = random.Random(seed)
    faults = faults or {}
    make = renderer(scene_seed, scene_px, kind)
    phase, period = rng.uniform(0, 2 * math.pi), rng.uniform(90, 240)
    photos: list[TakenPhoto] = []
    images: list[np.ndarray] = []
    truths, measures = [], []
    for number, shot in enumerate(plan.shots):
        time_s = number * SHOT_S
        heading = HEADING_DEG * math.sin(phase + 2 * math.pi * time_s / period)
        yaw, pitch, roll = (angle + rng.gauss(0, 0.03) for angle in (shot.yaw_deg, shot.pitch_deg, 0.0))
        truth = rotation(yaw - heading, pitch, roll)
        reported = (a + rng.gauss(0, ENCODER_DEG) + bias for a, bias in zip((yaw, pitch, roll), bias_deg, strict=True))
        measured = rotation(*reported)
        name, _, size = faults.get(number, "").partition("=")
        if name == "attitude-lie":
            # the camera is elsewhere than it says
            truth = truth @ _turn(rng, float(size))
        truths.append(truth)
        measures.append(measured)
        images.append(make.render(plan.camera, truth, width_px, shift=(shifts or {}).get(number, (0.0, 0.0, 0.0))))
    order = list(range(len(images)))
    for number, name in faults.items():
        if name == "photo-swapped" and number + 1 < len(order):
            order[number], order[number + 1] = order[number + 1], order[number]
        if name == "photo-stale" and number:
            order[number] = order[number - 1]
    marked = dict(faults)
    for number, name in faults.items():
        if name == "photo-swapped" and number + 1 < len(order):
            marked[number + 1] = name
    for number, shot in enumerate(plan.shots):
        name, _, size = faults.get(number, "").partition("=")
        image = spoiled_image(images[order[number]], name, float(size) if size else None, seed=rng.randrange(1 << 30))
        buffer = io.BytesIO()
        PIL.Image.fromarray(image).save(buffer, "JPEG", quality=quality)
        content = spoiled_file(buffer.getvalue(), name, seed=rng.randrange(1 << 30))
        photos.append(
            TakenPhoto(
                shot=shot.index,
                content=content,
                measured=measures[number],
                truth=truths[number],
                time_s=number * SHOT_S,
                fault=marked.get(number, ""),
            )
        )
    return PhotoSet(camera=plan.camera, photos=photos, faults=marked)


def _turn(rng: random.Random, angle_deg: float) -> FloatArray:
    """A rotation by that angle about a random axis."""
    axis = np.array([rng.gauss(0, 1) for _ in range(3)])
    axis /= np.linalg.norm(axis)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = math.radians(angle_deg)
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)
