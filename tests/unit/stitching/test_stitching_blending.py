from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from panoexec.stitching.blending import Patch, blend


def depth_from_centre(patch: Patch) -> NDArray[np.float32]:
    """As if the patch were the whole image."""
    h, w = patch.mask.shape
    y, x = np.abs(np.linspace(-1, 1, h))[:, None], np.abs(np.linspace(-1, 1, w))[None, :]
    return (1 - np.maximum(x, y)).astype(np.float32)


def patch(number: int, left: int, top: int, colour: int | NDArray[np.uint8], size: tuple[int, int] = (60, 80)) -> Patch:
    pixels = np.broadcast_to(np.asarray(colour, dtype=np.uint8), (*size, 3)).copy()
    return Patch(number, left, top, pixels, np.ones(size, dtype=bool))


def test_a_single_image_comes_out_as_it_is() -> None:
    noise = np.random.default_rng(1).integers(0, 255, (60, 80, 3)).astype(np.uint8)
    picture, covered = blend((100, 120), [patch(0, 10, 20, noise)], depth_from_centre, 3)
    np.testing.assert_allclose(picture[20:80, 10:90].astype(int), noise, atol=1)
    assert covered.sum() == 60 * 80
    assert (picture[~covered] == 0).all()


def test_equal_images_leave_no_seam() -> None:
    scene = np.random.default_rng(2).integers(0, 255, (60, 130, 3)).astype(np.uint8)
    parts = [patch(0, 0, 0, scene[:, :80]), patch(1, 50, 0, scene[:, 50:])]
    picture, covered = blend((60, 130), parts, depth_from_centre, 3)
    assert covered.all()
    assert np.abs(picture.astype(int) - scene).max() <= 3


def test_a_difference_in_exposure_fades_over_the_overlap() -> None:
    parts = [patch(0, 0, 0, 100), patch(1, 40, 0, 140)]
    picture, _ = blend((60, 120), parts, depth_from_centre, 3)
    row = picture[30, :, 0].astype(int)
    assert row[5] == 100
    assert row[115] == 140
    assert np.abs(np.diff(row)).max() <= 4
    assert (np.diff(row) >= 0).all()


def test_detail_comes_from_one_image_not_from_a_mean_of_two() -> None:
    """Two images of the same texture, one shifted by a pixel: averaging would blur the overlap."""
    scene = np.random.default_rng(3).integers(0, 255, (60, 131, 3)).astype(np.uint8)
    parts = [patch(0, 0, 0, scene[:, :80]), patch(1, 50, 0, scene[:, 51:131])]
    picture, _ = blend((60, 130), parts, depth_from_centre, 3)
    contrast = np.abs(np.diff(picture[20:40].astype(float), axis=1)).mean(axis=(0, 2))
    assert contrast[50:80].min() > 0.5 * contrast[:40].mean()
    assert contrast[52:60].mean() > 0.8 * contrast[:40].mean()


def test_masked_pixels_neither_show_nor_darken() -> None:
    half = patch(0, 0, 0, 200)
    half.mask[:, 40:] = False
    half.pixels[:, 40:] = 0
    picture, covered = blend((60, 80), [half], depth_from_centre, 5)
    assert (picture[:, :40] == 200).all()
    assert not covered[:, 40:].any()


@pytest.mark.parametrize("radius", [3, 30])
def test_parts_blended_alone_agree_with_the_whole(radius: int) -> None:
    """What makes blocks fit together: a margin of twice the radius is enough."""
    rng = np.random.default_rng(4)
    size = (200, 260)
    images = [patch(k, 40 * k, 10 * k, rng.integers(0, 255, (*size, 3)).astype(np.uint8), size) for k in range(3)]
    depths = {p.number: depth_from_centre(p) for p in images}
    whole, _ = blend((240, 360), images, lambda p: depths[p.number], radius)
    margin = 2 * radius + 2
    left, right = 100 - margin, 180 + margin
    parts, cut = [], {}
    for p in images:
        first, last = max(0, left - p.left), min(size[1], right - p.left)
        parts.append(
            Patch(p.number, p.left + first - left, p.top, p.pixels[:, first:last].copy(), p.mask[:, first:last].copy())
        )
        cut[p.number] = depths[p.number][:, first:last]
    part, _ = blend((240, right - left), parts, lambda p: cut[p.number], radius)
    inner = part[:, margin : margin + 80].astype(int)
    assert np.abs(inner - whole[:, 100:180]).max() <= 1


def test_no_images_no_picture() -> None:
    picture, covered = blend((20, 30), [], depth_from_centre, 3)
    assert not picture.any()
    assert not covered.any()
