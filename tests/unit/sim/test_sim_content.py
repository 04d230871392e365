"""A photo, read back from its file, shows the scene in the direction given by its own tags."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from panoexec.angles import FloatArray, quaternion_from_rotation, rotation, rotation_321
from panoexec.optics import Camera
from panoexec.sim.photos.jpeg import PhotoMetadata, write_jpeg
from panoexec.sim.photos.render import Renderer
from panoexec.sim.photos.scene import procedural_scene
from tests.content import pointing_offset_deg

LANDSCAPE = Camera.from_fov(59.94, 46.86)
SCENE = procedural_scene(1, 2048)


def photograph(path: Path, camera: Camera, pose: FloatArray) -> None:
    w, x, y, z = quaternion_from_rotation(pose).tolist()
    metadata = PhotoMetadata(
        time_utc_s=1.79e9, exposure_s=0.01, focal_length_mm=15, equivalent_focal_length_mm=30, q_wxyz=(w, x, y, z)
    )
    write_jpeg(path, Renderer(SCENE).render(camera, pose, 240), metadata)


def tagged_pose(path: Path) -> FloatArray:
    text = path.read_bytes().decode("latin-1")
    found = {axis: re.search(rf'drone-dji:Gimbal{axis}Degree="([^"]+)"', text) for axis in ("Yaw", "Pitch", "Roll")}
    return rotation_321(*(float(m[1]) for m in found.values() if m is not None))


@pytest.mark.parametrize("camera", [LANDSCAPE, LANDSCAPE.rotated()], ids=["landscape", "portrait"])
@pytest.mark.parametrize(
    ("yaw", "pitch", "roll"), [(0, -10, 0), (178, -30, 5), (-75, -90, 0), (60, -89.9, 0.3), (130, -60, -4)]
)
def test_photo_and_tags_agree(tmp_path: Path, camera: Camera, yaw: float, pitch: float, roll: float) -> None:
    path = tmp_path / "a.jpg"
    photograph(path, camera, rotation(yaw, pitch, roll))
    with PIL.Image.open(path) as picture:
        photo = np.array(picture)
    right, up, score = pointing_offset_deg(photo, SCENE, camera, tagged_pose(path))
    pixel = np.degrees(2 * camera.half_width / 240)
    assert abs(right) <= pixel
    assert abs(up) <= pixel
    assert score > 0.7


def test_an_offset_is_found_with_its_sign(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    photograph(path, LANDSCAPE, rotation(21.0, -28.0))
    with PIL.Image.open(path) as picture:
        photo = np.array(picture)
    right, up, _ = pointing_offset_deg(photo, SCENE, LANDSCAPE, rotation(20.0, -30.0))
    assert right == pytest.approx(1.0 * np.cos(np.radians(29)), abs=0.3)
    assert up == pytest.approx(2.0, abs=0.3)


def test_a_wrong_sign_does_not_correlate(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    photograph(path, LANDSCAPE, rotation(60.0, -89.9, 20.0))
    with PIL.Image.open(path) as picture:
        photo = np.array(picture)
    assert pointing_offset_deg(photo, SCENE, LANDSCAPE, rotation(60.0, -89.9, -20.0))[2] < 0.3
    assert pointing_offset_deg(photo, SCENE, LANDSCAPE, rotation(-60.0, -89.9, 20.0))[2] < 0.3
