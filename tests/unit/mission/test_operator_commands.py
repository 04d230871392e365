"""What a person may ask of a mission, at whatever moment."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from panoexec.errors import MissionError
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.shot_record import Verdict
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_plan, a_world

S = MissionState


def test_what_a_finished_mission_cannot_do() -> None:
    async def main() -> None:
        async with a_world() as world:
            mission = world.mission()
            with pytest.raises(CommandRefusedError, match="the mission is idle"):
                mission.commands.skip()
            await mission.run()
            for verb in (
                mission.commands.pause,
                mission.commands.resume,
                mission.commands.abort,
                mission.commands.finish,
            ):
                with pytest.raises(CommandRefusedError, match="the mission is complete"):
                    verb()
            with pytest.raises(MissionError, match="called before"):
                await mission.run()
            with pytest.raises(MissionError, match="complete and cannot be resumed"):
                world.mission(past=world.journal.events)

    run_virtual(main())


@pytest.mark.parametrize(
    ("verbs", "state"),
    [
        (["abort"], S.ABORTED),
        (["finish"], S.INCOMPLETE),
        (["interrupt"], S.PAUSED),
        (["finish", "abort"], S.ABORTED),
        (["abort", "pause", "finish"], S.ABORTED),
    ],
)
def test_a_stop_before_the_mission_runs_is_obeyed_before_anything_moves(verbs: list[str], state: S) -> None:
    async def main() -> None:
        async with a_world() as world:
            mission = world.mission()
            for verb in verbs:
                getattr(mission.commands, verb)("early")
            record = await mission.run()
            assert record.state is state
            assert world.camera.photos == []
            assert not any(event.type in ("gimbal_acquired", "shot_started") for event in world.journal.events)
            assert isinstance(world.journal.events[0], ev.MissionStarted), "the journal begins as ever"

    run_virtual(main())


def test_a_pause_before_the_mission_runs_holds_it_before_the_first_photo() -> None:
    async def main() -> None:
        async with a_world() as world, asyncio.TaskGroup() as group:
            mission = world.mission()
            mission.commands.pause("wait")
            flying = group.create_task(mission.run(), name="mission")
            await until_event(world, ev.MissionPaused)
            await world.clock.sleep(10.0)
            assert world.camera.photos == []
            mission.commands.resume()
            assert (await flying).state is S.COMPLETE

    run_virtual(main())


def test_pause_holds_after_the_photo_and_resume_goes_on() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        mission.commands.pause("coffee")
        with pytest.raises(CommandRefusedError, match="paused already"):
            mission.commands.pause()
        await until_event(world, ev.MissionPaused)
        photos = len(world.camera.photos)
        await world.clock.sleep(10.0)
        assert len(world.camera.photos) == photos
        assert mission.record.state is S.PAUSED
        assert mission.record.reason == "coffee"
        mission.commands.resume()

    world = fly(script)
    assert world.record.state is S.COMPLETE
    assert len(world.sink.of(ev.ShotInterrupted)) == 1
    assert world.sink.of(ev.MissionResumed)[0].paused_s == pytest.approx(10.0, abs=0.2)
    assert world.record.retakes == 0


def test_resume_right_after_pause_leaves_no_pause() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        mission.commands.pause()
        mission.commands.resume()
        with pytest.raises(CommandRefusedError, match="not paused"):
            mission.commands.resume()

    world = fly(script)
    assert world.sink.of(ev.MissionPaused) == []
    assert world.record.state is S.COMPLETE


def test_a_pause_that_nobody_ends_ends_the_mission_resumable() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted)
        mission.commands.pause()

    world = fly(script)
    assert world.record.state is S.FAILED
    assert "paused for 30 s" in world.record.reason


def test_skip_leaves_the_current_shot_out_at_once() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        assert mission.commands.skip() == 1
        assert mission.commands.skip(3) == 3
        with pytest.raises(CommandRefusedError, match="shots are 0 to 3"):
            mission.commands.skip(7)
        await until_event(world, ev.ShotSkipped, 2)
        with pytest.raises(CommandRefusedError, match="skipped already"):
            mission.commands.skip(3)

    world = fly(script)
    assert world.record.state is S.INCOMPLETE
    assert world.record.missing() == (1, 3)
    assert len(world.camera.photos) == 2


def test_repeat_takes_the_last_accepted_shot_again_and_the_new_photo_counts() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 1)
        assert mission.commands.repeat() == 0
        with pytest.raises(CommandRefusedError, match="still in the queue"):
            mission.commands.repeat(0)

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
        mission.commands.repeat(2)

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
        mission.commands.abort("enough")
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
        mission.commands.finish()

    world = fly(script)
    assert world.record.state is S.INCOMPLETE
    assert 2 <= world.record.shots_done <= 3
    assert "gaps are accepted" in world.record.reason


@pytest.mark.parametrize("verb", ["pause", "resume", "skip", "repeat", "finish", "abort", "interrupt"])
def test_each_verb_is_safe_at_every_instant_of_a_photo(verb: str) -> None:
    """From the start, through a slew, the settle time, the trigger, the open shutter and the proof, to the end."""
    trigger_s = fly(plan=a_plan(2)).camera.photos[1].triggered_s - 1000.1
    instants = [0.0, 1.0, *(trigger_s + step for step in (-0.15, -0.001, 0.06, 0.1, 1.0))]
    for at_s in instants:
        asked: list[str] = []

        async def script(world: World, mission: Mission, at_s: float = at_s, asked: list[str] = asked) -> None:
            await world.clock.sleep(at_s)
            before = (mission.record.seq, mission.record.state)
            try:
                getattr(mission.commands, verb)()
            except CommandRefusedError:
                assert (mission.record.seq, mission.record.state) == before
                asked.append("refused")
            else:
                asked.append("obeyed")
            while not mission.record.ended and mission.record.state is not S.PAUSED:
                await world.clock.sleep(0.05)
            if mission.record.state is S.PAUSED and verb == "pause":
                mission.commands.resume()

        world = fly(script, plan=a_plan(2))  # every invariant is checked at its end
        obeyed = asked == ["obeyed"]
        state = world.record.state
        if verb == "abort":
            assert (state is S.ABORTED) is obeyed
        elif verb == "interrupt":
            assert (state is S.PAUSED) is obeyed
        elif verb in {"pause", "resume", "repeat"} or not obeyed:
            assert state is S.COMPLETE
        else:
            assert state in {S.COMPLETE, S.INCOMPLETE}


@pytest.mark.parametrize("verb", ["repeat", "skip", "pause", "finish", "abort", "interrupt"])
def test_what_comes_after_the_last_decision_is_refused_and_not_forgotten(verb: str) -> None:
    """While the gimbal is being released there is nobody left who would obey."""

    async def script(world: World, mission: Mission) -> None:
        while not releasing:
            await world.clock.sleep(0.001)
        seq = mission.record.seq
        with pytest.raises(CommandRefusedError, match="the mission is over"):
            getattr(mission.commands, verb)()
        assert mission.record.seq == seq

    releasing: list[bool] = []

    def prepare(world: World) -> None:
        release = world.gimbal.release

        async def slowly() -> None:
            releasing.append(True)
            await world.clock.sleep(1.0)
            await release()

        setattr(world.gimbal, "release", slowly)  # noqa: B010

    world = fly(script, prepare)
    assert world.record.state is S.COMPLETE
    assert not world.sink.of(ev.CommandReceived)


def test_the_last_shot_is_the_last_one_whatever_the_wall_clock_says() -> None:
    """A computer without a clock of its own gets the time in the middle of a flight."""

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 1)
        time = world.clock.time
        setattr(world.clock, "time", lambda: time() - 86400.0)  # noqa: B010
        await until_event(world, ev.ShotAccepted, 3)
        assert mission.commands.repeat() == 2

    world = fly(script)
    assert world.record.state is S.COMPLETE
    assert len(world.record.shots[2].attempts) == 2
