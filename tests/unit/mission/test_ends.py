"""How missions begin, are stopped, fail and go on in a new process."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from panoexec.angles import FloatArray
from panoexec.devices import EvidenceLevel
from panoexec.errors import MissionError
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState
from panoexec.planning.model import Certificate, GimbalLimits, Hole
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.flying import drift_at, fly, pilot_takes_over, until_event
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_certificate, a_plan, a_world, some_settings

S = MissionState
HOLE = Hole(elevation_deg=-70.0, azimuth_deg=10.0, size_deg=2.0)


def test_an_interrupted_mission_can_be_resumed_and_the_photo_counts_stay_right() -> None:
    async def main() -> None:
        async with a_world() as world:
            mission = world.mission()
            async with asyncio.TaskGroup() as group:
                running = group.create_task(mission.run())
                await until_event(world, ev.ShotAccepted, 2)
                mission.commands.interrupt()
                record = await running
            check_mission(world, record)
            assert record.state is S.PAUSED
            assert not world.gimbal.in_control
            record = await world.mission(past=list(world.journal.events)).run()
            check_mission(world, record)
            assert record.state is S.COMPLETE
            assert record.restarts == 1
            assert len(world.camera.photos) == 4

    run_virtual(main())


def test_preflight_names_everything_that_is_wrong_and_moves_nothing() -> None:
    def prepare(world: World) -> None:
        world.vehicle.change(in_air=False, battery_frac=0.1, mode="STABILIZED", position_ok=False)
        world.camera.storage_free_images = 3
        world.gimbal.limits = GimbalLimits(pitch_min_deg=-10.0)
        world.gimbal.nan = True

    world = fly(prepare=prepare)
    assert world.record.state is S.FAILED
    problems = " | ".join(world.sink.of(ev.PreflightFailed)[0].problems)
    for text in (
        "not in the air",
        "battery at 10 %",
        "flight mode is STABILIZED",
        "no valid position",
        "room for 3 photos, 4 are needed",
        "shot 0 at pitch -20.00° is outside the gimbal's -10° to 90° (and 3 more)",
        "non-finite attitude",
    ):
        assert text in problems
    assert world.gimbal.commands == []
    assert world.gimbal.acquired == 0


def test_preflight_waits_a_little_for_what_is_just_starting() -> None:
    async def script(world: World, mission: Mission) -> None:
        await world.clock.sleep(2.0)
        world.vehicle.change(connected=True)

    world = fly(script, prepare=lambda w: w.vehicle.change(connected=False))
    assert world.record.state is S.COMPLETE


def test_a_journal_that_fails_ends_the_mission_and_releases_the_gimbal() -> None:
    async def main() -> None:
        async with a_world() as world:
            append = world.journal.append

            async def failing(events: Any) -> None:
                if any(isinstance(event, ev.ShotAccepted) for event in events):
                    raise MissionError("the journal was deleted")
                await append(events)

            world.journal.append = failing  # type: ignore[method-assign]
            with pytest.raises(MissionError, match="deleted"):
                await world.mission().run()
            assert not world.gimbal.in_control
            assert world.sink.of(ev.ShotAccepted) == []

    run_virtual(main())


def test_a_release_that_hangs_is_given_up() -> None:
    world = fly(prepare=lambda w: setattr(w.gimbal, "release_hangs", True))
    assert world.record.state is S.COMPLETE
    assert world.sink.of(ev.GimbalReleased)[0].confirmed is False


@pytest.mark.parametrize("again_s", [0.0, 0.005, 0.01, 0.5])
@pytest.mark.parametrize("at_s", [0.06, 1.0, 2.65, 7.62])
def test_cancelled_twice_the_gimbal_is_still_released_and_the_journal_complete(at_s: float, again_s: float) -> None:
    async def main() -> None:
        async with a_world() as world:
            world.journal.delay_s = 0.05
            mission = world.mission()
            running = asyncio.create_task(mission.run())
            await world.clock.sleep(at_s)
            running.cancel()
            await world.clock.sleep(again_s)
            running.cancel()
            await asyncio.wait({running})
            check_mission(world, mission.record)
            assert len(world.journal.events) == mission.record.seq
            assert world.record_of_journal().state is mission.record.state

    run_virtual(main())


def test_the_record_is_the_same_from_the_journal() -> None:
    world = fly(prepare=lambda w: drift_at(w, -90.0, until_s=1005.0))
    again = MissionRecord.from_events(mission_id="m1", shots=world.plan.shots, events=world.journal.events)
    assert again.shots == world.record.shots
    assert (again.state, again.retakes, again.seq) == (world.record.state, world.record.retakes, world.record.seq)


def _in_two_flights(between: Callable[[World], None], **mission: Any) -> tuple[World, list[float], int]:
    """A mission that is stopped after two shots; what happens then; and the rest in a new process.

    Returns:
        The world, the yaw of each pointing command, and how many of those were of the first flight.
    """

    async def main() -> tuple[World, list[float], int]:
        async with a_world() as world:
            first = world.mission(**mission)
            async with asyncio.TaskGroup() as group:
                running = group.create_task(first.run())
                await until_event(world, ev.ShotAccepted, 2)
                running.cancel()
            check_mission(world, first.record)
            so_far = len(world.gimbal.commands)
            between(world)
            world.record = await world.mission(past=list(world.journal.events)).run()
            check_mission(world, world.record)
            return world, [yaw for _, _, yaw in world.gimbal.commands], so_far

    return run_virtual(main())


def test_a_mission_that_moved_says_so_and_is_anchored_where_it_is_now() -> None:
    world, _, _ = _in_two_flights(lambda w: w.vehicle.change(latitude_deg=47.0001))
    assert world.record.state is S.COMPLETE
    assert "resumed 11.1 m from where" in world.sink.of(ev.Warned)[0].text
    assert world.record.origin[0] == 47.0001
    # 11 m from the old place is far beyond the bound: it is the new one that counts
    assert [event.code for event in world.sink.of(ev.MissionPaused)] == ["interrupted"]


@pytest.mark.parametrize(
    ("position", "origin"),
    [({"latitude_deg": 47.00001}, 47.00001), ({"latitude_deg": math.nan, "longitude_deg": math.nan}, 47.0)],
)
def test_a_metre_is_no_warning_and_a_place_that_is_not_known_moves_no_anchor(
    position: dict[str, float], origin: float
) -> None:
    world, _, _ = _in_two_flights(lambda w: w.vehicle.change(**position))
    assert world.sink.of(ev.Warned) == []
    assert world.record.origin[0] == origin


def test_after_a_battery_swap_yaw_zero_is_where_the_first_photos_had_it() -> None:
    """Plan yaws are -180, -90, 0, 90 from the heading at the start, 30; the vehicle stands at 200 afterwards."""

    def swapped(world: World) -> None:
        world.vehicle.change(heading_deg=200.0, boot_count=1, battery_frac=1.0)
        world.gimbal.in_control = False

    world, yaws, so_far = _in_two_flights(swapped, reference="heading")
    assert world.record.state is S.COMPLETE
    assert world.record.reference_yaw_north_deg == 30.0
    assert yaws[:2] == pytest.approx([-150.0, -60.0])
    assert yaws[so_far:][-2:] == pytest.approx([30.0, 120.0])
    assert all(event.reference_yaw_north_deg == 30.0 for event in world.sink.of(ev.MissionStarted))


def test_a_mission_that_never_knew_its_heading_takes_the_one_at_its_resumption() -> None:
    async def main() -> None:
        async with a_world() as world:
            world.vehicle.change(heading_deg=math.nan)
            record = await world.mission(reference="heading").run()
            assert record.state is S.FAILED
            assert "heading is unknown" in record.reason
            world.vehicle.change(heading_deg=75.0)
            record = await world.mission(past=list(world.journal.events)).run()
            check_mission(world, record)
            assert record.state is S.COMPLETE
            assert record.reference_yaw_north_deg == 75.0

    run_virtual(main())


def test_settings_that_make_no_sense_are_refused() -> None:
    for change, text in (
        ({"attempts": 0}, "attempts = 0"),
        ({"settle_s": -1.0}, "settle_s = -1.0"),
        ({"max_gap_s": float("nan")}, "max_gap_s = nan"),
        ({"tolerance": replace(some_settings().tolerance, yaw_deg=0.0)}, "tolerance yaw_deg = 0.0"),
    ):
        with pytest.raises(Exception, match=text):
            some_settings(**change)


@pytest.mark.parametrize(("planned_holes", "state"), [((), S.INCOMPLETE), ((HOLE,), S.COMPLETE), (None, S.COMPLETE)])
def test_a_hole_that_drifted_shots_left_is_not_called_complete(
    planned_holes: tuple[Hole, ...] | None, state: MissionState
) -> None:
    """Each counted while the others were to come as planned; no patch closes what they leave together."""

    def prepare(world: World) -> None:
        world.verifier.needed, world.verifier.holes = 5, (HOLE,)

    plan = a_plan()
    if planned_holes is not None:
        certificate = a_certificate(certified=not planned_holes, images=4)
        plan = replace(plan, certificate=replace(certificate, holes=planned_holes))
    world = fly(prepare=prepare, plan=plan)
    assert world.record.state is state
    assert not world.record.missing()
    if state is S.INCOMPLETE:
        assert "the measured attitudes leave a hole of 2° at elevation -70.0°, azimuth 10.0°" in world.record.reason


@pytest.mark.parametrize("heals", [True, False])
def test_a_vehicle_that_calls_its_sensors_unhealthy_is_waited_for_a_moment(heals: bool) -> None:
    async def script(world: World, mission: Mission) -> None:
        await world.clock.sleep(2.0)
        assert mission.record.state is S.PREFLIGHT
        if heals:
            world.vehicle.change(unhealthy=())

    world = fly(script, lambda w: w.vehicle.change(unhealthy=("compass", "attitude estimator")))
    assert world.record.state is (S.COMPLETE if heals else S.FAILED)
    if not heals:
        assert "as unhealthy: compass, attitude estimator" in world.record.reason
        assert not world.gimbal.commands


def test_a_photo_that_is_taken_back_after_its_acceptance_is_taken_again_before_the_certificate() -> None:
    """What was certified was the panorama with it, so the mission was complete without it."""

    async def contradict(world: World, mission: Mission) -> None:
        del mission
        await until_event(world, ev.ShotAccepted, 4)
        await world.clock.sleep(1.0)
        world.camera.contradictions[3] = "it may be another one"

    world = fly(contradict, prepare=lambda w: setattr(w.camera, "level", EvidenceLevel.COUNTED))
    assert [event.shot for event in world.sink.of(ev.ShotRevoked)] == [3]
    assert world.record.state is S.COMPLETE
    assert not world.record.missing()
    assert world.record.attempts == 5


def test_a_certificate_that_counts_a_photo_that_was_taken_back_proves_nothing() -> None:
    """By its content, while the gimbal is released after the certificate."""

    async def main() -> None:
        async with a_world() as world:
            mission = world.mission()
            release = world.gimbal.release

            async def taken_back() -> None:
                if not world.sink.of(ev.ShotRevoked):
                    assert mission.certificate is not None
                    assert mission.certificate.certified
                    mission._take_back(3, 1, "blurred", "a smear", ())
                await release()

            world.gimbal.release = taken_back  # type: ignore[method-assign]
            record = await mission.run()
            assert record.missing() == (3,)
            assert record.state is S.INCOMPLETE
            assert mission.certificate is None
            assert world.sink.of(ev.MissionFinished)[0].certified is None

    run_virtual(main())


@pytest.mark.parametrize("reports", [True, False])
def test_a_pilot_who_takes_over_while_the_last_report_is_awaited_gets_the_gimbal_at_once(reports: bool) -> None:
    """Nothing was shot any more, so nothing looked at the guards: it took up to 20 s."""

    def prepare(world: World) -> None:
        world.camera.level, world.camera.dates = EvidenceLevel.COUNTED, reports

    async def take_over(world: World, mission: Mission) -> None:
        del mission
        await until_event(world, ev.ShotAccepted, 4)
        await world.clock.sleep(0.2)
        assert world.gimbal.in_control
        await pilot_takes_over(world, within_s=0.5)

    world = fly(take_over, prepare=prepare)
    assert world.record.state is S.COMPLETE
    assert not world.record.missing()


def test_a_pilot_who_takes_over_while_the_certificate_is_computed_gets_the_gimbal_at_once() -> None:
    def prepare(world: World) -> None:
        certify = world.verifier.certify

        async def slowly(rotations: FloatArray, rows: Sequence[int]) -> Certificate:
            await world.clock.sleep(20.0)
            return await certify(rotations, rows)

        world.verifier.certify = slowly  # type: ignore[method-assign]

    async def take_over(world: World, mission: Mission) -> None:
        del mission
        await until_event(world, ev.MissionFinishing)
        await pilot_takes_over(world, within_s=0.5)

    world = fly(take_over, prepare=prepare)
    assert world.record.state is S.COMPLETE
