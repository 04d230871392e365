"""Retakes on fakes in virtual time: at once, later, with growing patience; overlap verdicts and patches."""

from __future__ import annotations

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.shot_record import ShotStatus
from panoexec.mission.log.states import MissionState
from panoexec.planning.model import Hole, Shot
from tests.unit.fakes.flying import drift_at, fly, until_event
from tests.unit.fakes.world import World, a_plan, some_settings

S = MissionState


def test_a_drift_during_the_exposure_is_rejected_and_taken_again_at_once() -> None:
    world = fly(prepare=lambda w: drift_at(w, -90.0, until_s=1005.0))
    assert world.record.state is S.COMPLETE
    rejected = world.sink.of(ev.ShotRejected)
    assert rejected
    assert {event.code for event in rejected} == {"pointing"}
    assert "pitch off by +1" in rejected[0].reason
    order = [event.shot for event in world.sink.of(ev.ShotStarted)]
    assert order == sorted(order)
    assert world.record.retakes == len(world.sink.of(ev.ShotRetaken)) == len(rejected)


def test_a_shot_that_keeps_failing_is_put_off_with_more_patience_each_round_and_then_missed() -> None:
    world = fly(prepare=lambda w: drift_at(w, -90.0, until_s=1e9))
    assert world.record.state is S.INCOMPLETE
    assert world.record.missing() == (1,)
    shot = world.record.shots[1]
    assert shot.status is ShotStatus.MISSED
    assert [attempt.round for attempt in shot.attempts] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    patience = [event.patience_s for event in world.sink.of(ev.ShotStarted) if event.shot == 1]
    assert patience == [1.0] * 3 + [2.0] * 3 + [4.0] * 3
    order = [(event.round, event.shot) for event in world.sink.of(ev.ShotStarted)]
    assert order == sorted(order)
    finished = world.sink.of(ev.MissionFinished)[0]
    assert (finished.accepted, finished.missing, finished.certified) == (3, (1,), False)


def test_a_missing_shot_does_not_matter_when_the_measured_attitudes_prove_the_panorama() -> None:
    def prepare(world: World) -> None:
        drift_at(world, -90.0, until_s=1e9)
        world.verifier.needed = 3

    world = fly(prepare=prepare)
    assert world.record.state is S.COMPLETE
    assert world.record.certified is True
    assert world.record.missing() == (1,)


def test_a_gimbal_that_never_arrives_ends_incomplete_without_a_photo() -> None:
    world = fly(prepare=lambda w: setattr(w.gimbal, "stuck", True), settings=some_settings(attempts=1, rounds=1))
    assert world.record.state is S.INCOMPLETE
    # a stuck gimbal looks at yaw 0: only the shot there can be taken, and the pitch is wrong for that one too
    assert world.camera.photos == []
    assert {event.code for event in world.sink.of(ev.ShotRejected)} == {"not_settled"}
    assert "off by" in world.sink.of(ev.ShotRejected)[0].reason


def test_patches_close_real_holes() -> None:
    def prepare(world: World) -> None:
        world.verifier.needed = 5
        world.verifier.patches = [Shot(index=0, row=0, pitch_deg=-70.0, yaw_deg=10.0)]
        world.verifier.holes = (Hole(elevation_deg=-70.0, azimuth_deg=10.0, size_deg=2.0),)

    world = fly(prepare=prepare)
    assert world.record.state is S.COMPLETE
    planned = world.sink.of(ev.PatchPlanned)
    assert [event.shots for event in planned] == [(4,)]
    assert world.record.shots[4].patch
    assert world.record.certified is True


def test_an_exposure_outside_tolerance_counts_when_the_overlaps_hold_as_measured() -> None:
    def off(world: World, size: float) -> None:
        # a steady offset that comes with the settled pose and goes unnoticed until the shutter opens
        drift_at(world, -90.0, until_s=1e9, size=size)

    world = fly(prepare=lambda w: off(w, 0.3), settings=some_settings(accept="overlap", max_rate_deg_s=8.0))
    assert world.record.state is S.COMPLETE
    assert [event.by for event in world.sink.of(ev.ShotAccepted)] == ["tolerance", "overlap", "tolerance", "tolerance"]
    assert world.record.retakes == 0

    def strict(world: World) -> None:
        off(world, 0.3)
        world.verifier.needed = 5  # the certificate never holds

    settings = some_settings(accept="overlap", max_rate_deg_s=8.0, attempts=1, rounds=1)
    world = fly(prepare=strict, settings=settings)
    assert world.record.missing() == (1,)
    assert "overlaps are too small" in world.sink.of(ev.ShotRejected)[0].reason

    blurred = some_settings(accept="overlap", attempts=1, rounds=1)
    world = fly(prepare=lambda w: off(w, 3.0), settings=blurred)
    assert world.record.missing() == (1,)


def test_the_estimate_follows_what_shots_really_cost() -> None:
    estimates = []
    settings = some_settings(interval_s=3.0)

    async def script(world: World, mission: Mission) -> None:
        for count in range(1, 24):
            await until_event(world, ev.ShotAccepted, count)
            estimates.append(mission.eta_s)
            assert mission.battery_need_frac == pytest.approx(mission.eta_s / settings.guards.hover_s)

    world = fly(script, plan=a_plan(24), settings=settings)
    times = [event.time_utc_s for event in world.sink.of(ev.ShotAccepted)]
    for count, estimate in enumerate(estimates, start=1):
        if count >= 8:
            assert estimate == pytest.approx(times[-1] - times[count - 1], rel=0.15)
