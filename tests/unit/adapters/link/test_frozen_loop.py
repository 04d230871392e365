"""A loop that stands still is told from a computer that does."""

from __future__ import annotations

import pytest

from panoexec.adapters.link.frozen_loop import CHECK_S, FROZEN_S, FrozenLoopGuard


@pytest.fixture
def now_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


def found(guard: FrozenLoopGuard, now_s: list[float], seconds: float, *, every_s: float = CHECK_S) -> list[float]:
    """When a guard calls the loop frozen, seconds from now on."""
    began_s, times = now_s[0], []
    while now_s[0] < began_s + seconds:
        now_s[0] += every_s
        if guard.check(now_s[0]):
            times.append(now_s[0] - began_s)
    return times


def test_it_is_found_once(now_s: list[float]) -> None:
    guard = FrozenLoopGuard(lambda: None)
    assert found(guard, now_s, 60.0) == [FROZEN_S]


def test_a_loop_that_runs_is_not_frozen_and_can_freeze_again(now_s: list[float]) -> None:
    guard = FrozenLoopGuard(lambda: None)
    for _ in range(3):
        guard.pulse()
        (at_s,) = found(guard, now_s, 10.0)
        assert at_s == FROZEN_S + CHECK_S  # the first check sees the pulse


def test_checks_that_are_late_themselves_say_nothing(now_s: list[float]) -> None:
    guard = FrozenLoopGuard(lambda: None)
    assert found(guard, now_s, 60.0, every_s=3 * CHECK_S) == []
    assert found(guard, now_s, 3.0) == [FROZEN_S]
