"""The estimate counts what a mission does: brackets, intervals, turns, files, examination, and the band's own size."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.inputs.camera_profiles import load_profile
from panoexec.inputs.config import Config
from panoexec.inputs.plan_options import configured_timing
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.planning.baselines.published import X5S_15MM, published_plan
from panoexec.planning.cautions import cautions
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Band, Constraints, GimbalLimits, Shot, Timing, Tolerance, Turning
from panoexec.planning.order.duration import estimate, slew_time_s

LIMITS = GimbalLimits()
timings = st.builds(
    Timing,
    settle_s=st.floats(0, 2),
    exposure_s=st.floats(0.001, 1),
    trigger_latency_s=st.floats(0, 0.5),
    interval_s=st.floats(0, 4),
    brackets=st.integers(1, 5),
    transfer_s=st.floats(0, 5),
    check_s=st.floats(0, 2),
)
poses = st.lists(st.tuples(st.floats(-90, 30), st.floats(-180, 179)), min_size=1, max_size=8)


def flown_s(shots: tuple[Shot, ...], timing: Timing) -> tuple[float, float]:
    """Seconds of shooting and in all, as an event after the other: what the mission does, written down again."""
    now, ready, here, checked = 0.0, 0.0, 0.0, 0.0
    last: Shot | None = None
    for shot in shots:
        if last is not None:
            now += slew_time_s(
                LIMITS,
                from_pitch_deg=last.pitch_deg,
                from_yaw_deg=last.yaw_deg,
                to_pitch_deg=shot.pitch_deg,
                to_yaw_deg=shot.yaw_deg,
            )
        now += timing.settle_s
        for photo in range(timing.brackets):
            if photo or last is not None:
                now = max(now, ready)
            ready = now + timing.interval_s
            now += timing.trigger_latency_s + timing.exposure_s
        for _ in range(timing.brackets):
            here = max(here, now) + timing.transfer_s
        checked = max(checked, here) + timing.brackets * timing.check_s
        last = shot
    return now, max(now, here, checked)


@given(timing=timings, angles=poses)
def test_the_estimate_is_what_a_mission_without_retakes_takes(
    timing: Timing, angles: list[tuple[float, float]]
) -> None:
    shots = tuple(Shot(index=i, row=0, pitch_deg=p, yaw_deg=y) for i, (p, y) in enumerate(angles))
    made = estimate(shots, X5S_15MM, LIMITS, timing)
    shooting_s, over_s = flown_s(shots, timing)
    assert made.duration_s == pytest.approx(over_s, abs=2e-3)
    assert made.after_s == pytest.approx(over_s - shooting_s, abs=2e-3)


def test_turns_of_the_vehicle_count() -> None:
    shots = tuple(Shot(index=i, row=0, pitch_deg=0.0, yaw_deg=90.0 * i - 180) for i in range(4))
    limits = GimbalLimits(yaw_min_deg=0.0, yaw_max_deg=0.0, yaw_endless=False, turning=Turning())
    free, turned = (estimate(shots, X5S_15MM, one, Timing()).duration_s for one in (LIMITS, limits))
    # 90° at 45°/s and 90°/s² are 2.5 s, and 1 s until the heading is steady; by the gimbal 1.25 s
    assert turned - free == pytest.approx(3 * (3.5 - 1.25), abs=1e-6)


def test_a_sector_has_a_panorama_of_its_own_size() -> None:
    shots = (Shot(index=0, row=0, pitch_deg=0.0, yaw_deg=0.0),)
    band = Band(elevation_min_deg=-40, elevation_max_deg=20, azimuth_min_deg=170, azimuth_max_deg=-100)
    made = estimate(shots, X5S_15MM, LIMITS, Timing(), band)
    assert made.panorama_px == X5S_15MM.panorama_px()
    assert made.band_px == (round(made.panorama_px[0] / 4), round(made.panorama_px[0] / 6))


def test_the_configuration_says_what_counts() -> None:
    profile = load_profile("dji-x5s-15mm")

    def timing(**camera: object) -> Timing:
        return configured_timing(Config.model_validate({"camera": camera}), profile)

    assert (timing().brackets, timing().transfer_s, timing().check_s) == (1, 0.0, 0.0)
    counted = timing(bracket=3, transfer_s=1.5)
    assert (counted.brackets, counted.transfer_s) == (3, 1.5)
    assert 0.1 < counted.check_s < 0.3
    assert timing(trigger="gphoto2", port="usb:").check_s == counted.check_s
    unchecked = Config.model_validate({"camera": {"transfer_s": 1.5}, "pictures": {"check": "off"}})
    assert configured_timing(unchecked, profile).check_s == 0.0


def test_a_worst_overlap_below_5_percent_is_told() -> None:
    constraints = Constraints(
        overlap_h=0.06,
        overlap_v=0.06,
        band=Band(elevation_min_deg=-60, elevation_max_deg=20),
        tolerance=Tolerance(pitch_deg=0.5, roll_deg=0.5, yaw_deg=1.5),
    )
    plan = replace(published_plan("scenario-1-proposed"), constraints=constraints)
    spec = PlanSpec(camera=plan.camera, constraints=constraints, given=replace(plan, certificate=None))
    assert cautions(certify(plan)) == ()
    assert spec.plan().notes == plan.notes
    loose = replace(constraints, tolerance=Tolerance(pitch_deg=4.0, roll_deg=4.0, yaw_deg=6.0))
    notes = replace(spec, given=replace(plan, constraints=loose)).plan().notes
    assert any("too little to tie them for certain" in text for text in notes)
