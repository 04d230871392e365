from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.lens.distortion import Distortion
from panoexec.lens.frame import Sides, frame_of, is_inside
from tests.unit.lens.test_distortion import lenses


def all_sides() -> st.SearchStrategy[Sides]:
    """Images from 6° to 90° wide whose middle is a little beside the boresight."""
    half, off = st.floats(0.05, 0.95), st.floats(0.9, 1.1)
    return st.builds(
        lambda w, h, a, b: Sides(left=w * a, right=w * (2 - a), top=h * b, bottom=h * (2 - b)),
        half,
        st.floats(0.05, 0.7),
        off,
        off,
    )


@settings(max_examples=15)
@given(sides=all_sides(), lens=lenses(), seed=st.integers(0, 1000))
def test_every_direction_of_the_frame_is_in_the_image(sides: Sides, lens: Distortion, seed: int) -> None:
    try:
        frame = frame_of(sides, lens)
    except ValueError:
        return
    rng = np.random.default_rng(seed)
    inside = rng.uniform(-1, 1, (500, 2)) * [frame.half_width, frame.half_height]
    along = np.linspace(-1, 1, 401)
    border = np.concatenate(
        [np.stack(pair, axis=1) for s in (-1.0, 1.0) for pair in ((along, along * 0 + s), (along * 0 + s, along))]
    ) * [frame.half_width, frame.half_height]
    for points in (inside, border):
        assert sides.hold(lens.apply(points))
        # and each is seen at one pixel only: undoing the distortion leads back to it
        assert lens.undo(lens.apply(points)) == pytest.approx(points, abs=1e-8)


@settings(max_examples=15)
@given(sides=all_sides(), lens=lenses(), seed=st.integers(0, 1000))
def test_the_area_is_a_bound_and_a_tight_one(sides: Sides, lens: Distortion, seed: int) -> None:
    try:
        frame = frame_of(sides, lens)
    except ValueError:
        return
    # ∫ over the sensor of 1 / det J, by Gauss and Legendre
    nodes, weights = np.polynomial.legendre.leggauss(24)
    y = ((nodes + 1) / 2 * (sides.left + sides.right) - sides.left)[:, None]
    z = ((nodes + 1) / 2 * (sides.top + sides.bottom) - sides.top)[None]
    points = np.stack(np.broadcast_arrays(y, z), axis=-1)
    density = 1 / np.linalg.det(lens.jacobian(lens.undo(points)))
    area = float(weights @ density @ weights) * (sides.left + sides.right) * (sides.top + sides.bottom) / 4
    assert area * (1 - 1e-6) <= frame.image_area <= area * (1 + 2e-3)
    assert 4 * frame.half_width * frame.half_height <= area


@settings(max_examples=15)
@given(sides=all_sides(), lens=lenses(), seed=st.integers(0, 1000))
def test_no_rectangle_is_proven_that_sticks_out(sides: Sides, lens: Distortion, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wide, high = rng.uniform(0.8, 1.2, 2) * [min(sides.left, sides.right), min(sides.top, sides.bottom)]
    try:
        proven = is_inside(wide, high, sides, lens)
    except ValueError:
        return
    along = np.linspace(-1, 1, 4001)
    one = np.ones_like(along)
    border = np.concatenate([np.stack(p, axis=1) for p in ((along, one), (along, -one), (one, along), (-one, along))])
    held = sides.hold(lens.apply(border * [wide, high]))
    assert held or not proven


def test_no_larger_frame_would_be_inside() -> None:
    for lens in (Distortion(k1=-0.1, k2=0.02), Distortion(k1=0.08), Distortion(k1=0.02, p1=0.003, p2=0.001)):
        sides = Sides(0.577, 0.577, 0.433, 0.433)
        frame = frame_of(sides, lens)
        larger = 1.0005
        assert not is_inside(frame.half_width * larger, frame.half_height * larger, sides, lens)


def test_without_distortion_the_frame_is_the_image_about_the_boresight() -> None:
    frame = frame_of(Sides(left=0.6, right=0.5, top=0.3, bottom=0.4), Distortion())
    assert (frame.half_width, frame.half_height) == (0.5, 0.3)
    assert frame.image_area == pytest.approx(1.1 * 0.7)


def test_barrel_distortion_widens_the_frame_and_its_borders_touch_in_the_middle() -> None:
    lens, sides = Distortion(k1=-0.1), Sides(0.5, 0.5, 0.375, 0.375)
    frame = frame_of(sides, lens)
    assert frame.half_width > 0.5
    assert lens.apply([frame.half_width, 0.0])[0] == pytest.approx(0.5, abs=1e-7)
    assert math.isclose(float(lens.apply([0.0, frame.half_height])[1]), 0.375, abs_tol=1e-7)
