"""The pace of sending follows the link."""

from __future__ import annotations

import math

import pytest

from panoexec.mqtt.pace import LARGE_S, LONGEST_WAIT_S, QUIET_S, Pace

STATE = 700


def paced(rate: float, latency_s: float, batches: int = 4) -> Pace:
    """A connection that has carried states."""
    pace, now = Pace(latency_s + 80 / rate), 0.0
    for _ in range(batches):
        took = latency_s + STATE / rate
        now += took
        pace.acknowledged(STATE, took, now_s=now, latest=STATE)
    return pace


@pytest.mark.parametrize("latency_s", [0.0, 0.05, 2.0])
@pytest.mark.parametrize("rate", [300.0, 1000.0, 4000.0])
def test_a_slow_link_is_measured_whatever_its_latency(rate: float, latency_s: float) -> None:
    pace = paced(rate, latency_s)
    assert pace.rate == pytest.approx(rate, rel=0.3)
    assert pace.window < rate
    assert pace.takes_s(10 * int(rate)) > LARGE_S


@pytest.mark.parametrize("latency_s", [0.0, 0.6, 3.0])
def test_a_satellite_link_is_far_and_not_slow(latency_s: float) -> None:
    pace = paced(100_000.0, latency_s)
    assert (pace.rate, pace.window) == (math.inf, math.inf)
    assert pace.may_go(10**6, waited_s=0.0, now_s=100.0, answered_s=100.0)


def test_one_busy_moment_of_the_computer_is_forgotten() -> None:
    pace = Pace(0.001)
    pace.acknowledged(STATE, 0.8, now_s=1.0, latest=0)
    assert pace.rate < 1000
    for number in range(4):
        pace.acknowledged(STATE, 0.001, now_s=2.0 + number, latest=0)
    assert pace.rate == math.inf


def test_states_leave_two_thirds_of_a_slow_link_to_others() -> None:
    pace = Pace(0.08)
    pace.acknowledged(1000, 1.08, now_s=100.0, latest=1000)
    assert not pace.may_go(1000, waited_s=0.0, now_s=101.9, answered_s=-math.inf)
    assert pace.may_go(1000, waited_s=0.0, now_s=102.1, answered_s=-math.inf)
    pace.acknowledged(1000, 1.08, now_s=200.0, latest=0)
    assert pace.may_go(1000, waited_s=0.0, now_s=200.0, answered_s=-math.inf), "events hold nothing back"


def test_a_large_plan_waits_for_a_quiet_moment_but_not_for_ever() -> None:
    pace = paced(1000.0, 0.0)
    for now, answered, waited, may in (
        (100.0, 95.0, 5.0, False),
        (100.0, 100.0 - QUIET_S, 5.0, True),
        (100.0, 99.0, LONGEST_WAIT_S, True),
    ):
        assert pace.may_go(8000, waited_s=waited, now_s=now, answered_s=answered) is may


def test_a_large_message_is_given_the_time_that_it_takes() -> None:
    assert paced(1000.0, 0.0).timeout_s(40_000) > 60


@pytest.mark.parametrize(("rate", "slow"), [(300.0, True), (1000.0, True), (3000.0, True), (20_000.0, False)])
def test_a_link_that_stays_slow_is_known_as_such(rate: float, slow: bool) -> None:
    pace = paced(rate, 0.2, batches=5)
    assert not pace.lastingly_slow, "not yet"
    pace.acknowledged(STATE, 0.2 + STATE / rate, now_s=9.0, latest=0)
    assert pace.lastingly_slow is slow
    pace.acknowledged(STATE, 0.2, now_s=9.0, latest=0)
    assert pace.lastingly_slow is slow, "whether it is said once"
    for _ in range(6):
        pace.acknowledged(STATE, 0.2, now_s=9.0, latest=0)
    assert not pace.lastingly_slow


def test_a_computer_that_is_slow_now_and_then_is_no_slow_link() -> None:
    pace = Pace(0.001)
    for number in range(40):
        pace.acknowledged(STATE, 0.8 if number % 2 else 0.05, now_s=float(number), latest=0)
        assert not pace.lastingly_slow


def test_deltas_leave_nine_tenths_of_a_slow_link_to_others() -> None:
    pace = Pace(0.08)
    pace.acknowledged(200, 0.68, now_s=100.0, latest=0, deltas=200)
    assert pace.rate < 400
    assert not pace.may_go(200, waited_s=0.0, now_s=105.3, answered_s=-math.inf, delta=True)
    assert pace.may_go(200, waited_s=0.0, now_s=105.5, answered_s=-math.inf, delta=True)
    assert pace.may_go(600, waited_s=0.0, now_s=100.0, answered_s=-math.inf)
    pace.acknowledged(4000, 9.0, now_s=110.0, latest=4000)
    assert pace.may_go(200, waited_s=0.0, now_s=110.0, answered_s=-math.inf, delta=True), "a plan holds none back"
    assert not pace.may_go(600, waited_s=0.0, now_s=110.0, answered_s=-math.inf)
