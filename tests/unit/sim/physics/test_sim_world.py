"""Simulated time, event order, drift, ground-truth log."""

from __future__ import annotations

import json
import math
import statistics
from pathlib import Path

import pytest

from panoexec.sim.physics.world import BoundedDrift, ColouredNoise, Repeater, SimClock, Timeline, TruthLog, seeded


def test_simulated_time_runs_by_the_speedup() -> None:
    wall = [100.0]
    clock = SimClock(20.0, monotonic=lambda: wall[0])
    wall[0] += 1.5
    assert clock.now() == pytest.approx(30.0)
    assert clock.wall_delay(40.0) == pytest.approx(0.5)
    assert clock.utc(40.0) - clock.utc(0.0) == pytest.approx(2.0)
    clock.jump_s = 3600.0
    assert clock.utc(40.0) - clock.utc(0.0) == pytest.approx(2.0)


@pytest.mark.parametrize("speedup", [0.0, -1.0, math.inf, math.nan])
def test_invalid_speedup_is_rejected(speedup: float) -> None:
    with pytest.raises(ValueError, match="speedup"):
        SimClock(speedup)


def test_events_run_in_order_of_time_then_of_scheduling_each_at_its_moment() -> None:
    timeline, seen = Timeline(), list[tuple[str, float]]()

    def event(name: str) -> None:
        seen.append((name, timeline.now_s))

    timeline.at(2.0, lambda: event("late"))
    timeline.at(1.0, lambda: event("first"))
    timeline.at(1.0, lambda: event("second"))
    timeline.at(1.5, lambda: timeline.after(0.1, lambda: event("made by another")))
    timeline.run_until(1.8)
    assert seen == [("first", 1.0), ("second", 1.0), ("made by another", pytest.approx(1.6))]
    assert timeline.now_s == 1.8
    assert timeline.next_s == 2.0
    timeline.at(0.5, lambda: event("overdue"))
    timeline.run_until(3.0)
    assert [name for name, _ in seen[3:]] == ["overdue", "late"]
    assert timeline.next_s == math.inf


def test_a_repeater_keeps_its_rate_however_late_it_is_run_and_stops() -> None:
    timeline, runs = Timeline(), list[float]()
    repeater = Repeater(timeline, lambda: runs.append(timeline.now_s))
    repeater.start(0.02)
    timeline.run_until(10.0)
    assert len(runs) == 500
    assert runs[-1] == pytest.approx(10.0)
    repeater.start(0.5)
    timeline.run_until(12.0)
    assert len(runs) == 504
    repeater.stop()
    timeline.run_until(20.0)
    assert len(runs) == 504


def test_drift_stays_in_its_bound_uses_it_and_its_rate_is_its_derivative() -> None:
    drift = BoundedDrift(0.667, 90.0, seeded(3, "test"))
    series = [drift.at(t / 2) for t in range(20_000)]
    assert 0.5 < max(map(abs, series)) <= 0.667
    assert statistics.pstdev(series) == pytest.approx(0.3536 * 0.667, rel=0.1)
    for t in (0.0, 17.0, 555.5):
        assert drift.rate_at(t) == pytest.approx((drift.at(t + 1e-4) - drift.at(t - 1e-4)) / 2e-4, abs=1e-6)


def test_coloured_noise_has_unit_deviation_and_its_corner() -> None:
    noise = ColouredNoise(1.5, 0.005, seeded(1, "test"))
    series = [noise.step() for _ in range(200_000)]
    assert statistics.pstdev(series) == pytest.approx(1.0, rel=0.05)
    lag = round(1 / (2 * math.pi * 1.5) / 0.005)
    correlation = statistics.fmean(a * b for a, b in zip(series, series[lag:], strict=False))
    assert correlation == pytest.approx(math.exp(-1), abs=0.05)


def test_each_purpose_has_its_own_random_numbers() -> None:
    assert seeded(1, "a").random() == seeded(1, "a").random()
    assert len({seeded(1, "a").random(), seeded(1, "b").random(), seeded(2, "a").random()}) == 3


def test_ground_truth_is_one_json_object_per_line(tmp_path: Path) -> None:
    log = TruthLog(tmp_path / "truth.jsonl")
    log.write("start", 0.0, {"seed": 1})
    log.write("exposure", 1.23456, {"file": "IMG_00001.jpg"})
    lines = (tmp_path / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    log.close()
    assert json.loads(lines[1]) == {"event": "exposure", "sim_s": 1.2346, "file": "IMG_00001.jpg"}
    nowhere = TruthLog(None)
    nowhere.write("start", 0.0, {})
    nowhere.close()
