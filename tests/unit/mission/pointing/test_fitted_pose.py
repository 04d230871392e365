"""A curve through the readings of an exposure: noise is no error, motion is one."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from panoexec.mission.pointing.fitted_pose import BESIDE_S, fitted
from panoexec.mission.pointing.poses import Reading
from panoexec.planning.geometry.pose_error import pose_error
from panoexec.sim.config import GimbalConfig
from panoexec.sim.physics.gimbal import GimbalPhysics
from tests.unit.mission.pointing.readings import TARGET, TOLERANCE, reading_at

START_S, END_S = 0.08, 0.13
TIMES = [round(0.02 * i + 0.01, 3) for i in range(10)]
NOISE = (0.014, -0.02, 0.009, 0.034, -0.012, 0.002, -0.024, 0.011, 0.018, -0.016)


def proven(readings: list[Reading], start_s: float = START_S, end_s: float = END_S) -> bool:
    rotations = np.stack([reading.rotation for reading in readings if reading.rotation is not None])
    errors = pose_error(TARGET.pitch_deg, TARGET.yaw_deg, rotations)
    return fitted(readings, errors, TOLERANCE, start_s=start_s, end_s=end_s) is not None


def pitching(error_deg: Callable[[float], float]) -> list[Reading]:
    # equal rotations would be repeats of one reading
    return [reading_at(t, pitch=error_deg(t) + 1e-5 * (-1) ** k) for k, t in enumerate(TIMES)]


def test_a_reading_that_noise_takes_out_of_tolerance_is_not_the_pose() -> None:
    readings = [reading_at(t, roll=0.0598 + 1.2 * noise) for t, noise in zip(TIMES, NOISE, strict=True)]
    assert max(0.0598 + 1.2 * noise for noise in NOISE) > TOLERANCE.roll_deg
    assert proven(readings)
    nearer = [reading_at(t, roll=0.09 + noise) for t, noise in zip(TIMES, NOISE, strict=True)]
    assert not proven(nearer), "what is beside the curve may be a motion"


@pytest.mark.parametrize(("error_deg", "ok"), [(0.099, True), (-0.099, True), (0.101, False), (-0.101, False)])
def test_readings_without_noise_prove_what_they_say(error_deg: float, ok: bool) -> None:
    assert proven(pitching(lambda _: error_deg)) is ok


def test_the_whole_exposure_must_be_inside() -> None:
    assert proven(pitching(lambda t: 1.2 * (t - 0.05)))  # 0.096° at its end, more afterwards
    assert not proven(pitching(lambda t: 1.2 * (t - 0.04)))


def test_what_shakes_more_than_encoders_do_is_a_motion() -> None:
    assert not proven(pitching(lambda t: 0.05 * math.sin(math.tau * 15.0 * t)))
    assert not proven(pitching(lambda t: 0.12 if abs(t - 0.11) < 0.001 else 0.0)), "one reading far away"


def test_a_vibration_that_may_be_noise_is_taken_for_the_motion_that_it_may_be() -> None:
    """0.08° aside and 0.035° at 12 Hz is outside in every period, though its mean is not."""
    for phase in range(16):
        assert not proven(pitching(partial(_shaken, phase / 16)))


def _shaken(phase: float, time_s: float) -> float:
    return 0.08 + 0.035 * math.sin(math.tau * (12.0 * time_s + phase))


def test_what_is_forwarded_twice_counts_once() -> None:
    readings = pitching(lambda _: 0.01)
    assert proven(readings)
    again = [reading_at(t, pitch=0.01 + 1e-5 * (-1) ** (k // 2)) for k, t in enumerate(TIMES)]
    assert not proven(again), "five readings, each told twice"
    at_once = [reading_at(TIMES[k // 2], pitch=0.01 + 1e-5 * k) for k in range(len(TIMES))]
    assert not proven(at_once)


def test_no_number_proves_nothing() -> None:
    readings = pitching(lambda _: 0.01)
    rotations = np.stack([r.rotation for r in readings if r.rotation is not None])
    errors = pose_error(TARGET.pitch_deg, TARGET.yaw_deg, rotations)
    unknown = replace(errors, roll_deg=np.full(len(readings), np.nan))
    assert fitted(readings, unknown, TOLERANCE, start_s=START_S, end_s=END_S) is None


def test_few_readings_or_none_beside_the_exposure_prove_nothing() -> None:
    readings = pitching(lambda _: 0.01)
    assert proven(readings)
    assert not proven(readings[:6])
    assert not proven(readings, end_s=0.2)
    assert not proven(readings, start_s=0.0)


def test_in_gusts_it_proves_true_poses_that_single_readings_do_not_and_no_others() -> None:
    physics = GimbalPhysics(GimbalConfig(), seed=5, step_s=0.004)
    physics.wind_m_s = 8.0
    noise = random.Random(2)
    true, told = [], []
    for step in range(50_000):
        physics.step(0.0)
        true.append(physics.truth.pitch_deg)
        if step % 5 == 0:
            told.append(reading_at(0.004 * step, pitch=true[-1] + noise.gauss(0.0, 0.017)))
    readings_near = round((END_S - START_S) / 0.02)
    seen = {"proven": 0, "by single readings": 0, "true": 0}
    for first in range(10, len(told) - 20, 7):
        start_s, end_s = 0.02 * first + 0.005, 0.02 * (first + readings_near) + 0.005
        worst = max(abs(error) for error in true[5 * first + 2 : 5 * (first + readings_near) + 2])
        if worst < 0.06:
            continue
        beside = [r for r in told[first - 6 : first + 10] if start_s - BESIDE_S <= r.time_s <= end_s + BESIDE_S]
        within = [r for r in beside if start_s - 0.02 <= r.time_s <= end_s + 0.02]
        errors = pose_error(
            TARGET.pitch_deg, TARGET.yaw_deg, np.stack([r.rotation for r in within if r.rotation is not None])
        )
        ok = proven(beside, start_s, end_s)
        seen["true"] += worst <= 0.1
        single = bool(np.all(errors.within(TOLERANCE)))
        seen["proven"] += ok or single
        seen["by single readings"] += single
        assert not (ok and worst > 0.103), f"{worst:.3f}° proven"
    assert seen["by single readings"] < seen["proven"] < seen["true"], seen
