"""The certificate of a panorama as flown, and its patches, against real geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from panoexec.angles import FloatArray, rotation, wrap_180
from panoexec.mission.measured_certificate import (
    NO_ROW,
    ThreadedVerifier,
    certify_measured,
    measured_constraints,
    patch_shots,
    row_of,
)
from panoexec.optics import Camera
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Band, Constraints, Plan, Shot, Tolerance
from panoexec.planning.search.planner import plan_certified
from tests.unit.fakes.virtual import run_virtual

TOLERANCE = Tolerance(pitch_deg=0.2, roll_deg=0.2, yaw_deg=0.7)


def _plan(per_row: int = 10, pitches: tuple[float, ...] = (-30.0, 0.0)) -> Plan:
    shots = [
        Shot(index=0, row=row, pitch_deg=pitch, yaw_deg=-180.0 + 360.0 * i / per_row)
        for row, pitch in enumerate(pitches)
        for i in range(per_row)
    ]
    numbered = tuple(replace(shot, index=index) for index, shot in enumerate(shots))
    plan = Plan(
        method="certified",
        camera=Camera.from_fov(60.0, 45.0),
        constraints=Constraints(
            overlap_h=0.3,
            overlap_v=0.2,
            band=Band(elevation_min_deg=-42.0, elevation_max_deg=12.0),
            tolerance=TOLERANCE,
        ),
        shots=numbered,
    )
    return replace(plan, certificate=certify(plan))


def _flown(plan: Plan, seed: int, scale: float = 1.0) -> FloatArray:
    """Every shot off by errors within `scale` times the tolerances."""
    errors = np.random.default_rng(seed).uniform(-scale, scale, (len(plan.shots), 3))
    return np.array(
        [
            rotation(
                s.yaw_deg + e[0] * TOLERANCE.yaw_deg,
                s.pitch_deg + e[1] * TOLERANCE.pitch_deg,
                e[2] * TOLERANCE.roll_deg,
            )
            for s, e in zip(plan.shots, errors, strict=True)
        ]
    )


ROWS = [shot.row for shot in _plan().shots]


@pytest.mark.parametrize("seed", range(8))
def test_a_panorama_within_tolerance_of_a_certified_plan_is_certified(seed: int) -> None:
    plan = _plan()
    assert plan.certificate is not None
    assert plan.certificate.certified
    tight = replace(
        plan.constraints, overlap_h=plan.certificate.min_overlap_h or 0, overlap_v=plan.certificate.min_overlap_v or 0
    )
    plan = replace(plan, constraints=tight)
    plan = replace(plan, certificate=certify(plan))
    assert certify_measured(plan, _flown(plan, seed), ROWS).certified
    # without the plan's own worst case, thresholds that hold exactly at the planned poses would not hold as flown
    assert not certify_measured(replace(plan, certificate=None), _flown(plan, seed), ROWS).certified


def test_a_guarantee_for_all_errors_keeps_its_thresholds() -> None:
    plan = _plan()
    strict = replace(plan, constraints=replace(plan.constraints, guarantee="all"))
    assert measured_constraints(strict).overlap_h == plan.constraints.overlap_h
    assert measured_constraints(strict).tolerance.is_zero
    assert measured_constraints(plan).overlap_h <= plan.constraints.overlap_h


def test_a_missing_shot_is_a_hole_where_it_was_and_one_patch_closes_it() -> None:
    plan = _plan(per_row=8, pitches=(-30.0, 5.0))
    kept = np.delete(plan.rotations(), 3, axis=0)
    rows = [shot.row for shot in plan.shots if shot.index != 3]
    verdict = certify_measured(plan, kept, rows)
    assert not verdict.certified
    assert verdict.holes
    patches = patch_shots(plan, kept)
    assert len(patches) == 1
    assert patches[0].yaw_deg == pytest.approx(plan.shots[3].yaw_deg, abs=10)
    assert patches[0].row == plan.shots[3].row
    closed = np.concatenate([kept, [rotation(patches[0].yaw_deg, patches[0].pitch_deg)]])
    assert certify_measured(plan, closed, [*rows, patches[0].row]).uncovered_fraction == 0


def test_many_missing_shots_are_patched_or_it_is_not_tried() -> None:
    plan = _plan(per_row=8, pitches=(-30.0, 5.0))
    for missing in ([0, 1], [2, 10], [0, 4, 8, 12], list(range(6))):
        kept = np.delete(plan.rotations(), missing, axis=0)
        patches = patch_shots(plan, kept)
        assert patches
        taken = np.array([rotation(p.yaw_deg, p.pitch_deg) for p in patches])
        assert (
            certify_measured(plan, np.concatenate([kept, taken]), [0] * (len(kept) + len(taken))).uncovered_fraction
            == 0
        )
    assert patch_shots(plan, plan.rotations()[:1]) == [] or len(patch_shots(plan, plan.rotations()[:1])) <= 12


def test_holes_of_the_plan_itself_are_not_patched() -> None:
    plan = _plan(per_row=4)
    assert certify_measured(plan, plan.rotations(), [0] * 8).holes
    assert patch_shots(plan, plan.rotations()) == []


def test_an_image_without_a_row_counts_for_coverage_only() -> None:
    plan = _plan()
    odd = rotation(18.0, -15.0)[None]
    with_it = certify_measured(plan, np.concatenate([plan.rotations(), odd]), [*ROWS, NO_ROW])
    assert with_it.certified
    assert with_it.images == len(ROWS) + 1
    without = certify_measured(plan, plan.rotations(), ROWS)
    assert with_it.min_overlap_h == without.min_overlap_h
    assert row_of(plan, -15.0) == NO_ROW
    assert row_of(plan, -25.0) == 0


def test_it_works_in_a_thread() -> None:
    plan = _plan()

    async def main() -> None:
        verifier = ThreadedVerifier(plan=plan)
        assert (await verifier.certify(plan.rotations(), ROWS)).certified
        assert list(await verifier.patch(plan.rotations(), ROWS)) == []

    run_virtual(main())


@pytest.mark.parametrize("azimuth", [(-180.0, 180.0), (100.0, 220.0)])
def test_patches_point_where_the_plan_does(azimuth: tuple[float, float]) -> None:
    """Images that drifted inwards leave slivers at the band's border, where a gimbal need not be able to point."""
    low, high = azimuth
    band = Band(elevation_min_deg=-40.0, elevation_max_deg=20.0, azimuth_min_deg=low, azimuth_max_deg=high)
    constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=band, tolerance=TOLERANCE)
    plan = plan_certified(Camera.from_fov(60.0, 45.0), constraints)
    assert plan.certificate is not None
    assert plan.certificate.certified
    pitches = [shot.pitch_deg for shot in plan.shots]
    flown = plan.rotations().copy()
    for index, shot in enumerate(plan.shots):
        if shot.pitch_deg == max(pitches):
            flown[index] = rotation(shot.yaw_deg, shot.pitch_deg - 3.0)
        elif high - low < 360.0:
            inwards = 3.0 * np.sign(float(wrap_180((low + high) / 2 - shot.yaw_deg)))
            flown[index] = rotation(shot.yaw_deg + inwards, shot.pitch_deg)
    patches = patch_shots(plan, flown)
    assert patches
    offsets = [float(wrap_180(shot.yaw_deg - (low + high) / 2)) for shot in plan.shots]
    for patch in patches:
        assert min(pitches) <= patch.pitch_deg <= max(pitches)
        if high - low < 360.0:
            offset = float(wrap_180(patch.yaw_deg - (low + high) / 2))
            assert min(offsets) - 1e-9 <= offset <= max(offsets) + 1e-9
    closed = np.concatenate([flown, [rotation(patch.yaw_deg, patch.pitch_deg) for patch in patches]])
    assert certify_measured(plan, closed, [NO_ROW] * len(closed)).uncovered_fraction == 0
