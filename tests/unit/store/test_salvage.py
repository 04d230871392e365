"""Salvaging: what is true is kept, what is lost is told, and the damaged files stay as they were."""

from __future__ import annotations

import asyncio
import json
import os
import random
import shutil
import sqlite3
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.mission.log.events import Event, ShotAccepted
from panoexec.report.mission_outputs import write_mission_outputs
from panoexec.store import journal_layout as layout
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import JournalFileError, SqliteJournal, load_journal, read_journal
from panoexec.store.manifest import manifest_events, read_manifest
from panoexec.store.rebuilding import restore_manifest
from panoexec.store.salvage import salvage_journal
from tests.repository import ROOT
from tests.unit.store.rewriting import unseal

RECORDED = ROOT / "tests" / "data" / "recorded"
FLIPS = int(os.environ.get("PANOEXEC_FLIPS", "240")) // 6
MISSION = json.loads((RECORDED / "manifest.json").read_text())["mission_id"]


@pytest.fixture(scope="module", name="missions")
def the_missions(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Sequence[Event]]:
    """The recorded mission with seals: closed, and as a killed process leaves it; and its events."""
    folder = tmp_path_factory.mktemp("salvage")
    shutil.copytree(RECORDED, folder / "recorded")
    head, events = read_journal(folder / "recorded" / "journal.sqlite")
    closed, killed = folder / "closed" / MISSION, folder / "killed" / MISSION

    async def write() -> None:
        closed.mkdir(parents=True)
        shutil.copy(RECORDED / "plan.json", closed)
        async with await SqliteJournal.create(closed / "journal.sqlite", head | {"number": "7"}) as journal:
            for event in events[:50]:
                await journal.append([event])
            journal._connection.execute("PRAGMA wal_checkpoint(PASSIVE)")
            for event in events[50:]:
                await journal.append([event])
            shutil.copytree(closed, killed)
        restore_manifest(MissionDirectory(closed))

    asyncio.run(write())
    return closed, killed, events


@pytest.fixture
def mission(missions: tuple[Path, Path, Sequence[Event]], tmp_path: Path) -> MissionDirectory:
    return MissionDirectory(Path(shutil.copytree(missions[0], tmp_path / MISSION)))


def _change(mission: MissionDirectory, statement: str) -> None:
    with sqlite3.connect(mission.journal) as connection:
        connection.executescript(statement)
    connection.close()


def _files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_whole_mission_stays_as_it_is(mission: MissionDirectory, capsys: pytest.CaptureFixture[str]) -> None:
    write_mission_outputs(mission)
    before = _files(mission.path)
    assert run(["salvage", str(mission.path)]) == 0
    assert _files(mission.path) == before
    assert capsys.readouterr().out == "whole: 95 events\n"


def test_the_part_before_the_damage_becomes_the_journal(
    mission: MissionDirectory, missions: tuple[Path, Path, Sequence[Event]], capsys: pytest.CaptureFixture[str]
) -> None:
    _change(mission, "UPDATE events SET json = replace(json, '\"seq\":60,', '\"seq\":61,') WHERE seq = 60")
    damaged = _files(mission.path)
    assert run(["salvage", str(mission.path), "--json"]) == 1
    captured = capsys.readouterr()
    told = json.loads(captured.out)
    assert (told["whole"], told["events"], told["lost"]["events"]) == (False, 59, 36)
    assert "event 60 was changed" in told["damage"]
    assert "lost: 36 events after event 59" in captured.err
    events = load_journal(mission.journal).events
    assert events == missions[2][:59]
    kept = {event.shot for event in events if isinstance(event, ShotAccepted)}
    assert set(told["lost"]["shots"]) == set(range(18)) - kept
    manifest = read_manifest(mission.manifest)
    assert (manifest["state"], manifest["counts"]["shots_done"], manifest_events(manifest)) == (
        "capturing", len(kept), 59,
    )  # fmt: skip
    assert mission.report.exists()
    assert (mission.path / "panorama.pto").exists()
    # what was damaged is still there, byte for byte
    aside = _files(mission.path / "damaged-1")
    assert aside == {name: damaged[name] for name in ("journal.sqlite", "manifest.json")}
    assert run(["salvage", str(mission.path)]) == 0


@pytest.mark.parametrize(
    ("statement", "lost"),
    [
        ("UPDATE tail SET events = events + 128", 0),
        ("UPDATE tail SET seal = zeroblob(16)", 0),
        ("UPDATE events SET seal = zeroblob(16) WHERE seq = 95", 1),
        ("DELETE FROM events WHERE seq > 90; VACUUM", 5),
    ],
)
def test_what_is_lost_at_the_end_is_counted(mission: MissionDirectory, statement: str, lost: int) -> None:
    mission.manifest.unlink()
    _change(mission, statement)
    salvage = salvage_journal(mission)
    assert (salvage.events, salvage.lost_events) == (95 - lost, lost)
    assert len(load_journal(mission.journal).events) == 95 - lost


def test_the_plan_comes_back_from_its_file_if_it_is_the_same(mission: MissionDirectory) -> None:
    head = load_journal(mission.journal).head
    _change(mission, "UPDATE head SET value = replace(value, 'certified', 'sertified') WHERE key = 'plan'; VACUUM")
    assert salvage_journal(mission).whole
    assert load_journal(mission.journal).head == head


def test_settings_that_are_lost_are_told(mission: MissionDirectory, capsys: pytest.CaptureFixture[str]) -> None:
    _change(mission, "UPDATE head SET value = replace(value, '0', '1') WHERE key = 'settings'; VACUUM")
    assert run(["salvage", str(mission.path)]) == 1
    assert "lost: settings; the mission cannot be resumed" in capsys.readouterr().err
    assert len(load_journal(mission.journal).events) == 95


def test_a_lost_end_that_the_manifest_tells_of(mission: MissionDirectory) -> None:
    """The write-ahead log was deleted."""
    _change(
        mission,
        "DELETE FROM events WHERE seq > 80; UPDATE tail SET events = 80,"
        " seal = (SELECT seal FROM events WHERE seq = 80); VACUUM",
    )
    assert len(load_journal(mission.journal).events) == 80
    salvage = salvage_journal(mission)
    assert (salvage.events, salvage.lost_events) == (80, 15)
    assert "the manifest tells of event 95" in salvage.damage


def test_a_journal_without_seals_is_recovered_and_said_to_be_unchecked(mission: MissionDirectory) -> None:
    unseal(mission.journal)
    mission.manifest.unlink()
    _change(mission, "DELETE FROM events WHERE seq = 50")
    salvage = salvage_journal(mission)
    assert (salvage.events, salvage.lost_events, salvage.whole) == (49, None, False)
    assert any("unchecked" in text for text in salvage.notes)
    assert any("unchecked" in text for text in load_journal(mission.journal).notes)


def test_what_is_no_mission_or_in_use_is_refused(mission: MissionDirectory, tmp_path: Path) -> None:
    assert run(["salvage", str(tmp_path / "nothing")]) == 2

    async def busy() -> None:
        async with await SqliteJournal.open(mission.journal) as journal:
            await journal.append([replace((await journal.events())[-1], seq=96)])
            assert await asyncio.to_thread(run, ["salvage", str(mission.path)]) == 2

    asyncio.run(busy())
    for content in (b"nothing", bytes(9000)):
        mission.journal.write_bytes(content)
        assert run(["salvage", str(mission.path)]) == 2
        assert mission.journal.read_bytes() == content
        assert not list(mission.path.glob("damaged-*"))


@pytest.mark.parametrize("name", ["journal.sqlite", "journal.sqlite-wal"])
def test_after_any_flipped_bit_all_that_is_kept_is_true(
    missions: tuple[Path, Path, Sequence[Event]], tmp_path: Path, name: str
) -> None:
    closed, killed, events = missions
    source = killed if name.endswith("-wal") else closed
    whole = (source / name).read_bytes()
    rng = random.Random(name)
    outcomes: Counter[str] = Counter()
    for number in range(FLIPS):
        mission = MissionDirectory(Path(shutil.copytree(source, tmp_path / str(number) / MISSION)))
        mission.manifest.unlink(missing_ok=True)
        data = bytearray(whole)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        (mission.path / name).write_bytes(data)
        try:
            salvage = salvage_journal(mission)
        except JournalFileError as error:
            outcomes["said"] += "nothing was changed" in str(error)
            outcomes["refused"] += 1
            continue
        contents = load_journal(mission.journal)
        assert list(contents.events) == list(events)[: salvage.events]
        lost_all = salvage.lost_events != 0 or salvage.lost_head or salvage.notes
        assert lost_all or (len(contents.events) == len(events) and contents.head[layout.NUMBER] == "7")
        outcomes["all" if len(contents.events) == len(events) else "part"] += 1
        shutil.rmtree(mission.path)
    print(name, dict(outcomes))
    assert outcomes["all"] > (FLIPS // 2 if name.endswith("-wal") else 0)
    assert outcomes["said"] == outcomes["refused"] <= FLIPS // 20
