"""Stations in an autopilot's mission: held, let go on, and left alone where something speaks against it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from panoexec.daemon.stations.tour_log import TourLog
from panoexec.errors import PlanningError
from panoexec.mission.log.states import MissionState
from tests.unit.daemon.station_world import World, jump, marker, two_stations, waypoint

pytestmark = pytest.mark.asyncio


def world(folder: Path, **settings: Any) -> World:
    return World(folder=folder, items=settings.pop("items", two_stations()), **settings)


async def test_both_are_flown_and_the_mission_goes_on_at_once(tmp_path: Path) -> None:
    flown = await world(tmp_path).run(90)
    assert flown.outcomes == [(1, "complete"), (3, "complete")]
    assert flown.seq == 5
    assert flown.said[0] == "2 stations in this mission"
    told = [what for _, what in flown.log]
    assert told == ["start", "current 1", "current 2", "start", "current 3", "current 4"]
    for stop in flown.tour.stops:
        assert stop.before_s is not None
        assert stop.after_s is not None
        assert 0 < stop.before_s < 3.0
        assert 0 <= stop.after_s < 1.0
    assert flown.modes == ("MISSION",)


async def test_a_hold_time_is_prolonged_as_long_as_the_panorama_takes(tmp_path: Path) -> None:
    flown = await world(tmp_path, items=two_stations(hold_s=10.0), panorama_s=60.0).run(100)
    assert flown.outcomes[0] == (1, "complete")
    assert len(flown.told("current 1")) >= 10


async def test_a_dead_process_lets_the_vehicle_go_on_within_a_hold_time(tmp_path: Path) -> None:
    flown = world(tmp_path, panorama_s=200.0)
    await flown.run(60)
    assert flown.seq == 1
    last_s = flown.told("current 1")[-1]
    await _nobody(flown, 60)
    assert flown.seq > 1
    assert flown.now_s - last_s <= 100


async def _nobody(flown: World, seconds: float) -> None:
    for _ in range(round(seconds / 0.2)):
        flown._step(0.2)


async def test_a_process_that_is_started_again_goes_on_with_the_panorama(tmp_path: Path) -> None:
    flown = world(tmp_path)
    await flown.run(15)
    assert flown.told("start")
    flown.kill()
    await _nobody(flown, 8)
    await flown.run(100)
    assert len(flown.told("resume")) == 1
    assert flown.made == 2
    assert flown.outcomes == [(1, "complete"), (3, "complete")]
    assert len({stop.mission_id for stop in flown.tour.stops}) == 2


async def test_a_panorama_that_was_over_when_the_process_died_is_not_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = world(tmp_path, panorama_s=10.0, refuses_current=True)
    await flown.run(9)
    flown.missions.record.state, flown.missions.mission = MissionState.COMPLETE, None
    flown.kill()
    flown.refuses_current = False

    async def on_disk(_log: TourLog, mission_id: str | None) -> MissionState:
        assert mission_id == "mission-1"
        return MissionState.COMPLETE

    monkeypatch.setattr(TourLog, "state_of", on_disk)
    await flown.run(5)
    assert flown.made == 1
    assert flown.outcomes[0] == (1, "complete")
    assert flown.told("current 2")


async def test_a_process_that_is_stopped_leaves_the_stop_open(tmp_path: Path) -> None:
    flown = world(tmp_path)
    await flown.run(15)
    flown.missions.record.state, flown.missions.mission = MissionState.PAUSED, None  # interrupted
    await flown.run(2)
    assert flown.tour.open_stop is not None
    assert not flown.told("current 2")
    flown.missions.mission = object()
    flown.kill()
    await flown.run(100)
    assert flown.outcomes == [(1, "complete"), (3, "complete")]


async def test_a_process_that_comes_back_too_late_leaves_the_stop_as_it_is(tmp_path: Path) -> None:
    flown = world(tmp_path)
    await flown.run(15)
    flown.kill()
    await _nobody(flown, 40)
    assert flown.seq == 3
    await flown.run(60)
    assert flown.outcomes == [(1, "left"), (3, "complete")]


async def test_the_pilot_takes_over_and_the_mission_is_the_pilots(tmp_path: Path) -> None:
    flown = world(tmp_path, script=[(20, lambda w: w.set_mode("HOLD")), (40, lambda w: w.set_mode("MISSION"))])
    await flown.run(90)
    taken_s = 120.0
    assert not [when for when in flown.told("current 1") + flown.told("current 2") if when > taken_s]
    # the plan's hold time, begun anew by the pilot's return, was over before it went on
    assert flown.told("finish")[0] >= 140.0 + 40.0 - 1.0
    assert flown.outcomes[0] == (1, "incomplete")


@pytest.mark.parametrize("mode", ["RETURN_TO_LAUNCH", "LAND"])
async def test_a_lost_transmitter_that_changes_the_mode_is_treated_like_the_pilot(tmp_path: Path, mode: str) -> None:
    flown = world(tmp_path, script=[(20, lambda w: w.set_mode(mode))])
    await flown.run(60)
    assert not [when for when in flown.told("current") if when > 120.0]
    assert flown.told("mode") == []


@pytest.mark.parametrize(("presets", "problem"), [((9, 1), "waypoint 1: there is no preset 9, 2 are configured")])
async def test_an_unknown_preset_is_told_and_its_hold_time_passes(
    tmp_path: Path, presets: tuple[int, int], problem: str
) -> None:
    flown = await world(tmp_path, items=two_stations(presets=presets)).run(100)
    assert problem in flown.said
    assert flown.outcomes == [(3, "complete")]
    assert not flown.told("current 1")


async def test_a_preset_that_cannot_be_planned_skips_its_stations(tmp_path: Path) -> None:
    flown = await world(tmp_path, plan_error=PlanningError("no plan")).run(40)
    assert flown.outcomes == [(1, "skipped"), (3, "skipped")]
    assert not flown.told("start")


async def test_a_battery_that_does_not_suffice_for_both_skips_at_once(tmp_path: Path) -> None:
    flown = await world(tmp_path, battery_frac=0.26).run(30)
    assert flown.outcomes == [(1, "skipped"), (3, "skipped")]
    assert any("battery at 26 %" in text for text in flown.said)
    assert flown.seq == 5


async def test_a_battery_at_its_floor_ends_the_panorama_and_the_mission_goes_on(tmp_path: Path) -> None:
    flown = await world(tmp_path, script=[(15, lambda w: w.pause("battery"))]).run(25)
    assert flown.outcomes[0] == (1, "incomplete")
    assert flown.seq == 3


async def test_no_position_no_arrival(tmp_path: Path) -> None:
    flown = await world(tmp_path, position_ok=False).run(80)
    assert not flown.told("start")
    assert not flown.told("current")


async def test_a_mission_that_is_uploaded_again_at_a_station_is_left_alone(tmp_path: Path) -> None:
    other = [waypoint(0, 0), waypoint(1, 20, hold_s=40.0), waypoint(2, 30), waypoint(3, 40)]
    flown = await world(tmp_path, panorama_s=12.0, script=[(12, lambda w: w.upload(other))]).run(30)
    assert not flown.told("current")
    assert flown.outcomes == [(1, "complete")]
    assert flown.seq == 1


async def test_a_jump_away_ends_the_panorama_that_is_under_way(tmp_path: Path) -> None:
    flown = await world(tmp_path, script=[(15, lambda w: w.jump_to(5))]).run(25)
    assert flown.outcomes == [(1, "incomplete")]
    assert flown.told("finish")
    assert not flown.told("current")


async def test_a_loop_flies_no_second_panorama_unless_it_may(tmp_path: Path) -> None:
    items = [
        waypoint(0, 0),
        waypoint(1, 20, hold_s=30.0),
        marker(2, 1),
        waypoint(3, 40),
        jump(4, 1, 1),
        waypoint(5, 60),
    ]
    once = await world(tmp_path / "once", items=items).run(150)
    assert once.outcomes == [(1, "complete")]
    assert "waypoint 1: done already, not again" in once.said
    assert once.seq == 5
    twice = await world(tmp_path / "twice", items=items, config={"stations": {"enabled": True, "visits": 2}}).run(150)
    assert twice.outcomes == [(1, "complete"), (1, "complete")]


async def test_what_another_one_does_is_left_to_it(tmp_path: Path) -> None:
    flown = await world(tmp_path, claimed="the panoexec of component 191 does it").run(100)
    assert set(flown.outcomes) == {(1, "skipped"), (3, "skipped")}
    assert not flown.told("current")
    assert not flown.told("start")


async def test_one_introduces_itself_to_another_one(tmp_path: Path) -> None:
    flown = world(tmp_path)

    def another(world: World) -> None:
        world.is_to_introduce = True

    flown.script = [(3, another)]
    await flown.run(5)
    assert flown.said == ["2 stations in this mission"] * 2
    assert not flown.is_to_introduce


async def test_where_holds_are_not_prolonged_a_short_one_is_skipped(tmp_path: Path) -> None:
    flown = await world(tmp_path, extends=False, items=two_stations(hold_s=36.0)).run(50)
    assert flown.outcomes == [(1, "skipped"), (3, "skipped")]
    assert any("36 s is too short for 25 s" in text for text in flown.said)


async def test_where_holds_are_not_prolonged_nothing_but_going_on_is_told(tmp_path: Path) -> None:
    flown = await world(tmp_path, extends=False).run(90)
    assert flown.outcomes == [(1, "complete"), (3, "complete")]
    assert flown.told("current 1") == flown.told("current 3") == []


async def test_a_vehicle_that_must_turn_is_refused_with_the_reason(tmp_path: Path) -> None:
    flown = await world(tmp_path, config={"gimbal": {"yaw": "vehicle"}}).run(40)
    assert flown.outcomes == [(1, "skipped"), (3, "skipped")]
    assert any("the vehicle must turn" in text for text in flown.said)
    assert not flown.told("mode")


async def test_where_it_may_the_vehicle_is_turned_in_guided_and_given_back(tmp_path: Path) -> None:
    turning = {"gimbal": {"yaw": "vehicle"}, "stations": {"enabled": True, "guided": True}}
    flown = await world(tmp_path, config=turning).run(100)
    assert flown.outcomes == [(1, "complete"), (3, "complete")]
    assert [what for _, what in flown.log if what.startswith("mode")] == ["mode OFFBOARD", "mode MISSION"] * 2
    assert "waypoint 1: changing to GUIDED to turn the vehicle" in flown.said
    assert "waypoint 1: back to the mission" in flown.said
    assert flown.seq == 5


async def test_a_pilot_who_takes_over_from_guided_keeps_the_mode(tmp_path: Path) -> None:
    turning = {"gimbal": {"yaw": "vehicle"}, "stations": {"enabled": True, "guided": True}}
    flown = await world(tmp_path, config=turning, script=[(15, lambda w: w.set_mode("POSCTL"))]).run(60)
    assert [what for _, what in flown.log if what.startswith("mode")] == ["mode OFFBOARD"]
    assert flown.mode == "POSCTL"


async def test_a_request_that_is_refused_lets_the_mission_go_on(tmp_path: Path) -> None:
    flown = await world(tmp_path, refuses="a mission is under way").run(40)
    assert flown.outcomes == [(1, "skipped"), (3, "skipped")]
    assert "waypoint 1: not started: a mission is under way" in flown.said


async def test_a_panorama_that_takes_too_long_ends_with_what_it_has(tmp_path: Path) -> None:
    flown = await world(tmp_path, panorama_s=500.0, config={"stations": {"enabled": True, "longest_s": 50}}).run(75)
    assert flown.outcomes[0] == (1, "incomplete")
    assert flown.seq == 3


async def test_a_mission_that_cannot_be_read_is_not_asked_for_all_the_time(tmp_path: Path) -> None:
    flown = await world(tmp_path, deaf=True).run(30)
    assert not flown.log
    assert flown.said == []


async def test_a_tour_that_cannot_be_written_is_told_once_and_the_hold_time_passes(tmp_path: Path) -> None:
    (tmp_path / "tours").write_text("not a folder")
    flown = await world(tmp_path).run(120)
    said = [text for text in flown.said if "no panorama" in text]
    assert [text.partition(" no panorama: ")[0] for text in said] == ["waypoint 1:", "waypoint 3:"]
    assert all("tours" in text for text in said)
    assert flown.seq == 5
    assert not flown.told("start")


async def test_a_bug_at_a_station_ends_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown = world(tmp_path)

    async def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(flown.watcher._tour, "of_mission", broken)
    await flown.run(20)
    assert [text for text in flown.said if "no panorama" in text] == ["waypoint 1: no panorama: ZeroDivisionError"]
    monkeypatch.undo()
    await flown.run(100)
    assert flown.outcomes[0] == (1, "complete")


async def test_it_is_off_by_default(tmp_path: Path) -> None:
    flown = world(tmp_path, config={"stations": {}})
    await flown.watcher.run()
    assert not flown.log
