"""Missions on fakes in virtual time: what is accepted, what is taken again, what a person may ask."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from panoexec import events as ev
from panoexec.devices import EvidenceLevel, YawFrame
from panoexec.errors import MissionError
from panoexec.mission.control import CommandRefusedError
from panoexec.mission.executor import Mission
from panoexec.mission.record import MissionRecord, ShotStatus, Verdict
from panoexec.mission.settings import GuardSettings
from panoexec.planning.model import GimbalLimits, Hole, Shot
from panoexec.states import MissionState
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_plan, a_world, some_settings

S = MissionState
Script = Callable[[World, Mission], Awaitable[None]]


def fly(script: Script | None = None, prepare: Callable[[World], None] | None = None, **world: Any) -> World:
    """Fly one mission to its end, with a script beside it; every invariant is checked afterwards."""

    async def main() -> World:
        async with a_world(**world) as w:
            if prepare is not None:
                prepare(w)
            mission = w.mission()
            async with asyncio.TaskGroup() as group:
                if script is not None:
                    group.create_task(_scripted(script, w, mission), name="script")
                record = await mission.run()
            check_mission(w, record)
            w.record = record
        return w

    return run_virtual(main())


async def _scripted(script: Script, world: World, mission: Mission) -> None:
    await script(world, mission)


async def until_event(world: World, kind: type[ev.Event], count: int = 1) -> None:
    while len(world.sink.of(kind)) < count:
        await world.clock.sleep(0.01)


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


def drift_at(world: World, shot_yaw_north: float, *, until_s: float, size: float = 1.0) -> None:
    """The gimbal wanders by `size` in pitch whenever it was sent to this yaw, before a moment."""

    def drift(at_s: float) -> tuple[float, float, float]:
        here = bool(world.gimbal.commands) and world.gimbal.commands[-1][2] == shot_yaw_north
        if not here or at_s > until_s:
            return 0.0, 0.0, 0.0
        # quiet until the trigger, then off
        fired = world.camera.photos and world.camera.photos[-1].triggered_s > world.gimbal.commands[-1][0]
        return (0.0, size, 0.0) if fired else (0.0, 0.0, 0.0)

    world.gimbal.drift = drift


def test_a_drift_during_the_exposure_is_rejected_and_taken_again_at_once() -> None:
    world = fly(prepare=lambda w: drift_at(w, -90.0, until_s=1005.0))
    assert world.record.state is S.COMPLETE
    rejected = world.sink.of(ev.ShotRejected)
    assert rejected
    assert {event.code for event in rejected} == {"pointing"}
    assert "pitch off by +1" in rejected[0].reason
    order = [event.shot for event in world.sink.of(ev.ShotStarted)]
    assert order == sorted(order)
    assert world.record.retakes == len(world.sink.of(ev.ShotRetaken)) == len(rejected)


def test_a_shot_that_keeps_failing_is_put_off_with_more_patience_each_round_and_then_missed() -> None:
    world = fly(prepare=lambda w: drift_at(w, -90.0, until_s=1e9))
    assert world.record.state is S.INCOMPLETE
    assert world.record.missing() == (1,)
    shot = world.record.shots[1]
    assert shot.status is ShotStatus.MISSED
    assert [attempt.round for attempt in shot.attempts] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    patience = [event.patience_s for event in world.sink.of(ev.ShotStarted) if event.shot == 1]
    assert patience == [1.0] * 3 + [2.0] * 3 + [4.0] * 3
    order = [(event.round, event.shot) for event in world.sink.of(ev.ShotStarted)]
    assert order == sorted(order)
    finished = world.sink.of(ev.MissionFinished)[0]
    assert (finished.accepted, finished.missing, finished.certified) == (3, (1,), False)


def test_a_missing_shot_does_not_matter_when_the_measured_attitudes_prove_the_panorama() -> None:
    def prepare(world: World) -> None:
        drift_at(world, -90.0, until_s=1e9)
        world.verifier.needed = 3

    world = fly(prepare=prepare)
    assert world.record.state is S.COMPLETE
    assert world.record.certified is True
    assert world.record.missing() == (1,)


def test_a_gimbal_that_never_arrives_ends_incomplete_without_a_photo() -> None:
    world = fly(prepare=lambda w: setattr(w.gimbal, "stuck", True), settings=some_settings(attempts=1, rounds=2))
    assert world.record.state is S.INCOMPLETE
    # a stuck gimbal looks at yaw 0: only the shot there can be taken, and the pitch is wrong for that one too
    assert world.camera.photos == []
    assert {event.code for event in world.sink.of(ev.ShotRejected)} == {"not_settled"}
    assert "off by" in world.sink.of(ev.ShotRejected)[0].reason


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
    assert all(e.photos[0].evidence is EvidenceLevel.ACKNOWLEDGED for e in world.sink.of(ev.ShotAccepted))
    assert len(world.sink.of(ev.PhotoIdentified)) == 4
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


def test_patches_close_real_holes() -> None:
    def prepare(world: World) -> None:
        world.verifier.needed = 5
        world.verifier.patches = [Shot(index=0, row=0, pitch_deg=-70.0, yaw_deg=10.0)]
        world.verifier.holes = (Hole(elevation_deg=-70.0, azimuth_deg=10.0, size_deg=2.0),)

    world = fly(prepare=prepare)
    assert world.record.state is S.COMPLETE
    planned = world.sink.of(ev.PatchPlanned)
    assert [event.shots for event in planned] == [(4,)]
    assert world.record.shots[4].patch
    assert world.record.certified is True


def test_an_exposure_outside_tolerance_counts_when_the_overlaps_hold_as_measured() -> None:
    def off(world: World, size: float) -> None:
        # a steady offset that comes with the settled pose and goes unnoticed until the shutter opens
        drift_at(world, -90.0, until_s=1e9, size=size)

    world = fly(prepare=lambda w: off(w, 0.3), settings=some_settings(accept="overlap", max_rate_deg_s=8.0))
    assert world.record.state is S.COMPLETE
    assert [event.by for event in world.sink.of(ev.ShotAccepted)] == ["tolerance", "overlap", "tolerance", "tolerance"]
    assert world.record.retakes == 0

    def strict(world: World) -> None:
        off(world, 0.3)
        world.verifier.needed = 5  # the certificate never holds

    settings = some_settings(accept="overlap", max_rate_deg_s=8.0, attempts=1, rounds=1)
    world = fly(prepare=strict, settings=settings)
    assert world.record.missing() == (1,)
    assert "overlaps would not hold" in world.sink.of(ev.ShotRejected)[0].reason

    blurred = some_settings(accept="overlap", attempts=1, rounds=1)
    world = fly(prepare=lambda w: off(w, 3.0), settings=blurred)
    assert world.record.missing() == (1,)


def test_what_a_finished_mission_cannot_do() -> None:
    async def main() -> None:
        async with a_world() as world:
            mission = world.mission()
            with pytest.raises(CommandRefusedError, match="the mission is idle"):
                mission.verbs.pause()
            await mission.run()
            for verb in (mission.verbs.pause, mission.verbs.resume, mission.verbs.abort, mission.verbs.finish):
                with pytest.raises(CommandRefusedError, match="the mission is complete"):
                    verb()
            with pytest.raises(MissionError, match="once"):
                await mission.run()
            with pytest.raises(MissionError, match="complete and cannot be resumed"):
                world.mission(past=world.journal.events)

    run_virtual(main())


def test_pause_holds_after_the_photo_and_resume_goes_on() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        mission.verbs.pause("coffee")
        with pytest.raises(CommandRefusedError, match="paused already"):
            mission.verbs.pause()
        await until_event(world, ev.MissionPaused)
        photos = len(world.camera.photos)
        await world.clock.sleep(10.0)
        assert len(world.camera.photos) == photos
        assert mission.record.state is S.PAUSED
        assert mission.record.reason == "coffee"
        mission.verbs.resume()

    world = fly(script)
    assert world.record.state is S.COMPLETE
    assert len(world.sink.of(ev.ShotInterrupted)) == 1
    assert world.sink.of(ev.MissionResumed)[0].paused_s == pytest.approx(10.0, abs=0.2)
    assert world.record.retakes == 0


def test_resume_right_after_pause_leaves_no_pause() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        mission.verbs.pause()
        mission.verbs.resume()
        with pytest.raises(CommandRefusedError, match="not paused"):
            mission.verbs.resume()

    world = fly(script)
    assert world.sink.of(ev.MissionPaused) == []
    assert world.record.state is S.COMPLETE


def test_a_pause_that_nobody_ends_ends_the_mission_resumable() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted)
        mission.verbs.pause()

    world = fly(script)
    assert world.record.state is S.FAILED
    assert "paused for 30 s" in world.record.reason


def test_skip_leaves_the_current_shot_out_at_once() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        assert mission.verbs.skip() == 1
        assert mission.verbs.skip(3) == 3
        with pytest.raises(CommandRefusedError, match="shots are 0 to 3"):
            mission.verbs.skip(7)
        await until_event(world, ev.ShotSkipped, 2)
        with pytest.raises(CommandRefusedError, match="skipped already"):
            mission.verbs.skip(3)

    world = fly(script)
    assert world.record.state is S.INCOMPLETE
    assert world.record.missing() == (1, 3)
    assert len(world.camera.photos) == 2


def test_repeat_takes_the_last_accepted_shot_again_and_the_new_photo_counts() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 1)
        assert mission.verbs.repeat() == 0
        with pytest.raises(CommandRefusedError, match="to be taken anyway"):
            mission.verbs.repeat(0)

    world = fly(script)
    assert world.record.state is S.COMPLETE
    assert world.record.shots_done == 4
    accepted = world.record.shots[0].accepted
    assert accepted is not None
    assert accepted.number == 2
    assert [a.verdict for a in world.record.shots[0].attempts] == [Verdict.ACCEPTED, Verdict.ACCEPTED]


def test_a_repeat_while_finishing_goes_back_to_shooting() -> None:
    async def script(world: World, mission: Mission) -> None:
        while mission.record.state is not S.FINISHING:
            await world.clock.sleep(0.001)
        mission.verbs.repeat(2)

    def prepare(world: World) -> None:
        certify = world.verifier.certify

        async def slowly(*args: Any) -> Any:
            await world.clock.sleep(1.0)
            return await certify(*args)

        setattr(world.verifier, "certify", slowly)  # noqa: B010

    world = fly(script, prepare)
    assert world.record.state is S.COMPLETE
    assert len(world.record.shots[2].attempts) == 2


@pytest.mark.parametrize("at_s", [0.0, 0.07, 0.5, 2.55, 2.62, 2.7, 4.3, 7.4])
def test_abort_at_any_moment_ends_at_once_with_the_gimbal_released(at_s: float) -> None:
    async def script(world: World, mission: Mission) -> None:
        await world.clock.sleep(0.001 + at_s)
        mission.verbs.abort("enough")
        asked = world.clock.monotonic()
        while not mission.record.ended:
            await world.clock.sleep(0.01)
        assert world.clock.monotonic() - asked < 0.6

    world = fly(script)
    assert world.record.state is S.ABORTED
    assert world.record.reason == "enough"


def test_finish_accepts_the_gaps() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 2)
        mission.verbs.finish()

    world = fly(script)
    assert world.record.state is S.INCOMPLETE
    assert 2 <= world.record.shots_done <= 3
    assert "gaps are accepted" in world.record.reason


def test_an_interrupted_mission_can_be_resumed_and_the_photo_counts_stay_right() -> None:
    async def main() -> None:
        async with a_world() as world:
            mission = world.mission()
            async with asyncio.TaskGroup() as group:
                running = group.create_task(mission.run())
                await until_event(world, ev.ShotAccepted, 2)
                mission.verbs.interrupt()
                record = await running
            check_mission(world, record)
            assert record.state is S.PAUSED
            assert not world.gimbal.in_control
            record = await world.mission(past=list(world.journal.events)).run()
            check_mission(world, record)
            assert record.state is S.COMPLETE
            assert record.restarts == 1
            assert len(world.camera.photos) == 4

    run_virtual(main())


def test_preflight_names_everything_that_is_wrong_and_moves_nothing() -> None:
    def prepare(world: World) -> None:
        world.vehicle.change(in_air=False, battery_frac=0.1, mode="STABILIZED", position_ok=False)
        world.camera.storage_free_images = 3
        world.gimbal.limits = GimbalLimits(pitch_min_deg=-10.0)
        world.gimbal.nan = True

    world = fly(prepare=prepare)
    assert world.record.state is S.FAILED
    problems = " | ".join(world.sink.of(ev.PreflightFailed)[0].problems)
    for text in (
        "not in the air",
        "battery at 10 %",
        "flight mode is STABILIZED",
        "no good position",
        "room for 3 photos, 4 are needed",
        "shot 0 at pitch -20.00° is outside the gimbal's -10° to 90° (and 3 more)",
        "not a number",
    ):
        assert text in problems
    assert world.gimbal.commands == []
    assert world.gimbal.acquired == 0


def test_preflight_waits_a_little_for_what_is_just_starting() -> None:
    async def script(world: World, mission: Mission) -> None:
        await world.clock.sleep(2.0)
        world.vehicle.change(connected=True)

    world = fly(script, prepare=lambda w: w.vehicle.change(connected=False))
    assert world.record.state is S.COMPLETE


def test_a_journal_that_fails_ends_the_mission_and_releases_the_gimbal() -> None:
    async def main() -> None:
        async with a_world() as world:
            append = world.journal.append

            async def failing(events: Any) -> None:
                if any(isinstance(event, ev.ShotAccepted) for event in events):
                    raise MissionError("the journal was deleted")
                await append(events)

            world.journal.append = failing  # type: ignore[method-assign]
            with pytest.raises(MissionError, match="deleted"):
                await world.mission().run()
            assert not world.gimbal.in_control
            assert world.sink.of(ev.ShotAccepted) == []

    run_virtual(main())


def test_a_release_that_hangs_is_given_up() -> None:
    world = fly(prepare=lambda w: setattr(w.gimbal, "release_hangs", True))
    assert world.record.state is S.COMPLETE
    assert world.sink.of(ev.GimbalReleased)[0].confirmed is False


@pytest.mark.parametrize("again_s", [0.0, 0.005, 0.01, 0.5])
@pytest.mark.parametrize("at_s", [0.06, 1.0, 2.65, 7.62])
def test_cancelled_twice_the_gimbal_is_still_released_and_the_journal_complete(at_s: float, again_s: float) -> None:
    async def main() -> None:
        async with a_world() as world:
            world.journal.delay_s = 0.05
            mission = world.mission()
            running = asyncio.create_task(mission.run())
            await world.clock.sleep(at_s)
            running.cancel()
            await world.clock.sleep(again_s)
            running.cancel()
            await asyncio.wait({running})
            check_mission(world, mission.record)
            assert len(world.journal.events) == mission.record.seq
            assert world.record_of_journal().state is mission.record.state

    run_virtual(main())


def test_the_estimate_follows_what_shots_really_cost() -> None:
    estimates = []

    async def script(world: World, mission: Mission) -> None:
        for count in range(1, 24):
            await until_event(world, ev.ShotAccepted, count)
            estimates.append(mission.eta_s)

    world = fly(script, plan=a_plan(24), settings=some_settings(interval_s=3.0))
    times = [event.time_utc_s for event in world.sink.of(ev.ShotAccepted)]
    for count, estimate in enumerate(estimates, start=1):
        if count >= 8:
            assert estimate == pytest.approx(times[-1] - times[count - 1], rel=0.15)


def test_the_record_is_the_same_from_the_journal() -> None:
    world = fly(prepare=lambda w: drift_at(w, -90.0, until_s=1005.0))
    again = MissionRecord.from_events(mission_id="m1", shots=world.plan.shots, events=world.journal.events)
    assert again.shots == world.record.shots
    assert (again.state, again.retakes, again.seq) == (world.record.state, world.record.retakes, world.record.seq)


class TestFaults:
    """Fault, reaction, state: as in docs/mission.md."""

    def test_link_loss_holds_and_goes_on_by_itself(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.vehicle.change(connected=False)
            await until_event(world, ev.MissionPaused)
            assert "no heartbeat" in mission.record.reason
            await world.clock.sleep(5.0)
            with pytest.raises(CommandRefusedError, match="no heartbeat"):
                mission.verbs.resume()
            world.vehicle.change(connected=True)

        world = fly(script)
        assert world.record.state is S.COMPLETE
        assert world.sink.of(ev.MissionPaused)[0].automatic

    def test_a_silent_attitude_stream_holds_and_goes_on_by_itself(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.gimbal.silent = True
            await until_event(world, ev.MissionPaused)
            assert "no attitude for" in mission.record.reason
            world.gimbal.silent = False

        assert fly(script).record.state is S.COMPLETE

    def test_a_short_silence_during_the_exposure_is_not_proof(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            while not world.camera.photos:
                await world.clock.sleep(0.001)
            world.gimbal.silent = True
            await world.clock.sleep(0.2)
            world.gimbal.silent = False

        world = fly(script)
        assert world.record.state is S.COMPLETE
        assert world.sink.of(ev.ShotRejected)[0].code == "no_samples"

    def test_nan_and_failure_flags_are_out_of_tolerance(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.gimbal.nan = True
            await until_event(world, ev.ShotRejected)
            world.gimbal.nan, world.gimbal.failure_flags = False, 32
            await until_event(world, ev.ShotRejected, 2)
            world.gimbal.failure_flags = 0

        world = fly(script)
        assert world.record.state is S.COMPLETE
        reasons = [event.reason for event in world.sink.of(ev.ShotRejected)]
        assert "not a number" in reasons[0]
        assert "motor error" in reasons[1]

    def test_a_frozen_attitude_never_settles_at_the_next_shot(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.gimbal.frozen = True
            await until_event(world, ev.ShotRejected)
            world.gimbal.frozen = False

        world = fly(script)
        assert world.record.state is S.COMPLETE
        assert world.sink.of(ev.ShotRejected)[0].code == "not_settled"

    def test_a_stolen_gimbal_is_asked_for_and_comes_back(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.gimbal.in_control = False
            await until_event(world, ev.MissionPaused)
            assert "another station has it" in mission.record.reason

        world = fly(script)
        assert world.record.state is S.COMPLETE
        assert world.gimbal.acquired == 2

    def test_a_stolen_gimbal_waits_for_the_pilot_when_so_configured(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.gimbal.in_control = False
            await until_event(world, ev.MissionPaused)
            await world.clock.sleep(20.0)
            assert mission.record.state is S.PAUSED
            assert world.gimbal.acquired == 1
            world.gimbal.in_control = True
            await world.clock.sleep(0.2)
            mission.verbs.resume()

        guards = GuardSettings(reclaim="never")
        assert fly(script, settings=some_settings(guards=guards)).record.state is S.COMPLETE

    def test_the_pilot_takes_over_and_has_the_gimbal_at_once(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.vehicle.change(mode="STABILIZED")
            asked = world.clock.monotonic()
            while world.gimbal.in_control:
                await world.clock.sleep(0.01)
            assert world.clock.monotonic() - asked < 0.4
            await world.clock.sleep(5.0)
            with pytest.raises(CommandRefusedError, match="taken over"):
                mission.verbs.resume()
            world.vehicle.change(mode="OFFBOARD")
            await world.clock.sleep(5.0)
            assert mission.record.state is S.PAUSED  # the pilot decides when
            mission.verbs.resume()

        world = fly(script)
        assert world.record.state is S.COMPLETE
        assert world.gimbal.acquired == 2

    def test_a_low_battery_holds_for_a_swap(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.vehicle.change(battery_frac=0.2)
            await until_event(world, ev.MissionPaused)
            assert "battery at 20 %, floor 25 %" in mission.record.reason

        world = fly(script)
        assert world.record.state is S.FAILED  # nobody resumed it

    def test_a_drift_of_position_holds_until_it_is_back_with_hysteresis(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            metre = 1 / 111_194.9
            world.vehicle.change(latitude_deg=47.0 + 3.1 * metre)
            await until_event(world, ev.MissionPaused)
            assert "3.1 m away from where" in mission.record.reason
            world.vehicle.change(latitude_deg=47.0 + 2.4 * metre)
            await world.clock.sleep(5.0)
            assert mission.record.state is S.PAUSED
            world.vehicle.change(latitude_deg=47.0 + 2.0 * metre)

        assert fly(script).record.state is S.COMPLETE

    def test_a_full_storage_holds_until_there_is_room(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.camera.storage_free_images = 0
            await until_event(world, ev.MissionPaused)
            assert "storage is full" in mission.record.reason
            world.camera.storage_free_images = 10

        assert fly(script).record.state is S.COMPLETE

    def test_a_reboot_is_said(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            world.vehicle.change(connected=False)
            world.gimbal.silent, world.gimbal.in_control = True, False
            await world.clock.sleep(3.0)
            world.vehicle.change(connected=True, boot_count=1)
            world.gimbal.silent = False

        world = fly(script)
        assert world.record.state is S.COMPLETE
        assert "rebooted" in world.sink.of(ev.Warned)[0].text


def test_a_mission_that_moved_says_so_when_it_is_resumed() -> None:
    async def main() -> None:
        async with a_world() as world:
            mission = world.mission()
            async with asyncio.TaskGroup() as group:
                running = group.create_task(mission.run())
                await until_event(world, ev.ShotAccepted, 2)
                running.cancel()
            check_mission(world, mission.record)
            world.vehicle.change(latitude_deg=47.0001)
            record = await world.mission(past=list(world.journal.events)).run()
            check_mission(world, record)
            assert record.state is S.COMPLETE
            assert "resumed 11.1 m from where" in world.sink.of(ev.Warned)[0].text
            assert record.origin[0] == 47.0001

    run_virtual(main())


def test_settings_that_make_no_sense_are_refused() -> None:
    for change, text in (
        ({"attempts": 0}, "attempts = 0"),
        ({"settle_s": -1.0}, "settle_s = -1.0"),
        ({"max_gap_s": float("nan")}, "max_gap_s = nan"),
        ({"tolerance": replace(some_settings().tolerance, yaw_deg=0.0)}, "tolerance yaw_deg = 0.0"),
    ):
        with pytest.raises(Exception, match=text):
            some_settings(**change)
