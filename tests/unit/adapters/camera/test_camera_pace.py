"""The least interval of a camera, learned from what became of its triggers."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.adapters.camera.camera_pace import CameraPace


def shoot(
    pace: CameraPace, real_s: float, *, photos: int, slew_s: float, configured_s: float = 1.0
) -> tuple[int, float]:
    """Take photos as a mission does; how many triggers were refused, and how many of those among the last half."""
    now_s, taken_s, refused, late_refused = 100.0, -math.inf, 0, 0
    ready_s = now_s
    for photo in range(photos):
        now_s += slew_s
        while True:
            now_s = max(now_s, ready_s, pace.ready_s)
            if now_s - taken_s >= real_s - 1e-6:
                break
            pace.refused(now_s)
            refused += 1
            late_refused += photo >= photos // 2
            ready_s = now_s + 0.5
        pace.accepted(now_s)
        taken_s, ready_s = now_s, now_s + configured_s
    return refused, late_refused


@settings(max_examples=100, deadline=None)
@given(real_s=st.floats(1.1, 12.0), slew_s=st.floats(0.3, 2.0))
def test_few_triggers_are_refused_whatever_the_interval(real_s: float, slew_s: float) -> None:
    pace = CameraPace()
    refused, late = shoot(pace, real_s, photos=40, slew_s=slew_s)
    assert refused <= 12
    assert late <= 1
    assert pace.interval_s <= 1.6 * real_s


def test_refusals_for_other_reasons_teach_nothing() -> None:
    pace = CameraPace()
    pace.refused(99.0)  # no photo yet: video mode, no card
    assert (pace.interval_s, pace.ready_s) == (0.0, -math.inf)
    pace.accepted(100.0)
    pace.accepted(101.0)
    for sent_s in (102.5, 103.0, 104.0, 140.0):  # later than the second photo was taken after the first
        pace.refused(sent_s)
    assert pace.interval_s == 0.0


def test_one_refusal_alone_delays_the_next_trigger_and_teaches_nothing() -> None:
    pace = CameraPace()
    pace.accepted(100.0)
    pace.refused(101.0)
    assert pace.ready_s == pytest.approx(101.5)
    pace.accepted(101.5)
    assert (pace.interval_s, pace.ready_s) == (0.0, -math.inf)


def test_a_parameter_is_believed() -> None:
    pace = CameraPace()
    pace.told(2.5)
    pace.accepted(100.0)
    assert pace.ready_s == pytest.approx(102.55)
    pace.told(-1.0)
    pace.told(1000.0)
    assert pace.interval_s == pytest.approx(2.55)


def test_a_trigger_that_an_autopilot_deferred_tells_its_interval() -> None:
    pace = CameraPace()
    pace.triggered(100.05, 100.0)
    pace.triggered(102.55, 101.2)
    assert pace.interval_s == pytest.approx(2.5)
    pace.triggered(106.1, 106.0)  # in time: no news
    assert pace.interval_s == pytest.approx(2.5)


def test_a_deferred_trigger_long_after_the_one_before_tells_nothing() -> None:
    pace = CameraPace()
    pace.triggered(100.05, 100.0)
    pace.triggered(200.0, 199.0)
    assert pace.interval_s == 0.0
