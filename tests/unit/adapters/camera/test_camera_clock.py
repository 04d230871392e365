"""The camera's clock runs slow or fast, or is stepped: dates stay true, and no photo goes to another trigger."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from panoexec.adapters.camera.camera_clock import DELAY_S, LATE_S, CameraClock
from panoexec.adapters.camera.capture import Capture, Report, Source, dated
from panoexec.adapters.camera.capture_matching import CaptureMatcher
from panoexec.devices import CaptureEvidence, EvidenceLevel
from tests.unit.fakes.virtual import VirtualClock

CAPTURED = EvidenceLevel.CAPTURE_MESSAGE


def test_nothing_is_dated_before_the_clocks_are_related() -> None:
    clock = CameraClock()
    assert math.isnan(clock.date(5.0, 100.0)[0])
    clock.note(1.0, 101.02)
    assert math.isnan(clock.date(math.nan, 104.0)[0])
    clock.note(math.nan, 104.0)
    assert clock.date(1.0, 102.0)[0] == pytest.approx(101.02)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(rate=st.floats(0.95, 1.05), boot=st.floats(0, 1e5), seed=st.integers(0, 2**32))
def test_a_date_is_wrong_by_no_more_than_it_says(rate: float, boot: float, seed: int) -> None:
    """Camera seconds pass at `rate`; messages need 5 to 45 ms; now and then one is held up."""
    rng = random.Random(seed)
    clock = CameraClock()
    for sent_s in range(1000, 1200, 4):
        held_up = rng.uniform(0.3, 2.0) if sent_s % 8 and rng.random() < 0.1 and 1010 < sent_s < 1190 else 0.0
        clock.note(boot + 0.0137 + rate * (sent_s - 1000), sent_s + rng.uniform(0.005, 0.045) + held_up)
        truth_s = sent_s + rng.uniform(0.1, 3.9)
        found_s, error_s = clock.date(boot + 0.0137 + rate * (truth_s - 1000), truth_s + 10)
        assert abs(found_s - truth_s) <= error_s + 1e-6
    assert clock.rate == pytest.approx(1 / rate, abs=0.002)
    assert error_s < DELAY_S + 0.03 + clock.resolution_s


@settings(max_examples=30, deadline=None, derandomize=True)
@given(rate=st.floats(0.95, 1.05), boot=st.floats(0, 1e5), seed=st.integers(0, 2**32), slowest_s=st.floats(0.004, 0.05))
def test_round_trips_bound_a_stamp(rate: float, boot: float, seed: int, slowest_s: float) -> None:
    """Requests and answers each need up to `slowest_s`; now and then a message that nobody asked for comes first."""
    rng = random.Random(seed)
    clock = CameraClock()
    bounded = 0
    for asked_s in range(1000, 1200, 4):
        sent_s = asked_s + rng.uniform(0.002, slowest_s)
        if rng.random() < 0.05:  # sent before the request, and received after it
            sent_s = asked_s - rng.uniform(0.0, 0.002)
        received_s = max(asked_s + 0.0005, sent_s + rng.uniform(0.002, slowest_s))
        clock.note(boot + 0.0137 + rate * (sent_s - 1000), received_s)
        clock.note_trip(boot + 0.0137 + rate * (sent_s - 1000), asked_s, received_s)
        truth_s = asked_s + rng.uniform(0.1, 3.9)
        earliest_s, latest_s = clock.bounds(boot + 0.0137 + rate * (truth_s - 1000), truth_s + 0.1)
        if math.isfinite(earliest_s):
            bounded += 1
            assert earliest_s - 1e-6 <= truth_s <= latest_s + 1e-6
            assert latest_s - earliest_s <= 0.06
    assert bounded > 30 or slowest_s > 0.02
    assert not math.isfinite(clock.bounds(math.nan, 1201.0)[0])


def test_nothing_is_bounded_by_few_round_trips_coarse_stamps_or_after_a_step() -> None:
    def related(trips: int, *, rounded: bool = False) -> CameraClock:
        clock = CameraClock()
        for number in range(trips):
            sent_s = 4.0 * number + 0.004
            stamp_s = round(sent_s) if rounded else sent_s + 0.003
            clock.note(stamp_s, sent_s + 0.004)
            clock.note_trip(stamp_s, sent_s - 0.004, sent_s + 0.004)
        return clock

    assert not math.isfinite(related(4).bounds(17.003, 17.1)[0])
    assert related(9).bounds(33.003, 33.1) == pytest.approx((33.0, 33.004), abs=0.015)
    assert not math.isfinite(related(9, rounded=True).bounds(33.0, 33.1)[0])
    stepped = related(9)
    stepped.note(45.0, 37.0)
    assert stepped.steps == 1
    assert not math.isfinite(stepped.bounds(46.0, 38.1)[0])


def test_one_false_trip_among_the_first_bounds_nothing_wrongly() -> None:
    """A message that was stamped up to 60 ms before its request: it falsifies each pair that it is part of."""
    rng, bounded = random.Random(5), 0
    for trips in (5, 6, 9):
        for false in [*range(trips)] * 8:
            rate, clock = rng.uniform(0.97, 1.03), CameraClock()
            for number in range(trips):
                sent_s = 4.0 * number + rng.uniform(0.0, 0.5)
                asked_s = sent_s - rng.uniform(0.002, 0.02)
                if number == false:
                    asked_s = sent_s + rng.uniform(0.001, 0.06)
                received_s = max(sent_s, asked_s) + rng.uniform(0.002, 0.02)
                clock.note(500 + rate * sent_s, received_s)
                clock.note_trip(500 + rate * sent_s, asked_s, received_s)
            true_s = sent_s + rng.uniform(0.1, 4.0)
            earliest_s, latest_s = clock.bounds(500 + rate * true_s, true_s + 0.1)
            if math.isfinite(earliest_s):
                bounded += 1
                assert earliest_s <= true_s <= latest_s
    assert bounded > 60


def test_nothing_is_bounded_where_the_newest_trip_contradicts_the_others() -> None:
    """The camera's clock was stepped by less than what is found at once, or the newest is false."""
    clock = CameraClock()
    for number in range(9):
        sent_s = 4.0 * number + 0.004
        stamp_s = sent_s + (0.1 if number == 8 else 0.0)
        clock.note(stamp_s, sent_s + 0.004)
        clock.note_trip(stamp_s, sent_s - 0.004, sent_s + 0.004)
        earliest_s, _ = clock.bounds(stamp_s + 1.0, sent_s + 1.1)
        assert math.isfinite(earliest_s) is (4 <= number < 8)


@pytest.mark.parametrize("rate", [0.97, 1.0, 1.03])
def test_round_trips_bound_the_rate_too_where_other_messages_come_often(rate: float) -> None:
    """Those push the older ones out of what messages alone tell of the rate."""
    clock, rng, widths_s = CameraClock(), random.Random(3), []
    for number in range(200):
        sent_s = 0.2 * number + 0.013
        received_s = sent_s + rng.uniform(0.003, 0.006)
        clock.note(500 + rate * sent_s, received_s)
        if number % 10 == 0:
            clock.note_trip(500 + rate * sent_s, sent_s - rng.uniform(0.003, 0.006), received_s)
        if number > 60:
            earliest_s, latest_s = clock.bounds(500 + rate * (sent_s + 0.1), sent_s + 0.2)
            assert earliest_s - 1e-6 <= sent_s + 0.1 <= latest_s + 1e-6
            widths_s.append(latest_s - earliest_s)
    assert max(widths_s) < 0.025
    assert sum(widths_s) / len(widths_s) < 0.018


@pytest.mark.parametrize("step_s", [-300.0, -3.0, -0.7, 0.7, 3.0, 300.0])
def test_two_messages_after_a_step_relate_the_clocks_anew(step_s: float) -> None:
    clock = CameraClock()
    for sent_s in range(0, 40, 4):
        clock.note(500.003 + sent_s, sent_s + 0.02)
    for again_s in (40.0, 40.6):
        clock.note(500.003 + again_s + step_s, again_s + 0.02)
    assert clock.steps == 1
    found_s, error_s = clock.date(541.003 + step_s, 52.0)
    assert found_s == pytest.approx(41.0, abs=error_s)
    assert error_s < 0.1


@pytest.mark.parametrize(("step_s", "is_dated"), [(-3.0, False), (3.0, True)])
def test_a_stamp_that_may_be_from_before_a_step_and_from_after_it_is_not_dated(step_s: float, is_dated: bool) -> None:
    clock = CameraClock()
    for sent_s in range(0, 40, 4):
        clock.note(500.003 + sent_s, sent_s + 0.02)
    for again_s in (40.0, 40.6):
        clock.note(500.003 + again_s + step_s, again_s + 0.02)
    # 41 s by the clock as it is now; by the clock before a step back 38 s, by the one before a step forward 44 s
    assert math.isfinite(clock.date(541.003 + step_s, 42.0)[0]) is is_dated
    # a report of a photo from before the step that was long under way
    found_s, error_s = clock.date(535.003, 42.0)
    assert math.isnan(found_s) or found_s == pytest.approx(35.0, abs=error_s)


def test_one_message_that_was_held_up_is_no_step() -> None:
    clock = CameraClock()
    for sent_s in range(0, 40, 4):
        clock.note(sent_s + 0.003, sent_s + (2.5 if sent_s == 20 else 0.02))
    assert clock.steps == 0
    assert clock.date(38.003, 45.0)[0] == pytest.approx(38.02, abs=0.01)


def test_messages_that_waited_in_one_queue_are_no_step() -> None:
    """Both late by the same time, as after a stall of this machine: the next message that is on time clears it."""
    clock = CameraClock()
    for sent_s in range(0, 40, 4):
        clock.note(500.003 + sent_s, sent_s + 0.02)
    for stamp_s in (540.003, 540.023, 540.053):
        clock.note(stamp_s, 540.9 + (stamp_s - 540.003) - 500.0)
    assert clock.steps == 0
    found_s, error_s = clock.date(541.003, 42.5)  # a step back by 0.9 s, or none
    assert found_s - error_s <= 41.02 <= 41.92 <= found_s + error_s
    clock.note(544.003, 44.02)
    found_s, error_s = clock.date(541.003, 42.5)
    assert found_s == pytest.approx(41.02)
    assert error_s == pytest.approx(DELAY_S, abs=0.01)


def test_stamps_in_whole_seconds_are_no_steps_and_make_dates_coarse() -> None:
    rng = random.Random(3)
    clock = CameraClock()
    for number in range(100):
        sent_s = 10.0 + 3.37 * number
        clock.note(math.floor(500.0 + sent_s), sent_s + rng.uniform(0.005, 0.04))
        if number >= 10:
            truth_s = sent_s + rng.uniform(0.1, 3.0)
            found_s, error_s = clock.date(math.floor(500.0 + truth_s), truth_s + 4.0)
            assert abs(found_s - truth_s) <= error_s
            assert 1.0 <= error_s < 1.5
    assert clock.steps == 0
    assert clock.resolution_s == 1.0
    clock.note(1000.417, 510.0)
    assert clock.resolution_s == 0.0


def test_a_photo_is_not_in_doubt_after_a_reboot_of_the_camera() -> None:
    """Its stamp lies in the future by the clock that began anew, so it was given before: nothing is taken again."""
    clock = CameraClock()
    for sent_s in (0.0, 4.0, 8.0):
        clock.note(500.003 + sent_s, sent_s + 0.01)
    matcher = CaptureMatcher(clock)
    captures = [Capture(number, clock=VirtualClock()) for number in (1, 2, 3)]
    for number, capture in enumerate(captures):
        capture.commanded(10.0 + 2 * number)
        matcher.enter(capture)
        _tell(matcher, clock, index=number + 1, stamp_s=510.05 + 2 * number, received_s=10.3 + 2 * number)
    for sent_s in (20.0, 20.6):
        clock.note(sent_s - 19.0, sent_s + 0.01)
        matcher.redate(sent_s + 0.02)
    assert clock.steps == 1
    assert [capture.contradicted for capture in captures] == [False] * 3


def test_a_photo_is_in_doubt_if_its_stamp_may_be_from_after_a_step() -> None:
    """By the clock as it is now it was exposed 3 s earlier: it may be another photo."""
    clock = CameraClock()
    for sent_s in (0.0, 4.0, 5.0):
        clock.note(500.003 + sent_s, sent_s + 0.01)
    matcher = CaptureMatcher(clock)
    capture = Capture(1, clock=VirtualClock())
    capture.commanded(10.0)
    matcher.enter(capture)
    _tell(matcher, clock, index=1, stamp_s=510.05, received_s=10.3)
    clock.note(523.0, 20.01)
    matcher.redate(20.02)
    assert clock.steps == 1
    assert "stepped" in capture.known.contradiction


def _tell(matcher: CaptureMatcher, clock: CameraClock, *, index: int, stamp_s: float, received_s: float) -> None:
    evidence = CaptureEvidence(level=CAPTURED, received_s=received_s, image_index=index, exposed_vehicle_s=stamp_s)
    matcher.report(dated(Report(source=Source.CAPTURED, evidence=evidence), *clock.date(stamp_s, received_s)))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    rate=st.floats(0.95, 1.05),
    step_s=st.floats(-20, 20),
    lost=st.sampled_from([0.0, 0.05]),
    strangers=st.sampled_from([0.0, 0.03]),
)
@example(seed=64, rate=1.0, step_s=-3.0, lost=0.05, strangers=0.03)
@example(seed=575308049, rate=1.0, step_s=0.4, lost=0.05, strangers=0.03)
def test_every_report_finds_its_own_trigger_or_none(
    seed: int, rate: float, step_s: float, lost: float, strangers: float
) -> None:
    """A mission of 150 photos: slow clock, one step, lost reports, somebody else at the shutter; counts come too."""
    rng = random.Random(seed)
    clock = CameraClock()
    matcher = CaptureMatcher(clock)
    stepped_at, index, images = rng.randrange(20, 130), rng.randrange(50), 0

    def stamp(at_s: float, number: int) -> float:
        return 77.0 + rate * at_s + (step_s if number >= stepped_at else 0.0)

    def status(at_s: float, number: int) -> None:
        received_s = at_s + rng.uniform(0.005, 0.03)
        clock.note(stamp(at_s, number), received_s)
        matcher.redate(received_s)
        matcher.counted(images, received_s)

    def tell(at_s: float, number: int, delay_s: float) -> None:
        exposed[index] = at_s
        evidence = CaptureEvidence(
            level=CAPTURED, received_s=at_s + delay_s, image_index=index, exposed_vehicle_s=stamp(at_s, number)
        )
        report = Report(source=Source.CAPTURED, evidence=evidence)
        matcher.report(dated(report, *clock.date(stamp(at_s, number), evidence.received_s)))

    now_s = 100.0
    for at_s in (90.0, 93.0, 96.0):
        status(at_s, -1)
    truth: dict[int, int] = {}
    exposed: dict[int, float] = {}
    captures: list[Capture] = []
    for number in range(150):
        now_s += rng.uniform(2.0, 4.0)
        if rng.random() < strangers:
            index, images = index + 1, images + 1
            tell(now_s - 0.9, number, 0.3)
        capture = Capture(number, clock=VirtualClock())
        capture.commanded(now_s)
        matcher.enter(capture)
        capture.acknowledged(now_s + 0.01)
        captures.append(capture)
        index, images = index + 1, images + 1
        truth[number] = index
        status(now_s + 0.02, number)
        if rng.random() >= lost:
            tell(now_s + rng.uniform(0.03, 0.2), number, rng.uniform(0.1, 0.3))
        if capture.known.level < CAPTURED:  # what the evidence's nudges do
            status(now_s + 1.0, number)
            status(now_s + 1.6, number)
            matcher.redate(now_s + 1.7)
    named = [capture for capture in captures if capture.known.image_index >= 0]
    for capture in named:
        found = capture.known
        if math.isfinite(found.exposed_s):  # whichever photo it is, its date is true
            assert abs(found.exposed_s - exposed[found.image_index]) <= found.exposed_error_s + LATE_S
        if found.image_index != truth[capture.number]:
            # somebody else's photo in the place of a lost one is recognised by its date, long after the trigger, or by
            # having none, which contradicts this camera
            assert found.contradiction or found.exposed_s - capture.commanded_s > 0.4
    assert len(named) >= 0.85 * 150
    if not lost and not strangers:
        assert len(named) >= 147


def test_a_contradiction_ends_when_the_report_finds_its_trigger() -> None:
    clock = CameraClock()
    for sent_s in (0.0, 4.0, 8.0):
        clock.note(sent_s, sent_s + 0.01)
    matcher = CaptureMatcher(clock)
    captures = [Capture(number, clock=VirtualClock()) for number in (1, 2)]
    for capture, commanded_s in zip(captures, (10.0, 12.0), strict=True):
        capture.commanded(commanded_s)
        matcher.enter(capture)
    # the camera's clock was stepped back by 11 s before the second photo
    evidence = CaptureEvidence(level=CAPTURED, received_s=12.4, image_index=2, exposed_vehicle_s=1.1)
    assert matcher.report(dated(Report(source=Source.CAPTURED, evidence=evidence), *clock.date(1.1, 12.4))) is None
    assert [capture.contradicted for capture in captures] == [True, True]
    for sent_s in (12.5, 13.1):
        clock.note(sent_s - 11.0, sent_s + 0.01)
    matcher.redate(13.2)
    assert captures[1].known.image_index == 2
    assert [capture.contradicted for capture in captures] == [False, False]


def test_a_contradiction_is_never_resolved_by_a_count() -> None:
    """A report that was exposed before its trigger, and nothing tells why: neither it nor the count proves the shot."""
    clock = CameraClock()
    for sent_s in (0.0, 4.0, 8.0):
        clock.note(sent_s, sent_s + 0.01)
    matcher = CaptureMatcher(clock)
    matcher.counted(10, 8.0)
    capture = Capture(1, clock=VirtualClock())
    capture.commanded(10.0)
    matcher.enter(capture)
    evidence = CaptureEvidence(level=CAPTURED, received_s=10.4, image_index=5, exposed_vehicle_s=8.5)
    assert matcher.report(dated(Report(source=Source.CAPTURED, evidence=evidence), *clock.date(8.5, 10.4))) is None
    matcher.counted(11, 10.5)
    assert capture.known.level is EvidenceLevel.COMMANDED  # the report is held, the camera is asked
    assert capture.contradicted  # whatever evidence is asked for, it is not accepted meanwhile
    matcher.redate(14.0)
    assert capture.contradicted
    assert "photo 5" in capture.known.contradiction
    matcher.counted(12, 14.1)
    assert capture.known.level is EvidenceLevel.COMMANDED
    assert matcher.foreign_photos == 1
    # its own report settles it
    evidence = CaptureEvidence(level=CAPTURED, received_s=14.4, image_index=6, exposed_vehicle_s=10.1)
    assert matcher.report(dated(Report(source=Source.CAPTURED, evidence=evidence), *clock.date(10.1, 14.4))) is capture
    assert not capture.contradicted
    assert capture.known.level is CAPTURED
