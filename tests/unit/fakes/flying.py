"""Fly one mission on fakes, with a script beside it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, TypeAlias

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world

Script: TypeAlias = Callable[[World, Mission], Awaitable[None]]


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


async def until_photos(world: World, count: int) -> None:
    while len(world.camera.photos) < count:
        await world.clock.sleep(0.01)


async def pilot_takes_over(world: World, *, within_s: float) -> None:
    """The pilot changes the flight mode, and has the gimbal within so many seconds."""
    world.vehicle.change(mode="STABILIZED")
    asked = world.clock.monotonic()
    while world.gimbal.in_control:
        await world.clock.sleep(0.01)
    assert world.clock.monotonic() - asked < within_s


async def pilot_hands_back(
    world: World, mission: Mission, *, mode: str = "OFFBOARD", after_s: float = 0.0, resume_after_s: float = 1.0
) -> None:
    """After a while the pilot changes back to an allowed flight mode, and a little later the mission is resumed."""
    await world.clock.sleep(after_s)
    world.vehicle.change(mode=mode)
    await world.clock.sleep(resume_after_s)
    mission.commands.resume()


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
