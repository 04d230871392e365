"""A command that was answered is obeyed, also when the process dies before it came to that."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import ShotStatus
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.flying import until_event
from tests.unit.fakes.process import Process
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world

S = MissionState


def _two_lives(script: Callable[[World, Mission], Awaitable[None]]) -> tuple[World, MissionRecord]:
    """Fly until the script is done and what it asked for is on disk; die; fly on in a new process."""

    async def main() -> tuple[World, MissionRecord]:
        async with a_world() as world:
            process = Process(world)
            mission = process.mission()
            running = asyncio.create_task(mission.run(), name="first life")
            await script(world, mission)
            seq = mission.record.seq
            while len(world.journal.events) < seq:
                await world.clock.sleep(0.001)
            await process.kill(running)
            assert world.journal.events[-1].seq == seq  # it died before it came to do more
            record = await Process(world).mission(past=list(world.journal.events)).run()
            check_mission(world, record)
            return world, record

    return run_virtual(main())


async def _open_shutter(world: World, count: int) -> None:
    while len(world.camera.photos) < count:
        await world.clock.sleep(0.001)


@pytest.mark.parametrize(("verb", "state"), [("abort", S.ABORTED), ("finish", S.INCOMPLETE)])
def test_what_ends_a_mission_ends_it(verb: str, state: MissionState) -> None:
    async def script(world: World, mission: Mission) -> None:
        await _open_shutter(world, 2)
        getattr(mission.commands, verb)("it rains")

    world, record = _two_lives(script)
    assert record.state is state
    assert "it rains" in record.reason
    assert len(world.camera.photos) == 2
    assert not world.gimbal.in_control


def test_an_abort_overrules_a_finish_there_too() -> None:
    async def script(world: World, mission: Mission) -> None:
        await _open_shutter(world, 2)
        mission.commands.finish()
        mission.commands.abort("danger")

    _, record = _two_lives(script)
    assert (record.state, record.reason) == (S.ABORTED, "danger")


def test_a_skip_is_a_skip() -> None:
    async def script(world: World, mission: Mission) -> None:
        await _open_shutter(world, 2)
        mission.commands.skip()

    world, record = _two_lives(script)
    assert record.shots[1].status is ShotStatus.SKIPPED
    assert (record.state, record.missing()) == (S.INCOMPLETE, (1,))
    assert len(world.camera.photos) == 4


def test_a_repeat_is_a_repeat_once() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 2)
        mission.commands.repeat(0)

    world, record = _two_lives(script)
    assert record.state is S.COMPLETE
    assert [len(record.shots[index].attempts) for index in (0, 1)] == [2, 1]
    assert len(world.camera.photos) == 5


def test_a_pause_is_on_record_until_somebody_wants_it_to_go_on() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 2)
        mission.commands.pause()
        assert mission.record.asked.pause
        mission.commands.resume()
        assert not mission.record.asked.pause
        mission.commands.pause()
        asked.append(mission.record.asked.pause)

    asked: list[bool] = []
    _, record = _two_lives(script)
    assert asked == [True]
    assert record.state is S.COMPLETE  # the second life is somebody's wish
    assert not record.asked.pause
