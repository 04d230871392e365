"""The gimbal's mechanics: motion, end stops, measurements, hidden errors."""

from __future__ import annotations

import dataclasses
import itertools
import math
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import quaternion_from_rotation, rotation
from panoexec.sim.config import GimbalConfig
from panoexec.sim.physics.gimbal import Angles, GimbalPhysics, Rates, Target, angles_of, body_rates, quaternion

STEP_S = 0.005
CALM = dataclasses.replace(GimbalConfig(), heading_error_deg=0.0)
YAW, PITCH = CALM.yaw, CALM.pitch


def gimbal(
    config: GimbalConfig = CALM, *, seed: int = 1, wind_m_s: float = 0.0, nose_deg: float = 0.0
) -> GimbalPhysics:
    physics = GimbalPhysics(config, seed=seed, step_s=STEP_S)
    physics.wind_m_s = wind_m_s
    physics.start_at(nose_deg)
    return physics


def run(physics: GimbalPhysics, seconds: float, *, nose_deg: float = 0.0) -> list[Angles]:
    """Its estimate after every step."""
    series = []
    for _ in range(round(seconds / STEP_S)):
        physics.step(nose_deg)
        series.append(physics.estimate)
    return series


def slew_s(angle_deg: float, rate: float, acceleration: float) -> float:
    """Least time for a move from rest to rest."""
    if angle_deg <= rate**2 / acceleration:
        return 2 * math.sqrt(angle_deg / acceleration)
    return angle_deg / rate + rate / acceleration


def test_it_moves_as_fast_as_rate_and_acceleration_allow_overshoots_and_settles() -> None:
    for angle in (2.0, 15.0, 52.0, 175.0):
        physics = gimbal()
        physics.command(Target(yaw_deg=angle, yaw_lock=True))
        errors = [a.yaw_deg - angle for a in run(physics, 5.0)]
        arrives = max(i for i, error in enumerate(errors) if abs(error) > 0.05) * STEP_S
        least = slew_s(angle, YAW.rate_deg_s, YAW.acceleration_deg_s2)
        assert least < arrives < least + 0.1
        assert 0.05 < max(errors) < 0.3
        assert abs(errors[-1]) < 1e-3


@pytest.mark.parametrize("target", [Target(yaw_deg=170.0, yaw_lock=True), Target(pitch_deg=-90.0)])
def test_no_move_exceeds_the_rate_by_more_than_the_overshoot_or_the_acceleration_by_more_than_the_loop(
    target: Target,
) -> None:
    physics = gimbal()
    physics.command(target)
    before, rates, accelerations = 0.0, [], []
    for _ in range(600):
        physics.step(0.0)
        rate = max(abs(physics.rates.yaw_deg_s), abs(physics.rates.pitch_deg_s))
        rates.append(rate)
        accelerations.append(abs(rate - before) / STEP_S)
        before = rate
    axis = YAW if target.yaw_deg else PITCH
    assert axis.rate_deg_s * 0.99 < max(rates) < axis.rate_deg_s * 1.05
    assert axis.acceleration_deg_s2 * 0.99 < max(accelerations) < axis.acceleration_deg_s2 * 1.25


def test_commands_beyond_the_limits_are_clipped_and_the_stops_hold() -> None:
    config = dataclasses.replace(CALM, pitch=dataclasses.replace(PITCH, min_deg=-60.0, max_deg=20.0))
    physics = gimbal(config)
    physics.command(Target(pitch_deg=80.0))
    assert physics.target.pitch_deg == 20.0
    assert run(physics, 3.0)[-1].pitch_deg == pytest.approx(20.0, abs=1e-3)
    physics.command(Target(rates=Rates(0.0, 0.0, -90.0)))
    low = min(a.pitch_deg for a in run(physics, 5.0))
    assert -60.5 < low < -60.0


def test_it_turns_the_near_way_without_stops_and_the_far_way_with_them() -> None:
    endless = gimbal(nose_deg=170.0)
    endless.command(Target(yaw_deg=-170.0, yaw_lock=True))
    assert run(endless, 3.0, nose_deg=170.0)[-1].yaw_deg == pytest.approx(190.0, abs=1e-3)

    stops = dataclasses.replace(CALM, yaw_endless=False, yaw=dataclasses.replace(YAW, min_deg=-170.0, max_deg=170.0))
    physics = gimbal(stops)
    physics.command(Target(yaw_deg=160.0, yaw_lock=True))
    run(physics, 4.0)
    physics.command(Target(yaw_deg=-160.0, yaw_lock=True))
    series = [a.yaw_deg for a in run(physics, 6.0)]
    assert max(series) < 170.0
    assert series[-1] == pytest.approx(-160.0, abs=1e-3)
    physics.command(Target(yaw_deg=178.0, yaw_lock=True))
    assert run(physics, 6.0)[-1].yaw_deg == pytest.approx(-170.0, abs=1e-3)


def test_unlocked_it_follows_the_nose_and_locked_it_does_not() -> None:
    physics = gimbal()
    physics.command(Target(yaw_deg=30.0))
    run(physics, 2.0)
    assert run(physics, 3.0, nose_deg=50.0)[-1].yaw_deg == pytest.approx(80.0, abs=1e-3)
    physics.command(Target(yaw_deg=80.0, yaw_lock=True))
    assert run(physics, 3.0, nose_deg=-100.0)[-1].yaw_deg == pytest.approx(80.0, abs=1e-3)
    assert physics.nose_deg == pytest.approx(-100.0)


def test_it_rotates_at_commanded_rates() -> None:
    physics = gimbal()
    physics.command(Target(yaw_lock=True, rates=Rates(20.0, 0.0, -10.0)))
    start, end = run(physics, 1.0)[-1], run(physics, 2.0)[-1]
    assert end.yaw_deg - start.yaw_deg == pytest.approx(40.0, abs=0.05)
    assert end.pitch_deg - start.pitch_deg == pytest.approx(-20.0, abs=0.05)


def test_encoders_have_the_noise_of_their_data_sheet_and_it_is_white() -> None:
    physics = gimbal()
    samples = [physics.measure() for _ in range(5000)]
    for axis in ("yaw_deg", "roll_deg", "pitch_deg"):
        series = [getattr(sample, axis) for sample in samples]
        assert statistics.fmean(series) == pytest.approx(0.0, abs=0.001)
        assert statistics.pstdev(series) == pytest.approx(0.017, rel=0.05)
        assert abs(np.corrcoef(series[:-1], series[1:])[0, 1]) < 0.05


def test_the_compass_error_moves_the_truth_and_no_report_shows_it() -> None:
    physics = gimbal(GimbalConfig())
    physics.command(Target(yaw_deg=40.0, yaw_lock=True))
    run(physics, 5.0)
    errors = []
    for _ in range(600):
        run(physics, 0.5)
        assert physics.estimate.yaw_deg == pytest.approx(40.0, abs=1e-6)
        errors.append(physics.estimate.yaw_deg - physics.truth.yaw_deg)
    assert max(map(abs, errors)) <= 0.667
    assert max(errors) - min(errors) > 0.5
    assert 0.1 < statistics.pstdev(errors) < 0.4
    # slow: an exposure sees nothing of it
    assert max(abs(b - a) for a, b in itertools.pairwise(errors)) < 0.05
    assert physics.truth.pitch_deg == physics.estimate.pitch_deg


def test_wind_shakes_it_with_the_square_of_its_speed() -> None:
    def shake(wind_m_s: float) -> float:
        return statistics.pstdev(a.pitch_deg for a in run(gimbal(wind_m_s=wind_m_s), 30.0))

    assert shake(0.0) == 0.0
    assert 0.02 < shake(8.0) < 0.06
    assert shake(16.0) / shake(8.0) == pytest.approx(4.0, rel=1e-6)


def test_a_seed_gives_the_same_motion_and_another_seed_another() -> None:
    def series(seed: int) -> list[Angles]:
        physics = gimbal(GimbalConfig(), seed=seed, wind_m_s=8.0)
        physics.command(Target(pitch_deg=-30.0, yaw_deg=90.0, yaw_lock=True))
        return [*run(physics, 2.0), physics.measure(), physics.truth]

    assert series(7) == series(7)
    assert series(7) != series(8)


def test_asking_for_measurements_does_not_change_the_motion() -> None:
    quiet, asked = gimbal(GimbalConfig(), wind_m_s=8.0), gimbal(GimbalConfig(), wind_m_s=8.0)
    for _ in range(400):
        quiet.step(0.0)
        asked.step(0.0)
        asked.measure()
    assert quiet.estimate == asked.estimate


def test_a_slip_moves_the_camera_is_reported_and_passes() -> None:
    physics = gimbal()
    run(physics, 0.5)
    physics.slip(yaw_deg=2.0, pitch_deg=0.0, hold_s=0.5)
    run(physics, 0.05)
    assert physics.estimate.yaw_deg == pytest.approx(2.0)
    assert physics.truth.yaw_deg == pytest.approx(2.0)
    assert physics.measure().yaw_deg == pytest.approx(2.0, abs=0.1)
    assert run(physics, 1.0)[-1].yaw_deg == 0.0


def test_stuck_it_stays_and_slow_it_takes_longer() -> None:
    stuck = gimbal()
    stuck.stuck = True
    stuck.command(Target(pitch_deg=-40.0, yaw_deg=90.0, yaw_lock=True))
    assert run(stuck, 2.0)[-1] == Angles(0.0, 0.0, 0.0)
    assert run(stuck, 1.0, nose_deg=10.0)[-1].yaw_deg == pytest.approx(10.0)

    slow = gimbal()
    slow.slowness = 0.25
    slow.command(Target(pitch_deg=-40.0))
    needs = slew_s(40.0, PITCH.rate_deg_s / 4, PITCH.acceleration_deg_s2 / 4)
    assert run(slow, needs - 0.2)[-1].pitch_deg > -40.0 + 0.2
    assert run(slow, 0.6)[-1].pitch_deg == pytest.approx(-40.0, abs=0.05)


def test_the_truth_between_steps_goes_on_at_the_rate() -> None:
    physics = gimbal()
    physics.command(Target(pitch_deg=-80.0))
    run(physics, 0.8)
    now = physics.time_s
    moved = physics.truth_at(now + 0.004).pitch_deg - physics.truth_at(now).pitch_deg
    assert moved == pytest.approx(-60.0 * 0.004, rel=0.02)


ANGLE = st.floats(-179.0, 179.0)


@given(yaw=ANGLE, roll=st.floats(-80.0, 80.0), pitch=ANGLE)
def test_quaternions_are_those_of_the_rest_of_panoexec(yaw: float, roll: float, pitch: float) -> None:
    ours = np.array(quaternion(Angles(yaw, roll, pitch)))
    theirs = quaternion_from_rotation(rotation(yaw, pitch, roll))
    assert abs(ours @ theirs) == pytest.approx(1.0, abs=1e-12)
    back = angles_of((ours[0], ours[1], ours[2], ours[3]))
    assert rotation(*back[:1], back[2], back[1]) == pytest.approx(rotation(yaw, pitch, roll), abs=1e-9)


@given(yaw=ANGLE, roll=st.floats(-40.0, 40.0), pitch=st.floats(-90.0, 90.0), rates=st.tuples(*[st.floats(-90, 90)] * 3))
def test_body_rates_are_the_derivative_of_the_attitude(
    yaw: float, roll: float, pitch: float, rates: tuple[float, float, float]
) -> None:
    h = 1e-4
    before = rotation(yaw, pitch, roll)
    after = rotation(yaw + rates[0] * h, pitch + rates[2] * h, roll + rates[1] * h)
    skew = before.T @ (after - before) / h
    expected = (skew[2, 1] - skew[1, 2]) / 2, (skew[0, 2] - skew[2, 0]) / 2, (skew[1, 0] - skew[0, 1]) / 2
    assert body_rates(Angles(yaw, roll, pitch), Rates(*rates)) == pytest.approx(expected, abs=2e-3)
