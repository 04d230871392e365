"""The certified planner: the goal table, every kind of panorama, errors, and properties of any request."""

from __future__ import annotations

import itertools
import os
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from panoexec.angles import FloatArray, rotation
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.baselines.paper import plan_paper
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import (
    NO_TOLERANCE,
    AngleBox,
    Band,
    Constraints,
    GimbalLimits,
    Plan,
    Tolerance,
)
from panoexec.planning.search.planner import plan_certified
from panoexec.planning.search.row_steps import highest_pitch
from tests.support.plan_judge import violations
from tests.unit.planning.sampling import directions_in

PAPER = Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.667)

MOST_IMAGES = 60
WHOLE_BAND = (
    AngleBox(elevation_min_deg=-90, elevation_max_deg=90, azimuth_min_deg=-180, azimuth_max_deg=0),
    AngleBox(elevation_min_deg=-90, elevation_max_deg=30, azimuth_min_deg=-10, azimuth_max_deg=190),
)


def camera(width_mm: float, height_mm: float, focal_mm: float) -> Camera:
    return Camera(
        name=f"{focal_mm:g} mm",
        sensor_width_mm=width_mm,
        sensor_height_mm=height_mm,
        image_width_px=6000,
        image_height_px=round(6000 * height_mm / width_mm),
        focal_length_mm=focal_mm,
    )


WIDE, LONG, APSC = camera(17.3, 13.0, 15.0), camera(17.3, 13.0, 45.0), camera(23.5, 15.6, 35.0)
ISAAC = Camera.from_fov(54.0, 39.8)


def asked(
    low_deg: float,
    high_deg: float,
    *,
    overlap: float = 0.15,
    tolerance: Tolerance = PAPER,
    azimuth_deg: tuple[float, float] = (-180.0, 180.0),
) -> Constraints:
    band = Band(
        elevation_min_deg=low_deg,
        elevation_max_deg=high_deg,
        azimuth_min_deg=azimuth_deg[0],
        azimuth_max_deg=azimuth_deg[1],
    )
    return Constraints(overlap_h=overlap, overlap_v=overlap, band=band, tolerance=tolerance)


@cache
def certified(cam: Camera, constraints: Constraints) -> Plan:
    """A plan, made once, whose own certificate and a fresh one say certified."""
    plan = plan_certified(cam, constraints)
    assert plan.certificate is not None
    assert plan.certificate.certified, plan.certificate.failures
    fresh = certify(plan)
    assert fresh.certified, fresh.failures
    assert plan.lower_bound is not None
    assert plan.lower_bound <= len(plan.shots)
    assert [shot.index for shot in plan.shots] == list(range(len(plan.shots)))
    assert plan.estimate is not None
    return plan


def brute_force_misses(plan: Plan, directions: np.ndarray, trials: int, rng: np.random.Generator) -> int:
    """How many of the directions are missed, over trials of random errors inside and at the tolerance corners."""
    t = plan.constraints.tolerance
    tau = np.array([t.yaw_deg, t.pitch_deg, t.roll_deg])
    yaw = np.array([shot.yaw_deg for shot in plan.shots])
    pitch = np.array([shot.pitch_deg for shot in plan.shots])
    missed = 0
    for trial in range(trials):
        error = rng.uniform(-1.0, 1.0, (len(yaw), 3))
        if trial % 2:
            error = np.sign(error)
        error *= tau
        poses = rotation(yaw + error[:, 0], pitch + error[:, 1], error[:, 2])
        left = directions
        for pose in poses:
            ray = left @ pose
            seen = (ray[:, 0] > 0) & (np.abs(ray[:, 1]) <= ray[:, 0] * plan.camera.half_width + 1e-9)
            seen &= np.abs(ray[:, 2]) <= ray[:, 0] * plan.camera.half_height + 1e-9
            left = left[~seen]
        missed += len(left)
    return missed


@pytest.mark.parametrize(
    ("cam", "constraints", "goal"),
    [
        (WIDE, asked(-90, 50.5), 21),
        (LONG, asked(-90, 37.7), 134),
        (APSC, asked(-90, 12.2), 40),
        (ISAAC, asked(-90, 90, overlap=0.3, tolerance=NO_TOLERANCE), 43),
        (Camera.from_fov(56.2, 42.7), asked(-90, 90, overlap=0.3, tolerance=NO_TOLERANCE), 38),
    ],
    ids=["scenario 1", "scenario 2", "scenario 3", "whole sphere", "mapper and hugin"],
)
def test_goal_table_is_reached_certified_and_passes_brute_force(
    cam: Camera, constraints: Constraints, goal: int
) -> None:
    plan = certified(cam, constraints)
    assert len(plan.shots) <= goal
    rng = np.random.default_rng(1)
    assert brute_force_misses(plan, directions_in(constraints.band, 30_000, rng), 8, rng) == 0
    assert violations(plan) == []


def test_brute_force_check_detects_a_missing_image() -> None:
    plan = certified(WIDE, asked(-90, 50.5))
    holed = replace(plan, shots=plan.shots[1:])
    rng = np.random.default_rng(2)
    assert brute_force_misses(holed, directions_in(plan.constraints.band, 5_000, rng), 2, rng) > 0


@pytest.mark.parametrize(
    ("cam", "constraints"),
    [
        (WIDE.rotated(), asked(-90, 90)),
        (WIDE, asked(-30, 30)),
        (LONG, asked(-5, 5)),
        (LONG, asked(-50, 10, azimuth_deg=(-45, 45))),
        (LONG, asked(-5, 5, azimuth_deg=(-45, 45))),
        (LONG, asked(-30, 10, azimuth_deg=(-5, 5))),
        (LONG, asked(-5, 5, azimuth_deg=(-15, 15))),
        (WIDE, asked(-90, 10, azimuth_deg=(0, 90))),
        (WIDE, asked(-60, 20, azimuth_deg=(150, 250))),
        (Camera.from_fov(110, 110), asked(-90, 90, tolerance=NO_TOLERANCE)),
    ],
    ids=[
        "portrait sphere",
        "band",
        "one closed row",
        "sector",
        "one row",
        "one column",
        "two fields of view",
        "sector to the nadir",
        "sector around the back",
        "very wide",
    ],
)
def test_every_kind_of_panorama_is_certified(cam: Camera, constraints: Constraints) -> None:
    plan = certified(cam, constraints)
    rng = np.random.default_rng(3)
    assert brute_force_misses(plan, directions_in(constraints.band, 5_000, rng), 4, rng) == 0


def test_a_single_image_is_enough_where_it_sees_everything() -> None:
    assert len(certified(LONG, asked(-5, 5, azimuth_deg=(-5, 5))).shots) == 1


def test_guarantee_all_holds_for_all_errors() -> None:
    constraints = replace(asked(-90, 50.5), guarantee="all")
    plan = certified(WIDE, constraints)
    assert plan.certificate is not None
    assert (plan.certificate.worst_overlap_h or 0) >= 0.15 - 1e-9
    assert (plan.certificate.worst_overlap_v or 0) >= 0.15 - 1e-9


def test_gimbal_limits_are_kept() -> None:
    gimbal = GimbalLimits(pitch_max_deg=30, yaw_min_deg=-160, yaw_max_deg=160, yaw_endless=False)
    plan = certified(WIDE, replace(asked(-90, 50), gimbal=gimbal))
    assert max(shot.pitch_deg for shot in plan.shots) <= 30
    assert all(-160 <= shot.yaw_deg <= 160 for shot in plan.shots)


@pytest.mark.parametrize(
    ("cam", "constraints", "message"),
    [
        (WIDE, replace(asked(-90, 50), gimbal=GimbalLimits(pitch_max_deg=20)), r"highest pitch 20° .* up to 4\d\.\d+°"),
        (WIDE, replace(asked(-90, 50), gimbal=GimbalLimits(pitch_min_deg=-60)), r"lowest pitch -60° .* 6\.\d+° short"),
        (
            LONG,
            replace(asked(-90, 20), gimbal=GimbalLimits(yaw_min_deg=-160, yaw_max_deg=160, yaw_endless=False)),
            r"pans from -160 to 160°.*gap of 40°.*18\.5",
        ),
        (
            Camera.from_fov(8, 3),
            asked(-90, 50, tolerance=Tolerance(pitch_deg=2, roll_deg=2, yaw_deg=2)),
            r"pitch must stay below 1\.5°",
        ),
        (WIDE, asked(-90, 50, overlap=1.2), "overlap 1.2"),
        (WIDE, asked(20, 10), "reversed"),
        (WIDE, asked(-90, 90, overlap=0.98), r"in about 2500 images, 2400 above"),
        (WIDE, asked(-90, 90, overlap=0.9999), "needs more than 5000 images in one row"),
        (WIDE, replace(asked(-90, 30), masks=WHOLE_BAND), "masks leave nothing"),
    ],
    ids=["pitch high", "pitch low", "pan", "tolerance", "overlap", "band", "dense", "too many", "masks"],
)
def test_errors_name_the_constraint_and_the_amount(cam: Camera, constraints: Constraints, message: str) -> None:
    with pytest.raises(PlanningError, match=message):
        plan_certified(cam, constraints)


def test_masks_never_add_images_and_exempt_only_masked_directions() -> None:
    free = certified(WIDE, asked(-90, 50.5))
    cap = AngleBox(elevation_min_deg=20, elevation_max_deg=90, azimuth_min_deg=-180, azimuth_max_deg=180)
    plan = certified(WIDE, replace(asked(-90, 50.5), masks=(cap,)))
    assert len(plan.shots) < len(free.shots)
    rng = np.random.default_rng(4)
    needed = replace(plan.constraints.band, elevation_max_deg=20)
    assert brute_force_misses(plan, directions_in(needed, 5_000, rng), 4, rng) == 0


def test_requested_order_is_kept() -> None:
    pitches = [shot.pitch_deg for shot in plan_certified(WIDE, asked(-90, 50.5), order="nadir-first").shots]
    assert pitches == sorted(pitches)


def requests() -> st.SearchStrategy[tuple[Camera, Constraints]]:
    def build(
        hfov: float, vfov: float, overlaps: tuple[float, float], ends: tuple[float, float], taus: tuple[float, ...]
    ) -> tuple[Camera, Constraints]:
        low, high = min(ends), max(ends)
        band = Band(elevation_min_deg=low, elevation_max_deg=max(high, min(low + 1, 90)))
        if band.elevation_max_deg - band.elevation_min_deg < 1:
            band = replace(band, elevation_min_deg=band.elevation_max_deg - 1)
        pitch, roll, yaw = taus
        tolerance = Tolerance(pitch_deg=pitch, roll_deg=roll, yaw_deg=yaw)
        h, v = overlaps
        return Camera.from_fov(hfov, vfov), Constraints(overlap_h=h, overlap_v=v, band=band, tolerance=tolerance)

    ends = st.one_of(st.sampled_from([-90.0, 90.0]), st.floats(-90, 90))
    return st.builds(
        build,
        st.floats(8, 110),
        st.floats(8, 110),
        st.tuples(st.floats(0, 0.6), st.floats(0, 0.6)),
        st.tuples(ends, ends),
        st.tuples(*itertools.repeat(st.one_of(st.just(0.0), st.floats(0, 2)), 3)),
    )


def expected_images(cam: Camera, constraints: Constraints) -> float:
    """Solid angle over what an image adds: how long a search will about take."""
    band = constraints.band
    zone = 2 * np.pi * float(np.diff(np.sin(np.radians([band.elevation_min_deg, band.elevation_max_deg])))[0])
    return zone / (cam.solid_angle_sr * (1 - constraints.overlap_h) * (1 - constraints.overlap_v))


@settings(
    max_examples=int(os.environ.get("PANOEXEC_PLANNER_REQUESTS", "6")),
    deadline=None,
    derandomize="PANOEXEC_PLANNER_REQUESTS" not in os.environ,  # which ones are drawn must not change from run to run
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
@given(requests().filter(lambda request_: expected_images(*request_) < MOST_IMAGES))
def test_any_request_gives_a_certified_plan_or_an_error_and_never_more_images_than_the_paper(
    request_: tuple[Camera, Constraints],
) -> None:
    cam, constraints = request_
    refusals: list[str] = []
    try:
        plan = plan_certified(cam, constraints)
    except PlanningError as error:
        refusals.append(str(error))
    if refusals:
        assert len(refusals[0]) > 20
        assert "\n" not in refusals[0]
        return
    assert plan.certificate is not None
    assert plan.certificate.certified, plan.certificate.failures
    try:
        paper = plan_paper(cam, constraints)
    except PlanningError:
        return
    # the paper's plan counts where it gives the same guarantees
    if certify(paper).certified:
        assert len(plan.shots) <= len(paper.shots)


@pytest.mark.parametrize(
    ("cam", "constraints", "most"),
    [
        (
            Camera.from_fov(106.3, 23.4),
            Constraints(
                overlap_h=0.2893,
                overlap_v=0.54,
                band=Band(elevation_min_deg=-90, elevation_max_deg=69.4),
                tolerance=Tolerance(pitch_deg=1.32, roll_deg=0, yaw_deg=1.54),
            ),
            87,
        ),
        (
            Camera.from_fov(16.8, 49.7),
            Constraints(
                overlap_h=0.07,
                overlap_v=0.0,
                band=Band(elevation_min_deg=-13.8, elevation_max_deg=37.4),
                tolerance=Tolerance(pitch_deg=1.46337, roll_deg=0.559819, yaw_deg=1.61804),
            ),
            58,
        ),
        (
            Camera.from_fov(77.4, 30.0),
            Constraints(
                overlap_h=0.449,
                overlap_v=0.409,
                band=Band(elevation_min_deg=-90, elevation_max_deg=-20, azimuth_min_deg=178.2, azimuth_max_deg=455.4),
                guarantee="all",
            ),
            60,
        ),
    ],
    ids=["wide images turned about a pole", "tall images", "a sector about a pole"],
)
def test_images_far_from_square_with_large_tolerances_are_certified(
    cam: Camera, constraints: Constraints, most: int
) -> None:
    assert len(certified(cam, constraints).shots) <= most


def test_narrow_gap_where_the_seams_of_two_rows_coincide_is_detected() -> None:
    """Rows of 8 and 11 images, whose seams come within 0.5 degrees of each other at one azimuth only."""
    plan = certified(Camera.from_fov(30.9, 20.64), asked(-90, 90))
    assert len(plan.shots) <= 97


def test_single_row_is_centred_in_its_band() -> None:
    for low, high, azimuth in ((-5.0, 5.0, (-180.0, 180.0)), (0.0, 10.0, (-45.0, 45.0))):
        plan = certified(WIDE, asked(low, high, azimuth_deg=azimuth))
        # there are about 18 degrees of slack to either side
        assert all(abs(shot.pitch_deg - (low + high) / 2) <= 0.5 for shot in plan.shots)


def test_a_very_long_lens_needs_one_certificate_and_work_for_its_rows_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is asked about pairs of rows grows with the rows, about the square root of the images: not with images."""
    pairs: list[int] = []
    honest = highest_pitch

    def counted(*args: Any, **kwargs: Any) -> FloatArray:
        pairs.append(len(args[1]))
        return honest(*args, **kwargs)

    monkeypatch.setattr("panoexec.planning.search.row_search.highest_pitch", counted)
    asked_for, images = [], []
    for fov in (1.0, 0.5):
        pairs.clear()
        plan = certified(Camera.from_fov(20.6 * fov, 13.76 * fov), asked(-90, 90, tolerance=NO_TOLERANCE))
        images.append(len(plan.shots))
        asked_for.append(sum(pairs))
    assert images[1] > 3.5 * images[0]
    assert asked_for[1] < 3 * asked_for[0]
