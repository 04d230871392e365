from __future__ import annotations

import numpy as np
import pytest

from panoexec.angles import direction, rotation
from panoexec.formats.hugin_pto import PtoProject, pto_image
from panoexec.stitching.canvas import block_side, blocks, image_depth, images_in_view, turned, view_of

CANVAS = (2000, 1000)
POSES = [(y, p) for p, n in ((-90, 1), (-45, 6), (0, 8)) for y in np.arange(n) * 360 / n - 170]


def project(width_px: int = 400) -> PtoProject:
    images = tuple(pto_image(f"{k}.jpg", width_px, 300, rotation(y, p, 1.0)) for k, (y, p) in enumerate(POSES))
    return PtoProject(images=images, hfov_deg=60.0, canvas_px=CANVAS)


@pytest.mark.parametrize("side", [512, 768, 2048])
def test_blocks_cover_the_canvas_once(side: int) -> None:
    seen = np.zeros((1000, 2000), dtype=int)
    for block in blocks(CANVAS, side):
        seen[block.top : block.top + block.height, block.left : block.left + block.width] += 1
    assert (seen == 1).all()


def test_views_hold_their_block_with_its_margin() -> None:
    for block in blocks(CANVAS, 512):
        view = view_of(block, CANVAS, 20)
        rows, columns = view.inner
        assert (rows.stop - rows.start, columns.stop - columns.start) == (block.height, block.width)
        assert columns.start == 20
        assert view.width == block.width + 40
        assert view.left >= 0
        assert view.left + view.width <= 2000
        assert rows.start == (0 if block.top == 0 else 20)
        # the middle of the block stays where it was, turned by the shift
        assert view.left + columns.start == block.left + view.shift


def test_the_turned_project_shows_the_same_directions() -> None:
    made = project()
    block = list(blocks(CANVAS, 512))[-1]
    view = view_of(block, CANVAS, 20)
    whole = turned(made, view)
    assert whole.crop_px == (view.left, view.left + view.width, view.top, view.top + view.height)
    # a direction in block coordinates, before and after
    column, row = block.left + 5, block.top + 7
    before = direction(90 - (row + 0.5) * 0.18, (column + 0.5) * 0.18 - 180)
    after = direction(90 - (row + 0.5) * 0.18, (column + view.shift + 0.5) * 0.18 - 180)
    for a, b in zip(made.rotations(), whole.rotations(), strict=True):
        np.testing.assert_allclose(before @ a, after @ b, atol=1e-9)


def test_depth_is_one_in_the_middle_zero_at_the_border_negative_outside() -> None:
    made = project()
    view = view_of(next(b for b in blocks(CANVAS, 2000) if b.row == 0), CANVAS, 0)
    whole = turned(made, view)
    depth = image_depth(whole, 9, view, (slice(0, 1000), slice(0, 2000)))
    elevation = 90 - (np.arange(1000) + 0.5) * 0.18
    azimuth = (np.arange(2000) + 0.5) * 0.18 - 180
    rays = direction(elevation[:, None], azimuth[None, :]) @ whole.images[9].rotation
    focal = made.focal_length_px
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = rays[..., 1] / rays[..., 0] * focal / 200, rays[..., 2] / rays[..., 0] * focal / 150
    inside = (rays[..., 0] > 0) & (np.abs(x) < 1) & (np.abs(y) < 1)
    np.testing.assert_array_equal(depth > 0, inside)
    np.testing.assert_allclose(depth[inside], 1 - np.maximum(np.abs(x), np.abs(y))[inside], atol=1e-4)
    assert depth.max() == pytest.approx(1.0, abs=0.01)
    part = image_depth(whole, 9, view, (slice(400, 450), slice(100, 300)))
    np.testing.assert_array_equal(part, depth[400:450, 100:300])


def test_no_image_is_forgotten_in_a_view() -> None:
    made = project()
    for block in blocks(CANVAS, 512):
        view = view_of(block, CANVAS, 20)
        whole = turned(made, view)
        found = set(images_in_view(whole, view))
        everything = (slice(0, view.height), slice(0, view.width))
        needed = {k for k in range(len(POSES)) if (image_depth(whole, k, view, everything) > 0).any()}
        assert needed <= found
        assert len(found) <= len(needed) + 4


def test_block_side_follows_the_memory() -> None:
    assert block_side(1 << 30, 100_000, 80) % 512 == 0
    assert block_side(1 << 30, 100_000, 80) > block_side(1 << 28, 100_000, 80) >= 512
    # never so wide that a block's margin would meet itself
    assert block_side(1 << 34, 4330, 12) == 4096
    assert block_side(1 << 20, 600, 12) == 512
