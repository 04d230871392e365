"""Where the exposure is metered, the sun, and a lens that is not the planned one."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import pytest

from panoexec.formats.photo_settings import PhotoExif
from panoexec.inputs.camera_profiles import load_profile
from panoexec.mission.executor import Mission
from panoexec.mission.lens_check import lens_problem
from panoexec.mission.log.states import MissionState
from panoexec.mission.metering import sun_direction, where_to_meter
from panoexec.planning.model import Shot
from tests.unit.fakes.camera import FakeCamera
from tests.unit.fakes.flying import fly, pilot_hands_back, pilot_takes_over
from tests.unit.fakes.world import World


@pytest.mark.parametrize(
    ("moment", "place", "expected"),
    [
        # NOAA's solar calculator, geometric elevation
        (datetime(2024, 6, 21, 12, 0, tzinfo=UTC), (0.0, 0.0), (0.9, 66.6)),
        (datetime(2024, 12, 21, 11, 28, tzinfo=UTC), (47.4, 8.55), (180.0, 19.2)),
        (datetime(2024, 3, 20, 6, 0, tzinfo=UTC), (0.0, 0.0), (90.0, -1.8)),
    ],
)
def test_the_sun_is_where_it_is(moment: datetime, place: tuple[float, float], expected: tuple[float, float]) -> None:
    azimuth_deg, elevation_deg = sun_direction(moment.timestamp(), *place)
    assert abs((azimuth_deg - expected[0] + 180) % 360 - 180) < 1.0
    assert elevation_deg == pytest.approx(expected[1], abs=0.5)


def shots() -> list[Shot]:
    poses = [(pitch, yaw) for pitch in (-40.0, 0.0, 20.0) for yaw in range(-180, 180, 30)]
    return [Shot(index=i, row=0, pitch_deg=pitch, yaw_deg=float(yaw)) for i, (pitch, yaw) in enumerate(poses)]


def test_it_is_metered_at_the_highest_row_as_near_to_the_sun_as_it_does_not_dazzle() -> None:
    shot = where_to_meter(shots(), reference_yaw_north_deg=90.0, sun_deg=(90.0, 20.0))
    assert shot.pitch_deg == 20.0
    assert abs(shot.yaw_deg) == 90.0  # 60 degrees of yaw are less than that of arc up there
    assert where_to_meter(shots(), reference_yaw_north_deg=0.0, sun_deg=(math.nan, math.nan)).pitch_deg == 20.0
    near = [Shot(index=0, row=0, pitch_deg=0, yaw_deg=0), Shot(index=1, row=0, pitch_deg=0, yaw_deg=30)]
    assert where_to_meter(near, reference_yaw_north_deg=0.0, sun_deg=(0.0, 10.0)).index == 1


def test_a_lens_that_is_not_the_planned_one_names_the_profile_that_fits() -> None:
    planned = load_profile("dji-x5s-15mm").camera
    assert lens_problem(15.2, planned) == ""
    assert lens_problem(math.nan, planned) == lens_problem(0.0, planned) == ""
    text = lens_problem(45.0, planned)
    assert "the camera's lens has 45 mm, the plan is for dji-x5s-15mm with 15 mm" in text
    assert 'set [camera] profile = "dji-x5s-45mm"' in text
    assert "write a profile with focal_length_mm = 25" in lens_problem(25.0, planned)


class _Metering(FakeCamera):
    """Needs 5 s to meter."""

    needs_metering = True
    begun = 0

    async def meter(self, known: PhotoExif | None) -> str:
        del known
        self.begun += 1
        await self.clock.sleep(5.0)
        self.needs_metering = False
        return ""


def _metering(world: World) -> None:
    world.camera = _Metering(clock=world.clock)


async def _until_metering(world: World) -> _Metering:
    camera = world.camera
    assert isinstance(camera, _Metering)
    while not camera.begun:
        await world.clock.sleep(0.01)
    return camera


def test_a_pilot_who_takes_over_while_the_exposure_is_metered_gets_the_gimbal_at_once() -> None:
    async def take_over(world: World, mission: Mission) -> None:
        await _until_metering(world)
        await pilot_takes_over(world, within_s=0.5)
        await pilot_hands_back(world, mission)

    world = fly(take_over, prepare=_metering)
    assert world.record.state is MissionState.COMPLETE
    assert isinstance(world.camera, _Metering)
    assert world.camera.begun == 2, "it was metered again, before the first photo"
    assert not world.camera.needs_metering


@pytest.mark.parametrize("command", ["pause", "finish"])
def test_stops_are_obeyed_while_the_exposure_is_metered(command: str) -> None:
    async def stop(world: World, mission: Mission) -> None:
        camera = await _until_metering(world)
        getattr(mission.commands, command)()
        await world.clock.sleep(1.0)
        assert mission.record.state is (MissionState.PAUSED if command == "pause" else MissionState.INCOMPLETE)
        assert camera.needs_metering
        if command == "pause":
            mission.commands.resume()

    world = fly(stop, prepare=_metering)
    assert world.record.state is (MissionState.COMPLETE if command == "pause" else MissionState.INCOMPLETE)
