"""Photos that do not arrive, or that the examination does not reach, are said to be unchecked."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from panoexec.errors import DeviceError
from panoexec.mission.log import events as ev
from panoexec.pictures.model import Verdicts
from panoexec.store import manifest
from tests.unit.fakes.examination import Mission, be_quick


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    be_quick(monkeypatch)


async def test_photos_that_do_not_arrive_are_unchecked(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0)
    mission.accept(1, stored=False)
    await mission.checked()
    assert mission.record.content is not None
    assert mission.record.content.unchecked == (1,)
    assert mission.record.shots[1].accepted is not None


async def test_an_examination_that_begins_late_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine starts its process late: the files are there, and a mission does not end as if all were good."""
    monkeypatch.setattr("panoexec.mission.content_check._NO_MORE_S", 60.0)
    mission = Mission(tmp_path)
    mission.accept(0)
    mission.check._ended = False
    settling = asyncio.create_task(mission.check.settle())
    await asyncio.sleep(0.2)  # four times the wait for a first file
    assert not settling.done()
    running = asyncio.create_task(mission.check.run())
    await settling
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert mission.record.content is not None
    assert "warned" not in mission.kinds()


async def test_an_examination_that_never_begins_is_told(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0)
    mission.accept(1)
    mission.check._ended = False
    await mission.check.settle()
    assert mission.record.content is not None
    assert mission.record.content.unchecked == (0, 1)
    written = manifest._content_json(mission.record)
    assert (written["certified"], written["connected"], written["unchecked"]) == (False, False, [0, 1])
    (warned,) = [event for event in mission.events if isinstance(event, ev.Warned)]
    assert warned.text == "the content of photos is not checked: of 2 files none could be examined in time"


async def test_a_judgement_that_fails_is_told(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0)
    judge = mission.checker.judge

    async def fails_at_the_end(*, final: bool = False) -> Verdicts:
        if final:
            raise DeviceError("gone")
        return await judge()

    mission.checker.judge = fails_at_the_end  # type: ignore[method-assign]
    await mission.checked()
    assert mission.record.content is not None
    assert mission.record.content.unchecked == (0,)
    (warned,) = [event for event in mission.events if isinstance(event, ev.Warned)]
    assert warned.text == "the content of photos is not checked: gone"


async def test_a_failed_examination_warns_and_ends_nothing(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0)
    mission.checker.broken = True
    await mission.check.run()
    assert mission.kinds()[-1] == "warned"
    await mission.check.settle()
    await mission.check.settle()
    assert mission.kinds()[-2:] == ["warned", "content_judged"]
    assert mission.record.content is not None
    assert mission.record.content.unchecked == (0,)


async def test_a_refused_file_is_unreadable_or_another_shots(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0, stored=False)
    mission.accept(1, stored=False)
    refused = {(0, 1): "a.jpg: cut off", (1, 1): "b.jpg: is the photo of shot 0, attempt 1, too (images/a.jpg)"}
    mission.check._source = replace(mission.check._source, refused=lambda: refused)  # type: ignore[type-var]
    running = asyncio.create_task(mission.check.run())
    while len(mission.revoked) < 2:  # noqa: ASYNC110
        await asyncio.sleep(0.001)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert sorted(mission.revoked) == [(0, 1, "unreadable"), (1, 1, "contradicts")]
