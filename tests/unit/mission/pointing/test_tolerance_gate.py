"""The gate against constructed attitudes: frames, settling, exposure windows."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.mission.pointing.poses import (
    Reading,
)
from panoexec.mission.pointing.tolerance_gate import (
    SettleLimits,
    SettleTracker,
    allowed_gap_s,
    judge_window,
)
from tests.unit.mission.pointing.readings import (
    LIMITS,
    NAN,
    TARGET,
    judged,
    reading_at,
    stream_of,
)


def _settle(readings: list[Reading], limits: SettleLimits = LIMITS) -> tuple[SettleTracker, list[float]]:
    tracker = SettleTracker(target=TARGET, limits=limits)
    settled = []
    for reading in readings:
        tracker.add(reading)
        if tracker.is_settled(reading.time_s):
            settled.append(round(reading.time_s, 6))
    return tracker, settled


def test_settled_means_the_whole_settle_time() -> None:
    tracker, settled = _settle([reading_at(i * 0.02) for i in range(15)])
    assert settled == [0.2, 0.22, 0.24, 0.26, 0.28]
    assert tracker.settled_at_s == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("bad", "word"),
    [
        (reading_at(0.1, pitch=0.11), "pitch off by +0.11"),
        (reading_at(0.1, roll=-0.11), "roll off by -0.11"),
        (reading_at(0.1, yaw=0.51), "yaw off by +0.51"),
        (reading_at(0.1, rate=2.1), "turning at 2.1"),
        (Reading(0.1, None, 0.0, "gone"), "gone"),
    ],
)
def test_one_bad_sample_starts_the_settle_time_again(bad: Reading, word: str) -> None:
    tracker = SettleTracker(target=TARGET, limits=LIMITS)
    for i in range(5):
        tracker.add(reading_at(i * 0.02))
    tracker.add(bad)
    assert word in tracker.problem
    assert math.isnan(tracker.inside_since_s)
    times = []
    for i in range(6, 20):
        tracker.add(reading_at(i * 0.02))
        times.append((round(i * 0.02, 6), tracker.is_settled(i * 0.02)))
    assert next(t for t, ok in times if ok) == pytest.approx(0.32)


def test_a_silence_starts_the_settle_time_again() -> None:
    _, settled = _settle([reading_at(t) for t in (0.0, 0.05, 0.1, 0.25, 0.3, 0.35, 0.4, 0.45)])
    assert settled == [0.45]


def test_the_settle_time_may_end_between_two_samples() -> None:
    tracker, _ = _settle([reading_at(i * 0.03) for i in range(7)])
    assert not tracker.is_settled(0.19)
    assert tracker.is_settled(0.2)


def test_a_settled_pose_goes_stale() -> None:
    tracker, _ = _settle([reading_at(i * 0.02) for i in range(12)])
    assert tracker.is_settled(0.22 + 0.1)
    assert not tracker.is_settled(0.22 + 0.11)
    assert SettleTracker(target=TARGET, limits=LIMITS).is_stale(0.0)


def test_without_a_reported_rate_motion_inside_tolerance_is_seen_and_noise_is_not() -> None:
    creeping = [reading_at(i * 0.02, yaw=-0.45 + 3.0 * i * 0.02, rate=NAN) for i in range(15)]
    assert _settle(creeping)[1] == []
    assert any("turning at 3.0" in _settle(creeping[:n])[0].problem for n in range(5, 8))
    shaking = [reading_at(i * 0.02, pitch=0.03 * (-1) ** i, rate=NAN) for i in range(15)]
    assert _settle(shaking)[1][0] == pytest.approx(0.2)


def test_no_settle_time_means_the_first_good_sample() -> None:
    assert _settle([reading_at(0.0)], SettleLimits(settle_s=0.0, max_rate_deg_s=2.0, max_gap_s=0.1))[1] == [0.0]


def test_a_window_of_good_samples_is_proven_and_says_what_was_measured() -> None:
    verdict = judge_window(stream_of(), target=TARGET, start_s=1.0, end_s=1.2, max_gap_s=0.1)
    assert verdict.ok
    assert verdict.samples == 11
    assert verdict.measured is not None
    assert [verdict.measured.pitch_deg, verdict.measured.yaw_deg] == pytest.approx([-30.0, 100.0])


@given(at=st.integers(10, 20), pitch=st.floats(0.1001, 50.0))
def test_any_bad_sample_inside_fails_the_window(at: int, pitch: float) -> None:
    readings = stream_of()
    readings[at] = reading_at(readings[at].time_s, pitch=-pitch)
    ok, code, reason = judged(readings)
    assert (ok, code) == (False, "pointing")
    assert "pitch off by -" in reason


def test_bad_samples_outside_do_not_matter() -> None:
    readings = stream_of()
    for i in (0, 5, 21, 30):
        readings[i] = reading_at(readings[i].time_s, yaw=20.0)
    assert judged(readings)[0]


@pytest.mark.parametrize(
    ("times", "ok"),
    [
        ([], False),
        ([0.95, 1.05, 1.12, 1.2], True),
        ([0.95, 1.05, 1.12], True),  # 0.08 s of silence at the end
        ([1.02, 1.1, 1.18], False),  # nothing before
        ([0.85, 1.02, 1.1, 1.18], False),  # too long before
        ([0.95, 1.06, 1.17], False),  # a gap of 0.11 s inside
        ([0.95, 1.05], False),  # 0.15 s of silence at the end
        ([0.95, 1.05, 1.3], False),  # a sample after the end does not close it
        ([1.25, 1.3], False),
    ],
)
def test_silence_is_not_proof(times: list[float], ok: bool) -> None:
    proven, code, _ = judged([reading_at(t) for t in times])
    assert proven is ok
    assert code == ("" if ok else "no_samples")


def test_an_unreadable_sample_is_not_proof() -> None:
    readings = stream_of()
    readings[14] = Reading(readings[14].time_s, None, NAN, "the gimbal reports: motor error")
    assert judged(readings) == (False, "no_samples", "the gimbal reports: motor error")


def test_the_worst_errors_keep_their_signs() -> None:
    readings = [
        reading_at(0.95),
        reading_at(1.0, pitch=0.05),
        reading_at(1.08, pitch=-0.08, yaw=0.3),
        reading_at(1.15, yaw=-0.4),
    ]
    errors = judge_window(readings, target=TARGET, start_s=1.0, end_s=1.2, max_gap_s=0.1).errors
    assert errors is not None
    assert [errors.pitch_deg, errors.yaw_deg] == pytest.approx([-0.08, -0.4])


def test_two_readings_of_one_moment_tell_no_speed() -> None:
    tracker = SettleTracker(target=TARGET, limits=SettleLimits(settle_s=0.0, max_rate_deg_s=2.0, max_gap_s=0.1))
    tracker.add(reading_at(1.0, rate=math.nan), reading_at(1.0, yaw=0.1, rate=math.nan))
    assert tracker.is_settled(1.0)


def test_readings_taken_at_once_lead_to_what_they_lead_to_one_by_one() -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        readings = [
            reading_at(0.02 * i, yaw=float(rng.normal(0, 0.5)), rate=float(rng.uniform(0, 3)))
            if rng.random() < 0.9
            else Reading(0.02 * i, None, math.nan, "broken")
            for i in range(int(rng.integers(1, 12)))
        ]
        one_by_one, at_once = (SettleTracker(target=TARGET, limits=LIMITS) for _ in range(2))
        for reading in readings:
            one_by_one.add(reading)
        at_once.add(*readings)
        at_once.add()
        assert at_once.problem == one_by_one.problem
        assert at_once.inside_since_s == pytest.approx(one_by_one.inside_since_s, nan_ok=True)
        assert (at_once.error is None) == (one_by_one.error is None)
        if at_once.error is not None and one_by_one.error is not None:
            assert float(at_once.error.yaw_deg) == float(one_by_one.error.yaw_deg)


FORESEEING = SettleLimits(settle_s=0.1, max_rate_deg_s=5.0, max_gap_s=0.1, foresee_s=0.2, use_reported_rate=False)


def test_a_sway_is_settled_where_it_stays_inside_for_the_exposure_and_not_where_it_leaves() -> None:
    def sway(t: float) -> float:
        return 0.7 * math.sin(math.tau * t / 3.0)  # beyond τ = 0.5 at its ends, 1.5°/s in its middle

    readings = [reading_at(0.02 * i, yaw=sway(0.02 * i), rate=math.nan) for i in range(600)]
    tracker = SettleTracker(target=TARGET, limits=FORESEEING)
    settled = []
    for reading in readings:
        tracker.add(reading)
        if tracker.is_settled(reading.time_s):
            settled.append(reading.time_s)
    assert settled
    for at_s in settled:
        worst = max(abs(sway(at_s + 0.2 * i / 20)) for i in range(21))
        assert worst <= 0.5 + 0.03
    assert 0.2 < len(settled) / len(readings) < 0.5
    leaving = SettleTracker(target=TARGET, limits=FORESEEING)
    leaving.add(*[reading for reading in readings if reading.time_s <= 0.25])
    assert leaving.problem == "yaw will be off by +0.623° in 0.20 s (at most 0.5°)"


def test_a_gust_that_is_about_to_take_the_pose_out_is_waited_for() -> None:
    """Once the settle time is over; it does not begin anew, and a pose that stays inside is not waited for."""
    limits = SettleLimits(settle_s=0.3, max_rate_deg_s=5.0, max_gap_s=0.1, gust_s=0.06)

    def first_s(gust: Callable[[float], float]) -> float:
        tracker = SettleTracker(target=TARGET, limits=limits)
        for i in range(60):
            now_s = 0.02 * i
            tracker.add(reading_at(now_s, yaw=gust(now_s)))
            if tracker.is_settled(now_s) and tracker.is_calm(now_s):
                assert tracker.settled_at_s == pytest.approx(now_s, abs=0.021)
                return now_s
        return math.nan

    assert first_s(lambda t: 0.4) == pytest.approx(0.3)
    # 0.48° at the end of the settle time, and rising by 4.5°/s; from there on it comes back
    there_and_back = first_s(lambda t: 0.3 + 4.5 * max(0.0, min(t, 0.3) - 0.26) - 4.5 * max(0.0, t - 0.3))
    assert 0.31 < there_and_back < 0.4


@pytest.mark.parametrize(
    ("gust_deg", "again_s"), [(0.6, 0.1), (1.4, 0.1), (1.6, 0.3)], ids=["out", "far out", "it may swing again"]
)
def test_a_pose_that_was_settled_is_settled_sooner_after_a_gust(gust_deg: float, again_s: float) -> None:
    limits = SettleLimits(settle_s=0.3, max_rate_deg_s=500.0, max_gap_s=0.1, again_s=0.1)

    def settled_s(gust_s: float) -> list[float]:
        """Beginnings of the times in which it is settled."""
        tracker, settled = SettleTracker(target=TARGET, limits=limits), [False]
        for i in range(60):
            now_s = 0.02 * i
            tracker.add(reading_at(now_s, yaw=gust_deg if abs(now_s - gust_s) < 0.001 else 0.0))
            settled.append(tracker.is_settled(now_s))
        return [0.02 * i for i in range(60) if settled[i + 1] and not settled[i]]

    assert settled_s(0.4) == pytest.approx([0.3, 0.42 + again_s])
    assert settled_s(0.2) == pytest.approx([0.22 + 0.3]), "it was not settled yet"


@pytest.mark.parametrize(
    ("interval_s", "gap_s"), [(math.nan, 0.1), (0.02, 0.1), (0.05, 0.125), (0.1, 0.25), (0.5, 0.25)]
)
def test_only_a_slow_stream_may_have_long_gaps(interval_s: float, gap_s: float) -> None:
    assert allowed_gap_s(interval_s, max_gap_s=0.25) == pytest.approx(gap_s)
    assert allowed_gap_s(interval_s, max_gap_s=0.06) == 0.06
