"""Plans and certificates for the lens in the air: calibrated focal length, distortion, margin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import FloatArray, rotation
from panoexec.inputs.camera_profiles import load_profile
from panoexec.lens.distortion import Distortion
from panoexec.optics import Camera
from panoexec.planning.baselines.published import PAPER_TOLERANCE
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import Band, Constraints, Plan
from panoexec.planning.search.planner import plan_certified
from tests.unit.planning.sampling import directions_in

SCENARIO_2 = Constraints(
    overlap_h=0.15,
    overlap_v=0.15,
    band=Band(elevation_min_deg=-90, elevation_max_deg=37.7),
    tolerance=PAPER_TOLERANCE,
)


@pytest.fixture(scope="module")
def plan_for_45_mm() -> Plan:
    return plan_certified(load_profile("dji-x5s-45mm").camera.with_lens("nominal"), SCENARIO_2)


def test_the_nominal_plan_of_scenario_2_is_not_certified_with_the_calibrated_lens(plan_for_45_mm: Plan) -> None:
    assert plan_for_45_mm.certificate is not None
    assert plan_for_45_mm.certificate.certified
    assert len(plan_for_45_mm.shots) <= 134
    judged = certify(replace(plan_for_45_mm, camera=plan_for_45_mm.camera.with_lens("calibrated")))
    assert not judged.certified
    assert judged.holes
    assert judged.min_overlap_h is not None
    assert judged.min_overlap_h < 0.15


def test_scenario_2_is_certified_for_the_calibrated_lens_when_planned_for_it() -> None:
    plan = plan_certified(load_profile("dji-x5s-45mm").camera, SCENARIO_2)
    assert plan.camera.focal_length_used_mm == 46.0
    assert plan.certificate is not None
    assert plan.certificate.certified
    assert 134 < len(plan.shots) <= 140


WIDE = load_profile("dji-x5s-15mm").camera
LOW_BAND = Constraints(
    overlap_h=0.2,
    overlap_v=0.2,
    band=Band(elevation_min_deg=-90, elevation_max_deg=20),
    tolerance=PAPER_TOLERANCE,
)


def seen(camera: Camera, rotations: FloatArray, directions: FloatArray) -> FloatArray:
    """Whether each image (n,) truly shows each direction (m,): by the lens, not by its frame; (n, m)."""
    local = np.swapaxes(rotations, -1, -2) @ directions.T
    ahead = local[:, 0] > 1e-9
    ideal = np.moveaxis(local[:, 1:] / np.where(ahead, local[:, 0], 1.0)[:, None], 1, -1)
    lens, sides = camera.distortion or Distortion(), camera.sides
    near = np.linalg.norm(ideal, axis=-1) < lens.radius_for(sides.corner)
    y, z = np.moveaxis(lens.apply(np.where(near[..., None], ideal, 0.0)), -1, 0)
    inside = (y >= -sides.left) & (y <= sides.right) & (z >= -sides.top) & (z <= sides.bottom)
    return np.asarray(ahead & near & inside)


@pytest.mark.parametrize(
    ("lens", "point"),
    [
        (Distortion(k1=-0.12, k2=0.03), (2640.0, 1978.0)),
        (Distortion(k1=0.06, p1=0.002, p2=-0.001), (2700.0, 1950.0)),
    ],
)
def test_a_distorting_lens_shows_what_the_certificate_promises(lens: Distortion, point: tuple[float, float]) -> None:
    camera = replace(WIDE, distortion=lens, principal_point_px=point, fov_margin=0.004)
    plan = plan_certified(camera, LOW_BAND)
    assert plan.certificate is not None
    assert plan.certificate.certified
    rotations = plan.rotations()
    directions = directions_in(LOW_BAND.band, 4000, np.random.default_rng(3))
    # the lens in the air has a focal length beside the calibrated one, within the margin
    for share in (0.9965, 1.0, 1.0035):
        in_air = replace(camera, calibrated_focal_length_mm=camera.focal_length_used_mm / share)
        assert seen(in_air, rotations, directions).any(axis=0).all()
    # and the overlap of neighbours is a share of the whole image, never less than stated
    row = plan.rows()[1][1]
    a, b = (replace(plan, shots=(shot,)).rotations()[0] for shot in row[:2])
    true = overlap_by_rays(camera, a, b)
    stated = float(pairwise_overlap(camera, a, b))
    assert true - 0.05 <= stated <= true + 2e-3
    assert true >= LOW_BAND.overlap_h


def overlap_by_rays(camera: Camera, a: FloatArray, b: FloatArray, points: int = 300) -> float:
    """The share of A's area in the ideal plane that B shows, by rays through each pixel of a raster."""
    sides, lens = camera.sides, camera.distortion or Distortion()
    y = ((np.arange(points) + 0.5) / points * (sides.left + sides.right) - sides.left)[:, None]
    z = ((np.arange(points) + 0.5) / points * (sides.top + sides.bottom) - sides.top)[None]
    ideal = lens.undo(np.stack(np.broadcast_arrays(y, z), axis=-1)).reshape(-1, 2)
    area = 1 / np.linalg.det(lens.jacobian(ideal))
    rays = np.concatenate([np.ones((len(ideal), 1)), ideal], axis=1)
    return float((area * seen(camera, b[None], rays @ a.T)[0]).sum() / area.sum())


@settings(max_examples=25)
@given(
    k1=st.floats(-0.1, 0.1),
    margin=st.floats(0, 0.05),
    yaw=st.floats(5, 40),
    pitch=st.floats(-60, 30),
    other=st.floats(-60, 30),
)
def test_no_stated_overlap_is_larger_than_the_true_one(
    k1: float, margin: float, yaw: float, pitch: float, other: float
) -> None:
    camera = replace(WIDE, distortion=Distortion(k1=k1), fov_margin=margin)
    a, b = rotation(0.0, pitch), rotation(yaw, other)
    true = overlap_by_rays(camera, a, b, points=150)
    assert float(pairwise_overlap(camera, a, b)) <= true + 4e-3
    union = float(union_overlap(camera, a[None], np.stack([b, rotation(-yaw, other)])[None])[0])
    assert float(pairwise_overlap(camera, a, b)) - 1e-12 <= union
