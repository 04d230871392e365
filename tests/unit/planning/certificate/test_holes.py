"""Holes: location, size, and outline."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import angle_between, direction, rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.holes import HoleRegion, Uncovered, coverage_holes, uncovered
from panoexec.planning.certificate.robust_footprint import robust_cores
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.model import NO_TOLERANCE, AngleBox, Band, Constraints, Tolerance
from tests.unit.planning.brute import (
    PAPER,
    SCENARIO_2,
    Array,
    enough_rows,
    even_rows,
    full_circle,
    in_domain,
    pinwheel,
    random_directions,
    sector_about,
    with_errors,
)


def missing(
    camera: Camera,
    attitudes: Array,
    band: Band,
    tolerance: Tolerance = NO_TOLERANCE,
    masks: tuple[AngleBox, ...] = (),
) -> Uncovered:
    return uncovered(robust_cores(camera, attitudes, tolerance), Domain.of(band, masks))


def place(region: HoleRegion) -> Array:
    return direction(region.hole.elevation_deg, region.hole.azimuth_deg)


@pytest.mark.parametrize(
    "band",
    [
        full_circle(-90.0, 90.0),
        full_circle(-90.0, 20.0),
        full_circle(-30.0, 60.0),
        Band(elevation_min_deg=-20.0, elevation_max_deg=90.0, azimuth_min_deg=100.0, azimuth_max_deg=330.0),
        Band(elevation_min_deg=-20.0, elevation_max_deg=40.0, azimuth_min_deg=170.0, azimuth_max_deg=190.0),
    ],
)
def test_without_images_everything_is_one_hole(band: Band) -> None:
    found = missing(SCENARIO_2, np.empty((0, 3, 3)), band)
    assert found.fraction == pytest.approx(1.0, abs=1e-9)
    assert len(found.regions) == 1
    assert found.regions[0].solid_angle_sr == pytest.approx(Domain.of(band).solid_angle_sr, abs=1e-9)
    assert in_domain(place(found.regions[0])[None], band).all()


@pytest.mark.parametrize("pitch", [-90.0, -75.0, -30.0, 0.0, 45.0, 85.0, 90.0])
def test_one_image_leaves_the_rest_of_the_sphere(pitch: float) -> None:
    found = missing(SCENARIO_2, rotation([40.0], [pitch]), full_circle(-90.0, 90.0))
    assert found.fraction == pytest.approx(1 - SCENARIO_2.solid_angle_sr / (4 * np.pi), abs=1e-6)
    assert len(found.regions) == 1
    assert found.regions[0].hole.size_deg == 180.0


def test_a_missing_row_leaves_a_ring() -> None:
    rows, _ = even_rows([(-45.0, 40), (0.0, 40)])
    camera = Camera.from_fov(30.0, 20.0)
    found = missing(camera, rows, full_circle(-45.0, 0.0))
    assert len(found.regions) == 1
    v = random_directions(200_000, np.random.default_rng(3))
    v = v[in_domain(v, full_circle(-45.0, 0.0))]
    share = (robust_cores(camera, rows, NO_TOLERANCE).depth(v) < 0).mean()
    assert found.fraction == pytest.approx(share, abs=4 * np.sqrt(share / len(v)))
    assert found.regions[0].hole.size_deg > 100


def test_edges_that_many_images_share_count_once() -> None:
    """The top edges of this row all lie on the horizon: the band above it is one clean strip."""
    camera = Camera.from_fov(40.0, 30.0)
    row, _ = even_rows([(-15.0, 12)])
    found = missing(camera, np.concatenate([row, row[:3]]), full_circle(-10.0, 8.0))
    strip = np.sin(np.radians(8.0)) / (np.sin(np.radians(8.0)) + np.sin(np.radians(10.0)))
    assert found.fraction == pytest.approx(strip, abs=1e-5)


def test_images_that_merely_touch_leave_a_hole_without_area() -> None:
    cube = rotation([0.0, 90.0, 180.0, -90.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 90.0, -90.0])
    found = missing(Camera.from_fov(90.0, 90.0), cube, full_circle(-90.0, 90.0))
    assert 0 < found.fraction < 1e-5
    assert found.regions
    assert missing(Camera.from_fov(90.001, 90.001), cube, full_circle(-90.0, 90.0)).fraction == 0.0


@pytest.mark.parametrize("width_deg", [2.0, 1e-2, 1e-4])
@pytest.mark.parametrize(("yaw", "pitch", "roll"), [(10.0, -20.0, 0.0), (-120.0, -64.0, 20.0)])
def test_a_small_hole_is_located_and_measured(width_deg: float, yaw: float, pitch: float, roll: float) -> None:
    centre = rotation(yaw, pitch, roll)
    images = pinwheel(centre, SCENARIO_2, width_deg)
    band = sector_about(centre, 3.0)
    found = missing(SCENARIO_2, images, band)
    (region,) = found.regions
    assert angle_between(place(region), centre[:, 0]) < 0.71 * width_deg
    assert region.hole.size_deg == pytest.approx(width_deg * np.sqrt(2), rel=0.02, abs=5e-5)
    assert region.solid_angle_sr == pytest.approx(np.radians(width_deg) ** 2, rel=0.05 if width_deg > 1e-3 else 0.5)
    assert found.fraction == pytest.approx(region.solid_angle_sr / Domain.of(band).solid_angle_sr)


def test_a_core_that_holds_the_outline_closes_the_hole() -> None:
    """What a patch shot relies on: aim at the hole, check its outline, and it is gone."""
    rows = [(-90.0, 1), (-78.0, 4), (-66.0, 9), (-54.0, 12), (-42.0, 16)]
    attitudes, _ = even_rows(rows)
    constraints = Constraints(overlap_h=0.1, overlap_v=0.1, band=full_circle(-90.0, -45.0), tolerance=PAPER)
    before = coverage_holes(SCENARIO_2, constraints, attitudes)
    assert len(before) == 4
    patched = attitudes
    for region in before:
        patch = rotation([region.hole.azimuth_deg], [region.hole.elevation_deg])
        assert robust_cores(SCENARIO_2, patch, PAPER).depth(region.outline).min() > 0
        patched = np.concatenate([patched, patch])
    assert coverage_holes(SCENARIO_2, constraints, patched) == ()
    assert len(coverage_holes(SCENARIO_2, constraints, patched[:-1])) == 1


@settings(max_examples=30, deadline=None)
@given(
    hfov=st.floats(25.0, 110.0),
    overlap=st.floats(-0.2, 0.2),
    top=st.floats(-50.0, 90.0),
    tolerance=st.sampled_from([NO_TOLERANCE, PAPER, Tolerance(pitch_deg=1.0, roll_deg=2.0, yaw_deg=1.5)]),
    start=st.floats(-180.0, 180.0),
    span=st.one_of(st.just(360.0), st.floats(20.0, 359.0)),
    masked=st.booleans(),
    seed=st.integers(0, 2**31),
)
def test_holes_agree_with_dense_sampling(
    hfov: float, overlap: float, top: float, tolerance: Tolerance, start: float, span: float, masked: bool, seed: int
) -> None:
    camera = Camera.from_fov(hfov, hfov * 0.7)
    rng = np.random.default_rng(seed)
    rows = enough_rows(camera, overlap, top)
    attitudes, _ = even_rows(rows, rng.uniform(0.0, 360.0, len(rows)).tolist())
    attitudes = with_errors(attitudes, Tolerance(pitch_deg=1.0, roll_deg=1.0, yaw_deg=3.0), rng, extreme=False)
    band = Band(elevation_min_deg=-90.0, elevation_max_deg=top, azimuth_min_deg=start, azimuth_max_deg=start + span)
    masks = (
        (
            AngleBox(
                elevation_min_deg=-70.0,
                elevation_max_deg=10.0,
                azimuth_min_deg=start + 5.0,
                azimuth_max_deg=start + 90.0,
            ),
        )
        if masked
        else ()
    )
    found = missing(camera, attitudes, band, tolerance, masks)
    v = random_directions(6000, rng)
    v = v[in_domain(v, band, masks)]
    if not len(v):
        return
    cores = robust_cores(camera, attitudes, tolerance)
    bare = cores.depth(v) < 0
    share = max(bare.mean(), 1 / len(v))
    assert found.fraction == pytest.approx(bare.mean(), abs=6 * np.sqrt(share / len(v)))
    assert (found.fraction == 0) == (not found.regions)
    assert sum(r.solid_angle_sr for r in found.regions) == pytest.approx(
        found.fraction * Domain.of(band, masks).solid_angle_sr, abs=1e-6
    )
    sizes = [r.hole.size_deg for r in found.regions]
    assert sizes == sorted(sizes, reverse=True)
    for region in found.regions:
        assert cores.depth(place(region)[None])[0] < 1e-6
        assert in_domain(place(region)[None], band, masks)[0] or region.solid_angle_sr < 1e-9
    # every uncovered direction is within a hole's size of that hole's place
    if bare.any():
        reach = angle_between(v[bare][:, None], np.stack([place(r) for r in found.regions])[None])
        assert np.all(np.any(reach <= np.array(sizes) + 1e-6, axis=1))
