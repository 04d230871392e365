import itertools

import pytest

from panoexec.adapters.link.stream_health import RebootDetector, Stream, StreamHealth

STREAM = Stream(message_id=285, name="GIMBAL_DEVICE_ATTITUDE_STATUS", rate_hz=50.0, idle_rate_hz=5.0)


def flowing(watch: StreamHealth, now_s: float, hz: float = 50.0) -> None:
    watch.note(now_s)
    watch.settle(hz, now_s)


def test_a_boot_time_that_runs_backwards_is_a_reboot_and_an_overtaken_message_is_none() -> None:
    boots = RebootDetector()
    assert [boots.note(t, 1000.0 + 0.1 * i) for i, t in enumerate((5.0, 100.0, 99.2, 100.1, 3.0, 2.5, 4.0, 1.2))] == [
        *[False] * 4,
        True,
        *[False] * 2,
        True,
    ]
    assert boots.reboots == 2


def test_a_reboot_soon_after_power_on_is_detected_although_the_time_since_boot_never_runs_backwards() -> None:
    boots = RebootDetector()
    assert not boots.note(0.4, 1000.0)
    assert not boots.note(0.9, 1000.5)
    # rebooted at 1000.6, heard again when the streams were requested anew
    assert boots.note(2.7, 1003.3)
    assert not boots.note(3.2, 1003.8)
    assert boots.reboots == 1


def test_silence_alone_and_late_messages_are_no_reboot() -> None:
    boots = RebootDetector()
    # the link is away for 30 s, then 3 s of queued messages arrive at once, then the clock runs 5 % slow for a minute
    heard = [(40.0, 1000.0), (67.0, 1030.0), (68.0, 1030.0), (69.9, 1030.1), (126.9, 1090.1)]
    assert not any(boots.note(boot_s, heard_s) for boot_s, heard_s in heard)


def test_a_stream_is_asked_for_once_and_left_alone_while_it_flows() -> None:
    watch = StreamHealth(STREAM)
    assert watch.due(50.0, 0.0)
    watch.asked(50.0, 0.0, granted=True)
    assert not watch.due(50.0, 0.5)
    for tick in range(200):
        now = 0.1 * tick
        flowing(watch, now)
        assert not watch.due(50.0, now)


def test_another_rate_is_asked_for_at_once() -> None:
    watch = StreamHealth(STREAM)
    watch.asked(50.0, 0.0, granted=True)
    flowing(watch, 0.1)
    assert watch.due(5.0, 0.1)
    watch.asked(5.0, 0.1, granted=True)
    assert not watch.due(5.0, 0.2)
    assert watch.due(50.0, 0.2)


def test_silence_is_answered_with_growing_patience() -> None:
    watch = StreamHealth(STREAM)
    watch.asked(50.0, 0.0, granted=True)
    asked = []
    for tick in range(400):
        now = 0.1 * tick
        if watch.due(50.0, now):
            asked.append(now)
            watch.asked(50.0, now, granted=True)
    gaps = [b - a for a, b in zip([0.0, *asked], asked, strict=False)]
    assert 1.0 <= gaps[0] <= 1.3
    assert all(b >= a - 1e-6 for a, b in itertools.pairwise(gaps))
    assert max(gaps) <= 10.3
    # once it flows, the next silence is met with fresh patience
    flowing(watch, 50.0)
    watch.asked(50.0, 50.0, granted=True)
    assert watch.due(50.0, 51.2)


def test_a_slow_stream_is_not_silent_between_two_messages() -> None:
    watch = StreamHealth(STREAM)
    watch.asked(0.5, 0.0, granted=True)
    watch.note(0.0)
    assert not watch.due(0.5, 9.0)
    assert watch.due(0.5, 10.5)


def test_a_refusal_is_final_for_half_a_minute() -> None:
    watch = StreamHealth(STREAM)
    watch.asked(50.0, 0.0, granted=False)
    assert watch.refused
    assert not watch.due(50.0, 29.0)
    assert watch.due(50.0, 31.0)


def test_no_answer_is_tried_again() -> None:
    watch = StreamHealth(STREAM)
    watch.asked(50.0, 0.0, granted=None)
    assert not watch.refused
    assert not watch.due(50.0, 0.5)
    assert watch.due(50.0, 1.1)


def test_after_a_reboot_everything_is_asked_for_at_once() -> None:
    watch = StreamHealth(STREAM)
    watch.asked(50.0, 0.0, granted=True)
    flowing(watch, 0.1)
    watch.forget()
    assert watch.due(50.0, 0.1)


def test_a_time_from_the_future_is_no_news_and_the_next_true_one_no_reboot() -> None:
    boots = RebootDetector()
    for tick in range(1, 200):
        now = tick * 0.02
        assert not boots.note(100.0 + now, 1000.0 + now)
        if tick % 10 == 0:  # somebody else stamps an hour ahead, again and again
            assert not boots.note(3700.0 + now, 1000.0 + now)
    assert boots.reboots == 0


def test_a_clock_that_stays_ahead_is_believed_after_a_second() -> None:
    boots = RebootDetector()
    assert not boots.note(100.0, 1000.0)
    for tick in range(100):
        assert not boots.note(5000.0 + tick * 0.02, 1000.0 + tick * 0.02)
    assert boots.note(3.0, 1002.1), "the reboot that follows is one"


@pytest.mark.parametrize("gap_s", [0.1, 3.0, 120.0, 3600.0])
def test_a_gap_is_no_leap_of_the_clock(gap_s: float) -> None:
    boots = RebootDetector()
    assert not boots.note(100.0, 1000.0)
    assert not boots.note(100.0 + gap_s, 1000.0 + gap_s)
    assert boots.note(0.5, 1001.0 + gap_s)


def test_a_stream_that_is_held_up_is_no_reboot() -> None:
    """Reports of the gimbal come 4 s late, everything else in time; then the autopilot reboots."""
    boots = RebootDetector()
    for tick in range(500):
        now_s = 0.02 * tick
        assert not boots.note(100.0 + now_s, 1000.0 + now_s, stream="ATTITUDE")
        if not 200 < tick <= 400:
            sent_s = 100.0 + now_s - (4.0 if tick > 200 else 0.0)
            assert not boots.note(sent_s, 1000.0 + now_s, stream="GIMBAL_DEVICE_ATTITUDE_STATUS")
    assert boots.note(2.0, 1010.5, stream="ATTITUDE")
    assert boots.reboots == 1


def test_a_reboot_is_seen_by_messages_that_were_not_heard_before_it() -> None:
    boots = RebootDetector()
    assert not boots.note(100.0, 1000.0, stream="ATTITUDE")
    assert not boots.note(3.0, 1000.5, stream="SYSTEM_TIME")
    assert boots.note(5.0, 1002.5, stream="SYSTEM_TIME")
    assert not boots.note(5.1, 1002.6, stream="ATTITUDE")
