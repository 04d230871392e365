"""Cameras that have to be prepared, that keep an interval of their own, whose triggers are deferred."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace

import pytest

from panoexec.devices import CaptureEvidence, EvidenceLevel
from panoexec.errors import DeviceError
from panoexec.mission.dated_exposure import ShutterLag, has_window, is_before, is_unlike_others, when, window
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.camera import FakeCamera, FakeCapture
from tests.unit.fakes.checks import check_mission
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_plan, a_world, some_settings

S = MissionState
NAN = float("nan")


@dataclass
class ModalCamera(FakeCamera):
    """A camera with modes.

    Attributes:
        problem: why photo mode cannot be set.
        deaf: it does not answer.
        hangs: it never finishes to restore its mode.
        calls: what was called.
    """

    problem: str = ""
    deaf: bool = False
    hangs: bool = False
    calls: tuple[str, ...] = ()

    async def prepare(self) -> str:
        self.calls += ("prepare",)
        await self.clock.sleep(0.1)
        if self.deaf:
            raise DeviceError("not answered")
        return self.problem

    async def restore(self) -> None:
        self.calls += ("restore",)
        await self.clock.sleep(3600.0 if self.hangs else 0.1)


def modal(**changes: object) -> Callable[[World], None]:
    def prepare(world: World) -> None:
        world.camera = ModalCamera(clock=world.clock, **changes)  # type: ignore[arg-type]

    return prepare


def calls_of(world: World) -> tuple[str, ...]:
    assert isinstance(world.camera, ModalCamera)
    return world.camera.calls


async def _nothing(world: World, mission: Mission) -> None:
    del world, mission


async def _abort(world: World, mission: Mission) -> None:
    await until_event(world, ev.ShotAccepted, 2)
    mission.commands.abort()


async def _interrupt(world: World, mission: Mission) -> None:
    await until_event(world, ev.ShotAccepted, 2)
    mission.commands.interrupt()


async def _pilot(world: World, mission: Mission) -> None:
    del mission
    await until_event(world, ev.ShotAccepted, 1)
    world.vehicle.change(mode="STABILIZED")


@pytest.mark.parametrize(
    ("script", "state"),
    [(_nothing, S.COMPLETE), (_abort, S.ABORTED), (_interrupt, S.PAUSED), (_pilot, S.FAILED)],
)
def test_a_camera_is_prepared_before_the_first_photo_and_restored_at_every_end(
    script: Callable[[World, Mission], Awaitable[None]], state: MissionState
) -> None:
    world = fly(script, prepare=modal())
    assert world.record.state is state
    assert calls_of(world) == ("prepare", "restore")


def test_a_mission_that_is_cancelled_restores_the_camera_too() -> None:
    async def main() -> None:
        async with a_world() as world:
            modal()(world)
            running = asyncio.create_task(world.mission().run())
            await until_event(world, ev.ShotAccepted, 1)
            running.cancel()
            with pytest.raises(asyncio.CancelledError):
                await running
            assert calls_of(world) == ("prepare", "restore")
            assert not world.gimbal.in_control

    run_virtual(main())


@pytest.mark.parametrize(
    ("camera", "reason"),
    [
        (modal(problem="the camera is in video mode and stays there: denied"), "is in video mode and stays there"),
        (modal(deaf=True), "the camera cannot be prepared: not answered"),
    ],
)
def test_a_camera_that_cannot_be_prepared_fails_the_preflight(camera: Callable[[World], None], reason: str) -> None:
    world = fly(prepare=camera)
    assert world.record.state is S.FAILED
    (failed,) = world.sink.of(ev.PreflightFailed)
    assert reason in failed.problems[0]
    assert not world.camera.photos
    assert calls_of(world) == ("prepare", "restore")


def test_a_camera_that_never_answers_at_the_end_holds_nothing_up() -> None:
    world = fly(prepare=modal(hangs=True))
    assert world.record.state is S.COMPLETE


@dataclass
class SlowCamera(FakeCamera):
    """Refuses what comes sooner than 2 s after the last photo, and knows that from the third refusal on."""

    last_s: float = -1e9
    refused: int = 0

    @property
    def interval_s(self) -> float:
        return 2.0 if self.refused >= 3 else 0.0

    @property
    def ready_s(self) -> float:
        return self.last_s + self.interval_s

    async def trigger(self) -> FakeCapture:
        if self.clock.monotonic() < self.last_s + 2.0 - 1e-6:
            self.refused += 1
            raise DeviceError("taking a photo: denied")
        self.last_s = self.clock.monotonic()
        return await super().trigger()


def test_an_interval_that_the_camera_has_learned_is_kept_and_told_once() -> None:
    world = fly(prepare=lambda w: setattr(w, "camera", SlowCamera(clock=w.clock)), plan=a_plan(8))
    assert world.record.state is S.COMPLETE
    assert isinstance(world.camera, SlowCamera)
    assert world.camera.refused == 3
    (warned,) = [event for event in world.sink.of(ev.Warned) if event.code == "interval"]
    assert warned.text == (
        "the camera needs 2.0 s between two photos, its interval is 0.5 s: set [camera] interval_s to 2"
    )


@dataclass
class DeferredCapture(FakeCapture):
    async def fired(self) -> float:
        exposed_s = self.camera.photos[self.index].exposed_s - 0.05
        await self.camera.clock.sleep(exposed_s - self.camera.clock.monotonic())
        return exposed_s


@dataclass
class DeferringCamera(FakeCamera):
    """Every second trigger is carried out later."""

    async def trigger(self) -> FakeCapture:
        self.latency_s = 1.6 if len(self.photos) % 2 else 0.05
        self.dates = True
        one = await super().trigger()
        return DeferredCapture(**{name: getattr(one, name) for name in one.__dataclass_fields__})


def test_nothing_moves_before_a_deferred_trigger_is_carried_out() -> None:
    world = fly(prepare=lambda w: setattr(w, "camera", DeferringCamera(clock=w.clock)))
    check_mission(world, world.record)  # by the fakes' truth each accepted photo was exposed in tolerance
    assert world.record.state is S.COMPLETE
    assert (world.record.attempts, world.sink.of(ev.ShotRejected)) == (4, [])


def undated(level: EvidenceLevel = EvidenceLevel.CAPTURE_MESSAGE, reported_s: float = 10.8) -> CaptureEvidence:
    return CaptureEvidence(level=level, received_s=99.0, reported_s=reported_s)


def test_a_report_without_a_date_bounds_the_exposure_by_its_arrival() -> None:
    settings = some_settings()
    assert has_window(undated())
    assert window(undated(EvidenceLevel.FILE_SEEN), 10.0, settings) == (10.0, 10.8)
    assert "not dated, and was reported 0.80 s after its trigger" in when(undated(), 10.0)
    assert not has_window(undated(reported_s=NAN))
    assert not has_window(undated(EvidenceLevel.COUNTED))


def test_the_wait_for_an_irregular_shutter_has_a_reserve() -> None:
    lag = ShutterLag(0.1)
    for exposed_s in (10.4, 11.4):
        found = CaptureEvidence(
            level=EvidenceLevel.CAPTURE_MESSAGE, received_s=99.0, exposed_s=exposed_s, exposed_error_s=0.05
        )
        lag.note(found, 10.0)
    assert lag.bound_s == pytest.approx(1.45 + 0.5)


def test_a_pose_is_held_until_the_autopilot_reports_a_trigger_that_it_reports_late() -> None:
    """CAMERA_FEEDBACK without a pin: the exposure may have been any time until it came."""
    lag = ShutterLag(0.1)
    found = CaptureEvidence(level=EvidenceLevel.COUNTED, received_s=99.0, exposed_s=10.05, exposed_error_s=0.1)
    assert lag.note(found, 10.0) == ""
    assert (lag.bound_s, lag.until_report) == (0.1, False)
    found = CaptureEvidence(level=EvidenceLevel.COUNTED, received_s=99.0, exposed_s=10.8, exposed_error_s=0.1)
    assert "reports its triggers 0.8 s after they were commanded" in lag.note(found, 10.0)
    assert lag.bound_s == pytest.approx(0.9)
    assert lag.until_report


def test_a_coarse_date_is_no_contradiction_and_bounds_nothing_but_the_report() -> None:
    coarse = CaptureEvidence(
        level=EvidenceLevel.CAPTURE_MESSAGE,
        received_s=10.4,
        reported_s=10.4,
        exposed_vehicle_s=7.0,
        exposed_s=9.6,
        exposed_error_s=0.6,
    )
    assert not is_unlike_others(coarse)
    assert not is_before(coarse, 10.0)
    assert is_before(coarse, 10.3)
    assert window(coarse, 10.0, some_settings()) == (10.0, 10.4)
    assert is_unlike_others(replace(coarse, exposed_s=NAN, exposed_error_s=NAN))
