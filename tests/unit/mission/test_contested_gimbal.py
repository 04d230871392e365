"""The gimbal between two stations: who has it, who gives it back, and to whom."""

from __future__ import annotations

import math
import random
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mission.settings import GuardSettings, MissionSettings
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.world import World, a_plan, some_settings

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


@pytest.mark.parametrize("settings", [NEVER, some_settings()])
def test_a_gimbal_that_nobody_has_any_more_is_acquired_again(settings: MissionSettings) -> None:
    """As after a reboot of its manager: nobody took it, so nobody has to give it back."""

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        world.gimbal.in_control, world.gimbal.other = False, (0, 0)

    world = fly(script, settings=settings)
    assert world.record.state is S.COMPLETE
    assert [(event.code, event.automatic) for event in world.sink.of(ev.MissionPaused)] == [("gimbal_lost", True)]
    assert world.sink.of(ev.MissionResumed)[0].paused_s < 2.0
    assert world.gimbal.acquired == 2


@pytest.mark.parametrize("settings", [NEVER, some_settings()])
@pytest.mark.parametrize("other", [(0, 0), (1, 1)])
@pytest.mark.parametrize("before_s", [0.05, 0.5, 0.95])
def test_an_autopilot_that_drops_or_takes_the_gimbal_for_a_mode_of_the_pilot_keeps_it(
    settings: MissionSettings, other: tuple[int, int], before_s: float
) -> None:
    """The mode is told by the next heartbeat only: PX4's RTL drops the gimbal before."""

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        await world.clock.sleep(math.floor(world.clock.monotonic()) + 2.0 - before_s - world.clock.monotonic())
        world.gimbal.in_control, world.gimbal.other = False, other
        await world.clock.sleep(before_s)
        world.vehicle.change(mode="RETURN_TO_LAUNCH")
        await world.clock.sleep(10.0)
        assert world.gimbal.acquired == 1
        world.gimbal.other = (0, 0)
        world.vehicle.change(mode="HOLD")
        await world.clock.sleep(2.0)
        mission.commands.resume()

    world = fly(script, settings=settings)
    assert world.record.state is S.COMPLETE
    assert [event.code for event in world.sink.of(ev.MissionPaused)] == ["pilot"]


def test_a_lost_gimbal_is_acquired_again_without_a_heartbeat_after_a_moment() -> None:
    """The link guard answers for heartbeats that stay away."""

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        world.vehicle.silent = True
        world.gimbal.in_control, world.gimbal.other = False, (0, 0)

    world = fly(script)
    assert world.record.state is S.COMPLETE
    lost = next(event for event in world.sink.of(ev.MissionPaused))
    assert lost.code == "gimbal_lost"
    # 1.5 s for a heartbeat that does not come, and 1 s for which the control must have been ours again
    assert 2.4 < world.sink.of(ev.MissionResumed)[0].paused_s < 3.0


def test_a_manager_that_refuses_what_nobody_has_is_asked_again_and_again() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        world.gimbal.in_control, world.gimbal.other, world.gimbal.refuse_control = False, (0, 0), 3

    world = fly(script, settings=NEVER)
    assert world.record.state is S.COMPLETE
    assert world.gimbal.acquired == 2
    assert all(event.automatic for event in world.sink.of(ev.MissionPaused))


def gap(world: World, *, lost_s: float, after: Callable[[World], None] = lambda _: None) -> Awaitable[None]:
    """No heartbeat for a while; then who has control is unknown until the manager has answered."""

    async def pass_by() -> None:
        world.vehicle.change(connected=False)
        await world.clock.sleep(lost_s)
        after(world)
        world.gimbal.unknown = True
        world.vehicle.change(connected=True)

    return pass_by()


@pytest.mark.parametrize("settings", [NEVER, some_settings()])
@pytest.mark.parametrize("lost_s", [0.05, 3.0, 15.0])
def test_unknown_control_holds_the_mission_only_until_the_manager_has_answered(
    settings: MissionSettings, lost_s: float
) -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        world.gimbal.mute_manager = True
        await gap(world, lost_s=lost_s)
        await world.clock.sleep(4.0)
        assert mission.record.state is S.PAUSED
        assert "asking its manager" in mission.record.reason
        asked = world.gimbal.asked
        assert asked >= 3
        world.gimbal.mute_manager = False

    world = fly(script, settings=settings)
    assert world.record.state is S.COMPLETE
    assert world.gimbal.acquired == 1, "it was ours all the time"
    assert all(event.automatic for event in world.sink.of(ev.MissionPaused))


def test_control_that_was_unknown_and_is_another_stations_waits_for_the_operator() -> None:
    def stolen(world: World) -> None:
        world.gimbal.in_control = False

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted, 2)
        await gap(world, lost_s=4.0, after=stolen)
        await world.clock.sleep(5.0)
        assert mission.record.state is S.PAUSED
        assert "another station took control" in mission.record.reason
        await gap(world, lost_s=4.0)  # the next gap changes nothing in that
        await world.clock.sleep(5.0)
        assert mission.record.state is S.PAUSED
        assert world.gimbal.acquired == 1
        world.gimbal.other = (0, 0)
        await world.clock.sleep(0.5)
        mission.commands.resume()

    world = fly(script, settings=NEVER)
    assert world.record.state is S.COMPLETE
    assert world.gimbal.acquired == 2


@pytest.mark.parametrize("seed", range(20))
def test_no_gap_needs_a_human(seed: int) -> None:
    """Gaps of 0.1 to 120 s at any moment, with the control kept, or lost to nobody as by a reboot."""
    rng = random.Random(seed)

    def dropped(world: World) -> None:
        world.gimbal.in_control, world.gimbal.other = False, (0, 0)

    async def script(world: World, mission: Mission) -> None:
        for number in range(5):
            await until_event(world, ev.ShotStarted, 2 * number + 1)
            await world.clock.sleep(rng.random())
            after = dropped if rng.random() < 0.3 else lambda _: None
            await gap(world, lost_s=0.1 * 1200 ** rng.random(), after=after)

    world = fly(script, settings=replace(NEVER, max_pause_s=200.0), plan=a_plan(12))
    assert world.record.state is S.COMPLETE
    assert all(event.automatic for event in world.sink.of(ev.MissionPaused))


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
