"""The journal on a real disk: what was kept stays, what is damaged is refused and left alone."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.store.journal import JournalFileError, JournalWriteError, SqliteJournal, load_journal, read_journal
from panoexec.store.journal_layout import APPLICATION_ID
from tests.unit.store.rewriting import rewrite, unseal

HEAD = {"mission_id": "m1", "plan": '{"format": "panoexec.plan/1"}'}


def _events(first: int, count: int) -> list[ev.Event]:
    return [
        ev.Warned(
            mission_id="m1", seq=seq, time_utc_s=seq / 4, clock_s=seq / 8, state=MissionState.PREFLIGHT,
            code="x", text="τ" * seq,
        )
        for seq in range(first, first + count)
    ]  # fmt: skip


async def _young(path: Path, count: int = 3) -> None:
    async with await SqliteJournal.create(path, HEAD) as journal:
        await journal.append(_events(1, count))


async def test_what_was_kept_is_there_again(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    await _young(path)
    async with await SqliteJournal.open(path) as journal:
        assert await journal.head() == HEAD
        assert await journal.events() == _events(1, 3)
        await journal.append(_events(4, 2))
    async with await SqliteJournal.open(path) as journal:
        assert await journal.events() == _events(1, 5)


async def test_it_is_set_up_to_survive_a_power_cut(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    async with await SqliteJournal.create(path, HEAD) as journal:
        connection = journal._connection
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        assert connection.execute("PRAGMA synchronous").fetchone() == (2,)
        assert path.read_bytes()[68:72] == APPLICATION_ID.to_bytes(4)


async def test_a_batch_is_kept_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    async with await SqliteJournal.create(path, HEAD) as journal:
        await journal.append(_events(1, 2))
        with pytest.raises(JournalWriteError, match=r"cannot be written .*UNIQUE"):
            await journal.append([*_events(3, 2), *_events(1, 1)])
        assert len(await journal.events()) == 2


KILLED = """
import asyncio, sys
from pathlib import Path
from panoexec.mission.log import events as ev
from panoexec.store.journal import SqliteJournal

async def main():
    journal = await SqliteJournal.create(Path(sys.argv[1]), {"mission_id": "m1"})
    seq = 0
    while True:
        seq += 1
        await journal.append([ev.Warned(mission_id="m1", seq=seq, code="x", text="y")])
        print(seq, flush=True)

asyncio.run(main())
"""


def test_kill_9_loses_nothing_that_was_returned_from(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        announced = 0
        for line in process.stdout:
            announced = int(line)
            if announced == 20:
                os.kill(process.pid, signal.SIGKILL)
        announced_after_the_kill = announced

    async def read() -> list[ev.Event]:
        async with await SqliteJournal.open(path) as journal:
            return await journal.events()

    kept = [event.seq for event in asyncio.run(read())]
    assert kept == list(range(1, len(kept) + 1))
    assert len(kept) >= announced_after_the_kill >= 20


def test_a_journal_killed_right_after_its_birth_is_recognised(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    code = KILLED.replace("    seq = 0\n", "    import os, signal; os.kill(os.getpid(), signal.SIGKILL)\n    seq = 0\n")
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)

    async def read() -> dict[str, str]:
        async with await SqliteJournal.open(path) as journal:
            return await journal.head()

    assert asyncio.run(read()) == {"mission_id": "m1"}


def _newer(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 7")
    connection.close()


def _foreign(path: Path) -> None:
    path.unlink()
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE t (x)")
    connection.close()


def _torn(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[4096:] = os.urandom(len(data) - 4096)
    path.write_bytes(data)


def _gap(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("DELETE FROM events WHERE seq = 2")
    connection.close()


def _nonsense(path: Path) -> None:
    rewrite(path, texts={2: '{"type": "moon_landing"}'})


def _sql(statement: str) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        with sqlite3.connect(path) as connection:
            connection.executescript(statement)
        connection.close()

    return change


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (lambda path: path.write_bytes(b""), "not an SQLite file"),
        (lambda path: path.write_bytes(b"half a page" * 30), "not an SQLite file"),
        (lambda path: path.write_bytes(path.read_bytes()[:5000]), "damaged"),
        (_torn, "damaged"),
        (_newer, r"newer panoexec \(layout 7, this one reads up to 2\)"),
        (_foreign, "not a panoexec journal"),
        (_gap, "damaged .event 2 is missing"),
        (_nonsense, "damaged .*moon_landing"),
        (lambda path: rewrite(path, keep=lambda seq: seq != 2), "damaged .event 2 is missing"),
        (_sql("UPDATE events SET json = replace(json, '7', '8') WHERE seq = 7"), "damaged .event 7 was changed"),
        (_sql("UPDATE events SET time_utc_s = 1 WHERE seq = 9"), "damaged .event 9 was changed"),
        (_sql("UPDATE events SET seal = zeroblob(16) WHERE seq = 9"), "damaged .event 9 was changed"),
        (_sql("DELETE FROM events WHERE seq > 30"), "damaged .40 events were written, 30 are there"),
        (_sql("DELETE FROM events"), "damaged .40 events were written, 0 are there"),
        (
            _sql(
                "UPDATE events SET seq = 99 WHERE seq = 4; UPDATE events SET seq = 4 WHERE seq = 5;"
                "UPDATE events SET seq = 5 WHERE seq = 99"
            ),
            "damaged .event 4 was changed",
        ),
        (_sql("UPDATE tail SET events = 39"), "damaged .39 events were written, 40 are there"),
        (_sql("DELETE FROM tail"), "damaged .the number of events is missing"),
        (_sql("UPDATE head SET value = replace(value, 'plan', 'flan')"), "damaged .plan was changed"),
        (_sql("UPDATE head SET value = 'm2' WHERE key = 'mission_id'"), "damaged .mission_id and plan was changed"),
        (_sql("DELETE FROM head WHERE key = 'plan'"), "damaged .a part of the head is missing"),
        (_sql("PRAGMA user_version = 1"), "damaged .layout 1 with other tables"),
        (_sql("ALTER TABLE events DROP COLUMN seal"), "damaged .layout 2 with other tables"),
    ],
)
async def test_damage_is_refused_and_nothing_is_overwritten(
    tmp_path: Path, damage: Callable[[Path], object], text: str
) -> None:
    path = tmp_path / "journal.sqlite"
    await _young(path, 40)
    damage(path)
    before = path.read_bytes()

    async def read() -> None:
        async with await SqliteJournal.open(path) as journal:
            await journal.events()

    with pytest.raises(JournalFileError, match=text):
        await read()
    assert path.read_bytes() == before


async def test_two_processes_cannot_have_one_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    async with await SqliteJournal.create(path, HEAD):
        with pytest.raises(JournalFileError, match="in use by another panoexec"):
            await SqliteJournal.open(path)
        with pytest.raises(JournalFileError, match="already exists"):
            await SqliteJournal.create(path, HEAD)


async def test_no_journal(tmp_path: Path) -> None:
    with pytest.raises(JournalFileError, match="there is no journal"):
        await SqliteJournal.open(tmp_path / "journal.sqlite")
    with pytest.raises(JournalFileError, match="cannot be created"):
        await SqliteJournal.create(tmp_path / "nowhere" / "journal.sqlite", HEAD)


async def test_a_directory_deleted_or_replaced_under_the_mission_is_noticed(tmp_path: Path) -> None:
    folder = tmp_path / "mission"
    folder.mkdir()
    async with await SqliteJournal.create(folder / "journal.sqlite", HEAD) as journal:
        shutil.rmtree(folder)
        with pytest.raises(JournalWriteError, match="deleted while the mission was running"):
            await journal.append(_events(1, 1))
        folder.mkdir()
        (folder / "journal.sqlite").touch()
        with pytest.raises(JournalWriteError, match="replaced while the mission was running"):
            await journal.append(_events(1, 1))
        assert (folder / "journal.sqlite").read_bytes() == b""


async def test_a_closed_journal_says_so(tmp_path: Path) -> None:
    journal = await SqliteJournal.create(tmp_path / "journal.sqlite", HEAD)
    await journal.close()
    await journal.close()
    with pytest.raises(JournalWriteError, match="is closed"):
        await journal.append(_events(1, 1))


def test_a_journal_is_read_without_touching_its_folder(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    events = _events(1, 3)

    async def write() -> None:
        async with await SqliteJournal.create(path, HEAD) as journal:
            await journal.append(events)
            with pytest.raises(JournalFileError, match="in use"):
                read_journal(path)
            # as a killed process leaves it: what was appended is not folded in yet
            for name in ("journal.sqlite", "journal.sqlite-wal"):
                (tmp_path / "killed").mkdir(exist_ok=True)
                (tmp_path / "killed" / name).write_bytes((tmp_path / name).read_bytes())

    asyncio.run(write())
    assert (tmp_path / "killed" / "journal.sqlite-wal").stat().st_size > 0
    for folder in (tmp_path, tmp_path / "killed"):
        head, found = read_journal(folder / "journal.sqlite")
        assert head == HEAD
        assert found == events
    assert sorted(item.name for item in tmp_path.iterdir()) == ["journal.sqlite", "killed"]


def test_what_is_no_journal_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(JournalFileError, match="there is no journal"):
        read_journal(tmp_path / "journal.sqlite")
    (tmp_path / "journal.sqlite").write_bytes(b"no database at all" * 20)
    with pytest.raises(JournalFileError, match="not an SQLite file"):
        read_journal(tmp_path / "journal.sqlite")


async def test_a_journal_without_seals_is_read_and_sealed_when_it_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    await _young(path)
    unseal(path)
    before = path.read_bytes()
    contents = load_journal(path)
    assert (contents.head, contents.events) == (HEAD, _events(1, 3))
    assert ["unchecked" in text for text in contents.notes] == [True]
    assert path.read_bytes() == before
    async with await SqliteJournal.open(path) as journal:
        await journal.append(_events(4, 1))
    contents = load_journal(path)
    assert contents.head == HEAD | {"sealed_later": "3"}
    assert contents.events == _events(1, 4)
    assert contents.notes == ("events up to 3 were sealed later: before that, unchecked",)
    _sql("UPDATE events SET json = replace(json, '2', '3') WHERE seq = 2")(path)
    with pytest.raises(JournalFileError, match="event 2 was changed"):
        load_journal(path)
