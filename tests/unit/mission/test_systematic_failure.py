"""The same failure at several shots in a row pauses the mission; gusts, drifts and single refusals do not."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from panoexec.mission.attempt_result import Offset
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.systematic_failure import ATTEMPTS, SystematicFailure
from panoexec.planning.model import Shot, Tolerance
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.world import World, a_plan, some_settings

S = MissionState
TOLERANCE = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.5)
DENIED = "photo 1 of 1: taking a photo: denied"


def shot(index: int, yaw_deg: float | None = None) -> Shot:
    return Shot(index=index, row=0, pitch_deg=0.0, yaw_deg=30.0 * index if yaw_deg is None else yaw_deg)


def refused(failures: SystematicFailure, index: int, reason: str = DENIED, code: str = "trigger") -> bool:
    return failures.rejected(shot(index), code=code, reason=reason) is not None


def missed(failures: SystematicFailure, index: int, yaw_deg: float, pitch_deg: float = 0.0) -> bool:
    offset = Offset(pitch_deg=pitch_deg, roll_deg=0.0, yaw_deg=yaw_deg)
    return failures.rejected(shot(index), code="not_settled", reason="off", offset=offset) is not None


def test_a_run_needs_both_shots_and_attempts() -> None:
    failures = SystematicFailure(TOLERANCE)
    assert [refused(failures, i // 3) for i in range(9)] == [False] * 7 + [True] * 2  # 3 attempts a shot
    failures.reset()
    assert [refused(failures, i) for i in range(8)] == [False] * 7 + [True]  # 1 attempt a shot
    failures.reset()
    assert not any(refused(failures, i % 2) for i in range(60)), "two shots say nothing about the others"
    assert failures.shots == (0, 1)


def test_anything_else_in_between_begins_the_run_anew() -> None:
    failures = SystematicFailure(TOLERANCE)
    for index in range(7):
        assert not refused(failures, index)
    assert not refused(failures, 7, reason="photo 1 of 1: taking a photo: not answered")
    assert not refused(failures, 8)
    assert list(failures.shots) == [8]
    assert failures.rejected(shot(9), code="no_samples", reason="a gap") is None
    assert not failures.shots


def test_figures_in_a_reason_do_not_matter() -> None:
    failures = SystematicFailure(TOLERANCE)
    reasons = [f"pointing the gimbal at pitch -{i}.5° yaw {40 * i}.0°: denied" for i in range(8)]
    assert [refused(failures, i, reasons[i], "gimbal") for i in range(8)] == [False] * 7 + [True]


def test_an_offset_must_be_the_same_in_sign_size_and_axes() -> None:
    failures = SystematicFailure(TOLERANCE)
    assert [missed(failures, i, 60.0 + 0.3 * (-1) ** i) for i in range(8)] == [False] * 7 + [True]
    for other in ((-4.0, 0.0), (2.0, 0.0), (4.0, 0.4), (0.4, 0.0)):  # sign, size, another axis, inside tolerance
        failures.reset()
        assert not any(missed(failures, i, 4.0) for i in range(7))
        assert not missed(failures, 7, *other)


def test_half_a_turn_to_the_left_is_half_a_turn_to_the_right() -> None:
    failures = SystematicFailure(TOLERANCE)
    assert [missed(failures, i, 179.9 * (-1) ** i) for i in range(8)] == [False] * 7 + [True]


def test_poses_that_have_nothing_to_do_with_their_targets_are_systematic() -> None:
    """A stuck gimbal, or one that reports in another convention: each error is another one, and all are large."""
    failures = SystematicFailure(TOLERANCE)
    found = None
    for index, yaw_deg in enumerate((144.0, 40.0, -63.0, -166.0, 90.0, 10.0, -20.0, 33.0)):
        assert found is None
        offset = Offset(pitch_deg=7.0, roll_deg=-3.0, yaw_deg=yaw_deg)
        found = failures.rejected(shot(index // 2), code="not_settled", reason="not settled", offset=offset)
        for code in ("not_settled", "stale"):
            assert failures.rejected(shot(index // 2), code=code, reason="the stream is silent, or late") is None
    assert found is not None
    assert found.code == "offset"
    assert "does not come near its targets" in found.reason
    assert failures.shots == (0, 1, 2, 3)
    failures.reset()
    assert not any(missed(failures, i, 4.9 * (-1) ** i) for i in range(30)), "sway and gusts are no cause"


def test_a_nose_that_is_pushed_aside_at_one_heading_is_not_systematic() -> None:
    """Three rows at one heading share its steady error in wind; the other headings have other ones."""
    failures = SystematicFailure(TOLERANCE, vehicle_pans=True)
    offset = Offset(pitch_deg=0.0, roll_deg=0.0, yaw_deg=-1.5)
    for number in range(30):
        found = failures.rejected(shot(number % 4, yaw_deg=90.0), code="pointing", reason="off", offset=offset)
        assert found is None
    for index, yaw_deg in ((5, 180.0), (6, -90.0)):
        found = failures.rejected(shot(index, yaw_deg=yaw_deg), code="pointing", reason="off", offset=offset)
    assert found is not None
    assert "yaw -1.50°" in found.reason


@pytest.mark.parametrize("seed", range(5))
def test_random_failures_do_not_pause(seed: int) -> None:
    """A fifth of the triggers is refused, and gusts push by random angles: 1000 shots of three attempts each."""
    rng, failures = random.Random(seed), SystematicFailure(TOLERANCE)
    paused = 0
    for index in range(1000):
        for _ in range(3):
            if rng.random() < 0.2:
                paused += refused(failures, index)
            elif rng.random() < 0.5:
                paused += missed(failures, index, rng.gauss(0.0, 1.0), rng.gauss(0.0, 0.3))
            else:
                failures.reset()
                break
    assert paused == 0


def test_a_camera_in_video_mode_pauses_after_three_shots_and_again_after_a_resume() -> None:
    refusals = 10_000

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.MissionPaused)
        assert mission.record.attempts == ATTEMPTS
        assert "refused to take a photo" in mission.record.reason
        assert "check the camera" in mission.record.reason
        await world.clock.sleep(20.0)
        assert mission.record.state is S.PAUSED, "it does not resume by itself"
        mission.commands.resume()  # nothing was changed
        await until_event(world, ev.MissionPaused, 2)
        assert mission.record.attempts == 2 * ATTEMPTS
        started = [event.shot for event in world.sink.of(ev.ShotStarted)]
        assert started == [0, 0, 0, 1, 1, 1, 2, 2] * 2, "resume tries the shots that failed"
        world.camera.refusals = 0  # photo mode
        mission.commands.resume()

    def prepare(world: World) -> None:
        world.camera.refusals = refusals

    world = fly(script, prepare, plan=a_plan(12), settings=some_settings(max_pause_s=60.0))
    assert world.record.state is S.COMPLETE
    paused = world.sink.of(ev.MissionPaused)
    assert [(event.code, event.automatic) for event in paused] == [("camera", False)] * 2
    assert len(world.sink.of(ev.ShotMissed)) == 0
    assert len(world.camera.photos) == 12


def test_a_pause_by_a_systematic_failure_can_be_resumed_at_once_and_finished() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.MissionPaused)
        mission.commands.resume()
        await until_event(world, ev.MissionPaused, 2)
        mission.commands.finish()

    world = fly(script, lambda w: setattr(w.camera, "refusals", 10_000), plan=a_plan(12))
    assert world.record.state is S.INCOMPLETE
    assert len(world.record.missing()) == 12


def test_a_gimbal_that_is_far_off_from_the_first_pose_on_ends_the_mission() -> None:
    world = fly(prepare=lambda w: setattr(w.gimbal, "drift", lambda _: (60.0, 0.0, 0.0)), plan=a_plan(12))
    assert world.record.state is S.FAILED
    assert "calibrate it" in world.record.reason
    assert not world.sink.of(ev.ShotAccepted)
    assert len(world.sink.of(ev.ShotRejected)) <= ATTEMPTS


def test_a_gimbal_that_is_off_by_the_same_angle_everywhere_pauses() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted)  # before that the mission would end: the gimbal never held a pose
        world.gimbal.drift = lambda _: (0.0, -0.4, 0.0)
        await until_event(world, ev.MissionPaused)
        assert "pitch -0." in mission.record.reason
        assert "calibrate" in mission.record.reason
        world.gimbal.drift = None
        mission.commands.resume()

    world = fly(script, plan=a_plan(12))
    assert world.record.state is S.COMPLETE
    assert [event.code for event in world.sink.of(ev.MissionPaused)] == ["offset"]
    assert len(world.sink.of(ev.ShotRejected)) >= ATTEMPTS


def test_a_stuck_gimbal_ends_a_mission_that_has_no_photo_yet() -> None:
    settings = replace(some_settings(), attempts=1, rounds=2)
    world = fly(prepare=lambda w: setattr(w.gimbal, "stuck", True), plan=a_plan(12), settings=settings)
    assert world.record.state is S.FAILED
    assert "does not come near its targets" in world.record.reason
    assert len(world.sink.of(ev.ShotRejected)) == ATTEMPTS


def test_a_gimbal_that_gets_stuck_pauses_the_mission() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted)
        world.gimbal.stuck = True
        await until_event(world, ev.MissionPaused)
        assert "does not come near its targets" in mission.record.reason
        world.gimbal.stuck = False
        mission.commands.resume()

    world = fly(script, plan=a_plan(12))
    assert world.record.state is S.COMPLETE
    assert [event.code for event in world.sink.of(ev.MissionPaused)] == ["offset"]


def test_another_station_that_points_the_gimbal_pauses_at_the_second_attempt() -> None:
    run = SystematicFailure(Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7))
    shot = Shot(index=3, row=0, pitch_deg=-30.0, yaw_deg=60.0)
    reason = "another station points the gimbal: it came to rest at pitch -70.0°, yaw 20.0°, 49° from its target"
    assert run.rejected(shot, code="foreign", reason=reason) is None
    found = run.rejected(shot, code="foreign", reason=reason)
    assert found is not None
    assert (found.code, found.automatic, found.retry) == ("foreign", False, True)
    assert "another station points the gimbal" in found.reason


def test_exposures_that_another_station_spoils_do_not_end_the_count_of_its_attempts() -> None:
    run = SystematicFailure(TOLERANCE)
    reason = "another station points the gimbal: it came to rest at pitch -70.0°, yaw 20.0°, 49° from its target"
    off = Offset(pitch_deg=-12.0, roll_deg=0.0, yaw_deg=3.0)
    assert run.rejected(shot(3), code="foreign", reason=reason) is None
    assert run.rejected(shot(4), code="pointing", reason="left its target", offset=off) is None
    assert run.rejected(shot(4), code="no_samples", reason="a gap") is None
    found = run.rejected(shot(5), code="foreign", reason=reason)
    assert found is not None
    assert found.code == "foreign"
    assert run.shots == (3, 5)
    run.reset()  # a photo was accepted
    assert run.rejected(shot(6), code="foreign", reason=reason) is None
