"""The lower bound for closed rows: below every certified plan, and near the counts that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.baselines.published import A6000_35MM, PAPER_TOLERANCE, X5S_15MM, X5S_45MM
from panoexec.planning.certificate.verdict import certify_poses
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import NO_TOLERANCE, AngleBox, Band, Constraints, Tolerance
from panoexec.planning.search import row_bound
from panoexec.planning.search.row_bound import least_images_in_rows
from panoexec.planning.skyline import Skyline
from tests.unit.planning.brute import even_rows


def asked(overlap: float, low_deg: float, high_deg: float, tolerance: Tolerance = NO_TOLERANCE) -> Constraints:
    band = Band(elevation_min_deg=low_deg, elevation_max_deg=high_deg)
    return Constraints(overlap_h=overlap, overlap_v=overlap, band=band, tolerance=tolerance)


@pytest.mark.parametrize(
    ("camera", "constraints", "least", "known"),
    [
        (X5S_15MM.with_lens("nominal"), asked(0.15, -90, 50.5, PAPER_TOLERANCE), 19, 21),
        (X5S_45MM.with_lens("nominal"), asked(0.15, -90, 37.7, PAPER_TOLERANCE), 128, 134),
        (A6000_35MM.with_lens("nominal"), asked(0.15, -90, 12.2, PAPER_TOLERANCE), 38, 40),
        (Camera.from_fov(54.0, 39.8), asked(0.3, -90, 90), 38, 43),
        (Camera.from_fov(56.2, 42.7), asked(0.3, -90, 90), 34, 38),
        (Camera.from_fov(110.9, 80.4), asked(0.3, -90, 90), 9, 11),
    ],
    ids=["scenario 1", "scenario 2", "scenario 3", "sphere", "mapper and hugin", "nav and hugin"],
)
def test_the_bound_is_near_and_below_what_is_known(
    camera: Camera, constraints: Constraints, least: int, known: int
) -> None:
    found = least_images_in_rows(camera, constraints)
    assert found is not None
    assert least <= found <= known


@settings(max_examples=25, deadline=None)
@given(
    fov=st.tuples(st.floats(25, 100), st.floats(20, 90)),
    overlap=st.floats(0.02, 0.4),
    bottom=st.sampled_from([-90.0, -60.0]),
    steps=st.lists(st.floats(0.4, 0.95), min_size=1, max_size=6),
    counts=st.lists(st.integers(3, 14), min_size=7, max_size=7),
    phase=st.floats(0, 60),
    cap=st.integers(0, 2),
)
def test_no_plan_in_rows_that_satisfies_c1_to_c3_has_fewer_images(  # whatever its steps, counts and phases
    fov: tuple[float, float],
    overlap: float,
    bottom: float,
    steps: list[float],
    counts: list[int],
    phase: float,
    cap: int,
) -> None:
    camera = Camera.from_fov(*fov)
    rows = [(-90.0, cap)] if cap else []
    pitch = bottom if cap else bottom + camera.vfov_deg / 3
    for step, count in zip(steps, counts, strict=False):
        pitch = pitch + step * camera.vfov_deg * (1 - overlap)
        if pitch > 75.0:
            break
        rows.append((pitch, count))
    poses, numbers = even_rows(rows, [k * phase for k in range(len(rows))])
    # the band and the overlaps that these rows do satisfy
    free = certify_poses(camera, asked(0.0, -89.0 if cap else bottom, rows[-1][0]), poses, numbers)
    least_h, least_v = free.min_overlap_h, free.min_overlap_v
    if free.uncovered_fraction > 0 or not least_h or not least_v or min(least_h, least_v) < 0.01:
        return
    constraints = replace(
        asked(0.0, -89.0 if cap else bottom, rows[-1][0]), overlap_h=min(least_h, 0.9), overlap_v=min(least_v, 0.9)
    )
    bound = least_images_in_rows(camera, constraints)
    assert bound is None or bound <= len(poses)


def test_neighbours_farther_apart_than_the_widest_spacing_never_overlap_enough() -> None:
    camera, across = Camera.from_fov(54.0, 39.8), 0.3
    pitch = np.linspace(-89.9, 89.9, 600)
    _, widest = row_bound._images(camera, across, pitch, 0.02)
    rng = np.random.default_rng(3)
    pitch, widest = pitch[widest < 179.9], widest[widest < 179.9]
    assert len(pitch) > 400
    for share in rng.uniform(0.0, 1.0, 20):
        yaw = widest + share * (180.0 - widest)
        assert np.all(pairwise_overlap(camera, rotation(0.0, pitch), rotation(yaw, pitch)) <= across + 1e-9)


def test_lowest_and_highest_elevations_are_those_of_the_border() -> None:
    camera, pitch = Camera.from_fov(70.0, 50.0), np.linspace(-90, 90, 61)
    found = row_bound._lowest(camera, pitch)
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-1, 1, 81)))
    rays = np.stack([np.ones_like(y), y * camera.half_width, z * camera.half_height], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for p, lowest in zip(pitch, found, strict=True):
        elevation = np.degrees(np.arcsin(np.clip(-(rays @ rotation(0.0, p).T)[:, 2], -1, 1)))
        assert lowest <= elevation.min() + 1e-9
        assert lowest >= elevation.min() - 1.5
        if abs(p) < 60:
            above = row_bound._quantile(camera, 0.25, np.array([p]))[0]
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
        replace(sphere, overlap_h=0.0),
        replace(sphere, overlap_v=0.0),
        replace(sphere, masks=(mask,)),
        replace(sphere, textured_below=Skyline.level(0.0)),
        replace(sphere, band=replace(sphere.band, azimuth_max_deg=90.0)),
    ):
        assert least_images_in_rows(camera, other) is None
