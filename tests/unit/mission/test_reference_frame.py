"""Where a mission is tied down when the vehicle tells its place and heading late."""

from __future__ import annotations

import asyncio
import math

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world

S = MissionState
METRE = 1 / 111_194.9
NOWHERE = {"latitude_deg": math.nan, "longitude_deg": math.nan, "altitude_m": math.nan}
HERE = {"latitude_deg": 47.0, "longitude_deg": 8.0, "altitude_m": 500.0}


def _lost(world: World) -> None:
    world.vehicle.change(**NOWHERE)


async def _drifts_and_comes_back(world: World, mission: Mission) -> None:
    world.vehicle.change(latitude_deg=47.0 + 4 * METRE)
    await until_event(world, ev.MissionPaused)
    assert "4.0 m from where" in mission.record.reason
    world.vehicle.change(latitude_deg=47.0)


@pytest.mark.parametrize("shots", [0, 2])
def test_drift_is_watched_from_the_moment_that_the_place_is_known(shots: int) -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, shots)
        await world.clock.sleep(0.3)
        world.vehicle.change(**HERE)
        await until_event(world, ev.ShotStarted, shots + 1)
        await world.clock.sleep(0.2)
        await _drifts_and_comes_back(world, mission)

    world = fly(script, _lost)
    assert world.record.state is S.COMPLETE
    assert world.record.origin == (47.0, 8.0, 500.0)
    assert len(world.sink.of(ev.MissionAnchored)) == 1


def test_yaw_0_is_the_heading_as_soon_as_that_is_told() -> None:
    async def main() -> tuple[World, MissionRecord]:
        async with a_world() as world:
            world.vehicle.change(heading_deg=math.nan)
            mission = world.mission(reference="heading")
            running = asyncio.create_task(mission.run(), name="mission")
            await world.clock.sleep(2.0)
            world.vehicle.change(heading_deg=75.0)
            record = await running
            check_mission(world, record)
            return world, record

    world, record = run_virtual(main())
    assert record.state is S.COMPLETE
    assert record.reference_yaw_north_deg == 75.0
    assert world.gimbal.commands[0][2] == pytest.approx(world.plan.shots[0].yaw_deg + 75.0)


def test_without_a_heading_nothing_moves() -> None:
    async def main() -> tuple[World, MissionRecord]:
        async with a_world() as world:
            world.vehicle.change(heading_deg=math.nan)
            return world, await world.mission(reference="heading").run()

    world, record = run_virtual(main())
    assert record.state is S.FAILED
    assert "heading is unknown" in record.reason
    assert not world.gimbal.commands


def test_a_resumed_mission_that_moved_says_so_when_it_knows() -> None:
    """Its guard measures from the new place: the old one is not to be flown back to."""

    async def main() -> tuple[World, MissionRecord]:
        async with a_world() as world:
            mission = world.mission()
            running = asyncio.create_task(mission.run(), name="first life")
            await until_event(world, ev.ShotAccepted, 2)
            mission.commands.interrupt()
            await running
            _lost(world)
            again = world.mission(past=list(world.journal.events))
            running = asyncio.create_task(again.run(), name="second life")
            await until_event(world, ev.ShotStarted, 3)
            world.vehicle.change(**HERE | {"latitude_deg": 47.0 + 6 * METRE})
            record = await running
            check_mission(world, record)
            return world, record

    world, record = run_virtual(main())
    assert record.state is S.COMPLETE
    assert [event.code for event in world.sink.of(ev.Warned)] == ["position"]
    assert "resumed 6.0 m from where" in world.sink.of(ev.Warned)[0].text
    assert not [event for event in world.sink.of(ev.MissionPaused) if event.code == "position"]


def test_many_small_moves_add_up() -> None:
    """Each process begins 2 m from where the last one did, which its guard of drift cannot see."""

    async def main() -> World:
        async with a_world() as world:
            for life in range(3):
                world.vehicle.change(**HERE | {"latitude_deg": 47.0 + 2 * life * METRE})
                mission = world.mission(past=list(world.journal.events))
                running = asyncio.create_task(mission.run(), name=f"life {life}")
                await until_event(world, ev.ShotAccepted, life + 1)
                mission.commands.interrupt()
                await running
            return world

    world = run_virtual(main())
    assert ["resumed 4.0 m from where" in event.text for event in world.sink.of(ev.Warned)] == [True]
