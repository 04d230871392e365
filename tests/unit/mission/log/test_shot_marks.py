"""Where each shot stands, as text and back."""

from __future__ import annotations

import pytest

from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.mark_text import ShotMark, marks_from_text
from panoexec.mission.log.shot_marks import ShotMarks, mark_of, marks_text
from tests.unit.fakes.flying import drift_at, fly, until_event
from tests.unit.fakes.world import World, a_plan


def test_a_mission_on_its_way_tells_all_its_shots() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotStarted)
        mission.commands.skip(4)
        noted = 0
        while not mission.record.ended:
            for event in world.sink.events[noted:]:
                kept.note(event)
            noted = len(world.sink.events)
            texts.append(marks_text(mission.record))
            if noted == mission.record.seq:  # all that is known was announced
                assert kept.text(mission.record) == texts[-1]
                compared.append(texts[-1])
            await world.clock.sleep(0.05)

    def prepare(world: World) -> None:
        drift_at(world, -120.0, until_s=world.clock.monotonic() + 4.0)

    texts: list[str] = []
    compared: list[str] = []
    kept = ShotMarks()
    assert kept.text(None) == ""
    world = fly(script, prepare, plan=a_plan(6))
    assert len(set(compared)) > 4
    other = world.record_of_journal()
    assert kept.text(other) == marks_text(other)  # of another mission
    assert "d1 a1 t2 m1 t1" in texts or "d1 c1 t2 m1 t1" in texts
    assert "d1 r1 c1 t1 m1 t1" in texts
    record = world.record
    here = [mark_of(shot, current=index == record.current) for index, shot in sorted(record.shots.items())]
    assert marks_from_text(marks_text(record), count=6) == here


def test_what_is_to_be_taken_again() -> None:
    async def script(world: World, mission: Mission) -> None:
        await until_event(world, ev.ShotRejected)
        texts.append(marks_text(mission.record))

    def prepare(world: World) -> None:
        drift_at(world, -180.0, until_s=world.clock.monotonic() + 4.0)

    texts: list[str] = []
    world = fly(script, prepare)
    assert texts[0] in {"a1 t3", "c1 t3"}
    assert marks_text(world.record) == "r1 d3"


@pytest.mark.parametrize("text", ["", "d", "x3", "d3 ", "d-3", "d0 t3", "d2", "d99999999999", "d1 d1 d2", "d3\n"])
def test_what_is_no_such_text_tells_nothing(text: str) -> None:
    assert marks_from_text(text, count=3) == []


def test_every_letter_is_read() -> None:
    assert marks_from_text("d1 r1 c1 a1 m1 t2", count=7) == [
        ShotMark.DONE,
        ShotMark.RETAKEN,
        ShotMark.CURRENT,
        ShotMark.AGAIN,
        ShotMark.MISSING,
        ShotMark.TO_DO,
        ShotMark.TO_DO,
    ]
