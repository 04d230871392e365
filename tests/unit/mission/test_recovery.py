"""A process that dies at any moment of a mission: what the next one settles by evidence, and what it takes again."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import pytest

from panoexec.devices import EvidenceLevel
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import ShotStatus, Verdict
from panoexec.mission.log.states import MissionState
from panoexec.planning.model import Shot
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.process import Process
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_plan, a_world, some_settings

S = MissionState
Moment = Callable[[World], bool]


@dataclass
class Two:
    """Two lives of one mission.

    Attributes:
        world: as it is after both.
        record: at the end.
        kept: events that the first one left on disk.
        photos: that the camera had taken when the first one died.
    """

    world: World
    record: MissionRecord
    kept: list[ev.Event]
    photos: int

    def second_life(self, kind: type[ev.Event]) -> list[Any]:
        return [event for event in self.world.journal.events[len(self.kept) :] if isinstance(event, kind)]


def killed_when(moment: Moment, prepare: Callable[[World], None], **settings: Any) -> Two:
    """Fly, die the moment that something is true, and fly on in a new process."""

    async def main() -> Two:
        async with a_world(settings=some_settings(**settings)) as world:
            prepare(world)
            process = Process(world)
            running = asyncio.create_task(process.mission().run(), name="first life")
            while not moment(world):
                await world.clock.sleep(0.001)
            await process.kill(running)
            kept, photos = list(world.journal.events), len(world.camera.photos)
            record = await Process(world).mission(past=kept).run()
            check_mission(world, record)
            return Two(world, record, kept, photos)

    return run_virtual(main())


def exposed(count: int) -> Moment:
    """The pose of so many photos is on disk, and the proof of the last one is still to come."""
    return lambda world: sum(isinstance(event, ev.ShotExposed) for event in world.journal.events) >= count


def open_shutter(count: int) -> Moment:
    """So many photos were triggered; the last one's shutter is open."""
    return lambda world: (
        len(world.camera.photos) >= count and world.clock.monotonic() >= world.camera.photos[count - 1].exposed_s
    )


def a_camera(
    *,
    remembers: bool = False,
    counts: bool = False,
    proof_after_s: float = 0.6,
    level: EvidenceLevel = EvidenceLevel.CAPTURE_MESSAGE,
) -> Callable[[World], None]:
    def prepare(world: World) -> None:
        world.camera.level = level
        world.camera.remembers, world.camera.counts = remembers, counts
        world.camera.proof_after_s = proof_after_s

    return prepare


def test_a_photo_whose_pose_was_on_disk_counts_when_the_camera_remembers_it() -> None:
    two = killed_when(exposed(2), a_camera(remembers=True))
    assert two.record.state is S.COMPLETE
    assert len(two.world.camera.photos) == 4  # none was repeated
    accepted = two.second_life(ev.ShotAccepted)[0]
    assert (accepted.shot, accepted.attempt, accepted.by) == (1, 1, "tolerance")
    assert (accepted.photos[0].image_index, accepted.photos[0].file) == (1, "IMG_0001.jpg")
    assert accepted.photos[0].evidence is EvidenceLevel.CAPTURE_MESSAGE
    # the slew to the next shot had begun; the camera knows that there was no photo
    assert [event.shot for event in two.second_life(ev.ShotInterrupted)] == [2]
    assert two.record.retakes == 0


def test_the_count_tells_of_a_photo_where_the_camera_tells_no_times() -> None:
    two = killed_when(exposed(2), a_camera(counts=True, level=EvidenceLevel.COUNTED))
    assert len(two.world.camera.photos) == 4
    accepted = two.second_life(ev.ShotAccepted)[0]
    assert (accepted.shot, accepted.photos[0].evidence) == (1, EvidenceLevel.COUNTED)


@pytest.mark.parametrize(("latency_s", "level"), [(0.35, EvidenceLevel.CAPTURE_MESSAGE), (1.0, EvidenceLevel.COUNTED)])
def test_a_first_photo_that_was_late_is_taken_again(latency_s: float, level: EvidenceLevel) -> None:
    """Its pose was judged until it should have been exposed; it was exposed during the slew to the next shot."""

    def prepare(world: World) -> None:
        a_camera(remembers=level > EvidenceLevel.COUNTED, counts=True, proof_after_s=2.0, level=level)(world)
        world.camera.latency_s = latency_s

    def over(world: World) -> bool:
        is_over = exposed(1)(world) and world.clock.monotonic() > world.camera.photos[0].ended_s + 0.05
        if is_over:
            world.camera.latency_s = 0.05
        return is_over

    two = killed_when(over, prepare)
    first, *others = two.record.shots[0].attempts
    assert (first.verdict, first.code) == (Verdict.REJECTED, "crash")
    assert others[-1].verdict is Verdict.ACCEPTED


def test_the_count_does_not_prove_a_photo_of_a_camera_that_reported_the_one_before() -> None:
    two = killed_when(exposed(2), a_camera(counts=True))
    rejected = two.second_life(ev.ShotRejected)[0]
    assert (rejected.shot, rejected.code) == (1, "crash")
    assert len(two.world.camera.photos) == 5
    assert two.record.state is S.COMPLETE


def test_a_photo_that_was_counted_before_the_first_report_is_taken_again_after_a_restart() -> None:
    """The first process accepted shot 0 by the count and was killed just after the camera's first report of shot 1."""

    def prepare(world: World) -> None:
        a_camera(counts=True, level=EvidenceLevel.COUNTED)(world)

    def reported(world: World) -> bool:
        if len(world.sink.of(ev.ShotAccepted)) == 1:
            world.camera.level = EvidenceLevel.CAPTURE_MESSAGE
        return any(e.photos[0].evidence >= EvidenceLevel.CAPTURE_MESSAGE for e in world.sink.of(ev.ShotAccepted))

    two = killed_when(reported, prepare)
    revoked = [event for event in two.world.journal.events if isinstance(event, ev.ShotRevoked)]
    assert [(event.shot, event.attempt, event.code) for event in revoked] == [(0, 1, "evidence")]
    assert two.record.state is S.COMPLETE
    assert [attempt.verdict for attempt in two.record.shots[0].attempts] == [Verdict.REJECTED, Verdict.ACCEPTED]


def test_a_count_that_somebody_else_may_have_raised_proves_nothing() -> None:
    def foreign(world: World) -> bool:
        if not exposed(2)(world):
            return False
        world.camera.photos.append(world.camera.photos[-1])
        return True

    two = killed_when(foreign, a_camera(counts=True))
    rejected = two.second_life(ev.ShotRejected)[0]
    assert (rejected.shot, rejected.code) == (1, "crash")
    assert two.record.state is S.COMPLETE


@pytest.mark.parametrize("apart_s", [-3.0, -0.5, 0.7, 3.0])
def test_somebody_elses_photo_of_another_moment_does_not_count_for_ours(apart_s: float) -> None:
    """Ours did not come about; the camera has one that an assistant took by hand."""

    def lost(world: World) -> bool:
        if not exposed(2)(world):
            return False
        ours = world.camera.photos.pop()
        world.camera.photos.append(
            replace(ours, index=7, exposed_s=ours.exposed_s + apart_s, ended_s=ours.ended_s + apart_s)
        )
        return True

    two = killed_when(lost, a_camera(remembers=True))
    assert two.record.shots[1].attempts[0].code == "crash"
    assert two.record.shots[1].attempts[0].photos[0].image_index == -1
    assert two.record.state is S.COMPLETE


@pytest.mark.parametrize("memory_fails", [0, 1, 2])
def test_a_camera_that_does_not_answer_is_asked_once_more(memory_fails: int) -> None:
    def prepare(world: World) -> None:
        a_camera(remembers=True)(world)
        world.camera.memory_fails = memory_fails

    two = killed_when(exposed(2), prepare)
    assert two.record.state is S.COMPLETE
    assert len(two.world.camera.photos) == (5 if memory_fails == 2 else 4)


def test_without_a_memory_the_photo_is_taken_again_once() -> None:
    two = killed_when(exposed(2), a_camera())
    assert two.record.state is S.COMPLETE
    assert len(two.world.camera.photos) == 5
    attempts = two.record.shots[1].attempts
    assert [(a.verdict, a.code) for a in attempts] == [(Verdict.REJECTED, "crash"), (Verdict.ACCEPTED, "")]
    assert attempts[0].reason == "panoexec stopped before there was evidence of the photo"


def test_acknowledgement_is_proof_enough_where_no_more_is_asked_for() -> None:
    # the verdict of the first life never reached the disk, the exposure with its acknowledgement did
    camera = a_camera(level=EvidenceLevel.ACKNOWLEDGED)
    two = killed_when(exposed(2), camera, min_evidence=EvidenceLevel.ACKNOWLEDGED)
    assert len(two.world.camera.photos) == 4
    assert two.record.state is S.COMPLETE


def test_a_photo_whose_pose_is_not_on_disk_is_filed_and_taken_again() -> None:
    two = killed_when(open_shutter(2), a_camera(remembers=True, counts=True))
    assert two.record.state is S.COMPLETE
    assert len(two.world.camera.photos) == 5
    first, second = two.record.shots[1].attempts
    assert (first.verdict, first.code, first.exposed) == (Verdict.REJECTED, "crash", None)
    assert [photo.image_index for photo in first.photos] == [1]
    assert "before the pointing during the exposure was recorded" in first.reason
    assert [photo.image_index for photo in second.photos] == [2]
    assert two.record.retakes == 1


def test_a_remembered_photo_of_less_proof_than_asked_for_does_not_count() -> None:
    def prepare(world: World) -> None:
        a_camera(remembers=True)(world)
        world.camera.level = EvidenceLevel.COUNTED

    two = killed_when(exposed(1), prepare, min_evidence=EvidenceLevel.CAPTURE_MESSAGE, attempts=1, rounds=1)
    assert two.record.shots[0].attempts[0].code == "crash"
    assert two.record.state is S.INCOMPLETE


@pytest.mark.parametrize("holds", [True, False])
def test_a_photo_out_of_tolerance_counts_if_the_overlaps_hold_with_it(holds: bool) -> None:
    def prepare(world: World) -> None:
        a_camera(remembers=True)(world)
        world.verifier.needed = 4 if holds else 5
        world.gimbal.drift = lambda at_s: (
            0.0,
            0.3 if world.camera.photos and at_s - world.camera.photos[-1].triggered_s < 0.3 else 0.0,
            0.0,
        )

    two = killed_when(exposed(1), prepare, accept="overlap", max_rate_deg_s=8.0, attempts=1, rounds=1)
    first = two.record.shots[0].attempts[0]
    assert first.photos[0].image_index == 0  # filed in any case
    if holds:
        assert (first.verdict, first.by) == (Verdict.ACCEPTED, "overlap")
        assert len(two.record.shots[0].attempts) == 1
    else:
        assert (first.verdict, first.code) == (Verdict.REJECTED, "crash")
        assert "off by" in first.reason


def test_a_blurred_photo_never_counts_however_well_the_camera_remembers() -> None:
    def prepare(world: World) -> None:
        a_camera(remembers=True)(world)
        world.gimbal.drift = lambda at_s: (
            0.0,
            3.0 if world.camera.photos and at_s - world.camera.photos[-1].triggered_s < 0.3 else 0.0,
            0.0,
        )

    def taken(world: World) -> bool:
        return len(world.camera.photos) == 1 and exposed(1)(world)

    two = killed_when(taken, prepare, accept="overlap", attempts=1, rounds=1)
    assert two.record.shots[0].accepted is None


def test_brackets_count_when_each_photo_is_remembered() -> None:
    two = killed_when(exposed(1), a_camera(remembers=True), brackets=2, interval_s=0.3)
    assert len(two.world.camera.photos) == 8
    accepted = two.second_life(ev.ShotAccepted)[0]
    assert [photo.image_index for photo in accepted.photos] == [0, 1]


def test_the_file_of_a_photo_that_counted_already_is_learned_after_the_crash() -> None:
    def accepted(world: World) -> bool:
        return any(isinstance(event, ev.ShotAccepted) for event in world.journal.events)

    two = killed_when(accepted, a_camera(remembers=True), min_evidence=EvidenceLevel.ACKNOWLEDGED)
    identified = two.second_life(ev.PhotoIdentified)[0]
    assert (identified.shot, identified.photos[0].file) == (0, "IMG_0000.jpg")
    assert two.record.shots[0].status is ShotStatus.ACCEPTED
    assert len(two.world.camera.photos) == 4


def test_a_second_stop_before_anything_was_settled_leaves_it_to_the_third_process() -> None:
    async def main() -> None:
        async with a_world() as world:
            a_camera(remembers=True)(world)
            process = Process(world)
            running = asyncio.create_task(process.mission().run(), name="first life")
            while not exposed(2)(world):
                await world.clock.sleep(0.001)
            await process.kill(running)
            second = world.mission(past=list(world.journal.events))
            asking = asyncio.create_task(second.run(), name="second life")
            await world.clock.sleep(0.001)
            second.commands.interrupt()
            record = await asking
            assert record.state is S.PAUSED
            assert record.shots[1].open_attempt is not None
            record = await world.mission(past=list(world.journal.events)).run()
            check_mission(world, record)
            assert record.state is S.COMPLETE
            assert len(world.camera.photos) == 4

    run_virtual(main())


def _killed_at(at_s: float, prepare: Callable[[World], None]) -> tuple[World, MissionRecord]:
    """A mission of two shots that is killed after so long, unless it has ended, and then resumed."""

    async def main() -> tuple[World, MissionRecord]:
        async with a_world(plan=a_plan(2)) as world:
            prepare(world)
            process = Process(world)
            running = asyncio.create_task(process.mission().run(), name="first life")
            done, _ = await asyncio.wait({running}, timeout=at_s)
            if done:
                return world, running.result()
            await process.kill(running)
            if world.journal.events and world.record_of_journal().ended:
                return world, world.record_of_journal()
            record = await world.mission(past=list(world.journal.events)).run()
            check_mission(world, record)
            return world, record

    return run_virtual(main())


@pytest.mark.parametrize("remembers", [True, False])
def test_a_kill_at_whatever_moment_costs_one_photo_at_most(remembers: bool) -> None:
    """Kills every 25 ms about the second photo, and every half second elsewhere."""
    prepare = a_camera(remembers=remembers, counts=remembers, proof_after_s=0.3)
    whole, _ = _killed_at(math.inf, prepare)
    start_s = 1000.1
    trigger_s = whole.camera.photos[1].triggered_s - start_s
    end_s = whole.journal.events[-1].time_utc_s - 1_700_000_000.0 - start_s
    moments = [trigger_s + 0.025 * step for step in range(-2, 22)] + [0.5 * step for step in range(1, int(2 * end_s))]
    repeated, settled = set(), set()
    for at_s in moments:
        world, record = _killed_at(at_s, prepare)
        assert record.state is S.COMPLETE
        assert len(world.camera.photos) <= 3
        assert sum(a.verdict is Verdict.ACCEPTED for shot in record.shots.values() for a in shot.attempts) == 2
        if len(world.camera.photos) == 3:
            repeated.add(at_s)
        # in a process of its own, before its preflight
        settled |= {
            at_s for event in world.journal.events if event.type == "shot_accepted" and event.state is S.PREFLIGHT
        }
    about = {at_s for at_s in moments if 0 <= at_s - trigger_s <= 0.3}
    assert repeated & about
    assert bool(settled) is remembers
    # with a memory it is only the time from the trigger to the verdict on the pose that costs a photo
    longest_s = whole.settings.exposure_bound_s + 2 * whole.journal.delay_s if remembers else 0.45
    assert all(0 <= at_s - trigger_s <= longest_s for at_s in repeated if at_s in about)


def _everything_taken(world: World) -> bool:
    return any(isinstance(event, ev.MissionFinishing) for event in world.journal.events)


def _slow_end(world: World) -> None:
    certify = world.verifier.certify

    async def slowly(*args: Any) -> Any:
        await world.clock.sleep(0.5)
        return await certify(*args)

    setattr(world.verifier, "certify", slowly)  # noqa: B010


def test_what_has_all_its_shots_needs_neither_gimbal_nor_flight_to_end() -> None:
    """Killed over its last certificate, and resumed on the bench."""

    def landed(world: World) -> bool:
        if not _everything_taken(world):
            return False
        world.vehicle.change(in_air=False, mode="STABILIZED", battery_frac=0.1)
        world.gimbal.refuse_control, world.gimbal.silent = 1000, True
        return True

    two = killed_when(landed, _slow_end)
    assert two.record.state is S.COMPLETE
    assert not two.second_life(ev.GimbalAcquired)


def test_patches_of_a_resumed_mission_are_checked_like_any_other_shot() -> None:
    def landed(world: World) -> bool:
        if not _everything_taken(world):
            return False
        world.vehicle.change(in_air=False)
        return True

    def prepare(world: World) -> None:
        _slow_end(world)
        world.verifier.needed, world.verifier.holes = 5, (SimpleNamespace(size_deg=3.0),)
        world.verifier.patches = [Shot(index=0, row=0, pitch_deg=-20.0, yaw_deg=45.0)]

    two = killed_when(landed, prepare)
    assert two.record.state is S.FAILED
    assert "not in the air" in two.record.reason
    assert not two.second_life(ev.ShotStarted)
    assert len(two.world.gimbal.commands) == 4
