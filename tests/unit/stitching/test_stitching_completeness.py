from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from panoexec.planning.model import AngleBox, Band
from panoexec.stitching.completeness import Completeness, CompletenessCounter, Ground

CANVAS = (720, 360)
BAND = Band(elevation_min_deg=-90, elevation_max_deg=30)


def judge(
    covered: NDArray[np.bool_], ground: Ground, side: int = 128, canvas: tuple[int, int] = CANVAS
) -> Completeness:
    counter = CompletenessCounter(canvas, ground, map_width=360)
    for top in range(0, canvas[1], side):
        for left in range(0, canvas[0], side):
            counter.add(counter.count(left, top, covered[top : top + side, left : left + side]))
    return counter.result()


def test_a_whole_ground_is_complete_whatever_the_sky() -> None:
    covered = np.ones((360, 720), dtype=bool)
    covered[:180] = False
    found = judge(covered, Ground(band=BAND))
    assert found.fraction == 1.0
    assert found.solid_angle_fraction == 1.0
    assert (found.ground_px, found.hole_px, found.holes) == (180 * 720, 0, ())


def test_equation_8_counts_pixels_and_holes_are_found_where_they_are() -> None:
    covered = np.ones((360, 720), dtype=bool)
    covered[320:326, 100:110] = False  # elevation -70 to -73, azimuth -130 to -125
    covered[200, 500] = False
    covered[100, 100] = False  # in the sky
    found = judge(covered, Ground(band=BAND))
    assert found.hole_px == 61
    assert found.fraction == pytest.approx(1 - 61 / (180 * 720), abs=1e-12)
    # near the nadir a pixel is little of the sphere
    assert found.solid_angle_fraction > found.fraction
    big, small = found.holes
    assert (big.pixels, small.pixels) == (60, 1)
    assert big.elevation_deg == pytest.approx(-71.5, abs=0.5)
    assert big.azimuth_deg == pytest.approx(-127.5, abs=0.5)
    assert 3.0 < big.size_deg < 5.0
    assert small.elevation_deg == pytest.approx(-10.25, abs=0.5)


@pytest.mark.parametrize("side", [50, 128, 720])
def test_blocks_of_any_size_add_up_to_the_same(side: int) -> None:
    covered = np.random.default_rng(1).random((360, 720)) > 0.001
    assert judge(covered, Ground(band=BAND), side) == judge(covered, Ground(band=BAND), 64)


def test_a_hole_across_the_back_is_one() -> None:
    covered = np.ones((360, 720), dtype=bool)
    covered[250:256, :6] = False
    covered[250:256, -6:] = False
    (hole,) = judge(covered, Ground(band=BAND)).holes
    assert abs(hole.azimuth_deg) == pytest.approx(180.0, abs=0.5)
    assert hole.pixels == 72


def test_horizon_band_sector_and_masks_say_what_counts() -> None:
    nothing = np.zeros((360, 720), dtype=bool)
    low = judge(nothing, Ground(band=BAND, horizon_deg=-30))
    assert low.ground_px == 120 * 720
    assert low.fraction == 0.0
    sector = Band(elevation_min_deg=-60, elevation_max_deg=-30, azimuth_min_deg=170, azimuth_max_deg=190)
    assert judge(nothing, Ground(band=sector)).ground_px == 60 * 40
    mask = AngleBox(elevation_min_deg=-60, elevation_max_deg=-45, azimuth_min_deg=-180, azimuth_max_deg=180)
    masked = judge(nothing, Ground(band=sector, masks=(mask,)))
    assert masked.ground_px == 30 * 40
    sky = judge(nothing, Ground(band=Band(elevation_min_deg=10, elevation_max_deg=40)))
    assert (sky.ground_px, sky.fraction) == (0, 1.0)
