"""Which photo in a tethered camera is whose: no photo ever goes to a trigger that did not take it."""

from __future__ import annotations

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.camera.capture import Capture
from panoexec.adapters.camera.tethered.photos import AMBIGUOUS, PhotoBook
from panoexec.clock import VehicleClock

LATE_S = 10.0
FOLDER = "/store_00010001/DCIM/100PANOX"


@dataclass
class Bench:
    """A book with triggers; times in seconds."""

    book: PhotoBook = field(default_factory=lambda: PhotoBook(LATE_S))
    clock: VehicleClock = field(default_factory=VehicleClock)
    number: int = 0

    def trigger(self, at_s: float) -> Capture:
        self.number += 1
        capture = Capture(self.number, clock=self.clock, must_report=True)
        capture.commanded(at_s)
        self.book.sent(capture)
        return capture

    def seen(self, *names: str, at_s: float) -> dict[str, Capture]:
        found = self.book.seen([(FOLDER, name) for name in names], at_s)
        return {photo.file: capture for photo, capture in found}


def test_a_photo_goes_to_the_only_trigger_that_waits() -> None:
    bench = Bench()
    bench.book.baseline([(FOLDER, "IMG_0001.JPG"), (FOLDER, "MVI_0002.MP4"), ("/", "DCIM.CTG")])
    capture = bench.trigger(1.0)
    assert bench.seen("IMG_0001.JPG", at_s=1.2) == {}
    assert bench.seen("IMG_0002.JPG", at_s=1.5) == {"IMG_0002.JPG": capture}
    assert bench.seen("IMG_0002.JPG", at_s=1.6) == {}
    assert (bench.book.count, bench.book.surplus) == (2, [])


def test_raw_and_jpeg_are_one_photo_in_either_order() -> None:
    for names in (("A.NEF", "A.JPG"), ("A.JPG", "A.NEF")):
        bench = Bench()
        capture = bench.trigger(0.0)
        (found,) = bench.book.seen([(FOLDER, names[0])], 0.5)
        assert bench.seen(names[1], at_s=0.6) == {}
        photo = found[0]
        assert (found[1], photo.file, photo.is_raw_only) == (capture, "A.JPG", False)
        assert photo.urls == [f"gphoto2:{FOLDER}/{name}" for name in names]
        assert bench.book.find(f"gphoto2:{FOLDER}/A.JPG") is photo


def test_two_lost_events_are_matched_in_order_once_both_photos_are_listed() -> None:
    bench = Bench()
    first, second = bench.trigger(0.0), bench.trigger(2.0)
    assert bench.seen("B.JPG", at_s=2.5) == {}
    assert bench.seen("C.JPG", at_s=2.6) == {"B.JPG": first, "C.JPG": second}


def test_a_photo_that_may_be_of_a_trigger_that_hung_is_nobodys_proof() -> None:
    bench = Bench()
    hung = bench.trigger(0.0)
    bench.book.gave_up(hung, 10.0)
    assert bench.book.doubt_until_s(4.0) == 10.0
    capture = bench.trigger(5.0)
    assert bench.seen("B.JPG", at_s=6.0) == {}
    assert capture.known.contradiction == AMBIGUOUS
    # once both are there, the first is that of the one that hung
    assert bench.seen("C.JPG", at_s=7.0) == {"C.JPG": capture}
    assert [photo.stem for photo in bench.book.surplus] == ["B"]


def test_the_photo_of_a_trigger_that_hung_is_over_before_the_next_trigger() -> None:
    bench = Bench()
    bench.book.gave_up(bench.trigger(0.0), 10.0)
    assert bench.seen("B.JPG", at_s=3.0) == {}
    assert bench.book.doubt_until_s(3.1) == float("-inf")
    capture = bench.trigger(4.0)
    assert bench.seen("C.JPG", at_s=4.5) == {"C.JPG": capture}
    assert [photo.stem for photo in bench.book.surplus] == ["B"]


def test_more_photos_than_triggers_prove_nothing() -> None:
    bench = Bench()
    capture = bench.trigger(0.0)
    assert bench.seen("B.JPG", "C.JPG", at_s=0.5) == {}
    assert capture.known.contradiction == AMBIGUOUS
    assert len(bench.book.surplus) == 2


@given(
    st.lists(st.tuples(st.sampled_from(["taken", "lost_event", "hung_taken", "hung_not"]), st.booleans()), max_size=30)
)
def test_whatever_happens_no_photo_goes_to_another_trigger(steps: list[tuple[str, bool]]) -> None:
    bench, now_s, photos = Bench(), 0.0, 0
    listed: list[tuple[str, str]] = []
    owner: dict[str, Capture] = {}
    found: dict[str, Capture] = {}
    for what, listed_soon in steps:
        now_s += 1.0
        if bench.book.waiting or bench.book.doubt_until_s(now_s) > now_s:  # as the adapter does before a trigger
            for one, capture in bench.book.seen(listed, now_s):
                found[one.file] = capture
            if bench.book.waiting or bench.book.doubt_until_s(now_s) > now_s:
                now_s += LATE_S + 1.0
                for capture in bench.book.waiting:
                    bench.book.gave_up(capture, now_s)
                now_s += 0.1
        capture = bench.trigger(now_s)
        taken = what != "hung_not"
        if taken:
            photos += 1
            name = f"IMG_{photos:04d}.JPG"
            listed.append((FOLDER, name))
            owner[name] = capture
        now_s += 0.5
        all_now = listed if listed_soon else []
        events = [listed[-1]] if what == "taken" else all_now
        if what.startswith("hung"):
            bench.book.gave_up(capture, now_s + LATE_S)
        for one, matched in bench.book.seen(events, now_s):
            found[one.file] = matched
    assert all(owner[name] is capture for name, capture in found.items())
    assert len({id(capture) for capture in found.values()}) == len(found)
