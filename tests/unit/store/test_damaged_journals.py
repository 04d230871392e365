"""Journals damaged at each byte that matters: used whole, or refused in words and left exactly as they were."""

from __future__ import annotations

import asyncio
import random
import shutil
import sqlite3
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from panoexec.errors import UsageError
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import JournalFileError
from panoexec.store.session import create_mission, open_mission
from tests.unit.fakes.world import a_plan, some_settings
from tests.unit.store.rewriting import rewrite

EVENTS = 12
LOG = "journal.sqlite-wal"


@dataclass
class Journals:
    """The same mission, closed in order, and as a killed process leaves it."""

    closed: Path
    killed: Path


@pytest.fixture(scope="module")
def journals(tmp_path_factory: pytest.TempPathFactory) -> Journals:
    storage = tmp_path_factory.mktemp("storage")

    async def make() -> Journals:
        stored = await create_mission(storage, plan=a_plan(), settings=some_settings(), now_utc_s=1.7e9)
        head = {"mission_id": "m", "time_utc_s": 1.7e9}
        preflight, capturing = MissionState.PREFLIGHT, MissionState.CAPTURING
        await stored.journal.append([ev.MissionStarted(**head, seq=1, state=preflight, shots_total=4)])  # type: ignore[arg-type]
        await stored.journal.append([ev.PreflightPassed(**head, seq=2, state=capturing)])  # type: ignore[arg-type]
        for seq in range(3, EVENTS + 1):
            warned = ev.Warned(**head, seq=seq, state=capturing, code="x", text="τ")  # type: ignore[arg-type]
            await stored.journal.append([warned])
        killed = storage / "killed"
        shutil.copytree(stored.directory.path, killed)
        await stored.journal.close()
        return Journals(closed=stored.directory.path, killed=killed)

    return asyncio.run(make())


def _outcome(folder: Path) -> int | str:
    """Events that the mission in a folder is opened with, or why it is refused; then nothing in there has changed."""
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    async def opened() -> int:
        stored = await open_mission(MissionDirectory(folder))
        await stored.journal.close()
        return len(stored.events)

    try:
        return asyncio.run(opened())
    except UsageError as error:
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
        return str(error)


def _damaged(source: Path, folder: Path, name: str, changes: Callable[[bytearray], object]) -> int | str:
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder)
    data = bytearray((folder / name).read_bytes())
    changes(data)
    (folder / name).write_bytes(data)
    return _outcome(folder)


def _flip(at: int) -> Callable[[bytearray], object]:
    def flip(data: bytearray) -> None:
        data[at] ^= 0x9F

    return flip


def _places(size: int, count: int, seed: int) -> Iterable[int]:
    return random.Random(seed).sample(range(size), count)


@pytest.mark.parametrize("which", ["closed", "killed"])
def test_a_byte_of_the_database(journals: Journals, tmp_path: Path, which: str) -> None:
    source: Path = getattr(journals, which)
    refused = 0
    for at in [*range(100), *_places((source / "journal.sqlite").stat().st_size, 20, 5)]:
        outcome = _damaged(source, tmp_path / "mission", "journal.sqlite", _flip(at))
        assert outcome == EVENTS or isinstance(outcome, str), at
        refused += isinstance(outcome, str)
    assert refused > 20


def test_a_text_that_is_none(journals: Journals, tmp_path: Path) -> None:
    """Neither a daemon at its start nor a user may meet the error of a codec."""
    for source in (journals.closed, journals.killed):
        whole = (source / "journal.sqlite").read_bytes()
        for text in (b"panoexec.plan/1", b"CREATE TABLE events", b"tolerance"):
            outcome = _damaged(source, tmp_path / "mission", "journal.sqlite", _flip(whole.index(text) + 2))
            assert isinstance(outcome, str)
            assert "journal.sqlite: damaged (" in outcome


def test_what_was_not_folded_in_is_not_forgotten(journals: Journals, tmp_path: Path) -> None:
    """SQLite would pass over the damage in silence, and a mission half flown would be a new one."""
    size = (journals.killed / LOG).stat().st_size
    for at in [*range(32), 32, 40, 47, 48, *_places(size - 3 * (24 + 4096), 20, 7)]:
        outcome = _damaged(journals.killed, tmp_path / "mission", LOG, _flip(at))
        assert isinstance(outcome, str), at
        assert f"of {LOG}, with " in outcome


def test_a_transaction_that_a_power_cut_tore_is_no_damage(journals: Journals, tmp_path: Path) -> None:
    def tear(data: bytearray) -> None:
        data[-3000:] = bytes(3000)

    assert _damaged(journals.killed, tmp_path / "torn", LOG, tear) == EVENTS - 1
    assert _damaged(journals.killed, tmp_path / "short", LOG, lambda data: data.__delitem__(slice(-3000, None))) == (
        EVENTS - 1
    )


def test_events_that_make_no_sense(journals: Journals, tmp_path: Path) -> None:
    for text in ("[]", '"warned"', '{"type": "photo_identified", "seq": 5, "shot": 0, "attempt": 9, "photos": []}'):
        folder = tmp_path / "mission"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(journals.closed, folder)
        rewrite(folder / "journal.sqlite", texts={5: text})
        outcome = _outcome(folder)
        assert isinstance(outcome, str)
        assert "damaged" in outcome


async def test_what_cannot_be_read_is_said(journals: Journals, tmp_path: Path) -> None:
    folder = tmp_path / "mission"
    shutil.copytree(journals.killed, folder)
    (folder / LOG).unlink()
    (folder / LOG).mkdir()
    with pytest.raises(JournalFileError, match=f"{LOG}: cannot be read"):
        await open_mission(MissionDirectory(folder))


async def test_a_full_disk_is_called_so(journals: Journals, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object, **__: object) -> sqlite3.Connection:
        raise sqlite3.OperationalError("disk I/O error")

    monkeypatch.setattr(sqlite3, "connect", failing)
    with pytest.raises(JournalFileError, match=r"cannot be opened .disk I/O error"):
        await open_mission(MissionDirectory(journals.killed))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    with pytest.raises(JournalFileError, match=r"cannot be opened .no space left in"):
        await open_mission(MissionDirectory(journals.killed))


def test_what_another_version_wrote_is_not_called_damaged(journals: Journals, tmp_path: Path) -> None:
    folder = tmp_path / "mission"
    shutil.copytree(journals.closed, folder)
    moon = '{"type": "moon_landing", "seq": 5}'
    rewrite(folder / "journal.sqlite", texts={5: moon}, head={"panoexec": "99.1"})
    outcome = _outcome(folder)
    assert isinstance(outcome, str)
    assert "written by panoexec 99.1" in outcome
    assert "resume it with that version" in outcome
