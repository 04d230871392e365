"""The charge against the time that shooting takes."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.preflight import battery_problems, battery_warning
from panoexec.mission.settings import GuardSettings
from tests.unit.fakes.flying import fly
from tests.unit.fakes.world import World, some_settings

GUARDS = GuardSettings(battery_floor_frac=0.25, hover_s=1200.0, allowed_modes=("OFFBOARD",))


@pytest.mark.parametrize(
    ("charge_frac", "minutes", "problem", "warned"),
    [
        (0.5, 4.9, "", False),
        (0.5, 5.1, "battery at 50 %: 5.1 min of shooting need about 26 %, and 25 % must remain", True),
        (0.2, 0.1, "battery at 20 %, the floor is 25 %", True),
        (0.95, 13.5, "", False),
        (0.92, 13.5, "", True),  # nearly full: there is no better one
        (0.5, 60.0, "", True),  # no battery is enough: it is flown on several
        (math.nan, 60.0, "", False),
    ],
)
def test_what_a_charge_is_enough_for(charge_frac: float, minutes: float, problem: str, warned: bool) -> None:
    problems = battery_problems(charge_frac, GUARDS, expected_s=60 * minutes)
    assert "; ".join(problems).startswith(problem)
    assert bool(problems) is bool(problem)
    assert bool(battery_warning(charge_frac, GUARDS, expected_s=60 * minutes)) is warned


def test_where_nobody_knows_how_long_a_battery_lasts_only_the_floor_counts() -> None:
    unknown = replace(GUARDS, hover_s=0.0)
    assert battery_problems(0.3, unknown, expected_s=3600.0) == []
    assert battery_warning(0.3, unknown, expected_s=3600.0) == ""
    assert battery_problems(0.2, unknown, expected_s=1.0)


def test_a_mission_that_the_battery_does_not_last_for_does_not_begin() -> None:
    def prepare(world: World) -> None:
        world.vehicle.change(battery_frac=0.3)

    world = fly(prepare=prepare, settings=some_settings(guards=replace(GUARDS, hover_s=60.0)))
    assert world.record.state is MissionState.FAILED
    assert "battery at 30 %" in world.record.reason
    assert not world.gimbal.commands


def test_one_that_needs_several_says_so_and_begins() -> None:
    world = fly(settings=some_settings(guards=replace(GUARDS, hover_s=5.0)))
    assert world.record.state is MissionState.COMPLETE
    assert [event.code for event in world.sink.of(ev.Warned)] == ["battery_estimate"]
    assert "pause at 25 %" in world.sink.of(ev.Warned)[0].text
