"""Pacing of a simulation: the encoding of its time and of its limits."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.sim.pacing import TimeLimits, limits_line, time_fields, time_from_fields
from panoexec.sim.physics.world import SimClock


@given(st.floats(0, 4e6))
def test_time_fields_have_microsecond_resolution(now_s: float) -> None:
    boot_ms, value = time_fields(now_s)
    assert 0 <= boot_ms < 2**32
    assert 0 <= value < 1000
    assert time_from_fields(boot_ms, value) == pytest.approx(now_s, abs=1e-6)


@given(st.lists(st.tuples(st.floats(0, 1e6), st.floats(0.01, 100)), min_size=1, max_size=5), st.data())
def test_limits_are_parsed_exactly_for_any_split_of_the_stream(
    told: list[tuple[float, float]], data: st.DataObject
) -> None:
    limits = TimeLimits()
    rest = b"".join(limits_line(*line) for line in told)
    while rest:
        size = data.draw(st.integers(1, len(rest)))
        limits.feed(rest[:size])
        rest = rest[size:]
    assert limits.changed.is_set()
    assert (limits.until_s, limits.speed) == told[-1]


@pytest.mark.parametrize("line", [b"", b"x y", b"1", b"1 2 3", b"nan 1", b"inf 1", b"5 0", b"5 -1", b"5 nan"])
def test_invalid_lines_are_ignored(line: bytes) -> None:
    limits = TimeLimits()
    limits.feed(line + b"\n")
    assert (limits.until_s, limits.speed, limits.changed.is_set()) == (0.0, 1.0, False)


def test_paused_clock_continues_from_its_time() -> None:
    wall = [0.0]
    clock = SimClock(20.0, monotonic=lambda: wall[0])
    wall[0] = 1.0
    clock.go_on(7.0, 2.0)
    assert clock.now() == 7.0
    wall[0] = 1.5
    assert clock.now() == 8.0
    assert clock.wall_delay(9.0) == 0.5
    assert math.isclose(clock.utc(9.0) - clock.utc(7.0), 1.0)
