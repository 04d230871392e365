"""A process that dies with the gimbal in its hands: the next one gives it back, whatever it does."""

from __future__ import annotations

import pytest

from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world

S = MissionState


class TestGimbalAfterACrash:
    """The manager goes on to name us when we are dead: the next process gives the gimbal back, whatever it does."""

    @staticmethod
    def _crashed(world: World, *, knows: bool) -> list[ev.Event]:
        """What a process left on disk that died with the gimbal in its hands, before or after the journal knew."""
        world.gimbal.in_control = True
        head = {"mission_id": "m1", "time_utc_s": 1_700_000_000.0, "state": S.PREFLIGHT}
        past: list[ev.Event] = [ev.MissionStarted(shots_total=4, seq=1, **head)]  # type: ignore[arg-type]
        if knows:
            past.append(ev.GimbalAcquired(seq=2, **head))  # type: ignore[arg-type]
        world.journal.events.extend(past)
        world.sink.events.extend(past)
        return past

    @pytest.mark.parametrize("knows", [True, False])
    def test_it_is_taken_anew_as_that_also_wakes_the_streams(self, knows: bool) -> None:
        async def main() -> None:
            async with a_world() as world:
                record = await world.mission(past=self._crashed(world, knows=knows)).run()
                assert record.state is S.COMPLETE
                assert world.gimbal.acquired == 1
                check_mission(world, record)

        run_virtual(main())

    @pytest.mark.parametrize("knows", [True, False])
    def test_it_is_given_back_by_a_process_that_never_comes_to_take_it(self, knows: bool) -> None:
        async def main() -> None:
            async with a_world() as world:
                world.vehicle.change(in_air=False)
                record = await world.mission(past=self._crashed(world, knows=knows)).run()
                assert record.state is S.FAILED
                assert world.gimbal.acquired == 0
                assert world.gimbal.released == 1
                assert not world.gimbal.in_control

        run_virtual(main())

    def test_killed_once_more_before_it_took_it_the_third_process_still_gives_it_back(self) -> None:
        async def main() -> None:
            async with a_world() as world:
                past = self._crashed(world, knows=True)
                head = {"mission_id": "m1", "time_utc_s": 1_700_000_001.0, "state": S.PREFLIGHT}
                past.append(ev.MissionStarted(shots_total=4, resumed=True, seq=3, **head))  # type: ignore[arg-type]
                world.journal.events[:] = past
                world.vehicle.change(in_air=False)
                world.gimbal.in_control = False  # its manager has not been heard yet
                await world.mission(past=past).run()
                assert world.gimbal.released == 1

        run_virtual(main())

    def test_a_gimbal_that_is_not_ours_is_left_alone(self) -> None:
        async def main() -> None:
            async with a_world() as world:
                world.vehicle.change(in_air=False)
                await world.mission().run()
                assert world.gimbal.released == 0

        run_virtual(main())
