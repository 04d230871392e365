"""The focal length and the distortion are found from the photos; one that is not as stated condemns no photo."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import PIL.Image
import pytest

from panoexec.lens.distortion import Distortion
from panoexec.pictures.correlation import samples
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.model import PhotoToCheck
from panoexec.pictures.straighten import stored_pixels, straightened
from panoexec.planning.model import Plan
from tests.support.photo_sets import PhotoSet, photo_set
from tests.unit.pictures.conftest import CAMERA, SCENE


def examined(photos: PhotoSet) -> Examiner:
    """As photos of the nominal camera."""
    examiner = Examiner(CAMERA)
    for photo in photos.photos:
        examiner.add(PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s), photo.content)
    return examiner


def with_focal_mm(plan: Plan, focal_mm: float) -> Plan:
    return replace(plan, camera=replace(plan.camera, focal_length_mm=focal_mm))


@pytest.mark.parametrize("ratio", [0.978, 1.012])
def test_a_focal_length_that_is_not_as_stated_is_found_and_condemns_nothing(two_rows: Plan, ratio: float) -> None:
    photos = photo_set(with_focal_mm(two_rows, 15.0 * ratio), seed=1, bias_deg=(0.0, 0.3, 0.0), **SCENE)
    examiner = examined(photos)
    verdicts = examiner.verdicts(final=True)
    assert not verdicts.bad, [found.reason for found in verdicts.bad]
    assert verdicts.graph.connected
    fit = examiner.lens()
    assert fit is not None
    assert fit.focal_ratio == pytest.approx(ratio, abs=0.0008)
    assert abs(fit.k1) < 0.004


def distorted(content: bytes, k1: float) -> bytes:
    """A photo as a lens with radial distortion makes it of an ideal one."""
    image = np.asarray(PIL.Image.open(io.BytesIO(content)).convert("RGB"))
    height, width = image.shape[:2]
    focal = width / (2 * CAMERA.half_width)
    x, y = np.meshgrid((np.arange(width) - (width - 1) / 2) / focal, (np.arange(height) - (height - 1) / 2) / focal)
    ideal_x, ideal_y = x, y
    for _ in range(8):
        scale = 1 + k1 * (ideal_x**2 + ideal_y**2)
        ideal_x, ideal_y = x / scale, y / scale
    columns = (ideal_x * focal + (width - 1) / 2).astype(np.float32)
    rows = (ideal_y * focal + (height - 1) / 2).astype(np.float32)
    out = np.stack([samples(image[..., channel], columns, rows, 1) for channel in range(3)], axis=-1)
    buffer = io.BytesIO()
    PIL.Image.fromarray(np.clip(out + 0.5, 0, 255).astype(np.uint8)).save(buffer, "JPEG", quality=92)
    return buffer.getvalue()


def test_radial_distortion_is_found(two_rows: Plan) -> None:
    photos = photo_set(two_rows, seed=1, **SCENE)
    bent = replace(photos, photos=[replace(one, content=distorted(one.content, -0.02)) for one in photos.photos])
    examiner = examined(bent)
    assert not examiner.verdicts(final=True).bad
    fit = examiner.lens()
    assert fit is not None
    assert fit.k1 + 0.25 * fit.k2 == pytest.approx(-0.02, abs=0.006), "at the middle of the image's side"
    assert fit.focal_ratio == pytest.approx(1.0, abs=0.002)


def test_a_few_points_tell_nothing(two_rows: Plan) -> None:
    photos = photo_set(two_rows, seed=1, **SCENE)
    assert examined(replace(photos, photos=photos.photos[:2])).lens() is None
    assert Examiner(CAMERA).lens() is None


def test_a_lens_that_the_profile_knows_ties_like_a_pinhole_and_is_found_as_it_is(two_rows: Plan) -> None:
    lens = Distortion(k1=-0.06, k2=0.01)
    width, height = CAMERA.image_width_px, CAMERA.image_height_px
    point = (width / 2 + 0.01 * width, height / 2 - 0.012 * height)
    known = replace(CAMERA, distortion=lens, principal_point_px=point)
    photos = photo_set(replace(two_rows, camera=known), seed=1, **SCENE)
    examiner = Examiner(known)
    for photo in photos.photos:
        examiner.add(PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s), photo.content)
    assert not examiner.verdicts(final=True).bad
    angles = [tie.angle_deg for tie in examiner.ties.values() if tie.tied]
    assert len(angles) > 15
    assert float(np.median(angles)) < 0.2
    fit = examiner.lens()
    assert fit is not None
    assert fit.focal_ratio == pytest.approx(1.0, abs=0.003)
    assert fit.k1 + 0.25 * fit.k2 == pytest.approx(-0.06 + 0.25 * 0.01, abs=0.008), "at the middle of the image's side"


def test_stored_pixels_are_where_the_lens_shows_the_ray_of_the_pinhole() -> None:
    camera = replace(CAMERA, distortion=Distortion(k1=-0.08, p2=0.002), principal_point_px=(2600.0, 2000.0))
    size = (528, 396)
    pixels = np.array([[10.0, 20.0], [263.5, 197.5], [500.0, 380.0]])
    focal = size[0] / (2 * CAMERA.pinhole_half_width)
    ideal = (pixels - (263.5, 197.5)) / focal
    expected = camera.distortion_used.apply(ideal) * focal + np.array([2600 / 5280 * 528, 2000 / 3956 * 396]) - 0.5  # type: ignore[union-attr]
    np.testing.assert_allclose(stored_pixels(pixels, camera, size), expected, atol=0.05)
    plain = np.arange(16, dtype=np.uint8).reshape(4, 4)
    assert straightened(plain, CAMERA) is plain
