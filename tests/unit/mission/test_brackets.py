"""Brackets: several photos of one pose, and what comes between two of them."""

from __future__ import annotations

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.shot_record import Verdict
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.flying import fly, pilot_hands_back, pilot_takes_over, until_photos
from tests.unit.fakes.world import World, some_settings

S = MissionState
FIVE = some_settings(brackets=5, interval_s=2.0, exposure_s=0.02)


def test_a_bracket_is_one_shot_with_all_its_photos() -> None:
    world = fly(settings=FIVE)
    assert world.record.state is S.COMPLETE
    assert len(world.camera.photos) == 20
    for shot in world.record.shots.values():
        assert [photo.number for photo in shot.attempts[0].photos] == [1, 2, 3, 4, 5]


def test_photos_of_a_bracket_that_have_one_file_are_not_two_photos() -> None:
    world = fly(prepare=lambda w: setattr(w.camera, "photos_a_name", 2), settings=FIVE)
    assert world.record.state is S.FAILED, "paused for a systematic failure"
    assert not world.sink.of(ev.ShotAccepted)
    assert {event.code for event in world.sink.of(ev.ShotRejected)} == {"evidence"}
    assert "one file for two photos" in world.sink.of(ev.ShotRejected)[0].reason


def test_a_pilot_need_not_wait_for_the_rest_of_a_bracket() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_photos(world, 7)
        await pilot_takes_over(world, within_s=0.5)
        await pilot_hands_back(world, mission, after_s=3.0)

    world = fly(script, settings=FIVE)
    assert world.record.state is S.COMPLETE
    attempts = world.record.shots[1].attempts
    assert [(a.verdict, len(a.photos)) for a in attempts] == [(Verdict.INTERRUPTED, 2), (Verdict.ACCEPTED, 5)]
    assert all(photo.file for photo in attempts[0].photos)  # what was taken is on record
    assert world.record.retakes == 0


@pytest.mark.parametrize(
    ("verb", "state"),
    [("abort", S.ABORTED), ("interrupt", S.PAUSED), ("finish", S.INCOMPLETE), ("skip", S.INCOMPLETE)],
)
def test_a_command_is_obeyed_between_two_photos(verb: str, state: MissionState) -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_photos(world, 2)
        await world.clock.sleep(0.5)
        getattr(mission.commands, verb)()
        await world.clock.sleep(1.0)
        assert len(world.camera.photos) == 2
        assert isinstance(world.sink.of(ev.ShotInterrupted)[0], ev.ShotInterrupted)

    world = fly(script, settings=FIVE)
    assert world.record.state is state
    assert world.record.shots[0].attempts[0].verdict is Verdict.INTERRUPTED
