import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.gimbal.dejitter import Backlog, StampCheck, StampDejitter

PERIOD_S = 0.02


def test_a_burst_keeps_the_spacing_of_its_sender() -> None:
    stamps = StampDejitter()
    sent = [100 + i * PERIOD_S for i in range(60)]
    # messages 30 to 41 are all delivered when the twelfth of them has been sent
    arrived = [max(s, sent[41]) if 30 <= i <= 41 else s for i, s in enumerate(sent)]
    told = [stamps.sent_s(s - 90, a + 0.003) for s, a in zip(sent, arrived, strict=True)]
    gaps = [b - a for a, b in itertools.pairwise(told)]
    assert max(gaps) == pytest.approx(PERIOD_S, abs=1e-9)
    assert max(b - a for a, b in itertools.pairwise(arrived)) > 0.2


def test_a_real_silence_stays_one() -> None:
    stamps = StampDejitter()
    told = [stamps.sent_s(s, s + 5) for s in (1.00, 1.02, 1.04, 1.34, 1.36)]
    assert told[3] - told[2] == pytest.approx(0.3)


def test_a_clock_that_runs_slower_is_followed() -> None:
    stamps = StampDejitter()
    # a simulation that reaches 80 % of the speed asked for
    for i in range(500):
        received_s = i * PERIOD_S / 0.8
        told = stamps.sent_s(i * PERIOD_S, received_s)
    assert received_s - told < 0.11


@pytest.mark.parametrize("stamp_s", [math.nan, 0.0])
def test_stamps_that_tell_nothing_leave_the_arrival(stamp_s: float) -> None:
    stamps = StampDejitter()
    stamps.sent_s(stamp_s, 1.0)
    assert [stamps.sent_s(stamp_s, t) for t in (2.0, 3.0)] == [2.0, 3.0]


def test_a_reboot_begins_anew() -> None:
    stamps = StampDejitter()
    stamps.sent_s(500.0, 10.0)
    stamps.sent_s(500.02, 10.02)
    assert stamps.sent_s(0.5, 20.0) == 20.0
    assert stamps.sent_s(0.52, 20.02) == pytest.approx(20.02)


@given(st.lists(st.tuples(st.floats(0.001, 0.1), st.floats(0, 0.4)), min_size=2, max_size=80))
def test_never_later_than_the_arrival_and_never_back(steps: list[tuple[float, float]]) -> None:
    stamps = StampDejitter()
    sent_s = received_s = before = 0.0
    for period_s, delay_s in steps:
        sent_s += period_s
        received_s = max(received_s, sent_s + delay_s)
        told = stamps.sent_s(sent_s + 7, received_s)
        assert before <= told <= received_s
        assert told >= sent_s - 1e-9
        before = told


def fits(*stamps_and_arrivals: tuple[float, float]) -> list[bool]:
    check = StampCheck()
    return [check.fits(stamp, arrival) for stamp, arrival in stamps_and_arrivals]


def test_one_stamp_from_the_future_or_the_past_is_dropped() -> None:
    assert fits((10.0, 0.0), (10.02, 0.02), (500.0, 0.03), (10.04, 0.04), (2.0, 0.05), (10.06, 0.06)) == [
        True,
        True,
        False,
        True,
        False,
        True,
    ]


def test_a_clock_that_was_set_is_believed_after_three_messages() -> None:
    rebooted = [(100.0, 0.0), (100.02, 0.02), (0.5, 3.0), (0.52, 3.02), (0.54, 3.04), (0.56, 3.06)]
    assert fits(*rebooted) == [True, True, False, False, True, True]


def test_forged_stamps_that_do_not_go_on_are_never_believed() -> None:
    stream = [item for n in range(50) for item in ((10 + n / 50, n / 50), (1e4 + 7.0 * n, n / 50 + 0.01))]
    assert fits(*stream) == [True, False] * 50


def test_a_slow_clock_and_a_silence_fit() -> None:
    assert all(fits(*((10 + 0.9 * t, float(t)) for t in (0, 1, 2, 30, 31))))
    assert all(fits((math.nan, 0.0), (0.0, 1.0), (math.nan, 9.0)))


def _told(backlog: Backlog, *, seconds: range, rate: float = 1.0, late_s: float = 0.0, jitter_s: float = 0.0) -> float:
    for tick in range(seconds.start * 50, seconds.stop * 50):
        at_s = tick / 50
        backlog.note(100 + rate * (at_s - late_s), at_s + (jitter_s if tick % 7 else 0.003))
    return backlog.late_s


def test_a_stream_that_is_held_up_shows_its_age_until_it_has_caught_up() -> None:
    backlog = Backlog()
    assert _told(backlog, seconds=range(10), jitter_s=0.2) == pytest.approx(0.0, abs=0.01)
    assert _told(backlog, seconds=range(14, 40), late_s=4.0) == pytest.approx(4.0, abs=0.3)
    assert _told(backlog, seconds=range(40, 50)) == 0.0


@given(rate=st.floats(0.95, 1.05))
def test_a_clock_of_another_rate_is_no_backlog(rate: float) -> None:
    assert _told(Backlog(), seconds=range(60), rate=rate) == pytest.approx(0.0, abs=0.02)


def test_a_clock_that_begins_anew_is_no_backlog() -> None:
    backlog = Backlog()
    _told(backlog, seconds=range(10))
    _told(backlog, seconds=range(10, 20), late_s=95.0)  # its stamps begin at 15 s
    assert backlog.late_s == 0.0
    backlog.note(math.nan, 30.0)
    backlog.note(0.0, 90.0)
    assert backlog.late_s == 0.0
