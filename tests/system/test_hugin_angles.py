"""Angles and signs from the gimbal to the stitcher: what `nona` makes of our project is where it is in the scene."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from numpy.typing import NDArray

from panoexec.angles import quaternion_from_rotation, rotation
from panoexec.exports import ExportSet, ExportShot, write_exports
from panoexec.formats.hugin_pto import parse_pto, render_pto
from panoexec.optics import Camera
from panoexec.sim.photos.render import Renderer
from panoexec.sim.photos.scene import Scene, procedural_scene

pytestmark = pytest.mark.skipif(
    shutil.which("nona") is None, reason="nona is not installed: apt-get install hugin-tools"
)

LANDSCAPE = Camera(
    name="test",
    sensor_width_mm=16.0,
    sensor_height_mm=12.0,
    image_width_px=400,
    image_height_px=300,
    focal_length_mm=14.0,
)
POSES = [(30.0, -20.0, 8.0), (-100.0, -89.5, 25.0), (45.0, -90.0, 0.0), (179.0, 15.0, -12.0), (-30.0, -91.0, 3.0)]
"""Yaw, pitch, roll: level, near the nadir with roll and yaw, at it, across the back, beyond the nadir."""


def shots(folder: Path, camera: Camera, scene: Scene, stored_turn: int = 0) -> tuple[ExportShot, ...]:
    """Photos of the scene, taken and stored as a camera would; `stored_turn` quarter turns anticlockwise."""
    renderer = Renderer(scene)
    out = []
    for index, (yaw, pitch, roll) in enumerate(POSES):
        pose = rotation(yaw, pitch, roll)
        pixels = np.rot90(renderer.render(camera, pose, camera.image_width_px), stored_turn)
        name = f"photo {index}.png"
        PIL.Image.fromarray(np.ascontiguousarray(pixels)).save(folder / name)
        w, x, y, z = quaternion_from_rotation(pose).tolist()
        out.append(
            ExportShot(
                index=index,
                row=0,
                q_wxyz=(w, x, y, z),
                target_pitch_deg=pitch,
                target_yaw_deg=yaw,
                measured=True,
                file_name=name,
                width_px=pixels.shape[1],
                height_px=pixels.shape[0],
                # EXIF 6: to be turned clockwise to be viewed
                orientation=6 if stored_turn else 1,
            )
        )
    return tuple(out)


def remapped(project: Path) -> list[tuple[NDArray[np.uint8], NDArray[np.bool_], int, int]]:
    """Colours, mask and place on the canvas (column, row) of each image as `nona` remaps it."""
    subprocess.run(["nona", "-o", "out_", project.name], cwd=project.parent, check=True, capture_output=True)
    found = []
    for path in sorted(project.parent.glob("out_*.tif")):
        with PIL.Image.open(path) as picture:
            pixels = np.array(picture)
            tags = picture.tag_v2  # type: ignore[attr-defined]
            left, top = (
                round(float(tags.get(tag, 0)) * float(tags.get(res, 1))) for tag, res in ((286, 282), (287, 283))
            )
        found.append((pixels[..., :3], pixels[..., 3] == 255, left, top))
    return found


def differences(project: Path, scene: Scene) -> list[float]:
    """Mean difference of each remapped image from the scene at its place, grey levels."""
    out = []
    for pixels, mask, left, top in remapped(project):
        part = scene.pixels[top : top + pixels.shape[0], left : left + pixels.shape[1]]
        assert mask.sum() > 20_000
        out.append(float(np.abs(pixels.astype(int) - part)[mask].mean()))
    return out


@pytest.mark.parametrize(
    ("camera", "stored_turn"),
    [(LANDSCAPE, 0), (LANDSCAPE.rotated(), 0), (LANDSCAPE.rotated(), 1)],
    ids=["landscape", "portrait", "portrait stored as landscape"],
)
def test_nona_puts_every_photo_where_it_was_taken(tmp_path: Path, camera: Camera, stored_turn: int) -> None:
    # the scene is as fine as the canvas that the project asks for
    draft = ExportSet(title="", camera=camera, shots=())
    scene = procedural_scene(1, 2 * round(camera.panorama_px()[0] / 2 + 0.499))
    exports = replace(draft, shots=shots(tmp_path, camera, scene, stored_turn))
    write_exports(exports, tmp_path)
    project = tmp_path / "panorama.pto"
    assert parse_pto(project.read_text()).canvas_px[0] == scene.width_px
    right = differences(project, scene)
    assert len(right) == len(POSES)
    assert max(right) < 6.0

    # the same comparison notices half a degree, and a wrong sign of roll
    made = parse_pto(project.read_text())
    off = replace(made, images=tuple(replace(i, yaw_deg=i.yaw_deg + 0.5) for i in made.images))
    project.write_text(render_pto(off))
    assert min(np.array(differences(project, scene)) / right) > 1.8


def test_hugin_s_tools_read_the_project_without_a_warning(tmp_path: Path) -> None:
    scene = procedural_scene(1, 1024)
    write_exports(ExportSet(title="", camera=LANDSCAPE, shots=shots(tmp_path, LANDSCAPE, scene)), tmp_path)
    done = subprocess.run(["checkpto", "panorama.pto"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert f"{len(POSES)} images" in done.stdout
    assert "1 lenses" in done.stdout
    said = (done.stdout + done.stderr).lower()
    assert "warning" not in said
    assert "error" not in said.replace("mean error", "")
