"""Fault, reaction, state: as the table of docs/mission.md has it."""

from __future__ import annotations

import math

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mission.settings import GuardSettings
from tests.unit.fakes.flying import fly, pilot_takes_over, until_event
from tests.unit.fakes.world import World, some_settings

S = MissionState


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
                mission.commands.resume()
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
        assert "non-finite attitude" in reasons[0]
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
            assert "another station took control" in mission.record.reason

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
            mission.commands.resume()

        guards = GuardSettings(reclaim="never")
        assert fly(script, settings=some_settings(guards=guards)).record.state is S.COMPLETE

    def test_the_pilot_takes_over_and_has_the_gimbal_at_once(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            await pilot_takes_over(world, within_s=0.4)
            await world.clock.sleep(5.0)
            with pytest.raises(CommandRefusedError, match="taken over"):
                mission.commands.resume()
            world.vehicle.change(mode="OFFBOARD")
            await world.clock.sleep(5.0)
            assert mission.record.state is S.PAUSED  # the pilot decides when
            mission.commands.resume()

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

    def test_a_charge_that_is_no_longer_told_is_a_warning_each_time(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            for charge_frac in (math.nan, 0.8, math.nan):
                await world.clock.sleep(1.0)
                world.vehicle.change(battery_frac=charge_frac)

        world = fly(script)
        assert world.record.state is S.COMPLETE
        assert [event.code for event in world.sink.of(ev.Warned)] == ["battery_unknown"] * 2
        assert "the floor of 25 % is not watched" in world.sink.of(ev.Warned)[0].text

    def test_a_charge_that_was_never_told_is_none(self) -> None:
        world = fly(prepare=lambda world: world.vehicle.change(battery_frac=math.nan))
        assert world.record.state is S.COMPLETE
        assert not world.sink.of(ev.Warned)

    def test_a_drift_of_position_holds_until_it_is_back_with_hysteresis(self) -> None:
        async def script(world: World, mission: Mission) -> None:
            await until_event(world, ev.ShotStarted, 2)
            metre = 1 / 111_194.9
            world.vehicle.change(latitude_deg=47.0 + 3.1 * metre)
            await until_event(world, ev.MissionPaused)
            assert "3.1 m from where" in mission.record.reason
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
