from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import direction, rotation
from panoexec.optics import Camera
from panoexec.planning.coverage_map import box_mask, coverage_count, grid, uncovered_fraction
from panoexec.planning.geometry.footprint import inside_margin
from panoexec.planning.model import AngleBox, Band

CAMERA = Camera.from_fov(59.94, 46.86)


@settings(max_examples=30, deadline=None)
@given(yaw=st.floats(-180, 180), pitch=st.floats(-90, 90), roll=st.floats(-30, 30), hfov=st.floats(5, 150))
def test_counts_agree_with_the_footprints_half_spaces(yaw: float, pitch: float, roll: float, hfov: float) -> None:
    camera = Camera.from_fov(hfov, 60.0)
    pose = rotation(yaw, pitch, roll)
    elevation, azimuth = grid(120)
    margin = inside_margin(camera, pose, direction(elevation[:, None], azimuth[None, :]))
    clear = np.abs(margin) > 1e-9
    count = coverage_count(camera, pose, 120)
    np.testing.assert_array_equal(count[clear], (margin >= 0)[clear])


def test_the_mean_count_is_the_solid_angle() -> None:
    rotations = rotation(np.array([0.0, 170.0, 40.0]), np.array([0.0, 30.0, -90.0]))
    elevation, azimuth = grid(1440)
    area = np.cos(np.radians(elevation))[:, None] * np.radians(0.25) ** 2
    total = (coverage_count(CAMERA, rotations) * area).sum()
    assert total == pytest.approx(3 * CAMERA.solid_angle_sr, rel=1e-3)
    assert len(azimuth) == 1440


def test_box_masks_wrap_around_the_back() -> None:
    back = AngleBox(elevation_min_deg=-10, elevation_max_deg=10, azimuth_min_deg=170, azimuth_max_deg=190)
    mask = box_mask(back, 72)
    elevation, azimuth = grid(72)
    rows, columns = np.nonzero(mask)
    assert set(np.abs(azimuth[columns])) == {172.5, 177.5}
    assert np.abs(elevation[rows]).max() < 10
    assert box_mask(Band(elevation_min_deg=-90, elevation_max_deg=90), 72).all()


def test_uncovered_fraction_weighs_by_solid_angle() -> None:
    required = box_mask(Band(elevation_min_deg=-90, elevation_max_deg=0), 360)
    count = np.ones((180, 360), dtype=np.uint16)
    assert uncovered_fraction(count, required) == 0.0
    # the cap below -60° is 1 - sin 60° of the half sphere
    count[150:] = 0
    assert uncovered_fraction(count, required) == pytest.approx(1 - np.sin(np.radians(60)), rel=1e-3)
    assert uncovered_fraction(count, np.zeros_like(required)) == 0.0
