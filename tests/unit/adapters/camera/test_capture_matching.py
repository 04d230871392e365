"""Reports late, twice, lost, out of order, of photos that are not ours: the right trigger, or none."""

import asyncio
import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.adapters.camera.camera_clock import CameraClock
from panoexec.adapters.camera.capture import Capture, Report, Source, dated
from panoexec.adapters.camera.capture_matching import CaptureMatcher
from panoexec.devices import CaptureEvidence, EvidenceLevel
from panoexec.errors import DeviceError
from tests.unit.fakes.virtual import VirtualClock, run_virtual

CAPTURED = EvidenceLevel.CAPTURE_MESSAGE


def report(
    index: int,
    received_s: float,
    *,
    exposed_s: float = math.nan,
    source: Source = Source.CAPTURED,
    level: EvidenceLevel = CAPTURED,
    success: bool = True,
    url: str = "",
) -> Report:
    evidence = CaptureEvidence(level=level, received_s=received_s, image_index=index, file_url=url)
    return Report(source=source, evidence=evidence, exposed_s=exposed_s, success=success)


def stamped(index: int, received_s: float, stamp_s: float, clock: CameraClock) -> Report:
    evidence = CaptureEvidence(level=CAPTURED, received_s=received_s, image_index=index, exposed_vehicle_s=stamp_s)
    return dated(Report(source=Source.CAPTURED, evidence=evidence), *clock.date(stamp_s, received_s))


def fired(ledger: CaptureMatcher, number: int, commanded_s: float, *, final: bool = False) -> Capture:
    capture = Capture(number, clock=VirtualClock(), final=final)
    capture.commanded(commanded_s)
    ledger.enter(capture)
    capture.acknowledged(commanded_s + 0.01)
    return capture


def known(capture: Capture) -> tuple[EvidenceLevel, int]:
    return capture.known.level, capture.known.image_index


ACKNOWLEDGED = (EvidenceLevel.ACKNOWLEDGED, -1)


def test_levels_rise_and_never_fall_and_the_best_report_wins() -> None:
    ledger = CaptureMatcher()
    capture = Capture(1, clock=VirtualClock())
    capture.commanded(10.0)
    assert capture.known == CaptureEvidence(level=EvidenceLevel.COMMANDED, received_s=10.0)
    ledger.enter(capture)
    capture.acknowledged(10.01)
    assert (capture.commanded_s, capture.acknowledged_s) == (10.0, 10.01)
    ledger.report(report(7, 10.2, exposed_s=10.1, url="file:///a.jpg"))
    ledger.report(report(3, 10.3, exposed_s=10.1, source=Source.FEEDBACK, level=EvidenceLevel.COUNTED))
    assert known(capture) == (CAPTURED, 7)
    assert capture.known.received_s == 10.2
    assert capture.known.file_url == "file:///a.jpg"
    assert capture.known.duplicates == 1
    capture.file_seen(11.0)
    assert known(capture) == (EvidenceLevel.FILE_SEEN, 7)


def test_the_same_index_twice_is_one_photo() -> None:
    ledger = CaptureMatcher()
    first, second = fired(ledger, 1, 10.0), fired(ledger, 2, 12.0)
    for received_s in (10.2, 10.4, 12.6):  # the last one comes after the next trigger
        ledger.report(report(5, received_s, exposed_s=10.1))
    assert known(first) == (CAPTURED, 5)
    assert first.known.duplicates == 2
    assert known(second) == ACKNOWLEDGED
    assert ledger.foreign_photos == 0


def test_time_decides_when_a_report_was_lost() -> None:
    ledger = CaptureMatcher()
    first, second = fired(ledger, 1, 10.0), fired(ledger, 2, 12.0)
    ledger.report(report(5, 12.3, exposed_s=12.1))
    assert known(first) == ACKNOWLEDGED
    assert known(second) == (CAPTURED, 5)
    # and the lost one may still be found
    ledger.report(report(4, 13.0, exposed_s=10.1))
    assert known(first) == (CAPTURED, 4)


def test_time_decides_when_a_report_is_late() -> None:
    ledger = CaptureMatcher()
    first, second = fired(ledger, 1, 10.0), fired(ledger, 2, 12.0)
    ledger.report(report(4, 12.2, exposed_s=10.1))
    assert (known(first), known(second)) == ((CAPTURED, 4), ACKNOWLEDGED)


@pytest.mark.parametrize("exposed_s", [9.5, 10.3, 21.0], ids=["before ours", "second for one trigger", "long after"])
def test_a_photo_that_is_not_ours_proves_nothing(exposed_s: float) -> None:
    ledger = CaptureMatcher()
    if exposed_s < 10.0 or exposed_s > 20.0:
        capture = fired(ledger, 1, 10.0)
        assert ledger.report(report(8, 22.0, exposed_s=exposed_s)) is None
        assert known(capture) == ACKNOWLEDGED
    else:
        capture = fired(ledger, 1, 10.0)
        ledger.report(report(7, 10.2, exposed_s=10.1))
        assert ledger.report(report(8, 10.5, exposed_s=exposed_s)) is None
        assert known(capture) == (CAPTURED, 7)
    assert ledger.foreign_photos == 1


def test_without_time_the_index_decides_once_one_is_known() -> None:
    ledger = CaptureMatcher()
    first = fired(ledger, 1, 10.0)
    ledger.report(report(100, 10.5))
    second, third = fired(ledger, 2, 12.0), fired(ledger, 3, 14.0)
    ledger.report(report(102, 14.5))
    assert [known(c) for c in (first, second, third)] == [(CAPTURED, 100), ACKNOWLEDGED, (CAPTURED, 102)]
    ledger.report(report(101, 14.6))
    assert known(second) == (CAPTURED, 101)


def test_without_time_and_index_the_oldest_is_served_first() -> None:
    ledger = CaptureMatcher()
    first, second = fired(ledger, 1, 10.0), fired(ledger, 2, 11.0)
    ledger.report(report(-1, 11.5, url="a"))
    ledger.report(report(-1, 11.6, url="b"))
    assert [c.known.file_url for c in (first, second)] == ["a", "b"]


def test_a_camera_that_rebooted_counts_from_one_again() -> None:
    ledger = CaptureMatcher()
    first = fired(ledger, 1, 10.0)
    ledger.report(report(1, 10.2, exposed_s=10.1))
    second = fired(ledger, 2, 90.0)
    ledger.report(report(1, 90.2, exposed_s=90.1))
    assert (known(first), known(second)) == ((CAPTURED, 1), (CAPTURED, 1))
    assert first.known.duplicates == 0


def test_a_refused_trigger_gets_no_photo() -> None:
    ledger = CaptureMatcher()
    refused = fired(ledger, 1, 10.0)
    ledger.withdraw(refused)
    ledger.withdraw(refused)
    assert ledger.report(report(5, 10.2, exposed_s=10.1)) is None


def test_a_count_proves_the_newest_trigger_and_the_first_count_nothing() -> None:
    ledger = CaptureMatcher()
    before = fired(ledger, 1, 5.0)
    ledger.counted(40, 9.0)
    lost, taken = fired(ledger, 2, 10.0), fired(ledger, 3, 12.0)
    ledger.counted(41, 12.5)
    assert known(before) == ACKNOWLEDGED
    assert known(lost) == ACKNOWLEDGED
    assert known(taken) == (EvidenceLevel.COUNTED, -1)
    ledger.counted(41, 13.0)
    assert known(lost) == ACKNOWLEDGED
    ledger.counted(42, 13.5)  # it was late after all
    assert known(lost) == (EvidenceLevel.COUNTED, -1)
    ledger.counted(0, 20.0)  # formatted
    third = fired(ledger, 4, 21.0)
    ledger.counted(1, 21.5)
    assert known(third) == (EvidenceLevel.COUNTED, -1)


def test_evidence_comes_when_it_is_there_and_the_best_there_is_at_the_end() -> None:
    async def main() -> None:
        clock, ledger = VirtualClock(), CaptureMatcher()
        now = clock.monotonic()
        good, poor = fired(ledger, 1, now), fired(ledger, 2, now)
        loop = asyncio.get_running_loop()
        loop.call_later(2.0, lambda: good.add(report(5, now + 2.0)))
        loop.call_later(
            3.0, lambda: poor.add(report(5, now + 3.0, source=Source.FEEDBACK, level=EvidenceLevel.COUNTED))
        )
        found = await good.evidence(CAPTURED, 8.0)
        assert (found.level, clock.monotonic() - now) == (CAPTURED, 2.0)
        found = await poor.evidence(CAPTURED, 8.0)
        assert (found.level, clock.monotonic() - now) == (EvidenceLevel.COUNTED, 8.0)
        # the timeout counts from the trigger: now it is over at once
        await poor.evidence(CAPTURED, 8.0)
        assert clock.monotonic() - now == 8.0

    run_virtual(main())


def test_evidence_does_not_wait_for_what_cannot_come() -> None:
    async def main() -> None:
        clock, ledger = VirtualClock(), CaptureMatcher()
        now = clock.monotonic()
        cable = fired(ledger, 1, now, final=True)
        assert (await cable.evidence(CAPTURED, 8.0)).level is EvidenceLevel.ACKNOWLEDGED
        failed = fired(ledger, 2, now)
        asyncio.get_running_loop().call_later(1.0, lambda: failed.add(report(5, now + 1.0, success=False)))
        assert (await failed.evidence(CAPTURED, 8.0)).level is EvidenceLevel.ACKNOWLEDGED
        assert clock.monotonic() - now == 1.0

    run_virtual(main())


def test_the_camera_is_asked_for_lost_news_and_may_refuse() -> None:
    async def main() -> None:
        clock = VirtualClock()
        began = clock.monotonic()
        asked = []

        async def poll(capture: Capture) -> None:
            asked.append(clock.monotonic() - began)
            if len(asked) < 2:
                raise DeviceError("not answered")
            capture.add(report(5, clock.monotonic()))

        capture = Capture(1, clock=clock, poll=poll)
        capture.commanded(began)
        assert (await capture.evidence(CAPTURED, 8.0)).level is CAPTURED
        assert asked == [1.0, 3.0]

    run_virtual(main())


@settings(max_examples=200, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    photos=st.integers(1, 30),
    lost=st.floats(0, 0.6),
    unreported=st.floats(0, 0.6),
    twice=st.floats(0, 0.6),
)
def test_no_photo_is_ever_credited_to_another_trigger(
    seed: int, photos: int, lost: float, unreported: float, twice: float
) -> None:
    """Photos lost, reports lost, doubled, delayed past later triggers and shuffled; the index is the truth."""
    rng = random.Random(seed)
    stamps = CameraClock()
    ledger = CaptureMatcher(stamps)
    boot = rng.uniform(-1000, 1000)
    arrivals: list[tuple[float, float, int, int]] = []
    now, index = 50.0, rng.randrange(100)
    triggers: list[tuple[float, Capture]] = []
    truth: dict[int, int] = {}
    for number in range(photos):
        now += rng.uniform(0.5, 3.0)
        capture = Capture(number, clock=VirtualClock())
        capture.commanded(now)
        triggers.append((now, capture))
        if rng.random() >= lost:
            index += 1
            exposed = now + rng.uniform(0.0, 0.3)
            if rng.random() >= unreported:
                truth[number] = index
                copies = 2 if rng.random() < twice else 1
                arrivals += [(exposed + rng.uniform(0.05, 4.0), exposed, index, number) for _ in range(copies)]
    for sent in (30.0, 35.0, 40.0, 45.0):
        stamps.note(sent - boot, sent + rng.uniform(0, 0.03))
    events = [(t, 0, n, c) for n, (t, c) in enumerate(triggers)] + [
        (received, 1, n, arrival) for n, arrival in enumerate(arrivals) for received in [arrival[0]]
    ]
    for time_s, _kind, _n, what in sorted(events, key=lambda event: event[:3]):
        if isinstance(what, Capture):
            ledger.enter(what)
        else:
            stamps.note(time_s - 0.01 - boot, time_s)  # the camera's clock is asked for at each photo
            ledger.redate(time_s)
            _, exposed, photo, _number = what
            ledger.report(stamped(photo, time_s, exposed - boot, stamps))
    for _, capture in triggers:
        found = capture.known.image_index
        if capture.number in truth:
            assert found in (truth[capture.number], -1)
        else:
            assert found == -1
    # what was exposed well before the next trigger is credited for sure
    for (start, capture), (following, _) in zip(triggers, [*triggers[1:], (math.inf, triggers[0][1])], strict=True):
        if capture.number in truth and following - start > 0.5:
            assert capture.known.image_index == truth[capture.number]


def test_a_photo_that_a_reporting_camera_does_not_report_is_contradicted() -> None:
    async def main() -> None:
        clock, ledger = VirtualClock(), CaptureMatcher()
        now = clock.monotonic()
        capture = Capture(1, clock=clock, must_report=True)
        capture.commanded(now)
        ledger.enter(capture)
        capture.acknowledged(now + 0.01)
        ledger.counted(4, now - 1.0)
        ledger.counted(5, now + 1.0)
        assert capture.known.level is EvidenceLevel.COUNTED
        assert capture.known.contradiction == "", "its report may still come"
        found = await capture.evidence(EvidenceLevel.COUNTED, 3.0)
        assert clock.monotonic() - now == 3.0, "a count alone does not end the wait"
        assert found.contradiction == "the camera did not report this photo, but reports its photos"
        capture.add(report(5, now + 4.0, exposed_s=now + 0.1))
        assert capture.known.contradiction == ""

    run_virtual(main())


def test_an_impossible_stamp_of_a_camera_that_dates_its_photos_is_no_proof() -> None:
    clock = CameraClock()
    for second in range(10):
        clock.note(100.0 + second, 10.0 + second)
    ledger = CaptureMatcher(clock)
    first, second_one = fired(ledger, 1, 20.0), fired(ledger, 2, 22.0)
    ledger.report(stamped(1, 20.3, 110.1, clock))
    assert (known(first), ledger.dated_photos) == ((CAPTURED, 1), 1)
    ledger.report(stamped(2, 22.3, 500.0, clock))
    ledger.redate(30.0)
    assert known(second_one) == (CAPTURED, 2)
    assert second_one.known.contradiction == "the camera's stamp of photo 2 cannot be true: it may be another one"
    ledger.report(stamped(2, 22.6, 500.0, clock))  # the same again does not make it true
    assert second_one.known.contradiction


def test_a_camera_that_never_dates_its_photos_is_not_contradicted() -> None:
    ledger = CaptureMatcher()
    one = fired(ledger, 1, 10.0)
    ledger.report(report(1, 10.3))
    assert (ledger.dated_photos, ledger.undated_photos) == (0, 1)
    assert (known(one), one.known.contradiction) == ((CAPTURED, 1), "")


def test_a_trigger_that_may_be_deferred_is_waited_for_until_it_is_reported_or_cannot_be() -> None:
    async def main() -> None:
        clock = VirtualClock()
        now = clock.monotonic()
        plain, deferred, lost = (Capture(n, clock=clock, defer_s=s) for n, s in ((1, 0.0), (2, 3.0), (3, 3.0)))
        for capture in (plain, deferred, lost):
            capture.commanded(now)
        assert await plain.fired() == now
        loop = asyncio.get_running_loop()
        feedback = report(5, now + 1.5, exposed_s=now + 1.5, source=Source.FEEDBACK, level=EvidenceLevel.COUNTED)
        loop.call_later(1.5, lambda: deferred.add(dated(feedback, now + 1.5, 0.1)))
        assert await deferred.fired() == now + 1.5
        assert clock.monotonic() - now == 1.5
        assert await lost.fired() == now
        assert clock.monotonic() - now == 3.0

    run_virtual(main())


def test_a_photo_of_a_refused_trigger_is_found_out() -> None:
    ledger = CaptureMatcher()
    refused = fired(ledger, 1, 10.0)
    ledger.withdraw(refused)
    assert ledger.report(report(3, 11.4, exposed_s=11.2)) is None
    assert ledger.refused_taken_after_s == pytest.approx(1.2)
    assert known(refused) == ACKNOWLEDGED
