"""The order of missions, and what is found of them, do not depend on the clock."""

from __future__ import annotations

import shutil
import sqlite3
import time
from pathlib import Path

import pytest

from panoexec.clock import SystemClock
from panoexec.daemon.missions import Missions
from panoexec.inputs.config import Config
from panoexec.inputs.service_sections import StorageSection
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.store.catalogue import catalogue, glance
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import JournalFileError
from panoexec.store.session import create_mission
from tests.repository import ROOT
from tests.unit.fakes.world import ListSink, a_plan, some_settings
from tests.unit.store.rewriting import unseal

S = MissionState
NOW = 1_796_000_000.0
"""In 2026."""


async def _mission(storage: Path, now_utc_s: float, *states: MissionState) -> MissionDirectory:
    """A mission of which a process left these states."""
    stored = await create_mission(storage, plan=a_plan(), settings=some_settings(), now_utc_s=now_utc_s)
    events: list[ev.Event] = []
    for seq, state in enumerate(states, start=1):
        kind = ev.MissionStarted if seq == 1 else ev.PreflightPassed
        more = {"shots_total": 4} if seq == 1 else {}
        events.append(kind(mission_id="m", seq=seq, time_utc_s=now_utc_s, state=state, **more))  # type: ignore[arg-type]
    if events:
        await stored.journal.append(events)
    await stored.journal.close()
    return stored.directory


OVER = (S.PREFLIGHT, S.ABORTED)
FLYING = (S.PREFLIGHT, S.CAPTURING)


def _missions(storage: Path) -> Missions:
    config = Config(storage=StorageSection(path=storage))
    return Missions(config=lambda: config, clock=SystemClock(), sink=ListSink(), changed=lambda: None)


async def test_missions_are_ordered_as_they_began_whatever_the_clock_said(tmp_path: Path) -> None:
    clock = [NOW, NOW - 3600.0, 30.0, 30.0, NOW + 10.0, 31.0]
    made = [await _mission(tmp_path, now, *OVER) for now in clock]
    found = catalogue(tmp_path)
    assert [stored.directory for stored in found] == made
    assert len({directory.mission_id for directory in made}) == len(clock)
    assert [stored.glance.number for stored in found if stored.glance] == [1, 2, 3, 4, 5, 6]
    assert made[2].mission_id == "19700101T000030.000Z"
    # names alone would have another opinion
    assert sorted(made, key=lambda directory: directory.mission_id) != made


@pytest.mark.parametrize("set_back_s", [3600.0, NOW - 60.0])
async def test_an_interrupted_mission_is_found_although_the_clock_was_set_back(
    tmp_path: Path, set_back_s: float
) -> None:
    await _mission(tmp_path, NOW, *OVER)
    interrupted = await _mission(tmp_path, NOW - set_back_s, *FLYING)
    missions = _missions(tmp_path)
    assert await missions.find_interrupted()
    assert missions.offer is not None
    assert missions.offer.stored_id == interrupted.mission_id


async def test_an_older_mission_is_not_offered_for_a_newer_one_with_an_earlier_name(tmp_path: Path) -> None:
    await _mission(tmp_path, NOW, *FLYING)
    await _mission(tmp_path, 60.0, *OVER)
    missions = _missions(tmp_path)
    assert not await missions.find_interrupted()
    assert missions.offer is None


async def test_a_directory_in_which_no_mission_began_hides_none(tmp_path: Path) -> None:
    interrupted = await _mission(tmp_path, NOW, *FLYING)
    empty = tmp_path / "missions" / "20300101T000000.000Z"
    empty.mkdir()
    (empty / ".journal.sqlite-new").touch()
    missions = _missions(tmp_path)
    assert await missions.find_interrupted()
    assert missions.offer is not None
    assert missions.offer.stored_id == interrupted.mission_id


async def test_missions_of_an_earlier_version_come_first(tmp_path: Path) -> None:
    old = [await _mission(tmp_path, NOW + i, *OVER) for i in range(2)]
    for directory in old:
        unseal(directory.journal)
        _forget_number(directory.journal)
    young = await _mission(tmp_path, 60.0, *FLYING)
    assert [stored.directory for stored in catalogue(tmp_path)] == [*old, young]


def _forget_number(journal: Path) -> None:
    with sqlite3.connect(journal) as connection:
        connection.execute("DELETE FROM head WHERE key = 'number'")
    connection.close()


async def test_the_newest_mission_is_told_if_it_is_damaged(tmp_path: Path) -> None:
    await _mission(tmp_path, NOW, *FLYING)
    newest = await _mission(tmp_path, NOW + 1, *FLYING)
    data = bytearray(newest.journal.read_bytes())
    data[data.index(b'"state":"capturing"') + 12] ^= 1
    newest.journal.write_bytes(data)
    missions = _missions(tmp_path)
    assert not await missions.find_interrupted()
    assert missions.offer is None
    assert missions.damage == f"the newest mission cannot be read: panoexec salvage {newest.path}"
    assert catalogue(tmp_path)[-1].directory == newest


async def test_a_glance_sees_that_the_end_is_missing(tmp_path: Path) -> None:
    directory = await _mission(tmp_path, NOW, *FLYING)
    assert glance(directory.journal).state is S.CAPTURING
    with sqlite3.connect(directory.journal) as connection:
        connection.execute("DELETE FROM events WHERE seq = 2")
    connection.close()
    with pytest.raises(JournalFileError, match="the last events are missing"):
        glance(directory.journal)


def test_a_storage_with_many_missions_is_looked_through_quickly(tmp_path: Path) -> None:
    """A start must not wait for it: a few milliseconds a mission, whatever its length."""
    recorded = ROOT / "tests" / "data" / "recorded"
    for number in range(40):
        folder = tmp_path / "missions" / f"20260101T0000{number:02}.000Z"
        folder.mkdir(parents=True)
        shutil.copy(recorded / "journal.sqlite", folder)
    began = time.process_time()
    assert len(catalogue(tmp_path)) == 40
    assert time.process_time() - began < 40 * 0.02


async def test_numbers_are_given_while_an_older_mission_is_damaged(tmp_path: Path) -> None:
    broken = await _mission(tmp_path, NOW, *OVER)
    broken.journal.write_bytes(b"nothing")
    young = await _mission(tmp_path, NOW + 5, *OVER)
    assert [stored.directory for stored in catalogue(tmp_path)] == [broken, young]
