"""The lower bounds for closed rows: below every certified plan, and near the counts that are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import rotation, yaw_pitch_roll
from panoexec.optics import Camera
from panoexec.planning.baselines.published import A6000_35MM, PAPER_TOLERANCE, X5S_15MM, X5S_45MM
from panoexec.planning.certificate.robust_footprint import robust_cores
from panoexec.planning.certificate.verdict import certify_poses
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import NO_TOLERANCE, AngleBox, Band, Constraints, Tolerance
from panoexec.planning.search.parallels import core_shown_deg, shown_deg
from panoexec.planning.search.row_bound import least_images_in_rows, more_at_end
from panoexec.planning.search.row_cells import closing_deg
from panoexec.planning.search.row_limits import (
    fewest_images,
    highest_after_caps,
    lowest_shown,
    quantile,
    useful_caps,
    yaw_rate,
)
from panoexec.planning.skyline import Skyline
from tests.unit.planning.brute import Array


def asked(overlap: float, low_deg: float, high_deg: float, tolerance: Tolerance = NO_TOLERANCE) -> Constraints:
    band = Band(elevation_min_deg=low_deg, elevation_max_deg=high_deg)
    return Constraints(overlap_h=overlap, overlap_v=overlap, band=band, tolerance=tolerance)


@pytest.mark.parametrize(
    ("camera", "constraints", "least", "known"),
    [
        (X5S_15MM.with_lens("nominal"), asked(0.15, -90, 50.5, PAPER_TOLERANCE), 20, 21),
        (X5S_45MM.with_lens("nominal"), asked(0.15, -90, 37.7, PAPER_TOLERANCE), 131, 134),
        (A6000_35MM.with_lens("nominal"), asked(0.15, -90, 12.2, PAPER_TOLERANCE), 40, 40),
        (Camera.from_fov(54.0, 39.8), asked(0.3, -90, 90), 40, 43),
        (Camera.from_fov(54.0, 42.7), asked(0.0, -90, 90), 23, 25),
        (Camera.from_fov(56.2, 42.7), asked(0.3, -90, 90), 36, 38),
        (Camera.from_fov(110.9, 80.4), asked(0.3, -90, 90), 10, 11),
    ],
    ids=["scenario 1", "scenario 2", "scenario 3", "sphere", "mapper", "mapper and hugin", "nav and hugin"],
)
def test_the_bound_is_near_and_below_what_is_known(
    camera: Camera, constraints: Constraints, least: int, known: int
) -> None:
    found = least_images_in_rows(camera, constraints)
    assert found is not None
    assert least <= found <= known


@st.composite
def plans_in_rows(draw: st.DrawFn, *, overlap: bool) -> tuple[Camera, Constraints, Array, list[int]] | None:
    """A plan of the class with the strictest request that it satisfies; None if it satisfies none."""
    camera = Camera.from_fov(draw(st.floats(25, 110)), draw(st.floats(20, 90)))
    low_cap, top_cap = draw(st.integers(0, 2)), draw(st.integers(0, 2))
    share = draw(st.floats(0.02, 0.4)) if overlap else 0.0
    half = camera.vfov_deg / 2
    tilt = draw(st.floats(0.0, 1.0))
    pitch = -90.0 + tilt * half if low_cap else draw(st.floats(-90.0 + half, 20.0))
    poses: list[Array] = []
    numbers: list[int] = []
    pitches: list[float] = []

    def add(pitch: float, count: int) -> None:
        jitter = np.array([draw(st.floats(-1.0, 1.0)) for _ in range(count)]) * draw(st.sampled_from([0.0, 0.02, 0.1]))
        yaws = (np.arange(count) + jitter) * 360.0 / count + draw(st.floats(0.0, 90.0))
        poses.append(rotation(yaws, np.full(count, pitch)))
        numbers.extend([len(pitches)] * count)
        pitches.append(pitch)

    if low_cap:
        add(pitch, low_cap)
    for _ in range(draw(st.integers(1, 6))):
        if pitches:
            pitch += draw(st.floats(0.3, 1.0)) * camera.vfov_deg * (1 - share)
        if pitch > 80.0:
            break
        spacing = float(closing_deg(camera, np.array([pitch]))[0]) * (1 - share)
        add(pitch, max(3, math.ceil(360.0 / spacing) + draw(st.integers(0, 1))))
    if top_cap and pitches[-1] + 0.6 * camera.vfov_deg > 90.0 - half:
        add(max(90.0 - draw(st.floats(0.0, 1.0)) * half, pitches[-1]), top_cap)
    rotations = np.concatenate(poses)
    low = -90.0 if low_cap else max(pitches[0] - draw(st.floats(0.0, 0.4)) * camera.vfov_deg, -90.0)
    high = min(pitches[-1] + draw(st.floats(0.0, 0.4)) * camera.vfov_deg, 90.0)
    if top_cap and numbers.count(numbers[-1]) == top_cap:
        high = 90.0
    tolerance = Tolerance(pitch_deg=0.2, roll_deg=0.1, yaw_deg=1.0) if draw(st.booleans()) else NO_TOLERANCE
    if high - low < 1.0:
        return None
    free = certify_poses(camera, asked(0.0, low, high, tolerance), rotations, numbers)
    if free.uncovered_fraction > 0:
        return None
    if not overlap:
        return camera, asked(0.0, low, high, tolerance), rotations, numbers
    least_h, least_v = free.min_overlap_h, free.min_overlap_v
    if not least_h or not least_v or min(least_h, least_v) < 0.01:
        return None
    constraints = asked(0.0, low, high, tolerance)
    return camera, replace(constraints, overlap_h=min(least_h, 0.9), overlap_v=min(least_v, 0.9)), rotations, numbers


@settings(max_examples=12, deadline=None)
@given(plan=plans_in_rows(overlap=True))
def test_no_plan_in_rows_that_satisfies_c1_to_c3_has_fewer_images(  # whatever its steps, counts, spacings and phases
    plan: tuple[Camera, Constraints, Array, list[int]] | None,
) -> None:
    if plan is not None:
        bound = least_images_in_rows(plan[0], plan[1])
        assert bound is None or bound <= len(plan[3])


@settings(max_examples=12, deadline=None)
@given(plan=plans_in_rows(overlap=False))
def test_no_plan_in_closed_rows_that_covers_has_fewer_images(
    plan: tuple[Camera, Constraints, Array, list[int]] | None,
) -> None:
    if plan is None:
        return
    camera, constraints, rotations, numbers = plan
    yaw, pitch, _ = yaw_pitch_roll(rotations)
    for row in set(numbers):
        where = np.array(numbers) == row
        if where.sum() > 2:
            around = np.sort(yaw[where] % 360.0)
            widest = np.diff(around, append=around[0] + 360.0).max()
            if widest > closing_deg(camera, pitch[where][:1])[0]:
                return  # not a closed row
    bound = least_images_in_rows(camera, constraints)
    assert bound is None or bound <= len(numbers)


@settings(max_examples=40, deadline=None)
@given(
    fov=st.tuples(st.floats(15, 120), st.floats(10, 100)),
    pitch=st.floats(-90.5, 90.5),
    elevation=st.floats(-89.5, 89.5),
)
def test_azimuths_that_an_image_shows_are_those_counted(
    fov: tuple[float, float], pitch: float, elevation: float
) -> None:
    camera = Camera.from_fov(*fov)
    found = float(shown_deg(camera.half_width, camera.half_height, pitch, elevation))
    assert found == pytest.approx(_counted(camera, pitch, elevation, 7200), abs=0.2)


def _counted(camera: Camera, pitch: float, elevation: float, count: int) -> float:
    azimuth, up = (np.arange(count) + 0.5) * 2 * np.pi / count, math.radians(elevation)
    rays = np.stack([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.full(count, -np.sin(up))], axis=1)
    x, y, z = (rays @ rotation(0.0, pitch)).T
    seen = (x > 0) & (np.abs(y) <= camera.half_width * x) & (np.abs(z) <= camera.half_height * x)
    return 360.0 * float(seen.mean())


def test_robust_cores_show_no_more_than_reckoned() -> None:
    rng = np.random.default_rng(5)
    for _ in range(40):
        camera = Camera.from_fov(*rng.uniform(25, 100, 2))
        tolerance = Tolerance(pitch_deg=rng.uniform(0, 1), roll_deg=rng.uniform(0, 1), yaw_deg=rng.uniform(0, 1.5))
        pitch, elevation = rng.uniform(-90, 90), rng.uniform(-89, 89)
        near, up = pitch + rng.uniform(-0.2, 0.2), math.radians(elevation)
        most = core_shown_deg(camera, tolerance, np.array([pitch]), 0.2, np.array([elevation]))[0, 0]
        turn = (np.arange(3600) + 0.5) * 2 * np.pi / 3600
        rays = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.full(3600, -np.sin(up))], axis=1)
        shown = robust_cores(camera, rotation([0.0], [near]), tolerance).depth(rays) >= 0
        assert 360.0 * shown.mean() <= most + 0.2


@pytest.mark.parametrize(("fov", "overlap"), [((54.0, 39.8), 0.3), ((85.0, 35.0), 0.1), ((40.0, 60.0), 0.2)])
def test_rows_above_the_highest_after_caps_lack_overlap(fov: tuple[float, float], overlap: float) -> None:
    camera, rng = Camera.from_fov(*fov), np.random.default_rng(7)
    for caps, highest in zip((1, 2), highest_after_caps(camera, overlap, overlap), strict=True):
        assert highest < 0.0
        for _ in range(60):
            pitch = highest + rng.uniform(0.0, 4.0)
            _, widest = fewest_images(camera, overlap, np.array([pitch]), 0.0)
            count = max(3, math.ceil(360.0 / widest[0]))
            cap = rotation(rng.uniform(0, 360, caps), np.full(caps, -90.0 + rng.uniform(0, camera.vfov_deg / 2)))
            row = rotation(np.arange(count) * 360.0 / count + rng.uniform(0, 90), np.full(count, pitch))
            partners = np.broadcast_to(cap, (count, caps, 3, 3))
            assert union_overlap(camera, row, partners).min() < overlap


def test_only_caps_that_show_something_of_the_band_are_useful() -> None:
    camera, pitch = Camera.from_fov(40.0, 30.0), np.linspace(-90.0, 90.0, 361)
    band = Band(elevation_min_deg=-60.0, elevation_max_deg=55.0)
    low, top = useful_caps(camera, band, pitch, 0.0)
    assert not top[pitch > 55.0 + 30.0].any()
    caps = np.abs(pitch) >= 75.0
    for p, useful in zip(pitch[caps].tolist(), (low | top)[caps].tolist(), strict=True):
        shows = shown_deg(camera.half_width, camera.half_height, p, np.linspace(-60.0, 55.0, 200)).max() > 0
        assert useful or not shows
    assert not low[pitch == -90.0].any()


def test_rows_anywhere_in_a_cell_need_no_more_images_at_the_end_than_counted() -> None:
    camera, half, end = Camera.from_fov(50.0, 40.0), 0.05, 35.0
    rng = np.random.default_rng(9)
    pitch = rng.uniform(5.0, 60.0, 400)
    shown = shown_deg(camera.half_width, camera.half_height, pitch + half * rng.uniform(-1.0, 1.0, 400), end)
    some = shown > 1.0
    needed = np.ceil(360.0 / shown[some])
    # of as many images as fill the parallel none are lacking, of one fewer for nearly all
    assert not more_at_end(camera, end, pitch[some], needed, half).any()
    assert more_at_end(camera, end, pitch[some], needed - 1, half).mean() > 0.8


def test_a_cap_beside_the_band_does_not_lower_the_bound() -> None:
    # with caps that see nothing of the band, and take two images, it would be 57
    found = least_images_in_rows(Camera.from_fov(30.0, 20.0), asked(0.0, -50, 40))
    assert found is not None
    assert found >= 58


def test_neighbours_farther_apart_than_the_widest_spacing_never_overlap_enough() -> None:
    camera, across = Camera.from_fov(54.0, 39.8), 0.3
    pitch = np.linspace(-89.9, 89.9, 600)
    _, widest = fewest_images(camera, across, pitch, 0.02)
    rng = np.random.default_rng(3)
    pitch, widest = pitch[widest < 179.9], widest[widest < 179.9]
    assert len(pitch) > 400
    for share in rng.uniform(0.0, 1.0, 20):
        yaw = widest + share * (180.0 - widest)
        assert np.all(pairwise_overlap(camera, rotation(0.0, pitch), rotation(yaw, pitch)) <= across + 1e-9)


@settings(max_examples=60, deadline=None)
@given(fov=st.tuples(st.floats(5, 150), st.floats(5, 140)), pitch=st.floats(-90, 90))
def test_the_overlap_of_neighbours_never_falls_faster_with_the_yaw(fov: tuple[float, float], pitch: float) -> None:
    camera = Camera.from_fov(*fov)
    yaw = np.linspace(0.0, 180.0, 721)
    overlaps = pairwise_overlap(camera, rotation(0.0, pitch), rotation(yaw, np.full(len(yaw), pitch)))
    fallen = -np.diff(overlaps) * camera.image_area / (4 * camera.half_width * camera.half_height)
    assert fallen.max() <= yaw_rate(camera, np.array([pitch]))[0] * math.radians(yaw[1]) + 1e-12


def test_the_rate_of_the_overlap_is_reached_by_narrow_images_at_the_horizon() -> None:
    camera = Camera.from_fov(4.0, 3.0)
    yaw = np.array([0.0, 1e-3])
    first, then = pairwise_overlap(camera, rotation(0.0, 0.0), rotation(yaw, np.zeros(2)))
    assert (first - then) / math.radians(yaw[1]) == pytest.approx(yaw_rate(camera, np.zeros(1))[0], rel=0.01)


def test_lowest_and_highest_elevations_are_those_of_the_border() -> None:
    camera, pitch = Camera.from_fov(70.0, 50.0), np.linspace(-90, 90, 61)
    found = lowest_shown(camera, pitch)
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-1, 1, 81)))
    rays = np.stack([np.ones_like(y), y * camera.half_width, z * camera.half_height], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for p, lowest in zip(pitch, found, strict=True):
        elevation = np.degrees(np.arcsin(np.clip(-(rays @ rotation(0.0, p).T)[:, 2], -1, 1)))
        assert lowest <= elevation.min() + 1e-9
        assert lowest >= elevation.min() - 1.5
        if abs(p) < 60:
            above = quantile(camera, 0.25, np.array([p]))[0]
            assert (elevation >= above).mean() <= 0.25 + 0.02
            assert (elevation >= above - 0.5).mean() >= 0.25 - 0.02


@pytest.mark.parametrize("ends", [(-90.0, -80.0), (80.0, 90.0)])
def test_one_image_about_a_pole_may_be_all(ends: tuple[float, float]) -> None:
    camera, constraints = Camera.from_fov(54.0, 39.8), asked(0.3, *ends)
    pole = rotation([0.0], [ends[0] if ends[0] < 0 else ends[1]])
    assert certify_poses(camera, constraints, pole, [0]).certified
    assert least_images_in_rows(camera, constraints) == 1


def test_it_does_not_apply_where_its_class_ends() -> None:
    camera, sphere = Camera.from_fov(54.0, 39.8), asked(0.3, -90, 90)
    mask = AngleBox(elevation_min_deg=0, elevation_max_deg=10, azimuth_min_deg=0, azimuth_max_deg=20)
    for other in (
        replace(sphere, masks=(mask,)),
        replace(sphere, textured_below=Skyline.level(0.0)),
        replace(sphere, band=replace(sphere.band, azimuth_max_deg=90.0)),
    ):
        assert least_images_in_rows(camera, other) is None
