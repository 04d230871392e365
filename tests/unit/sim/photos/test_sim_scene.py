from __future__ import annotations

from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from panoexec.angles import direction, elevation_azimuth
from panoexec.errors import InputFileError
from panoexec.sim.photos.scene import DEFAULT_WIDTH_PX, load_scene, procedural_scene, width_for_photos_px


def test_the_same_seed_gives_the_same_scene_another_seed_another() -> None:
    first, again, other = procedural_scene(3, 256), procedural_scene(3, 256), procedural_scene(4, 256)
    assert again is first
    assert first.pixels.shape == (128, 256, 3)
    assert first.pixels.dtype == np.uint8
    procedural_scene.__globals__["_procedural_scene"].cache_clear()
    np.testing.assert_array_equal(procedural_scene(3, 256).pixels, first.pixels)
    assert (other.pixels != first.pixels).mean() > 0.5


def test_every_part_of_the_ground_has_texture_to_find_points_in() -> None:
    """In every 6° x 6° patch of the ground the gradient is strong at many places, and in both directions."""
    scene = procedural_scene(1, 2048)
    grey = scene.pixels.astype(np.float32).mean(axis=2)
    side = 2048 * 6 // 360
    for elevation in (-3.0, -20.0, -45.0, -70.0, -84.0):
        for azimuth in range(-180, 180, 15):
            # patches of equal size on the sphere: sampled in a tangent plane, so that the pole's pinch does not count
            patch = _tangent_patch(grey, elevation, azimuth, side)
            gy, gx = np.gradient(patch)
            tensor = np.array([[(gx * gx).mean(), (gx * gy).mean()], [(gx * gy).mean(), (gy * gy).mean()]])
            assert np.linalg.eigvalsh(tensor)[0] > 9.0, (elevation, azimuth)


def _tangent_patch(grey: np.ndarray, elevation: float, azimuth: float, side: int) -> np.ndarray:
    height, width = grey.shape
    centre = direction(elevation, azimuth)
    right = direction(0.0, azimuth + 90)
    down = np.cross(centre, right)
    grid = (np.arange(side) - side / 2) * (2 * np.pi / width)
    rays = centre + right * grid[None, :, None] + down * grid[:, None, None]
    el, az = elevation_azimuth(rays)
    rows = np.clip(((90 - el) / 180 * height).astype(int), 0, height - 1)
    return np.asarray(grey[rows, ((az + 180) / 360 * width).astype(int) % width])


def test_there_is_no_seam_at_the_back() -> None:
    pixels = procedural_scene(1, 2048).pixels.astype(np.float64)
    across = np.abs(pixels[:, 0] - pixels[:, -1]).mean()
    elsewhere = np.abs(np.diff(pixels, axis=1)).mean()
    assert across < 1.3 * elsewhere


def test_sky_is_brighter_and_bluer_than_ground_and_the_horizon_is_the_middle() -> None:
    pixels = procedural_scene(1, 512).pixels.astype(np.float64)
    blueness = pixels[..., 2].mean(axis=1) - pixels[..., 0].mean(axis=1)
    assert blueness[:110].min() > 0 > blueness[140:].max()


@pytest.mark.parametrize("width", [0, 63, 65, 20000])
def test_invalid_sizes_are_rejected(width: int) -> None:
    with pytest.raises(ValueError, match="width_px"):
        procedural_scene(1, width)


def test_a_scene_is_painted_as_fine_as_its_photos_show() -> None:
    """A photo of 160 px that is 60° wide has 139 px a radian: a scene of 2048 px has 2.3 times as many."""
    widths = {fine: width_for_photos_px(fine) for fine in (10.0, 139.0, 160.0, 170.0, 320.0, 5000.0)}
    assert widths == {10.0: 1024, 139.0: 2048, 160.0: 2048, 170.0: 4096, 320.0: 4096, 5000.0: DEFAULT_WIDTH_PX}


@pytest.mark.parametrize("name", ["scene.png", "scene.jpg"])
def test_a_picture_is_read_as_rgb(tmp_path: Path, name: str) -> None:
    pixels = np.full((64, 128, 3), (200, 30, 90), dtype=np.uint8)
    PIL.Image.fromarray(pixels).save(tmp_path / name)
    scene = load_scene(tmp_path / name)
    assert scene.pixels.shape == (64, 128, 3)
    np.testing.assert_allclose(scene.pixels, pixels, atol=3)
    assert scene.name.endswith(name)


def test_a_grey_picture_becomes_rgb(tmp_path: Path) -> None:
    PIL.Image.fromarray(np.full((64, 128), 77, dtype=np.uint8)).save(tmp_path / "grey.png")
    assert load_scene(tmp_path / "grey.png").pixels[10, 10].tolist() == [77, 77, 77]


def _write(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def test_bad_scenes_are_named_in_one_line(tmp_path: Path) -> None:
    PIL.Image.new("RGB", (300, 200)).save(tmp_path / "photo.png")
    PIL.Image.new("RGB", (40, 20)).save(tmp_path / "tiny.png")
    PIL.Image.effect_noise((256, 128), 50).save(tmp_path / "whole.jpg")
    whole = (tmp_path / "whole.jpg").read_bytes()
    cases = [
        (tmp_path / "missing.jpg", "no such file"),
        (_write(tmp_path / "text.jpg", b"no image at all"), "is no image"),
        (_write(tmp_path / "empty.jpg", b""), "is no image"),
        (_write(tmp_path / "cut.jpg", whole[: len(whole) // 2]), "cannot be read as an image"),
        (tmp_path, "cannot be read as an image"),
        (tmp_path / "photo.png", "300 x 200 px; .* twice as wide as high"),
        (tmp_path / "tiny.png", "40 px; a scene has 64 to 16384 px"),
    ]
    for path, text in cases:
        with pytest.raises(InputFileError, match=text) as caught:
            load_scene(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
