"""Faults: syntax and timing."""

from __future__ import annotations

import itertools

import pytest

from panoexec.errors import UsageError
from panoexec.sim.faults import CONTENT_FAULTS, FAULTS, Faults, FaultSpec, Kind, parse_fault

ISSUE_NAMES = {
    "link-loss",
    "reboot",
    "attitude-stop",
    "attitude-frozen",
    "attitude-late",
    "attitude-nan",
    "gimbal-stuck",
    "gimbal-slow",
    "drift",
    "control-stolen",
    "mode-change",
    "photo-lost",
    "photo-refused",
    "capture-lost",
    "capture-twice",
    "storage-full",
    "battery-low",
    "gps-lost",
    "rtl",
    "gust",
    "clock-jump",
    *CONTENT_FAULTS,
}


def test_every_required_fault_exists_and_can_be_given_by_name_only() -> None:
    assert set(FAULTS) == ISSUE_NAMES
    for name, fault in FAULTS.items():
        spec = parse_fault(name)
        assert spec.name == name
        assert bool(spec.probability) == (fault.kind is Kind.PHOTO)
        assert bool(spec.spans) == (fault.kind is not Kind.PHOTO)


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("drift=0.4", FaultSpec(name="drift", size=2.0, probability=0.4)),
        ("drift=1.5", FaultSpec(name="drift", size=1.5, probability=0.3)),
        ("drift=#3,#5,x1.5", FaultSpec(name="drift", size=1.5, photos=(3, 5))),
        ("photo-lost=5+10", FaultSpec(name="photo-lost", size=0.0, spans=((5.0, 15.0),))),
        ("link-loss=20+5", FaultSpec(name="link-loss", size=0.0, spans=((20.0, 25.0),))),
        ("link-loss=20", FaultSpec(name="link-loss", size=0.0, spans=((20.0, 25.0),))),
        ("link-loss=t3+1,40+2", FaultSpec(name="link-loss", size=0.0, spans=((40.0, 42.0),), absolute_spans=((3, 4),))),
        ("gust=0.5,x9", FaultSpec(name="gust", size=9.0, probability=0.5)),
        ("battery-low=30,x0.1", FaultSpec(name="battery-low", size=0.1, spans=((30.0, 35.0),))),
    ],
)
def test_values_give_times_and_size(text: str, spec: FaultSpec) -> None:
    assert parse_fault(text) == spec


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("gimbal-stuk", r"unknown fault 'gimbal-stuk'; known are attitude-frozen, .*gimbal-stuck"),
        ("=3", "unknown fault ''"),
        ("link-loss=soon", "invalid part 'soon'; expected a probability below 1 like 0.3, or seconds START"),
        ("link-loss=x3", "invalid part 'x3'"),
        ("link-loss=#3", "invalid part '#3'"),
        ("photo-lost=7", "invalid part '7'; .*photo numbers like #3"),
        ("drift=t3", "invalid part 't3'; .*a size in deg like x2"),
        ("drift=#0", "invalid part '#0'"),
        ("drift=-1", "invalid part '-1'"),
    ],
)
def test_invalid_values_are_rejected_with_the_accepted_forms(text: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint) as caught:
        parse_fault(text)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def faults(*texts: str, seed: int = 1) -> Faults:
    return Faults([parse_fault(text) for text in texts], seed=seed)


def test_spans_count_from_the_first_photo_or_from_the_start() -> None:
    both = faults("link-loss=20+5,t3+1")
    assert [both.active("link-loss", t) for t in (2.9, 3.0, 3.9, 4.0, 25.0)] == [False, True, True, False, False]
    both.photo_commanded(100.0)
    both.photo_commanded(103.0)
    assert [both.active("link-loss", t) for t in (119.0, 120.0, 124.9, 125.0)] == [False, True, True, False]
    assert not both.active("gust", 120.0)


def test_moments_fire_once_each() -> None:
    two = faults("reboot=t5,t50")
    fired = [t for t in range(100) if two.fires("reboot", float(t))]
    assert fired == [5, 50]
    assert two.size("reboot") == 3.0
    assert not two.fires("battery-low", 99.0)


def test_photo_faults_by_number_span_and_probability() -> None:
    some = faults("photo-lost=#2", "capture-lost=10+5", "capture-twice=0.25")
    hits: dict[str, list[int]] = {"photo-lost": [], "capture-lost": [], "capture-twice": []}
    for number in range(400):
        some.photo_commanded(50.0 + number)
        for name, photos in hits.items():
            if some.photo(name):
                photos.append(number)
    assert hits["photo-lost"] == [1]
    assert hits["capture-lost"] == [10, 11, 12, 13, 14]
    assert 70 < len(hits["capture-twice"]) < 130
    assert not some.photo("drift")


@pytest.mark.parametrize("value", ["", "=0.3", "=0.99"])
def test_drift_never_strikes_twice_in_a_row_so_that_a_retake_ends_well(value: str) -> None:
    one = faults(f"drift{value}")
    hits = []
    for number in range(300):
        one.photo_commanded(float(number))
        hits.append(one.photo("drift"))
    assert sum(hits) > 40
    assert not any(a and b for a, b in itertools.pairwise(hits))


def test_random_spans_depend_on_the_seed_and_not_on_queries() -> None:
    def active(seed: int, step: float) -> list[bool]:
        one = faults("gust=0.8", seed=seed)
        one.photo_commanded(10.0)
        return [one.active("gust", 10.0 + i * step) for i in range(int(1800 / step))]

    often, seldom = active(1, 0.5), active(1, 5.0)
    assert often[::10] == seldom
    assert any(often)
    assert active(2, 5.0) != seldom
    # 0.8 a minute for 30 minutes, 8 s each
    assert 8 * 12 < 0.5 * sum(often) < 8 * 30
