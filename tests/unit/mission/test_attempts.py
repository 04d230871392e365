"""Attempts on fakes in virtual time: the gate, the trigger, the proof of a photo."""

from __future__ import annotations

import itertools

import pytest
import structlog

from panoexec.devices import EvidenceLevel, YawFrame
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.camera import FakeCapture
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.flying import fly
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world, some_settings

S = MissionState


def test_a_mission_without_trouble_takes_each_shot_once() -> None:
    world = fly()
    assert world.record.state is S.COMPLETE
    assert world.record.attempts == len(world.camera.photos) == 4
    assert [event.shot for event in world.sink.of(ev.ShotAccepted)] == [0, 1, 2, 3]
    assert world.gimbal.released == 1
    assert not world.gimbal.in_control


def test_the_next_slew_begins_when_the_exposure_ends_not_when_the_proof_arrives() -> None:
    def slow_proof(world: World) -> None:
        world.camera.proof_after_s = 0.8

    world = fly(prepare=slow_proof)
    assert world.record.state is S.COMPLETE
    ends = [photo.triggered_s + world.settings.exposure_bound_s for photo in world.camera.photos]
    slews = [at for at, _, _ in world.gimbal.commands[1:]]
    for end, slew in zip(ends, slews, strict=False):
        assert end <= slew <= end + 0.01
    for event in world.sink.of(ev.ShotAccepted):
        assert event.photos[0].evidence is EvidenceLevel.CAPTURE_MESSAGE


def test_an_early_proof_ends_the_exposure_earlier_than_the_latency_bound() -> None:
    world = fly(prepare=lambda w: setattr(w.camera, "proof_after_s", 0.05))
    for photo, (slew, _, _) in zip(world.camera.photos, world.gimbal.commands[1:], strict=False):
        assert photo.ended_s + 0.05 <= slew <= photo.ended_s + 0.06


def test_the_trigger_follows_the_end_of_the_settle_time_at_once() -> None:
    world = fly(rate_hz=50.0)
    assert all(0 <= event.trigger_delay_s + 1e-9 <= 0.025 for event in world.sink.of(ev.ShotExposed))


def a_burst_after(late_s: float) -> World:
    """Samples of each exposure arrive that long after its trigger, as on a computer that was busy."""

    def prepare(world: World) -> None:
        photos = world.camera.photos
        world.gimbal.held_up = lambda at_s: bool(photos) and 0 < at_s - photos[-1].triggered_s < late_s

    return fly(prepare=prepare)


def test_samples_that_arrive_late_prove_an_exposure_all_the_same() -> None:
    world = a_burst_after(0.45)
    assert world.record.state is S.COMPLETE
    assert world.record.attempts == 4


def test_samples_that_do_not_arrive_prove_nothing() -> None:
    world = a_burst_after(0.95)
    codes = {event.code for event in world.sink.of(ev.ShotRejected)}
    assert codes == {"no_samples"}


def test_no_trigger_before_the_attempt_is_on_disk() -> None:
    def slow_disk(world: World) -> None:
        world.journal.delay_s = 6.0

    world = fly(prepare=slow_disk)
    for photo, started in zip(world.camera.photos, world.sink.of(ev.ShotStarted), strict=True):
        assert photo.triggered_s >= started.time_utc_s - 1_700_000_000.0 + 6.0 - 1e-6
    assert world.record.state is S.COMPLETE


def test_the_cameras_interval_is_kept() -> None:
    world = fly(settings=some_settings(interval_s=4.0))
    times = [photo.triggered_s for photo in world.camera.photos]
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert all(4.0 - 1e-6 <= gap <= 4.0 + 0.03 for gap in gaps)


@pytest.mark.parametrize("frame", list(YawFrame))
def test_every_feedback_frame_serves(frame: YawFrame) -> None:
    world = fly(frame=frame)
    assert world.record.state is S.COMPLETE
    assert world.record.attempts == 4


def test_a_plan_relative_to_the_heading_is_turned_north() -> None:
    async def main() -> None:
        async with a_world() as world:
            record = await world.mission(reference="heading").run()
            check_mission(world, record)
            assert record.reference_yaw_north_deg == 30.0
            assert list(world.gimbal.commands[0][1:]) == pytest.approx([-20.0, -150.0])
            measured = world.sink.of(ev.ShotExposed)[1].measured
            assert measured.yaw_deg == pytest.approx(-90.0, abs=0.1)

    run_virtual(main())


def test_a_lost_proof_becomes_a_retake_after_the_next_slew_began() -> None:
    world = fly(prepare=lambda w: setattr(w.camera, "lost_proofs", 1))
    assert world.record.state is S.COMPLETE
    assert [event.code for event in world.sink.of(ev.ShotRejected)] == ["evidence"]
    assert len(world.camera.photos) == 5
    assert [event.shot for event in world.sink.of(ev.ShotStarted)] == [0, 1, 0, 2, 3]


def test_proof_of_the_least_level_is_enough_and_better_proof_is_still_recorded() -> None:
    settings = some_settings(min_evidence=EvidenceLevel.ACKNOWLEDGED)
    world = fly(settings=settings, prepare=lambda w: setattr(w.camera, "proof_after_s", 0.4))
    assert world.record.state is S.COMPLETE
    levels = [event.photos[0].evidence for event in world.sink.of(ev.ShotAccepted)]
    # once the camera has reported a photo, its report is waited for
    assert levels[0] is EvidenceLevel.ACKNOWLEDGED
    assert levels[-1] is EvidenceLevel.CAPTURE_MESSAGE
    assert len(world.sink.of(ev.PhotoIdentified)) == levels.count(EvidenceLevel.ACKNOWLEDGED)
    assert not world.sink.of(ev.ShotRevoked)
    photos = [shot.accepted.photos[0] for shot in world.record.shots.values() if shot.accepted]
    assert [photo.file for photo in photos] == [f"IMG_{i:04d}.jpg" for i in range(4)]


def test_a_camera_that_only_counts_is_believed_when_that_is_asked_for_and_not_otherwise() -> None:
    def counts(world: World) -> None:
        world.camera.level = EvidenceLevel.COUNTED

    assert fly(prepare=counts).record.state is S.COMPLETE
    settings = some_settings(min_evidence=EvidenceLevel.CAPTURE_MESSAGE, attempts=1, rounds=1)
    world = fly(prepare=counts, settings=settings)
    assert world.record.state is S.INCOMPLETE
    assert world.record.shots_done == 0
    assert "only counted" in world.sink.of(ev.ShotRejected)[0].reason


@pytest.mark.parametrize("fault", ["refusals", "lost_commands"])
def test_a_trigger_that_fails_is_tried_again(fault: str) -> None:
    world = fly(prepare=lambda w: setattr(w.camera, fault, 2))
    assert world.record.state is S.COMPLETE
    assert [event.code for event in world.sink.of(ev.ShotRejected)] == ["trigger", "trigger"]


def test_a_pointing_command_that_is_refused_is_repeated_before_it_counts() -> None:
    world = fly(prepare=lambda w: setattr(w.gimbal, "refusals", 2))
    assert world.sink.of(ev.ShotRejected) == []
    world = fly(prepare=lambda w: setattr(w.gimbal, "refusals", 3))
    assert [event.code for event in world.sink.of(ev.ShotRejected)] == ["gimbal"]
    assert world.record.state is S.COMPLETE


def test_brackets_need_every_photo_proven() -> None:
    world = fly(settings=some_settings(brackets=3, interval_s=0.3))
    assert world.record.state is S.COMPLETE
    assert len(world.camera.photos) == 12
    assert [len(event.photos) for event in world.sink.of(ev.ShotAccepted)] == [3] * 4
    world = fly(
        settings=some_settings(brackets=3, interval_s=0.3), prepare=lambda w: setattr(w.camera, "lost_proofs", 1)
    )
    assert len(world.camera.photos) == 15


def test_without_feedback_the_mission_says_so_and_believes_the_gimbal() -> None:
    world = fly(settings=some_settings(feedback="none"), prepare=lambda w: setattr(w.gimbal, "silent", True))
    assert world.record.state is S.COMPLETE
    assert world.record.open_loop
    assert "open loop" in world.sink.of(ev.Warned)[0].text
    assert {event.by for event in world.sink.of(ev.ShotAccepted)} == {"open_loop"}


def test_whatever_devices_log_during_an_attempt_carries_its_shot() -> None:
    bound: list[tuple[object, object]] = []

    def listen(world: World) -> None:
        trigger = world.camera.trigger

        async def heard() -> FakeCapture:
            ids = structlog.contextvars.get_contextvars()
            bound.append((ids.get("shot"), ids.get("attempt")))
            return await trigger()

        world.camera.trigger = heard  # type: ignore[method-assign]

    world = fly(prepare=listen)
    exposed = [(event.shot, event.attempt) for event in world.sink.of(ev.ShotExposed)]
    assert bound == exposed
    assert len({shot for shot, _ in bound}) > 1
    assert structlog.contextvars.get_contextvars() == {}
