"""A lens that is not the planned one, and an exposure that is metered once."""

from __future__ import annotations

from dataclasses import dataclass, field

from panoexec.errors import DeviceError
from panoexec.formats.photo_settings import PhotoExif
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.camera import FakeCamera
from tests.unit.fakes.flying import fly
from tests.unit.fakes.world import World


@dataclass
class SetCamera(FakeCamera):
    """Tells its lens, and meters."""

    focal_length_mm: float = float("nan")
    needs_metering: bool = False
    problem: str = ""
    raises: str = ""
    metered_at: list[tuple[int, PhotoExif | None]] = field(default_factory=list)

    async def meter(self, known: PhotoExif | None) -> str:
        self.metered_at.append((len(self.photos), known))
        if self.raises:
            raise DeviceError(self.raises)
        self.needs_metering = bool(self.problem)
        return self.problem


def with_camera(**given: object) -> World:
    def prepare(world: World) -> None:
        world.camera = SetCamera(clock=world.clock, **given)  # type: ignore[arg-type]

    return fly(prepare=prepare)


def camera_of(world: World) -> SetCamera:
    assert isinstance(world.camera, SetCamera)
    return world.camera


def test_a_lens_of_another_focal_length_fails_the_preflight_before_anything_moves() -> None:
    world = with_camera(focal_length_mm=50.0)
    assert world.record.state is MissionState.FAILED
    (failed,) = world.sink.of(ev.PreflightFailed)
    assert "the camera's lens has 50 mm, the plan is for" in failed.problems[0]
    assert "plan again" in failed.problems[0]
    assert not world.gimbal.commands
    assert not world.camera.photos


def test_a_lens_that_is_the_planned_one_or_is_not_told_passes() -> None:
    planned_mm = with_camera().plan.camera.focal_length_mm
    for told_mm in (planned_mm, 1.015 * planned_mm, 0.0, float("nan")):
        assert with_camera(focal_length_mm=told_mm).record.state is MissionState.COMPLETE


def test_the_exposure_is_metered_once_before_the_first_photo_with_the_camera_at_the_highest_row() -> None:
    world = with_camera(needs_metering=True)
    assert world.record.state is MissionState.COMPLETE
    assert camera_of(world).metered_at == [(0, None)]
    highest = max(shot.pitch_deg for shot in world.plan.shots)
    assert world.gimbal.commands[0][1] == highest


def test_an_exposure_that_cannot_be_kept_ends_the_mission_without_a_photo() -> None:
    for given in ({"problem": "shutter speed 1: the camera offers 0.1"}, {"raises": "no photo to meter by"}):
        world = with_camera(needs_metering=True, **given)
        assert world.record.state is MissionState.FAILED
        assert next(iter(given.values())) in world.record.reason
        assert not world.camera.photos
