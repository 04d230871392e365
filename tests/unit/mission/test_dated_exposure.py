"""Dated photos: the pose at the date of the exposure decides."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from panoexec.devices import CaptureEvidence, EvidenceLevel
from panoexec.mission.dated_exposure import ShutterLag, has_window, when, window
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.flying import fly
from tests.unit.fakes.world import World, a_plan, some_settings


def late(world: World, latency_s: float) -> None:
    world.camera.latency_s = latency_s
    world.camera.dates = True


@pytest.mark.parametrize("latency_s", [0.3, 0.8, 1.2, 2.5])
def test_a_late_shutter_is_found_out_at_its_first_photo_and_waited_for_from_then_on(latency_s: float) -> None:
    world = fly(prepare=lambda w: late(w, latency_s))
    assert world.record.state is MissionState.COMPLETE
    check_mission(world, world.record)  # each accepted photo was exposed in tolerance, by the fakes' truth
    rejected = world.sink.of(ev.ShotRejected)
    assert len(rejected) <= 3
    assert {event.code for event in rejected} <= {"late_exposure"}
    assert all(f"exposed {latency_s:.2f} s after its trigger" in event.reason for event in rejected)
    warned = [event for event in world.sink.of(ev.Warned) if event.code == "latency"]
    assert len(warned) == 1
    assert f"exposes {latency_s:.2f} s after its trigger" in warned[0].text
    assert "latency_s is" in warned[0].text


def test_a_shutter_as_configured_costs_nothing() -> None:
    plain, dated = fly(), fly(prepare=lambda w: setattr(w.camera, "dates", True))
    assert dated.record.attempts == plain.record.attempts == 4
    assert not dated.sink.of(ev.Warned)
    took_s = [world.journal.events[-1].clock_s for world in (plain, dated)]
    assert took_s[1] == pytest.approx(took_s[0], abs=0.2)


def test_a_photo_that_may_be_another_one_is_taken_again() -> None:
    why = "the camera reported photo 7, which fits no trigger"
    world = fly(prepare=lambda w: w.camera.contradictions.update({1: why}))
    assert world.record.state is MissionState.COMPLETE
    rejected = world.sink.of(ev.ShotRejected)
    assert [(event.code, event.reason) for event in rejected] == [("evidence", why)]


def test_the_window_is_bounded_by_trigger_and_report() -> None:
    settings = some_settings(latency_s=0.1, exposure_s=0.02)

    def found(level: EvidenceLevel, exposed_s: float, received_s: float = 99.0) -> CaptureEvidence:
        return CaptureEvidence(level=level, received_s=received_s, exposed_s=exposed_s, exposed_error_s=0.05)

    captured = found(EvidenceLevel.CAPTURE_MESSAGE, 10.02, received_s=10.06)
    assert window(captured, 10.0, settings) == pytest.approx((10.0, 10.06))
    assert window(found(EvidenceLevel.FEEDBACK_PIN, 11.0), 10.0, settings) == pytest.approx((10.0, 11.07))
    # a trigger that is dated says that the shutter opens within the latency after it, unless its report was held up
    assert window(found(EvidenceLevel.COUNTED, 11.0), 10.0, settings) == pytest.approx((10.0, 11.12))
    assert window(found(EvidenceLevel.COUNTED, 10.03), 10.0, settings) == pytest.approx((10.0, 10.12))


def test_a_photo_that_is_only_counted_was_exposed_before_its_count() -> None:
    settings = some_settings(latency_s=0.1, exposure_s=0.02)
    counted = CaptureEvidence(level=EvidenceLevel.COUNTED, received_s=13.0, counted_s=13.0)
    assert has_window(counted)
    assert window(counted, 10.0, settings) == (10.0, 13.0)
    assert when(counted, 10.0) == "the photo is only counted, 3.00 s after its trigger"
    lag = ShutterLag(0.1)
    assert "each pose is held until its photo is counted, 3.0 s after the trigger" in lag.note(counted, 10.0)
    assert lag.bound_s == 3.0
    assert lag.note(counted, 10.0) == "", "once"
    reported = replace(counted, level=EvidenceLevel.CAPTURE_MESSAGE, reported_s=10.4)
    assert window(reported, 10.0, settings) == (10.0, 10.4), "a report tells more"


def test_what_cannot_be_a_lag_is_not_learned() -> None:
    lag = ShutterLag(0.1)
    for exposed_s, error_s in ((math.nan, math.nan), (11.0, 1.0), (9.0, 0.05), (40.0, 0.05)):
        found = CaptureEvidence(
            level=EvidenceLevel.CAPTURE_MESSAGE, received_s=99.0, exposed_s=exposed_s, exposed_error_s=error_s
        )
        assert lag.note(found, 10.0) == ""
    assert lag.bound_s == 0.1


def test_a_date_that_was_judged_once_is_not_judged_again_when_its_samples_are_gone() -> None:
    """A second look at it a minute later found no samples of then, and the photo was taken again."""

    def slow(world: World) -> None:
        late(world, 0.15)
        world.gimbal.rate_hz = 100.0  # as many samples are kept as come in 20 s

    world = fly(prepare=slow, plan=a_plan(12), settings=some_settings(interval_s=4.0))
    assert world.record.state is MissionState.COMPLETE
    assert not world.sink.of(ev.ShotRevoked)
