"""An internal error in a mission: it ends the mission, not the daemon."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from panoexec.daemon.beginnings import Beginning, StopCommand, StopVerb
from panoexec.daemon.errors import MissionBusyError
from panoexec.daemon.missions import Missions
from panoexec.inputs.config import Config
from panoexec.inputs.service_sections import StorageSection
from panoexec.mission.log.states import MissionState
from panoexec.store.session import Devices, create_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import a_world


def test_an_error_of_ours_ends_the_mission_and_not_the_daemon(tmp_path: Path) -> None:
    async def main() -> None:
        async with a_world() as world:
            config = Config(storage=StorageSection(path=tmp_path))
            missions = Missions(config=lambda: config, clock=world.clock, sink=world.sink, changed=lambda: None)
            stored = await create_mission(
                tmp_path, plan=world.plan, settings=world.settings, now_utc_s=world.clock.time()
            )

            async def broken() -> None:
                raise ZeroDivisionError("a fault of ours")

            setattr(world.camera, "trigger", broken)  # noqa: B010
            devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
            await missions._flown(stored, devices, "north")
            assert missions.record is not None
            assert missions.record.state is MissionState.FAILED  # so that it does not go on by itself into the same
            assert "internal error" in missions.record.reason
            assert not world.gimbal.in_control
            assert missions.trouble == "ZeroDivisionError: a fault of ours"
            assert missions.mission is None
            assert not await missions.find_interrupted()
            assert missions.offer is not None

    run_virtual(main())


@pytest.mark.parametrize("verb", ["abort", "finish"])
@pytest.mark.parametrize("when", ["before it exists", "while it flies"])
def test_a_start_waits_for_a_mission_that_was_told_to_end(tmp_path: Path, verb: StopVerb, when: str) -> None:
    async def main() -> None:
        async with a_world() as world:
            config = Config(storage=StorageSection(path=tmp_path))
            missions = Missions(config=lambda: config, clock=world.clock, sink=world.sink, changed=lambda: None)
            devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
            async with missions.claimed(Beginning("start")):
                name = await missions.begin(world.plan, world.settings, devices, "north")
            if when == "before it exists":
                assert missions.beginning is not None
                missions.beginning.stop(StopCommand(verb))
            running = asyncio.create_task(missions.run())
            if when == "while it flies":
                mission = await missions.under_way()
                assert mission is not None
                with pytest.raises(MissionBusyError, match=f"{name} is under way"):
                    async with missions.claimed(Beginning("start")):
                        pass
                missions.stop(StopCommand(verb))
                assert mission.record.state is not MissionState.ABORTED  # it takes its time
            assert missions.busy
            async with missions.claimed(Beginning("start")):
                assert missions.record is not None
                assert missions.record.mission_id == name
                assert missions.record.state is (MissionState.ABORTED if verb == "abort" else MissionState.INCOMPLETE)
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    run_virtual(main())
