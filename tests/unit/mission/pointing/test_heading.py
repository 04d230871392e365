"""Missions whose camera is panned by the vehicle, wholly or where the gimbal cannot; in virtual time."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from panoexec.angles import wrap_180
from panoexec.mission.executor import Mission
from panoexec.mission.guards import GimbalControl, Situation, TurnGuard
from panoexec.mission.log import events as ev
from panoexec.mission.log.shot_record import Verdict
from panoexec.mission.log.states import MissionState
from panoexec.mission.pointing.heading import AVERAGED_S, GAIN, HeadingController
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.planning.model import GimbalLimits, Shot, Turning
from panoexec.planning.order.duration import turn_times_s
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.vehicle import FakeVehicle
from tests.unit.fakes.virtual import VirtualClock, run_virtual
from tests.unit.fakes.world import TOLERANCE, World, a_plan, a_world, some_settings

TURNING = Turning(settle_s=0.5)
TWO_AXES = GimbalLimits(yaw_min_deg=0.0, yaw_max_deg=0.0, yaw_endless=False, turning=TURNING)
LITTLE = GimbalLimits(yaw_min_deg=-40.0, yaw_max_deg=40.0, yaw_endless=False, turning=TURNING)
S = MissionState


def settings(limits: GimbalLimits, **changes: Any) -> MissionSettings:
    return some_settings(**({"gimbal": limits, "patience_s": 5.0, "max_rate_deg_s": 5.0} | changes))


def fly(
    limits: GimbalLimits,
    prepare: Callable[[World], None] = lambda _: None,
    script: Callable[[World, Mission], Any] | None = None,
    *,
    own: GimbalLimits | None = None,
    **changes: Any,
) -> World:
    """Fly four shots, 90° apart, with a gimbal that states its own limits; every invariant is checked afterwards."""

    async def main() -> World:
        stated = replace(own or limits, turning=None)
        async with a_world(settings=settings(limits, **changes), limits=stated, rate_hz=50.0) as world:
            prepare(world)
            mission = world.mission()
            scripted = None if script is None else script(world, mission)
            world.record = await mission.run()
            if scripted is not None:
                scripted.cancel()
            check_mission(world, world.record)
        return world

    return run_virtual(main())


def test_two_axes_the_vehicle_pans_the_gimbal_tilts_and_the_gate_judges_the_sum() -> None:
    world = fly(TWO_AXES)
    assert world.record.state is S.COMPLETE
    assert world.record.attempts == 4
    assert [heading for _, heading in world.vehicle.turns] == pytest.approx([180.0, 270.0, 0.0, 90.0])
    assert all(pitch == -20.0 and math.isnan(yaw) for _, pitch, yaw in world.gimbal.commands)
    for exposed in world.sink.of(ev.ShotExposed):
        assert exposed.errors.yaw_deg == pytest.approx(0.0, abs=0.1)


def test_a_heading_that_stays_beside_its_target_is_corrected_once_and_for_all_that_follow() -> None:
    """As in ArduCopter's SITL: 0.9° off, where 0.5° are tolerated."""
    world = fly(TWO_AXES, lambda w: setattr(w.vehicle, "offset_deg", lambda _: -0.9))
    assert world.record.state is S.COMPLETE
    assert world.record.attempts == 4
    assert [heading for _, heading in world.vehicle.turns] == pytest.approx(
        [180.0, 180.72, 270.72, 0.72, 90.72], abs=0.05
    )


def test_a_nose_that_sways_out_of_tolerance_and_back_is_caught_in_between() -> None:
    def sway(at_s: float) -> float:
        return 0.9 * math.sin(2 * math.pi * at_s / 3.0)

    world = fly(TWO_AXES, lambda w: setattr(w.vehicle, "offset_deg", sway))
    assert world.record.state is S.COMPLETE
    assert all(abs(heading - round(heading)) < 0.5 for _, heading in world.vehicle.turns), "swaying is no steady error"


async def _calm_after_the_pause(world: World, mission: Mission) -> None:
    while mission.record.state is not S.PAUSED:
        await world.clock.sleep(0.1)
    world.vehicle.offset_deg = lambda _: 0.0
    mission.commands.resume()


@pytest.mark.parametrize(
    ("offset_deg", "reason"),
    [
        (lambda at_s: 12.0 * math.sin(at_s), "the vehicle's heading moves at "),
        (lambda at_s: 4.0 * math.sin(1.2 * at_s), "the vehicle holds its heading within "),
    ],
)
def test_a_heading_that_is_not_held_pauses_with_its_figures_and_all_shots_are_taken_after_resume(
    offset_deg: Callable[[float], float], reason: str
) -> None:
    def script(world: World, mission: Mission) -> asyncio.Task[None]:
        return asyncio.create_task(_calm_after_the_pause(world, mission))

    world = fly(TWO_AXES, lambda w: setattr(w.vehicle, "offset_deg", offset_deg), script, rounds=1, attempts=1)
    (paused,) = world.sink.of(ev.MissionPaused)
    assert paused.code == "heading"
    assert paused.reason.startswith(reason)
    assert "at 4 headings (4 attempts in a row)" in paused.reason
    assert world.record.state is S.COMPLETE
    reasons = [attempt.reason for shot in world.record.shots.values() for attempt in shot.attempts]
    assert any("yaw off by" in reason for reason in reasons)


def test_auto_the_vehicle_turns_only_where_the_gimbal_does_not_reach() -> None:
    world = fly(LITTLE)
    assert world.record.state is S.COMPLETE
    assert len(world.vehicle.turns) == 4, "90° apart, 60° of reach: one heading each"
    for (_, _, yaw), (_, heading) in zip(world.gimbal.commands, world.vehicle.turns, strict=True):
        assert abs(float(wrap_180(yaw - heading))) <= 30.0 + 1e-6


def test_auto_takes_no_photo_while_the_nose_turns_under_the_gimbal() -> None:
    world = fly(LITTLE)
    before = 30.0
    for (turned_s, heading), photo in zip(world.vehicle.turns, world.camera.photos, strict=True):
        turn_s = float(turn_times_s(TURNING, wrap_180(heading - before)))
        assert turn_s > 0.5 + TURNING.settle_s
        assert photo.triggered_s >= turned_s + turn_s - 1e-6
        before = heading


def test_auto_leaves_the_vehicle_alone_while_the_gimbal_reaches() -> None:
    much = replace(LITTLE, yaw_min_deg=-160.0, yaw_max_deg=160.0)
    plan = a_plan(4)
    near = replace(plan, shots=tuple(replace(s, yaw_deg=s.yaw_deg / 2) for s in plan.shots))

    async def main() -> None:
        guards = GuardSettings(allowed_modes=("HOLD", "OFFBOARD"))
        async with a_world(plan=near, settings=settings(much, guards=guards), limits=much, rate_hz=50.0) as world:
            world.vehicle.change(mode="HOLD")  # in which it could not be turned
            record = await world.mission().run()
            assert record.state is S.COMPLETE
            assert world.vehicle.turns == []
            assert [yaw for _, _, yaw in world.gimbal.commands] == [shot.yaw_deg for shot in near.shots]

    run_virtual(main())


def test_a_gimbal_that_states_no_pan_is_panned_by_the_vehicle_in_auto() -> None:
    endless = GimbalLimits(turning=TURNING)
    world = fly(endless, own=TWO_AXES)
    assert world.record.state is S.COMPLETE
    assert len(world.vehicle.turns) == 4


def test_vehicle_does_not_use_a_pan_axis_that_is_there() -> None:
    world = fly(TWO_AXES, own=GimbalLimits())
    assert world.record.state is S.COMPLETE
    assert all(math.isnan(yaw) for _, _, yaw in world.gimbal.commands)


def test_a_mode_in_which_the_vehicle_cannot_be_turned_is_refused_before_anything_moves() -> None:
    world = fly(TWO_AXES, lambda w: w.vehicle.change(mode="HOLD"))
    assert world.record.state is S.FAILED
    assert world.record.reason == (
        "4 shots need the vehicle to turn: it does not turn in flight mode HOLD; change to OFFBOARD (ArduPilot: GUIDED)"
    )
    assert world.vehicle.turns == []
    assert world.gimbal.commands == []


def test_a_pilot_who_takes_the_mode_away_pauses_it_and_gives_it_back() -> None:
    async def script(world: World) -> None:
        while not world.sink.of(ev.ShotAccepted):
            await world.clock.sleep(0.05)
        world.vehicle.change(mode="HOLD")
        turns = len(world.vehicle.turns)
        while not world.sink.of(ev.MissionPaused):
            await world.clock.sleep(0.05)
        await world.clock.sleep(3.0)
        assert len(world.vehicle.turns) <= turns + 1
        world.vehicle.change(mode="OFFBOARD")

    world = fly(TWO_AXES, script=lambda w, _: asyncio.create_task(script(w)))
    assert world.record.state is S.COMPLETE
    (paused,) = world.sink.of(ev.MissionPaused)
    assert (paused.code, paused.automatic) == ("turning", True)
    assert "it does not turn in flight mode HOLD" in paused.reason


@pytest.mark.parametrize("low_high", [(-40.0, 40.0), (0.0, 0.0)])
def test_without_leave_to_turn_a_pose_beyond_the_pan_range_is_refused(low_high: tuple[float, float]) -> None:
    low, high = low_high
    world = fly(GimbalLimits(yaw_min_deg=low, yaw_max_deg=high, yaw_endless=False))
    assert world.record.state is S.FAILED
    assert f"outside the gimbal's {low:g}° to {high:g}° relative to the heading" in world.record.reason
    assert 'gimbal.yaw = "auto" lets the vehicle turn' in world.record.reason


def test_a_pose_that_neither_can_reach_is_refused() -> None:
    world = fly(replace(TWO_AXES, pitch_min_deg=-10.0))
    assert world.record.state is S.FAILED
    assert "pitch -20.00° is outside the gimbal's -10° to 90°" in world.record.reason


def test_a_vehicle_that_does_not_tell_its_heading_is_refused() -> None:
    def deaf(world: World) -> None:
        world.vehicle.heading = lambda at_s: math.nan  # type: ignore[method-assign]
        world.vehicle.change(heading_deg=math.nan)

    world = fly(TWO_AXES, deaf)
    assert world.record.state is S.FAILED
    assert "the vehicle's heading is unknown" in world.record.reason


def test_a_refusal_of_the_vehicle_is_tried_again_and_told() -> None:
    world = fly(TWO_AXES, lambda w: setattr(w.vehicle, "refusals", 4))
    assert world.record.state is S.COMPLETE
    first = world.record.shots[0].attempts[0]
    assert (first.verdict, first.code, first.reason) == (Verdict.REJECTED, "vehicle", "the vehicle refused to turn")


def test_the_guard_speaks_only_while_a_turn_is_needed() -> None:
    vehicle = FakeVehicle().status
    situation = Situation(
        now_s=0.0,
        vehicle=replace(vehicle, mode="HOLD"),
        sample_age_s=0.0,
        control=GimbalControl.OURS,
        expects_control=True,
        origin=(0.0, 0.0, 0.0),
        storage_free_images=10,
    )
    guard = TurnGuard()
    assert guard.check(situation) is None
    finding = guard.check(replace(situation, turn_modes=("OFFBOARD",)))
    assert finding is not None
    assert finding.automatic
    assert guard.check(replace(situation, turn_modes=("HOLD",))) is None


def test_a_correction_waits_until_the_nose_stands_and_is_bounded() -> None:
    async def main() -> None:
        clock = VirtualClock()
        vehicle = FakeVehicle(clock=clock)
        heading_controller = HeadingController(
            vehicle=vehicle, clock=clock, turning=TURNING, tolerance_yaw_deg=TOLERANCE.yaw_deg
        )
        expected_s = await heading_controller.begin([100.0], TWO_AXES)
        began_s = clock.monotonic()
        while clock.monotonic() < began_s + expected_s + AVERAGED_S - 0.1:
            heading_controller.note(clock.monotonic(), 4.0)
            assert not heading_controller.is_off(clock.monotonic()), "still turning, or not yet averaged"
            await clock.sleep(0.02)
        while not heading_controller.is_off(clock.monotonic()):
            heading_controller.note(clock.monotonic(), 4.0)
            await clock.sleep(0.02)
        assert clock.monotonic() < began_s + expected_s + AVERAGED_S + 0.1
        await heading_controller.correct()
        assert vehicle.turns[-1][1] == pytest.approx(100.0 - GAIN * 4.0)
        heading_controller.note(clock.monotonic(), math.nan)
        assert not heading_controller.is_off(clock.monotonic())
        vehicle.refusals = 1
        await heading_controller.correct()
        assert heading_controller.trim_deg == pytest.approx(-GAIN * 4.0), "nothing was measured since"
        assert heading_controller.turns == 1

    run_virtual(main())


def test_shots_of_one_heading_are_not_turned_for_twice() -> None:
    shots = tuple(Shot(index=i, row=i, pitch_deg=-30.0 * i, yaw_deg=90.0) for i in range(3))
    plan = replace(a_plan(4), shots=shots)

    async def main() -> None:
        async with a_world(plan=plan, settings=settings(TWO_AXES), limits=TWO_AXES, rate_hz=50.0) as world:
            mission = world.mission()
            record = await mission.run()
            assert record.state is S.COMPLETE
            assert mission.turns == 1

    run_virtual(main())
