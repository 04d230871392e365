from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from panoexec.angles import FloatArray, direction, rotation
from panoexec.lens.distortion import Distortion
from panoexec.optics import Camera
from panoexec.sim.photos.render import Renderer, image_size
from panoexec.sim.photos.scene import Scene, procedural_scene

LANDSCAPE = Camera.from_fov(59.94, 46.86)
PORTRAIT = LANDSCAPE.rotated()


def compass_scene(width: int) -> Scene:
    """Every colour is its direction: (x, y, z) of the unit vector as (R, G, B), so any wrong turn shows."""
    height = width // 2
    azimuth = (np.arange(width) + 0.5) / width * 360 - 180
    elevation = 90 - (np.arange(height) + 0.5) / height * 180
    vectors = direction(elevation[:, None], azimuth[None, :])
    return Scene(np.round((vectors + 1) * 127.5).astype(np.uint8), "compass")


def rays(camera: Camera, width: int, height: int) -> FloatArray:
    """Unit vectors of pixel centres, camera frame, written down independently of the renderer."""
    focal_px = width / 2 / camera.half_width
    out = np.empty((height, width, 3))
    for row in range(height):
        for column in range(width):
            out[row, column] = (focal_px, column + 0.5 - width / 2, row + 0.5 - height / 2)
    return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))


@pytest.mark.parametrize("camera", [LANDSCAPE, PORTRAIT], ids=["landscape", "portrait"])
@pytest.mark.parametrize(
    ("yaw", "pitch", "roll"),
    [(0, 0, 0), (30, -20, 0), (90, 10, 25), (180, 0, 0), (-179, 5, -10), (45, -90, 0), (-60, -88, 7), (120, 89, -3)],
)
def test_every_pixel_shows_its_own_direction(camera: Camera, yaw: float, pitch: float, roll: float) -> None:
    scene = compass_scene(720)
    pose = rotation(yaw, pitch, roll)
    width, height = image_size(camera, 60)
    image = Renderer(scene).render(camera, pose, 60)
    assert image.shape == (height, width, 3)
    expected = (rays(camera, width, height) @ pose.T + 1) * 127.5
    # one level is 0.45°; rounding in the scene and in the mixing, and the chord of the interpolation
    np.testing.assert_allclose(image, expected, atol=1.6)


def test_a_distorting_lens_shows_each_direction_where_its_profile_says() -> None:
    lens = Distortion(k1=-0.12, k2=0.03, p1=0.002, p2=-0.001)
    camera = replace(LANDSCAPE, distortion=lens, principal_point_px=(2100.0, 1480.0), fov_margin=0.05)
    pose = rotation(20, -15, 3)
    width, height = image_size(camera, 120)
    image = Renderer(compass_scene(720)).render(camera, pose, 120)
    focal_px = 120 * 18 / 36 / np.tan(np.radians(59.94 / 2))
    checked = 0
    for y in np.linspace(-0.5, 0.5, 9):
        for z in np.linspace(-0.38, 0.38, 7):
            ideal = np.array([y, z])
            column, row = (
                lens.apply(ideal) * focal_px + np.array([2100.0 / 4000, 1480.0 / 3006]) * (width, height) - 0.5
            )
            if not (0 <= column <= width - 1 and 0 <= row <= height - 1):
                continue
            ray = np.array([1.0, y, z])
            expected = (pose @ ray / np.linalg.norm(ray) + 1) * 127.5
            # the colour between the four pixels around
            c, r = int(column), int(row)
            part = image[r : r + 2, c : c + 2].astype(float)
            weights = np.outer([1 - (row - r), row - r], [1 - (column - c), column - c])
            if part.shape[:2] == (2, 2):
                np.testing.assert_allclose((part * weights[..., None]).sum(axis=(0, 1)), expected, atol=2.0)
                checked += 1
    assert checked > 40
    # places and rays of the camera are each other's inverse
    across, down = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 7))
    ideal = camera.rays(across, down)
    np.testing.assert_allclose(camera.places(ideal[..., 0], ideal[..., 1]), (across, down), atol=1e-9)


def test_signs_in_words() -> None:
    """Right of the image is further clockwise, top is further up, roll moves the right side down."""
    renderer = Renderer(compass_scene(720))
    image = renderer.render(LANDSCAPE, rotation(0, 0), 60).astype(int)
    assert image[22, 59, 1] > image[22, 0, 1] + 50
    assert image[0, 30, 2] < image[-1, 30, 2] - 50
    rolled = renderer.render(LANDSCAPE, rotation(0, 0, 20), 60).astype(int)
    assert rolled[22, 59, 2] > image[22, 59, 2] + 10


def test_pixel_centres_are_exact() -> None:
    """A scene pixel seen exactly at an image's pixel centre comes out as it is; half a pixel off it is the mean."""
    width = 720
    pixels = np.zeros((width // 2, width, 3), dtype=np.uint8)
    pixels[:, ::2] = 200
    renderer = Renderer(Scene(pixels, "stripes"))
    # an odd image width: the middle pixel looks along the boresight; finer than the scene, so that it is not halved
    camera = Camera.from_fov(20, 15)
    pixel = 360 / width
    middle = np.array(image_size(camera, 81)[::-1]) // 2
    on_even = renderer.render(camera, rotation(0.5 * pixel, 0.0), 81)[middle[0], middle[1]]
    on_odd = renderer.render(camera, rotation(1.5 * pixel, 0.0), 81)[middle[0], middle[1]]
    between = renderer.render(camera, rotation(1.0 * pixel, 0.0), 81)[middle[0], middle[1]]
    assert [on_even[0], on_odd[0], between[0]] == [200, 0, 100]


def test_agrees_with_slow_bilinear_sampling_at_seam_and_poles() -> None:
    scene = procedural_scene(2, 1024)
    renderer = Renderer(scene)
    camera = Camera.from_fov(40, 30)
    for yaw, pitch in ((180, 0), (-170, -60), (10, -90), (10, 90)):
        pose = rotation(yaw, pitch, 3.0)
        image = renderer.render(camera, pose, 120)
        width, height = image_size(camera, 120)
        expected = slow_bilinear(scene.pixels, rays(camera, width, height) @ pose.T)
        difference = np.abs(image.astype(float) - expected)
        # fractions are kept to 1/256
        assert difference.max() <= 2.0
        assert difference.mean() < 0.5


def slow_bilinear(pixels: NDArray[np.uint8], vectors: FloatArray) -> FloatArray:
    height, width = pixels.shape[:2]
    azimuth = np.arctan2(vectors[..., 1], vectors[..., 0])
    elevation = np.arcsin(np.clip(-vectors[..., 2], -1, 1))
    column = (azimuth / (2 * np.pi) + 0.5) * width - 0.5
    row = (0.5 - elevation / np.pi) * height - 0.5
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    total = np.zeros(vectors.shape)
    for down in (0, 1):
        for right in (0, 1):
            r, c = top + down, left + right
            over = (r < 0) | (r >= height)
            r = np.where(r < 0, -1 - r, np.where(r >= height, 2 * height - 1 - r, r))
            c = np.where(over, c + width // 2, c) % width
            weight = (1 - np.abs(column - left - right)) * (1 - np.abs(row - top - down))
            total += weight[..., None] * pixels[r, c]
    return total


def test_a_coarse_image_of_a_fine_scene_is_averaged_not_aliased() -> None:
    """A checkerboard finer than the image's pixels becomes an even grey."""
    board = ((np.indices((512, 1024)).sum(axis=0) % 2) * 255).astype(np.uint8)
    renderer = Renderer(Scene(np.repeat(board[..., None], 3, axis=2), "board"))
    image = renderer.render(Camera.from_fov(90, 90), rotation(12.3, 0), 40)
    assert np.abs(image.astype(int) - 128).max() <= 1


def test_odd_halves_are_not_halved_further() -> None:
    scene = compass_scene(100)  # 50 rows: 25 after one halving
    camera = Camera.from_fov(90, 90)
    image = Renderer(scene).render(camera, rotation(170, 0), 4)
    expected = (rays(camera, 4, 4) @ rotation(170, 0).T + 1) * 127.5
    np.testing.assert_allclose(image, expected, atol=4)


def test_motion_blurs_along_the_motion_only() -> None:
    renderer = Renderer(procedural_scene(2, 2048))
    camera = Camera.from_fov(40, 30)
    still = renderer.render(camera, rotation(20, -40), 200).astype(float)
    moving = np.stack([rotation(20 + 0.2 * k, -40) for k in range(-8, 9)])
    blurred = renderer.render(camera, moving, 200).astype(float)
    across, down = (np.abs(np.diff(blurred, axis=a)).mean() / np.abs(np.diff(still, axis=a)).mean() for a in (1, 0))
    assert across < 0.35
    assert down > across * 1.3
    # the mean brightness stays, and the middle of the motion is where the still image is
    assert abs(blurred.mean() - still.mean()) < 2
    one_by_one = np.mean([renderer.render(camera, pose, 200) for pose in moving], axis=0)
    np.testing.assert_allclose(blurred, one_by_one, atol=0.51)


def test_an_exposure_that_moves_less_than_a_pixel_is_sharp() -> None:
    renderer = Renderer(procedural_scene(2, 1024))
    tiny = np.stack([rotation(20 + 1e-4 * k, -40) for k in range(5)])
    np.testing.assert_array_equal(
        renderer.render(LANDSCAPE, tiny, 80), renderer.render(LANDSCAPE, rotation(20 + 2e-4, -40), 80)
    )
