"""Worst-case overlaps: valid and tight lower bounds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import rotation, yaw_pitch_roll
from panoexec.optics import Camera
from panoexec.planning.certificate.worst_overlap import (
    ErrorCorners,
    overlaps_at_least,
    worst_pair_overlaps,
    worst_union_overlaps,
)
from panoexec.planning.geometry.footprint import edge_normals
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import NO_TOLERANCE, Tolerance
from tests.unit.planning.brute import PAPER, SCENARIO_2, Array

ONE, OTHER = np.array([0]), np.array([1])
TWO_DEGREES = Tolerance(pitch_deg=2.0, roll_deg=2.0, yaw_deg=2.0)

_TOLERANCES = st.builds(
    Tolerance, pitch_deg=st.floats(0.0, 2.0), roll_deg=st.floats(0.0, 2.0), yaw_deg=st.floats(0.0, 2.0)
)


def taken(attitudes: Array, tolerance: Tolerance, count: int, seed: int) -> Array:
    """(count, n, 3, 3): images under errors at the corners of the tolerance, at its faces and inside it."""
    rng = np.random.default_rng(seed)
    yaw, pitch, roll = yaw_pitch_roll(attitudes)
    share = rng.uniform(-1, 1, (3, count, len(attitudes)))
    share[:, : count * 2 // 3] = np.sign(share[:, : count * 2 // 3])
    return rotation(
        yaw + share[0] * tolerance.yaw_deg, pitch + share[1] * tolerance.pitch_deg, roll + share[2] * tolerance.roll_deg
    )


@settings(max_examples=80, deadline=None)
@given(
    hfov=st.floats(8.0, 110.0),
    ratio=st.floats(0.4, 1.5),
    pitch=st.floats(-90.0, 90.0),
    up=st.floats(-0.9, 0.9),
    aside=st.floats(0.0, 0.9),
    roll=st.sampled_from([0.0, 0.0, 3.0]),
    tolerance=_TOLERANCES,
    seed=st.integers(0, 2**31),
)
def test_no_errors_reduce_a_pair_below_its_bound(
    hfov: float, ratio: float, pitch: float, up: float, aside: float, roll: float, tolerance: Tolerance, seed: int
) -> None:
    camera = Camera.from_fov(hfov, min(hfov * ratio, 110.0))
    yaw = aside * camera.hfov_deg / max(np.cos(np.radians(pitch)), 0.1)
    pair = rotation([0.0, yaw], [pitch, pitch + up * camera.vfov_deg], [roll, 0.0])
    corners = ErrorCorners.of(camera, pair, tolerance)
    (bound,) = worst_pair_overlaps(corners, ONE, OTHER)
    errors = taken(pair, tolerance, 400, seed)
    assert bound <= pairwise_overlap(camera, errors[:, 0], errors[:, 1]).min() + 1e-12
    for least in (bound + 1e-9, 0.05):
        if overlaps_at_least(corners, ONE, OTHER, least)[0]:
            assert bound >= least - 1e-12, "the rough bound promises more than the close one"


@pytest.mark.parametrize("pitch", [-90.0, -75.0, -43.0, 0.0, 30.0])
@pytest.mark.parametrize(
    ("camera", "tolerance", "gap"),
    [
        (SCENARIO_2, PAPER, 0.006),
        (Camera.from_fov(60.0, 47.0), PAPER, 0.006),
        (Camera.from_fov(60.0, 47.0), TWO_DEGREES, 0.07),
        (Camera.from_fov(100.0, 80.0), TWO_DEGREES, 0.07),
    ],
)
def test_the_bound_of_a_pair_is_close(pitch: float, camera: Camera, tolerance: Tolerance, gap: float) -> None:
    yaw = 0.8 * camera.hfov_deg / max(np.cos(np.radians(pitch)), 0.2)
    pair = rotation([0.0, yaw], [pitch, pitch])
    (bound,) = worst_pair_overlaps(ErrorCorners.of(camera, pair, tolerance), ONE, OTHER)
    errors = taken(pair, tolerance, 3000, 1)
    assert bound > pairwise_overlap(camera, errors[:, 0], errors[:, 1]).min() - gap


@settings(max_examples=50, deadline=None)
@given(
    hfov=st.floats(10.0, 100.0),
    pitch=st.floats(-85.0, 60.0),
    up=st.floats(0.3, 0.95),
    below=st.booleans(),
    spacing=st.floats(0.5, 0.9),
    tolerance=st.one_of(st.just(PAPER), _TOLERANCES),
    seed=st.integers(0, 2**31),
)
def test_no_errors_reduce_a_row_below_its_bound(
    hfov: float, pitch: float, up: float, below: bool, spacing: float, tolerance: Tolerance, seed: int
) -> None:
    camera = Camera.from_fov(hfov, hfov * 0.75)
    other = max(pitch + (-up if below else up) * camera.vfov_deg, -90.0)
    count = min(max(1, int(np.ceil(360 * np.cos(np.radians(other)) / (hfov * spacing)))), 12)
    yaws = np.random.default_rng(seed).uniform(0, hfov) + (np.arange(count) - count // 2) * hfov * spacing / max(
        np.cos(np.radians(other)), 0.1
    )
    attitudes = np.concatenate([rotation([0.0], [pitch]), rotation(yaws, np.full(count, other))])
    partners = np.arange(1, count + 1)[None]
    corners = ErrorCorners.of(camera, attitudes, tolerance)
    (bound,) = worst_union_overlaps(corners, ONE, partners, np.ones_like(partners, dtype=bool))
    errors = taken(attitudes, tolerance, 90, seed)
    errors[:16, 1:] = taken(attitudes, tolerance, 16, seed + 1)[:, 1:]
    assert bound <= union_overlap(camera, errors[:, 0], errors[:, 1:]).min() + 1e-12


@pytest.mark.parametrize("pitch", [-80.0, -43.0, 0.0, 30.0])
def test_the_bound_of_a_row_is_close(pitch: float) -> None:
    count = max(3, int(22 * np.cos(np.radians(pitch + 12.0))))
    yaws = 5.0 + np.arange(count) * 360 / count
    attitudes = np.concatenate([rotation([0.0], [pitch]), rotation(yaws, np.full(count, pitch + 12.0))])
    partners = np.arange(1, count + 1)[None]
    present = np.ones_like(partners, dtype=bool)
    (bound,) = worst_union_overlaps(ErrorCorners.of(SCENARIO_2, attitudes, PAPER), ONE, partners, present)
    errors = taken(attitudes, PAPER, 400, 2)
    assert bound > union_overlap(SCENARIO_2, errors[:, 0], errors[:, 1:]).min() - 0.012


@pytest.mark.parametrize("tolerance", [PAPER, TWO_DEGREES, Tolerance(pitch_deg=0.0, roll_deg=9.0, yaw_deg=0.0)])
def test_edges_stay_near_what_the_corners_interpolate(tolerance: Tolerance) -> None:
    """The lemma under the bounds: an edge normal is never farther from the interpolation than the remainder."""
    rng = np.random.default_rng(3)
    attitudes = rotation([0.0, 15.0], [-40.0, -52.0])
    corners = ErrorCorners.of(SCENARIO_2, attitudes, tolerance)
    reach = np.sqrt(1 + SCENARIO_2.half_width**2 + SCENARIO_2.half_height**2)
    taus = np.array([t for t in (tolerance.yaw_deg, tolerance.pitch_deg, tolerance.roll_deg) if t])
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=len(taus))))
    yaw, pitch, roll = yaw_pitch_roll(attitudes)
    farthest = 0.0
    for share in [np.zeros((2, 3)), *rng.uniform(-1, 1, (200, 2, 3))]:
        used = share[:, [t > 0 for t in (tolerance.yaw_deg, tolerance.pitch_deg, tolerance.roll_deg)]]
        weights = np.prod((1 + signs * used[:, None]) / 2, axis=2)
        between = np.einsum("nc,ncij->nij", weights, corners.extreme)
        errors = share * [tolerance.yaw_deg, tolerance.pitch_deg, tolerance.roll_deg]
        exact = rotation(yaw + errors[:, 0], pitch + errors[:, 1], roll + errors[:, 2])
        difference = edge_normals(SCENARIO_2) @ (exact[1].T @ exact[0] - between[1].T @ between[0])
        farthest = max(farthest, float(np.linalg.norm(difference, axis=1).max()))
    assert 0.3 * corners.remainder < farthest * reach <= corners.remainder


def test_without_tolerance_the_bounds_are_the_overlaps() -> None:
    attitudes = rotation([0.0, 15.0, -12.0], [-40.0, -40.0, -52.0])
    corners = ErrorCorners.of(SCENARIO_2, attitudes, NO_TOLERANCE)
    first, second = np.array([0, 1, 0]), np.array([1, 0, 2])
    exact = pairwise_overlap(SCENARIO_2, attitudes[first], attitudes[second])
    assert worst_pair_overlaps(corners, first, second) == pytest.approx(exact, abs=1e-12)
    (union,) = worst_union_overlaps(corners, ONE, np.array([[1, 2]]), np.array([[True, True]]))
    expected = union_overlap(SCENARIO_2, attitudes[:1], attitudes[None, 1:])
    assert union == pytest.approx(expected, abs=0.005)
    assert union <= expected + 1e-12


def test_padding_does_not_change_the_bound() -> None:
    attitudes = rotation([0.0, 5.0, -5.0], [-40.0, -52.0, -52.0])
    corners = ErrorCorners.of(SCENARIO_2, attitudes, PAPER)
    alone = worst_union_overlaps(corners, ONE, np.array([[1]]), np.array([[True]]))
    padded = worst_union_overlaps(corners, ONE, np.array([[1, 0, 2]]), np.array([[True, False, False]]))
    assert padded == pytest.approx(alone, abs=1e-15)
    assert worst_union_overlaps(corners, ONE, np.array([[1]]), np.array([[False]])) == [0.0]


def test_images_that_do_not_meet_share_nothing() -> None:
    corners = ErrorCorners.of(SCENARIO_2, rotation([0.0, 90.0], [0.0, 0.0]), PAPER)
    assert worst_pair_overlaps(corners, ONE, OTHER) == [0.0]
    assert not overlaps_at_least(corners, ONE, OTHER, 1e-6)[0]
