"""The gimbal between two stations: who has it, who gives it back, and to whom."""

from __future__ import annotations

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mission.settings import GuardSettings
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.world import World, some_settings

S = MissionState
NEVER = some_settings(guards=GuardSettings(reclaim="never", allowed_modes=("OFFBOARD", "HOLD")))


@pytest.mark.parametrize("acquire_s", [0.05, 1.5])
def test_a_gimbal_that_is_given_back_is_nobodys_and_can_be_taken_by_resuming(acquire_s: float) -> None:
    """A station that releases control leaves it to nobody; the manager never names us of itself."""

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        world.gimbal.in_control, world.gimbal.acquire_s = False, acquire_s
        await until_event(world, ev.MissionPaused)
        await world.clock.sleep(5.0)
        with pytest.raises(CommandRefusedError, match="release it there"):
            mission.commands.resume()
        world.gimbal.other = (0, 0)
        await world.clock.sleep(5.0)
        assert mission.record.state is S.PAUSED  # it is for the pilot to say
        mission.commands.resume()

    world = fly(script, settings=NEVER)
    assert world.record.state is S.COMPLETE
    assert world.gimbal.acquired == 2
    assert len(world.sink.of(ev.MissionPaused)) == 1


def test_a_gimbal_that_nobody_has_any_more_holds_all_the_same() -> None:
    """As after a reboot of its manager."""

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        world.gimbal.in_control, world.gimbal.other = False, (0, 0)
        await until_event(world, ev.MissionPaused)
        await world.clock.sleep(5.0)
        assert mission.record.state is S.PAUSED
        mission.commands.resume()

    assert fly(script, settings=NEVER).record.state is S.COMPLETE


@pytest.mark.parametrize("moment", ["first", "after a pause"])
def test_a_pilot_who_takes_over_while_the_gimbal_is_being_taken_sees_it_stand_still(moment: str) -> None:
    async def script(world: World, mission: Mission) -> None:
        pauses = 1
        if moment == "after a pause":
            await until_event(world, ev.ShotStarted, 2)
            world.vehicle.change(mode="STABILIZED")
            await until_event(world, ev.MissionPaused)
            await world.clock.sleep(1.0)
            world.vehicle.change(mode="HOLD")
            await world.clock.sleep(1.0)
            mission.commands.resume()
            pauses = 2
        await world.clock.sleep(1.99)  # the gimbal is ours in a moment
        world.vehicle.change(mode="STABILIZED")
        before = len(world.gimbal.commands)
        await until_event(world, ev.MissionPaused, pauses)
        await world.clock.sleep(1.0)
        assert len(world.gimbal.commands) == before
        assert not world.gimbal.in_control
        world.vehicle.change(mode="HOLD")
        await world.clock.sleep(1.0)
        mission.commands.resume()

    def prepare(world: World) -> None:
        world.gimbal.acquire_s = 2.0

    assert fly(script, prepare).record.state is S.COMPLETE


def test_a_gimbal_that_is_not_ours_may_report_seldom() -> None:
    """Its reports are asked for at full rate only while it is held: a short patience must not hold a mission."""

    def prepare(world: World) -> None:
        acquire, release = world.gimbal.acquire, world.gimbal.release

        async def take() -> None:
            await acquire()
            world.gimbal.rate_hz = 50.0
            world.gimbal.report()

        async def give() -> None:
            await release()
            world.gimbal.rate_hz = 1.0

        setattr(world.gimbal, "acquire", take)  # noqa: B010
        setattr(world.gimbal, "release", give)  # noqa: B010

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        world.vehicle.change(mode="STABILIZED")
        await until_event(world, ev.MissionPaused)
        await world.clock.sleep(3.0)
        world.vehicle.change(mode="OFFBOARD")
        await world.clock.sleep(1.45)
        mission.commands.resume()

    guards = GuardSettings(attitude_silence_s=0.5, allowed_modes=("OFFBOARD",))
    world = fly(script, prepare, settings=some_settings(guards=guards))
    assert world.record.state is S.COMPLETE
    assert [event.code for event in world.sink.of(ev.MissionPaused)] == ["pilot"]
    assert len(world.sink.of(ev.ShotRejected)) == 0
