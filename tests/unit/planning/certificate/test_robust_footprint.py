"""Robust cores: inside the exact core, and close to it, for any attitude and tolerance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import rotation, yaw_pitch_roll
from panoexec.optics import Camera
from panoexec.planning.certificate.robust_footprint import robust_cores
from panoexec.planning.geometry.footprint import edge_normals
from panoexec.planning.model import NO_TOLERANCE, Tolerance
from tests.unit.planning.brute import PAPER, SCENARIO_2, Array

_TOLERANCES = st.builds(
    Tolerance, pitch_deg=st.floats(0.0, 2.0), roll_deg=st.floats(0.0, 2.0), yaw_deg=st.floats(0.0, 2.0)
)


def surely_inside(camera: Camera, attitude: Array, tolerance: Tolerance, directions: Array, steps: int = 13) -> Array:
    """The least margin of directions (m, 3) over a dense grid of errors, the extreme ones included."""
    yaw, pitch, roll = yaw_pitch_roll(attitude)
    axes = [np.linspace(-t, t, steps) for t in (tolerance.yaw_deg, tolerance.pitch_deg, tolerance.roll_deg)]
    e_yaw, e_pitch, e_roll = (axis.reshape(-1) for axis in np.meshgrid(*axes))
    turned = rotation(yaw + e_yaw, pitch + e_pitch, roll + e_roll)
    normals = edge_normals(camera) @ np.swapaxes(turned, 1, 2)
    return np.asarray((normals.reshape(-1, 3) @ directions.T).min(axis=0))


@settings(max_examples=60, deadline=None)
@given(
    hfov=st.floats(8.0, 110.0),
    vfov=st.floats(8.0, 110.0),
    yaw=st.floats(-180.0, 180.0),
    pitch=st.floats(-95.0, 95.0),
    roll=st.one_of(st.just(0.0), st.floats(-5.0, 5.0)),
    tolerance=_TOLERANCES,
)
def test_cores_are_seen_whatever_the_error(
    hfov: float, vfov: float, yaw: float, pitch: float, roll: float, tolerance: Tolerance
) -> None:
    """At their corners, where they reach farthest, cores are still inside every image that the errors make."""
    camera = Camera.from_fov(hfov, vfov)
    attitude = rotation(yaw, pitch, roll)
    cores = robust_cores(camera, attitude[None], tolerance)
    if cores.empty[0]:
        assert min(hfov, vfov) < 2 * (tolerance.pitch_deg + tolerance.roll_deg + tolerance.yaw_deg) + 0.1
        return
    assert surely_inside(camera, attitude, tolerance, cores.vertices[0]).min() > -1e-12


@pytest.mark.parametrize("pitch", [-90.0, -60.0, -20.0, 5.0, 80.0])
@pytest.mark.parametrize("tolerance", [PAPER, Tolerance(pitch_deg=1.0, roll_deg=0.5, yaw_deg=2.0)])
def test_cores_lose_at_most_a_hundredth_of_a_degree(pitch: float, tolerance: Tolerance) -> None:
    """What is surely seen by a hundredth of a degree is in the core."""
    rng = np.random.default_rng(4)
    attitude = rotation(30.0, pitch)
    # directions along the core's border, pushed out by 0.01°, must be lost by some error
    core = robust_cores(SCENARIO_2, attitude[None], tolerance)
    corners = core.vertices[0][core.is_edge[0]]
    share = rng.uniform(0.0, 1.0, (40, 1))
    border = np.concatenate(
        [(1 - share) * a + share * b for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    )
    normals = np.repeat(core.normals[0][core.is_edge[0]], 40, axis=0)
    outside = border / np.linalg.norm(border, axis=1, keepdims=True) - np.radians(0.01) * normals
    assert surely_inside(SCENARIO_2, attitude, tolerance, outside).max() < 0


def test_without_tolerance_the_core_is_the_image() -> None:
    attitude = rotation(12.0, -34.0, 5.0)
    core = robust_cores(SCENARIO_2, attitude[None], NO_TOLERANCE)
    assert np.allclose(core.normals[0] @ attitude, edge_normals(SCENARIO_2), atol=1e-15)
    assert not core.empty[0]


def test_yaw_error_turns_the_image_at_the_nadir_and_moves_it_at_the_horizon() -> None:
    yaw_only = Tolerance(pitch_deg=0.0, roll_deg=0.0, yaw_deg=2.0)
    nadir, level = robust_cores(SCENARIO_2, rotation([0.0, 0.0], [-90.0, 0.0]), yaw_only).normals
    margin = [(n @ rotation(0.0, p)[:, 0]).min() for n, p in ((nadir, -90.0), (level, 0.0))]
    # turning about the boresight leaves the inscribed circle; moving sideways cannot touch top and bottom
    assert margin[0] == pytest.approx(np.sin(np.radians(16.44 / 2)), rel=1e-3)
    side = (level @ np.array([1.0, 0.0, 0.0]))[np.argmax(np.abs(level[:, 1]))]
    assert side == pytest.approx(np.sin(np.radians(21.76 / 2 - 2.0)), rel=1e-4)


def test_tolerance_larger_than_the_image_gives_an_empty_core() -> None:
    tolerance = Tolerance(pitch_deg=9.0, roll_deg=0.0, yaw_deg=0.0)
    cores = robust_cores(SCENARIO_2, rotation([0.0, 90.0], [0.0, -90.0]), tolerance)
    assert cores.empty.all()
    assert not cores.is_edge.any()
    assert cores.depth(np.array([[1.0, 0.0, 0.0]])).tolist() == [-1.0]


def test_depth_is_that_of_the_best_core() -> None:
    cores = robust_cores(SCENARIO_2, rotation([0.0, 5.0], [0.0, 0.0]), NO_TOLERANCE)
    depth = cores.depth(rotation([0.0, 5.0, 40.0], [0.0, 0.0, 0.0])[:, :, 0])
    assert depth[:2] == pytest.approx(np.sin(np.radians(16.44 / 2)))
    assert depth[2] < 0


def test_equal_attitudes_share_a_rotated_core() -> None:
    turned = rotation([10.0, 100.0], [-40.0, -40.0])
    first, second = robust_cores(SCENARIO_2, turned, PAPER).vertices
    assert np.allclose(second, first @ rotation(90.0, 0.0).T, atol=1e-12)
