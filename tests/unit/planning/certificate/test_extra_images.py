"""Photos that nobody needed, and rows that are not quite rows, do not change the verdict on a plan."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import lru_cache

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from panoexec.inputs.plan_file import plan_from_data, row_gap_deg
from panoexec.optics import Camera
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance
from panoexec.planning.search.planner import plan_certified

CAMERA = Camera.from_fov(90.0, 70.0)
few_examples = settings(max_examples=8, derandomize=True, deadline=None)

SPHERE = Band(elevation_min_deg=-90.0, elevation_max_deg=40.0)
SECTOR = Band(elevation_min_deg=-50.0, elevation_max_deg=30.0, azimuth_min_deg=-70.0, azimuth_max_deg=80.0)


def asked(band: Band, overlap: float, tolerance_deg: float = 0.2) -> Constraints:
    tolerance = Tolerance(pitch_deg=tolerance_deg, roll_deg=tolerance_deg, yaw_deg=tolerance_deg)
    return Constraints(overlap_h=overlap, overlap_v=overlap, band=band, tolerance=tolerance)


@lru_cache
def certified_plan(band: Band) -> Plan:
    """A plan with some slack: for more overlap and larger errors than it is judged by."""
    plan = plan_certified(CAMERA, asked(band, 0.3, 2.0))
    assert plan.certificate is not None
    assert plan.certificate.certified
    return replace(plan, constraints=asked(band, 0.2), certificate=None)


def as_foreign(plan: Plan, poses: list[tuple[float, float]]) -> Plan:
    """The poses alone, as a file of another program has them."""
    data = {"shots": [{"pitch_deg": pitch, "yaw_deg": yaw} for pitch, yaw in poses]}
    return plan_from_data(data, source="foreign").plan(camera=plan.camera, constraints=plan.constraints)


def poses_of(plan: Plan) -> list[tuple[float, float]]:
    return [(shot.pitch_deg, shot.yaw_deg) for shot in plan.shots]


def jittered(plan: Plan, seed: int, by_deg: float) -> list[tuple[float, float]]:
    rng = random.Random(seed)
    return [
        (max(-90.0, min(90.0, pitch + rng.uniform(-by_deg, by_deg))), yaw + rng.uniform(-by_deg, by_deg))
        for pitch, yaw in poses_of(plan)
    ]


@pytest.mark.parametrize("band", [SPHERE, SECTOR], ids=["sphere", "sector"])
@few_examples
@given(st.floats(-90, 90), st.floats(-180, 180), st.integers(0, 3))
@example(0.0, 0.0, 0)
@example(90.0, 0.0, 0)
@example(-20.0, 179.0, 0)
def test_an_image_more_never_makes_a_plan_fail(band: Band, pitch_deg: float, yaw_deg: float, row: int) -> None:
    plan = certified_plan(band)
    assert certify(as_foreign(plan, [*poses_of(plan), (pitch_deg, yaw_deg)])).certified
    # whatever row its file says
    extra = Shot(index=len(plan.shots), row=row, pitch_deg=pitch_deg, yaw_deg=yaw_deg)
    certificate = certify(replace(plan, shots=(*plan.shots, extra)))
    assert certificate.certified
    assert certificate.images == len(plan.shots) + 1


@pytest.mark.parametrize("band", [SPHERE, SECTOR], ids=["sphere", "sector"])
@few_examples
@given(st.integers(0, 10_000), st.floats(0, 1.2))
def test_rows_are_found_though_pitches_differ(band: Band, seed: int, by_deg: float) -> None:
    plan = certified_plan(band)
    poses = jittered(plan, seed, by_deg)
    shots = tuple(
        replace(shot, pitch_deg=pitch, yaw_deg=yaw) for shot, (pitch, yaw) in zip(plan.shots, poses, strict=True)
    )
    given_rows, found_rows = certify(replace(plan, shots=shots)), certify(as_foreign(plan, poses))
    assert found_rows.certified == given_rows.certified
    assert found_rows.min_overlap_h == pytest.approx(given_rows.min_overlap_h)
    assert found_rows.min_overlap_v == pytest.approx(given_rows.min_overlap_v)


def test_several_images_more() -> None:
    plan = certified_plan(SPHERE)
    more = [(5.0, 10.0), (-42.0, 100.0), (88.0, -60.0)]
    certificate = certify(as_foreign(plan, [*jittered(plan, 1, 0.8), *more]))
    assert certificate.certified
    assert certificate.images == len(plan.shots) + 3


def test_a_plan_without_a_certified_part_fails_as_before() -> None:
    plan = certified_plan(SPHERE)
    # an image missing: a hole
    for missing in range(len(plan.shots)):
        rest = [pose for i, pose in enumerate(poses_of(plan)) if i != missing]
        assert not certify(as_foreign(plan, [*rest, (0.0, 0.0)])).certified
    # more overlap asked for than any part has
    greedy = replace(plan, constraints=replace(plan.constraints, overlap_h=0.6, overlap_v=0.6))
    failures = certify(as_foreign(greedy, poses_of(plan))).failures
    assert any(line.startswith("C2") for line in failures)
    assert any(line.startswith("C3") for line in failures)


@pytest.mark.parametrize(
    ("pitches", "rows"),
    [
        ([-90, -45, -45, 0, 0], 3),
        ([-90, -45.8, -44.1, -45.0, -0.9, 0.4, 1.0], 3),
        ([-2.0, -1.0, 0.0, 1.0, 2.0], 5),
        ([-60, -50, -40, -30], 4),
        ([-60, -57.6, -57.6, -55.2, -55.2], 3),
        ([0.0], 1),
        ([0.0, 0.0], 1),
        ([-89.2, -54.3, -53.1, -20.5, -19.9, -0.4, 14.1, 15.2, 16.0], 5),
    ],
)
def test_rows_by_pitch(pitches: list[float], rows: int) -> None:
    shots = [{"pitch_deg": pitch, "yaw_deg": 40.0 * i} for i, pitch in enumerate(pitches)]
    assert len({shot.row for shot in plan_from_data({"shots": shots}, source="x").shots}) == rows


def test_the_step_of_a_row_is_clearly_larger_than_those_within() -> None:
    assert row_gap_deg([0.0, 0.4, 1.0, 31.0, 31.2]) == pytest.approx(0.6)
    assert row_gap_deg([0.0, 2.0, 4.5, 7.0]) == pytest.approx(0.001)
