"""Predicted seam errors agree with where ground really appears; what breaks the limit is taken again and told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import FloatArray, angle_between, rotation
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.parallax import Place, SeamErrors, SeamTable
from panoexec.mission.settings import GuardSettings
from panoexec.optics import Camera
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.world import World, a_plan, some_settings

X5S = Camera(
    name="x5s", sensor_width_mm=17.3, sensor_height_mm=13.0, image_width_px=5280, image_height_px=3956,
    focal_length_mm=15.0,
)  # fmt: skip
METRE = 1 / 111_194.9
COS_47 = math.cos(math.radians(47.0))


def place(yaw: float, pitch: float, *, north: float = 0.0, east: float = 0.0, up: float = 0.0) -> Place:
    position = (47.0 + north * METRE, 8.0 + east * METRE / COS_47, 500.0 + up)
    return Place(rotation=rotation(yaw, pitch), position=position, height_m=30.0 + up)


def test_the_figure_of_the_nadir() -> None:
    """3 m at 30 m height with 15 mm: 458 px."""
    errors = SeamErrors(X5S, 0.0)
    assert errors.error_px(place(0, -90), place(0, -90, north=3.0)) == pytest.approx(457.8, abs=1.0)
    # towards the horizon the ground is far, in the sky there is none
    flat = errors.error_px(place(0, -10), place(20, -10, north=3.0))
    assert flat < 200
    assert errors.error_px(place(0, 45), place(20, 45, north=3.0)) == 0.0
    assert errors.error_px(place(0, -60), place(180, -10, north=3.0)) == 0.0, "they do not overlap"


def _truth_px(one: Place, other: Place, camera: Camera, move: FloatArray) -> float:
    """The largest angle between where two places see the same ground, from a dense grid, by intersection."""
    side = np.linspace(-1, 1, 41)
    y, z = np.meshgrid(side * camera.half_width, side * camera.half_height)
    worst = 0.0
    for first, second, shift, height in ((one, other, move, one.height_m), (other, one, -move, other.height_m)):
        rays = np.stack([np.ones(y.size), y.ravel(), z.ravel()], axis=1) @ first.rotation.T
        rays = rays[rays[:, 2] > 1e-3]
        ground = rays / rays[:, 2:] * height
        from_other = ground - shift
        inside = rays @ second.rotation
        seen = (
            (inside[:, 0] > 0)
            & (np.abs(inside[:, 1]) <= camera.half_width * inside[:, 0])
            & (np.abs(inside[:, 2]) <= camera.half_height * inside[:, 0])
        )
        if seen.any():
            worst = max(worst, float(angle_between(ground[seen], from_other[seen]).max()))
    return math.radians(worst) * camera.focal_length_px


@given(
    yaw=st.floats(-180, 180), pitch=st.floats(-90, -20), turn=st.floats(5, 30),
    north=st.floats(-1, 1), east=st.floats(-1, 1), up=st.floats(-0.5, 0.5), reference=st.floats(0, 360),
)  # fmt: skip
def test_predictions_agree_with_intersected_ground(
    yaw: float, pitch: float, turn: float, north: float, east: float, up: float, reference: float
) -> None:
    # the plan's frame is turned against north by the reference
    one = place(yaw, pitch)
    other = place(yaw + turn, pitch, north=north, east=east, up=up)
    angle = math.radians(reference)
    move = np.array(
        [
            math.cos(angle) * north + math.sin(angle) * east,
            -math.sin(angle) * north + math.cos(angle) * east,
            -up,
        ]
    )
    told = SeamErrors(X5S, reference).error_px(one, other)
    assert told == pytest.approx(_truth_px(one, other, X5S, move), rel=0.15, abs=3.0)


def limited(**more: object) -> object:
    return some_settings(guards=GuardSettings(allowed_modes=("OFFBOARD", "HOLD"), parallax_px=100.0), **more)


def test_a_vehicle_that_has_drifted_is_waited_for() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 3)
        world.vehicle.change(latitude_deg=47.0 + 1.5 * METRE)
        await until_event(world, ev.MissionPaused)
        await world.clock.sleep(2.0)
        assert mission.record.state is MissionState.PAUSED
        world.vehicle.change(latitude_deg=47.0)

    world = fly(script, plan=a_plan(8), settings=limited())
    assert world.record.state is MissionState.COMPLETE
    (paused,) = world.sink.of(ev.MissionPaused)
    assert (paused.code, paused.automatic) == ("parallax", True)
    assert all(error <= 100 for error in SeamTable(world.plan.camera).pairs(world.record).values())


def test_a_photo_taken_while_drifting_is_rejected_and_taken_again() -> None:
    def prepare(world: World) -> None:
        triggered = world.camera.trigger
        count = 0

        async def trigger():  # type: ignore[no-untyped-def]
            nonlocal count
            count += 1
            world.vehicle.change(latitude_deg=47.0 + (1.5 * METRE if count == 4 else 0.0))
            return await triggered()

        world.camera.trigger = trigger  # type: ignore[method-assign]

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotRejected)
        world.vehicle.change(latitude_deg=47.0)

    world = fly(script, prepare=prepare, plan=a_plan(8), settings=limited())
    assert world.record.state is MissionState.COMPLETE
    (rejected,) = world.sink.of(ev.ShotRejected)
    assert (rejected.shot, rejected.code) == (3, "parallax")
    assert "with shot 2 is expected from the drift (at most 100 px)" in rejected.reason
    assert world.record.shots[3].attempts[1].exposed is not None
    assert world.record.shots[3].attempts[1].exposed.height_m == 30.0


def test_without_a_limit_it_is_told_once() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 3)
        world.vehicle.change(latitude_deg=47.0 + 2.8 * METRE)

    world = fly(script, plan=a_plan(8))
    assert world.record.state is MissionState.COMPLETE
    (warned,) = [event for event in world.sink.of(ev.Warned) if event.code == "parallax"]
    assert "is expected between shots" in warned.text
    errors = SeamTable(world.plan.camera).pairs(world.record)
    a, b = max(errors, key=lambda pair: errors[pair])
    assert (a < 3) != (b < 3), "one from before the drift and one from after it"
    assert not world.sink.of(ev.ShotRejected)


def test_a_retake_changes_the_errors_of_its_shot_alone() -> None:
    world = fly(plan=a_plan(8))
    table = SeamTable(world.plan.camera)
    before = dict(table.pairs(world.record))
    assert set(before.values()) <= {0.0}, "it has not moved"
    attempt = world.record.shots[3].accepted
    assert attempt is not None
    attempt.number += 10  # as if another attempt counted
    assert table.pairs(world.record) == SeamTable(world.plan.camera).pairs(world.record)
