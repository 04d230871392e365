"""Ties count below the skyline only: what of an image counts, and what the certificate makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import elevation_azimuth, rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.texture import LEAST_COUNTED, MARGIN_DEG, Texture
from panoexec.planning.certificate.verdict import certify, certify_poses
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import NO_TOLERANCE, Band, Constraints, Tolerance
from panoexec.planning.search.planner import plan_certified
from panoexec.planning.skyline import Skyline
from tests.unit.planning.brute import even_rows, with_errors

WIDE = Camera.from_fov(59.94, 46.86)
TOLERANCE = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7)
HILLS = Skyline(((-150.0, 4.0), (-60.0, 30.0), (10.0, -5.0), (100.0, 12.0)))

skylines = st.one_of(
    st.floats(-40, 60).map(Skyline.level),
    st.lists(st.tuples(st.integers(-180, 179), st.integers(-30, 50)), min_size=2, max_size=12, unique_by=lambda p: p[0])
    .map(sorted)
    .map(lambda points: Skyline(tuple((float(a), float(e)) for a, e in points))),
)


def band(low_deg: float, high_deg: float, *azimuth_deg: float) -> Constraints:
    limits = azimuth_deg or (-180.0, 180.0)
    return Constraints(
        overlap_h=0.15,
        overlap_v=0.15,
        band=Band(
            elevation_min_deg=low_deg,
            elevation_max_deg=high_deg,
            azimuth_min_deg=limits[0],
            azimuth_max_deg=limits[1],
        ),
        tolerance=TOLERANCE,
    )


def points_of(camera: Camera, top: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random points (count, 3) of an image below a line of its plane, in the camera's frame."""
    across = rng.uniform(-camera.half_width, camera.half_width, count)
    down = rng.uniform(top, camera.half_height, count)
    return np.stack([np.ones(count), across, down], axis=1)


@settings(max_examples=25, deadline=None)
@given(
    skyline=skylines,
    yaw=st.floats(-180, 180),
    pitch=st.floats(-90, 90),
    roll=st.sampled_from([0.0, 0.0, 3.0, -30.0]),
    tolerance=st.sampled_from([NO_TOLERANCE, TOLERANCE, Tolerance(pitch_deg=1.5, roll_deg=2.0, yaw_deg=2.0)]),
    fov=st.tuples(st.floats(5, 110), st.floats(5, 100)),
    seed=st.integers(0, 99),
)
def test_what_counts_lies_below_the_skyline_for_every_error(
    skyline: Skyline,
    yaw: float,
    pitch: float,
    roll: float,
    tolerance: Tolerance,
    fov: tuple[float, float],
    seed: int,
) -> None:
    camera, rng = Camera.from_fov(*fov), np.random.default_rng(seed)
    pose = rotation([yaw], pitch, roll)
    texture = Texture.of(camera, pose, tolerance, skyline)
    assert texture is not None
    top = float(texture.tops[0])
    assert texture.shares[0] == pytest.approx((camera.half_height - top) / (2 * camera.half_height))
    if top >= camera.half_height:
        return
    rays = points_of(camera, top, 300, rng)
    azimuths, elevations = zip(*skyline.points, strict=True)
    for extreme in (False, True):
        taken = with_errors(pose, tolerance, rng, extreme=extreme)[0]
        elevation, azimuth = elevation_azimuth(rays @ taken.T)
        limit = np.interp(azimuth, azimuths, elevations, period=360.0)
        assert np.all(np.asarray(elevation) <= limit - MARGIN_DEG + 1e-6)


def test_the_line_is_where_the_skyline_is() -> None:
    texture = Texture.of(WIDE, rotation([0.0, 0.0, 0.0], [0.0, 60.0, -60.0]), NO_TOLERANCE, Skyline.level(0.0))
    assert texture is not None
    assert texture.tops[0] == pytest.approx(np.tan(np.radians(MARGIN_DEG)), abs=0.008)
    assert texture.shares[1:].tolist() == [0.0, 1.0]
    assert texture.counts.tolist() == [True, False, True]
    assert Texture.of(WIDE, rotation([0.0], 0.0), NO_TOLERANCE, None) is None


def test_overlaps_of_cropped_images_are_those_of_random_points() -> None:
    rng = np.random.default_rng(5)
    poses = rotation([0.0, 35.0, -40.0], [10.0, 8.0, 20.0])
    tops = np.array([0.1, -0.2, 0.05])
    found = pairwise_overlap(WIDE, poses[:2], poses[[1, 2]], tops=tops[:2])
    together = union_overlap(WIDE, poses[:1], poses[None, 1:], tops=tops[:1])
    for i, j in ((0, 1), (1, 2)):
        assert found[i] == pytest.approx(seen_share(poses[i], tops[i], [poses[j]], rng), abs=0.006)
    assert together[0] == pytest.approx(seen_share(poses[0], tops[0], [poses[1], poses[2]], rng), abs=0.006)


def seen_share(own: np.ndarray, top: float, others: list[np.ndarray], rng: np.random.Generator) -> float:
    """Fraction of a whole image that lies below its line and that at least one of the others sees."""
    rays = points_of(WIDE, top, 60_000, rng) @ own.T
    seen = np.zeros(len(rays), dtype=bool)
    for other in others:
        inside = rays @ other
        seen |= (np.abs(inside[:, 1]) <= inside[:, 0] * WIDE.half_width) & (
            np.abs(inside[:, 2]) <= inside[:, 0] * WIDE.half_height
        )
    return float(seen.mean()) * (WIDE.half_height - top) / (2 * WIDE.half_height)


def test_images_of_the_sky_alone_need_no_ties_and_give_none() -> None:
    ring, sky = (-15.0, 9), (45.0, 5)
    poses, rows = even_rows([ring, sky])
    asked = band(-35.0, 5.0)
    assert not certify_poses(WIDE, asked, poses, rows).certified
    with_sky = replace(asked, textured_below=Skyline.level(10.0))
    found = certify_poses(WIDE, with_sky, poses, rows)
    assert found.certified, found.failures
    assert found.min_overlap_v is None
    # without half of the ring nothing holds together, whatever the sky shows
    parted = [i for i, row in enumerate(rows) if row == 1 or i not in {0, 4}]
    again = certify_poses(WIDE, with_sky, poses[parted], [rows[i] for i in parted])
    assert not again.connected


def test_what_neighbours_share_of_the_sky_is_no_overlap() -> None:
    poses, rows = even_rows([(12.0, 8)])
    asked = replace(band(-5.0, 20.0), tolerance=NO_TOLERANCE)
    whole = certify_poses(WIDE, asked, poses, rows)
    below = certify_poses(WIDE, replace(asked, textured_below=Skyline.level(0.0)), poses, rows)
    assert whole.min_overlap_h is not None
    assert below.min_overlap_h is not None
    texture = Texture.of(WIDE, poses, NO_TOLERANCE, Skyline.level(0.0))
    assert texture is not None
    rng = np.random.default_rng(6)
    share = seen_share(poses[0], float(texture.tops[0]), [poses[1]], rng) / texture.shares[0]
    assert LEAST_COUNTED < texture.shares[0] < 0.5
    assert below.min_overlap_h == pytest.approx(share, abs=0.02)
    assert below.min_overlap_h != pytest.approx(whole.min_overlap_h, abs=0.01)


def test_a_plan_is_certified_and_marks_what_sees_the_sky_alone() -> None:
    skyline = HILLS
    plan = plan_certified(WIDE, replace(band(-40.0, 70.0), textured_below=skyline))
    assert plan.certificate is not None
    assert plan.certificate.certified
    assert certify(plan).certified
    texture = Texture.of(WIDE, plan.rotations(), TOLERANCE, skyline)
    assert texture is not None
    assert [shot.geometry_only for shot in plan.shots] == (~texture.counts).tolist()
    assert any(shot.geometry_only for shot in plan.shots)
    assert not all(shot.geometry_only for shot in plan.shots)


@pytest.mark.parametrize("sky", [None, 0.0])
def test_no_image_is_outside_the_band_only_to_tie_others(sky: float | None) -> None:
    constraints = replace(band(-20.0, 20.0, 0.0, 90.0), textured_below=None if sky is None else Skyline.level(sky))
    plan = plan_certified(WIDE, constraints)
    assert plan.certificate is not None
    assert plan.certificate.certified
    assert all(-20.0 <= shot.pitch_deg <= 20.0 for shot in plan.shots)
