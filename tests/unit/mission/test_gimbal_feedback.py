"""A mission believes a gimbal's reports only as long as they look measured, and refuses what the gimbal cannot hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest

from panoexec.clock import SystemClock
from panoexec.devices import SteadyError
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.planning.model import Shot, Tolerance
from panoexec.store.manifest import ManifestWriter
from tests.unit.fakes.flying import fly, until_event
from tests.unit.fakes.world import World, a_plan


def echoing(world: World) -> None:
    world.gimbal.echoes = True


def exactly_echoing(world: World) -> None:
    world.gimbal.echoes = True
    world.gimbal.noise_deg = 0.0


def test_an_exact_echo_stops_the_mission_before_anything_is_accepted() -> None:
    world = fly(prepare=exactly_echoing)
    assert world.record.state is MissionState.FAILED
    assert "the gimbal's reports are no feedback: a slew of" in world.record.reason
    assert '[gimbal] feedback = "none"' in world.record.reason
    assert world.sink.of(ev.ShotAccepted) == []
    assert not world.camera.photos
    assert world.gimbal.known.echo


def test_photos_that_an_echo_had_verified_do_not_stay_accepted() -> None:
    world = fly(prepare=echoing)
    assert world.record.state is MissionState.FAILED
    accepted = world.sink.of(ev.ShotAccepted)
    assert accepted, "noise hides the echo at first"
    assert [event.shot for event in world.sink.of(ev.ShotRevoked)] == [event.shot for event in accepted]
    assert world.record.shots_done == 0
    assert set(world.record.missing()) == set(world.record.shots)
    assert world.record_of_journal().shots_done == 0


@pytest.mark.parametrize("axis", ["pitch", "yaw"])
def test_an_echo_of_one_axis_leaves_nothing_accepted(axis: Literal["pitch", "yaw"]) -> None:
    """A tilt servo that never moved, below a pan that is measured: the mission was complete."""
    poses = [(pitch, yaw) for pitch in (-40.0, 0.0, 40.0) for yaw in (-135.0, -45.0, 45.0, 135.0)]
    if axis == "yaw":
        poses.sort(key=lambda pose: pose[1])
    shots = tuple(Shot(index=k, row=0, pitch_deg=pitch, yaw_deg=yaw) for k, (pitch, yaw) in enumerate(poses))
    world = fly(prepare=lambda w: setattr(w.gimbal, "echoes_axis", axis), plan=replace(a_plan(), shots=shots))
    assert world.record.state is MissionState.FAILED
    assert f"° in {axis} took" in world.record.reason
    assert world.sink.of(ev.ShotAccepted), "the other axis hides it at first"
    assert world.record.shots_done == 0


def test_an_echo_that_begins_in_flight_is_found_as_well() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted, 1)
        world.gimbal.echoes, world.gimbal.noise_deg = True, 0.0

    world = fly(script)
    assert world.record.state is MissionState.FAILED
    assert world.record.shots_done == 0


def test_without_feedback_an_echo_does_not_matter() -> None:
    def blind(world: World) -> None:
        echoing(world)
        world.settings = replace(world.settings, feedback="none")

    world = fly(prepare=blind)
    assert world.record.state is MissionState.COMPLETE
    assert {event.by for event in world.sink.of(ev.ShotAccepted)} == {"open_loop"}


def test_what_is_known_to_be_an_echo_is_refused_before_the_gimbal_moves() -> None:
    def known(world: World) -> None:
        world.gimbal.known.echo = "MNT_MODE_OUT = 0"

    world = fly(prepare=known)
    assert world.record.state is MissionState.FAILED
    (failed,) = world.sink.of(ev.PreflightFailed)
    assert failed.problems[0].startswith("the gimbal's reports are no feedback: MNT_MODE_OUT = 0; use a gimbal that")
    assert world.gimbal.commands == []


def beside(world: World) -> None:
    world.gimbal.drift = lambda _: (0.0, 0.3, 0.0)


def test_a_steady_error_beyond_the_tolerance_ends_the_mission_and_is_refused_from_then_on() -> None:
    world = fly(prepare=beside)
    assert world.record.state is MissionState.FAILED
    assert "comes to rest with a steady error of pitch +0.30°: it cannot hold tolerance_pitch_deg = 0.1" in (
        world.record.reason
    )
    known = world.gimbal.known.steady_error
    assert known is not None

    def again(other: World) -> None:
        other.gimbal.known.steady_error = known

    refused = fly(prepare=again)
    assert refused.sink.of(ev.PreflightFailed)
    assert refused.gimbal.commands == []


def test_with_a_tolerance_that_it_can_hold_the_mission_completes() -> None:
    def wide(world: World) -> None:
        beside(world)
        world.gimbal.known.steady_error = SteadyError(mean_deg=(0.3, 0.0, 0.0), hold_deg=(0.32, 0.02, 0.02))
        world.settings = replace(world.settings, tolerance=Tolerance(pitch_deg=1.0, roll_deg=1.0, yaw_deg=2.0))

    assert fly(prepare=wide).record.state is MissionState.COMPLETE


def test_ten_reports_a_second_complete_a_mission() -> None:
    def slow(world: World) -> None:
        world.gimbal.rate_hz = 10.0

    world = fly(prepare=slow)
    assert world.record.state is MissionState.COMPLETE
    assert world.sink.of(ev.ShotRejected) == []


def test_a_contradiction_about_north_is_told_once_and_kept(tmp_path: Path) -> None:
    def off(world: World) -> None:
        known = world.gimbal.known
        known.manager, known.device, known.device_id, known.feedback = 1, 154, 1, "earth"
        known.north_off_deg, known.north_corrected = 60.0, True
        known.strangers.add(155)

    world = fly(prepare=off)
    (told,) = world.sink.of(ev.GimbalContradicted)
    assert told.text.startswith("the gimbal's north is +60.0° from that of the autopilot (tolerance 0.5°)")
    assert [event.code for event in world.sink.of(ev.Warned)] == ["stranger"]
    assert world.record.warnings == [
        told.text,
        "component 155 tells attitudes, but the gimbal is component 154: they are ignored",
    ]
    writer = ManifestWriter(
        path=tmp_path / "manifest.json",
        plan=world.plan,
        record=world.record,
        vehicle={},
        clock=SystemClock(),
        certificate=lambda: None,
    )
    assert writer._head()["gimbal"] == {
        "manager": 1,
        "device": 154,
        "device_id": 1,
        "feedback": "earth",
        "north_off_deg": 60.0,
        "north_corrected": True,
    }


def test_reports_that_fall_behind_verify_nothing_until_a_slew_shows_their_age() -> None:
    """Their stamps tell of it before the next slew does."""

    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotAccepted)
        await until_event(world, ev.ShotStarted)
        await world.clock.sleep(0.05)
        world.gimbal.feed.late_s = 5.0

    world = fly(script)
    assert world.record.state is MissionState.COMPLETE
    rejected = world.sink.of(ev.ShotRejected)
    assert {event.code for event in rejected} == {"stale"}
    assert "5.0 s later than they were at the last slew: no exposure can be verified by them" in rejected[0].reason
    assert len({event.shot for event in rejected}) == 1, "the next slew shows that they are of the moment"
