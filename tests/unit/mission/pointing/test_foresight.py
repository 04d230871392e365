"""Foresight of pose errors: gusts are seen in the rates of a gimbal, and in the speed of its readings without them."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from panoexec.mission.pointing.foresight import CALM_PATIENCE_S, REST_PATIENCE_S, Foresight
from panoexec.mission.pointing.rate_bias import RateBias
from panoexec.mission.pointing.tolerance_gate import SettleTracker
from panoexec.planning.model import Tolerance
from panoexec.sim.config import GimbalConfig
from panoexec.sim.physics.gimbal import GimbalPhysics
from tests.unit.mission.pointing.readings import LIMITS, TARGET, reading_at

TOLERANCE = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.5)
AHEAD_S = 0.06
UNKNOWN = (math.nan, math.nan, math.nan)
INTERVAL_S = 0.02


def seen(*readings: tuple[float, float], axis: int = 0) -> Foresight:
    """The errors and rates of one axis, 50 times a second; the others are at rest."""
    foresight = Foresight(TOLERANCE, 0.1)
    for number, (error, rate) in enumerate(readings):
        errors, rates = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        errors[axis], rates[axis] = error, rate
        foresight.add(number * INTERVAL_S, (errors[0], errors[1], errors[2]), (rates[0], rates[1], rates[2]))
    return foresight


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    ("error", "rate", "gusty"),
    [
        pytest.param(0.1, 0.0, False, id="in the middle"),
        pytest.param(0.5, 2.0, True, id="on its way out"),
        pytest.param(0.5, -2.0, False, id="on its way back"),
        pytest.param(0.1, -9.0, True, id="so fast that it will be beyond the other side"),
        pytest.param(0.7, 0.0, False, id="beside its target, but at rest"),
        pytest.param(0.9, 0.0, True, id="at rest near the edge"),
    ],
)
def test_rates_tell_where_a_pose_will_be(axis: int, error: float, rate: float, gusty: bool) -> None:
    """Errors and rates in tolerances (a second)."""
    limit = (0.1, 0.1, 0.5)[axis]
    assert seen(*[(error * limit, rate * limit)] * 6, axis=axis).is_gusty(AHEAD_S) is gusty


def test_a_gust_shows_in_one_rate_before_it_shows_in_the_errors() -> None:
    calm = [(0.02, 0.0)] * 5
    assert not seen(*calm, (0.02, 0.0)).is_gusty(AHEAD_S)
    assert seen(*calm, (0.02, 0.8)).is_gusty(AHEAD_S)
    unseen = Foresight(TOLERANCE, 0.1)
    for number in range(6):
        unseen.add(number * INTERVAL_S, (0.02, 0.0, 0.0), UNKNOWN)
    assert not unseen.is_gusty(AHEAD_S)


def test_without_rates_the_speed_of_the_readings_tells() -> None:
    foresight = Foresight(TOLERANCE, 0.1)
    for number in range(6):
        foresight.add(number * INTERVAL_S, (0.005 * number, 0.0, 0.0), UNKNOWN)
    assert not foresight.is_gusty(AHEAD_S)
    for number in range(6, 16):
        foresight.add(number * INTERVAL_S, (0.005 * number, 0.0, 0.0), UNKNOWN)
    assert foresight.is_gusty(AHEAD_S), "0.075° and 0.25°/s"
    assert foresight.leaving(AHEAD_S) == ""
    assert foresight.leaving(0.2) == "pitch will be off by +0.125° in 0.20 s (at most 0.1°)"


def test_gyroscopes_that_never_get_calm_hold_no_trigger_for_long() -> None:
    """Rates of an airframe's vibration say nothing of where the camera will be."""
    foresight, refused = Foresight(TOLERANCE, 0.1), 0
    for number in range(50):
        foresight.add(number * INTERVAL_S, (0.01, 0.0, 0.0), (6.0 * (-1) ** number, 0.0, 0.0))
        refused += foresight.is_gusty(AHEAD_S)
    assert refused == pytest.approx(CALM_PATIENCE_S / INTERVAL_S, abs=2)


@pytest.mark.parametrize("told", [True, False], ids=["rates", "no rates"])
def test_a_pose_that_rests_near_the_edge_is_shot_after_a_while(told: bool) -> None:
    """It comes no nearer: it would be waited for until its timeout, at every attempt."""
    foresight, refused = Foresight(TOLERANCE, 0.1), 0
    for number in range(100):
        rates = (0.0, 0.0, 0.0) if told else UNKNOWN
        foresight.add(number * INTERVAL_S, (0.09, 0.0, 0.0), rates)
        refused += foresight.is_gusty(AHEAD_S)
    assert refused == pytest.approx(REST_PATIENCE_S / INTERVAL_S, abs=2)
    for number in range(100, 110):
        foresight.add(number * INTERVAL_S, (0.101, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert foresight.is_gusty(AHEAD_S)


@pytest.mark.parametrize("bias_deg_s", [0.0, 0.15, -0.5, 2.0])
def test_a_bias_of_the_gyroscopes_costs_no_time_once_it_is_known(bias_deg_s: float) -> None:
    """Poses of half a second beside each other, in which the gimbal rests within encoder noise."""
    bias, rng, waited = RateBias(), random.Random(4), []
    limits = replace(LIMITS, gust_s=AHEAD_S, max_rate_deg_s=5.0)
    for pose in range(20):
        tracker = SettleTracker(target=TARGET, limits=limits, bias=bias)
        waited.append(0)
        for number in range(40):
            now_s = 3.0 * pose + number * INTERVAL_S
            off_deg = 5.0 if number < 5 else 0.03 + rng.gauss(0.0, 0.01)
            rates = (bias_deg_s + rng.gauss(0.0, 0.03), rng.gauss(0.0, 0.03), rng.gauss(0.0, 0.03))
            tracker.add(replace(reading_at(now_s, pitch=off_deg), axis_rates_deg_s=rates))
            if tracker.is_settled(now_s):
                if tracker.is_calm(now_s):
                    break
                waited[-1] += 1
    assert sum(waited[6:]) <= 3
    assert abs(bias.rates_deg_s[0] - bias_deg_s) < 0.05


def test_a_motion_is_no_bias() -> None:
    """Rates that the angles show as well are a motion, however long it lasts."""
    bias = RateBias()
    for number in range(100):
        bias.note(number * INTERVAL_S, (0.5 * number * INTERVAL_S, 0.0, 0.0), (0.5, 0.0, math.nan))
    assert bias.rates_deg_s == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_in_gusts_fewer_exposures_are_out_than_by_speed() -> None:
    """A trigger twice a second in 8 m/s, at the first moment foreseen calm; judged while the shutter is open."""
    outside = {"rates": 0, "speed": 0}
    waited = dict.fromkeys(outside, 0)
    physics = GimbalPhysics(GimbalConfig(), seed=3, step_s=0.004)
    physics.wind_m_s = 8.0
    told: list[tuple[tuple[float, float, float], tuple[float, float, float]]] = []
    true: list[float] = []
    for step in range(45_000):
        physics.step(0.0)
        true.append(max(abs(physics.truth.pitch_deg), abs(physics.truth.roll_deg)))
        if step % 5 == 0:
            angles, rates = physics.measure(), physics.measure_rates()
            told.append(
                ((angles.pitch_deg, angles.roll_deg, 0.0), (rates.pitch_deg_s, rates.roll_deg_s, rates.yaw_deg_s))
            )
    for kind in outside:
        for start in range(10, len(told) - 60, 25):
            foresight = Foresight(TOLERANCE, 0.1)
            for number in range(start - 6, start + 40):
                errors, measured = told[number]
                foresight.add(number * INTERVAL_S, errors, measured if kind == "rates" else UNKNOWN)
                if number >= start and not foresight.is_gusty(AHEAD_S):
                    break
            waited[kind] += number - start
            outside[kind] += max(true[5 * number + 15 : 5 * number + 21]) > 0.08
    assert outside["speed"] >= 8
    assert outside["rates"] <= outside["speed"] / 2
    assert (waited["rates"] - waited["speed"]) * INTERVAL_S / (len(told) / 25) < 0.03
