"""The proof of coverage: it detects every hole of any size, and reports none in a true cover."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.baselines.ring import ring
from panoexec.planning.certificate.coverage import border_gaps, is_covered, neighbours
from panoexec.planning.certificate.robust_footprint import robust_cores
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.model import NO_TOLERANCE, AngleBox, Band, Tolerance
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
    unseen,
    with_errors,
)


def covered(
    camera: Camera,
    attitudes: Array,
    band: Band,
    tolerance: Tolerance = NO_TOLERANCE,
    masks: tuple[AngleBox, ...] = (),
) -> bool:
    return is_covered(robust_cores(camera, attitudes, tolerance), Domain.of(band, masks))


@pytest.mark.parametrize("width_deg", [1.0, 1e-2, 1e-4, 1e-6, 2e-7, 0.0])
@pytest.mark.parametrize(("yaw", "pitch", "roll"), [(0, 0, 0), (-120, -47, 13), (179.9, 60, -30), (33, -71, 45)])
def test_a_hole_of_any_width_is_found(width_deg: float, yaw: float, pitch: float, roll: float) -> None:
    centre = rotation(yaw, pitch, roll)
    band = sector_about(centre, 3.0)
    assert not covered(SCENARIO_2, pinwheel(centre, SCENARIO_2, width_deg), band)


@pytest.mark.parametrize("overlap_deg", [1.0, 1e-4, 1e-6])
@pytest.mark.parametrize(("yaw", "pitch", "roll"), [(0, 0, 0), (-120, -47, 13), (179.9, 60, -30), (33, -71, 45)])
def test_where_images_overlap_there_is_no_hole(overlap_deg: float, yaw: float, pitch: float, roll: float) -> None:
    centre = rotation(yaw, pitch, roll)
    band = sector_about(centre, 3.0)
    assert covered(SCENARIO_2, pinwheel(centre, SCENARIO_2, -overlap_deg), band)


@pytest.mark.parametrize("error", [PAPER, Tolerance(pitch_deg=0.5, roll_deg=0.3, yaw_deg=1.0)])
def test_errors_open_holes_that_the_planned_poses_hide(error: Tolerance) -> None:
    """Overlaps that just outlast the errors pass; a thousandth of a degree less does not."""
    centre = rotation(20.0, -40.0)
    band = sector_about(centre, 2.0)
    low, high = 0.0, 6.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (
            (low, middle) if covered(SCENARIO_2, pinwheel(centre, SCENARIO_2, -middle), band, error) else (middle, high)
        )
    assert 0.02 < high < 4.0
    # just too little: some errors within the tolerance show the hole to random directions
    rng = np.random.default_rng(2)
    images = pinwheel(centre, SCENARIO_2, -high + 0.1)
    dense = rotation(20.0, -40.0) @ rotation(rng.uniform(-0.4, 0.4, 4000), rng.uniform(-0.4, 0.4, 4000))[:, :, 0].T
    shown = any(len(unseen(SCENARIO_2, with_errors(images, error, rng, extreme=True), dense.T)) for _ in range(400))
    assert shown


def test_a_hole_under_a_mask_does_not_count_and_beside_it_does() -> None:
    centre = rotation(50.0, -30.0)
    images, band = pinwheel(centre, SCENARIO_2, 0.1), sector_about(centre, 3.0)

    def mask(from_deg: float, to_deg: float) -> AngleBox:
        return AngleBox(
            elevation_min_deg=-31.0, elevation_max_deg=-29.0, azimuth_min_deg=from_deg, azimuth_max_deg=to_deg
        )

    assert covered(SCENARIO_2, images, band, masks=(mask(49.0, 51.0),))
    # two masks that meet in the middle of the hole hide it as one
    assert covered(SCENARIO_2, images, band, masks=(mask(49.0, 50.0), mask(50.0, 51.0)))
    assert not covered(SCENARIO_2, images, band, masks=(mask(49.0, 50.0),))
    assert not covered(SCENARIO_2, images, band, masks=(mask(49.0, 50.0), mask(50.0 + 1e-6, 51.0)))


def test_six_images_of_90_degrees_touch_and_a_little_more_close_the_sphere() -> None:
    cube = rotation([0.0, 90.0, 180.0, -90.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 90.0, -90.0])
    sphere = full_circle(-90.0, 90.0)
    assert not covered(Camera.from_fov(90.0, 90.0), cube, sphere)
    assert covered(Camera.from_fov(90.0001, 90.0001), cube, sphere)
    for missing in range(6):
        assert not covered(Camera.from_fov(100.0, 100.0), np.delete(cube, missing, 0), sphere)


def test_a_full_row_covers_up_to_its_ring_and_not_further() -> None:
    low, high = ring(SCENARIO_2, -30.0, 360.0 / 20 / 2)
    row, _ = even_rows([(-30.0, 20)])
    assert covered(SCENARIO_2, row, full_circle(float(low) + 1e-6, float(high) - 1e-6))
    assert not covered(SCENARIO_2, row, full_circle(float(low) - 1e-6, float(high) - 1e-6))
    assert not covered(SCENARIO_2, row, full_circle(float(low) + 1e-6, float(high) + 1e-6))
    assert not covered(SCENARIO_2, row[:-1], full_circle(float(low) + 1e-6, float(high) - 1e-6))


def test_a_domain_inside_one_image_or_out_of_sight_of_all() -> None:
    image = rotation([0.0], [0.0])
    inside = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=-5.0, azimuth_max_deg=5.0)
    behind = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=170.0, azimuth_max_deg=190.0)
    assert covered(SCENARIO_2, image, inside)
    assert not covered(SCENARIO_2, image, behind)
    assert covered(SCENARIO_2, rotation([180.0], [0.0]), behind)
    assert not covered(SCENARIO_2, np.empty((0, 3, 3)), inside)


def test_component_of_the_domain_isolated_by_masks_is_tested() -> None:
    """Two islands, only one of them in an image; no border of the image crosses the domain."""
    camera = Camera.from_fov(40.0, 40.0)
    band = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=-5.0, azimuth_max_deg=65.0)
    gap = AngleBox(elevation_min_deg=-90.0, elevation_max_deg=90.0, azimuth_min_deg=10.0, azimuth_max_deg=55.0)
    assert not covered(camera, rotation([0.0], [0.0]), band, masks=(gap,))
    assert covered(camera, rotation([0.0, 60.0], [0.0, 0.0]), band, masks=(gap,))


@pytest.mark.parametrize("pole", [-90.0, 90.0])
def test_a_pole_is_covered_once_an_image_holds_it(pole: float) -> None:
    band = full_circle(-90.0, -86.0) if pole < 0 else full_circle(86.0, 90.0)
    half = 16.44 / 2
    inward = -1.0 if pole > 0 else 1.0
    assert covered(SCENARIO_2, rotation([7.0], [pole]), band)
    assert not covered(SCENARIO_2, rotation([7.0], [pole + inward * (half + 0.01)]), band)


@settings(max_examples=60, deadline=None)
@given(
    hfov=st.floats(20.0, 110.0),
    ratio=st.floats(0.5, 1.3),
    overlap=st.floats(0.02, 0.4),
    top=st.floats(-60.0, 90.0),
    tolerance=st.one_of(
        st.just(NO_TOLERANCE),
        st.builds(Tolerance, pitch_deg=st.floats(0.0, 2.0), roll_deg=st.floats(0.0, 2.0), yaw_deg=st.floats(0.0, 2.0)),
    ),
    start=st.floats(-180.0, 180.0),
    span=st.one_of(st.just(360.0), st.floats(10.0, 359.0)),
    spoil=st.floats(0.0, 2.0),
    seed=st.integers(0, 2**31),
)
def test_proven_coverage_has_no_hole_in_dense_sampling(
    hfov: float,
    ratio: float,
    overlap: float,
    top: float,
    tolerance: Tolerance,
    start: float,
    span: float,
    spoil: float,
    seed: int,
) -> None:
    """Plans of any kind, spoiled a little: when the proof holds, no random error shows a hole to a random direction."""
    camera = Camera.from_fov(hfov, min(110.0, hfov * ratio))
    rng = np.random.default_rng(seed)
    planned, _ = even_rows(rows := enough_rows(camera, overlap, top), rng.uniform(0.0, 360.0, len(rows)).tolist())
    attitudes = with_errors(planned, Tolerance(pitch_deg=spoil, roll_deg=spoil, yaw_deg=spoil), rng, extreme=False)
    band = Band(elevation_min_deg=-90.0, elevation_max_deg=top, azimuth_min_deg=start, azimuth_max_deg=start + span)
    directions = random_directions(3000, rng)
    directions = directions[in_domain(directions, band)]
    cores = robust_cores(camera, attitudes, tolerance)
    proven = is_covered(cores, Domain.of(band))
    if proven:
        for extreme in (True, False):
            taken = with_errors(attitudes, tolerance, rng, extreme=extreme)
            assert len(unseen(camera, taken, directions)) == 0
    if len(directions):
        assert proven <= bool(cores.depth(directions).min() >= 0)


def test_a_plan_with_room_to_spare_is_proven() -> None:
    """The proof is not only safe but finds what is there: generous plans pass, with errors too."""
    for hfov, tolerance in product((24.0, 60.0, 100.0), (NO_TOLERANCE, PAPER)):
        camera = Camera.from_fov(hfov, hfov * 0.75)
        attitudes, _ = even_rows(enough_rows(camera, 0.35, 90.0))
        assert covered(camera, attitudes, full_circle(-90.0, 90.0), tolerance)


def test_gaps_lie_where_no_other_core_is() -> None:
    attitudes, _ = even_rows([(-40.0, 14), (-20.0, 20)])
    cores = robust_cores(SCENARIO_2, attitudes, PAPER)
    gaps = border_gaps(cores, Domain.of(full_circle(-50.0, -10.0)))
    assert len(gaps)
    middles = gaps.starts + gaps.ends
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    own = cores.normals[gaps.images, gaps.edges]
    assert np.abs(np.sum(own * middles, axis=1)).max() < 1e-12
    assert cores.depth(middles).max() < 2e-9
    assert in_domain(middles, full_circle(-50.0 - 1e-6, -10.0 + 1e-6)).all()


@pytest.mark.parametrize(("fov", "count"), [(3.0, 1500), (12.0, 900), (60.0, 150)])
def test_neighbours_found_by_cells_are_all_that_could_meet(fov: float, count: int) -> None:
    rng = np.random.default_rng(8)
    attitudes = rotation(rng.uniform(-180, 180, count), np.degrees(np.arcsin(rng.uniform(-1, 1, count))))
    cores = robust_cores(Camera.from_fov(fov, fov), attitudes, NO_TOLERANCE)
    first, second = neighbours(cores)
    expected = cores.centres @ cores.centres.T >= np.cos(2 * cores.radii[0])
    np.fill_diagonal(expected, val=False)
    found = np.zeros_like(expected)
    found[first, second] = True
    assert not np.any(expected & ~found)
    assert len(first) == found.sum() <= expected.sum() + count // 100
    assert np.all(np.diff(first) >= 0)
