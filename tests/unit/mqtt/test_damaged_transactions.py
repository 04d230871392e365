"""Transactions damaged on disk: no false answer, a start in any case, and what is lost is told.

`PANOEXEC_FLIPS` sets how many bits are flipped in all (default 60 here), in a closed file and in a log.
"""

from __future__ import annotations

import asyncio
import os
import random
import shutil
import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from panoexec.durable.wal_check import LogState
from panoexec.errors import UsageError
from panoexec.mqtt import transaction_file
from panoexec.mqtt.requests import RefusedRequestError, StartRequest
from panoexec.mqtt.transaction_file import FORGOTTEN, open_transaction_file
from panoexec.mqtt.transaction_rows import Noted
from panoexec.mqtt.transactions import Transactions

FLIPS = int(os.environ.get("PANOEXEC_FLIPS", "60"))
ROWS = 30


def _request(number: int) -> StartRequest:
    return StartRequest(transaction=number)


async def _fill(path: Path, killed: Path) -> None:
    store = await Transactions.open(path, boot_id="b")
    for number in range(ROWS):
        await store.note(_request(number))
        await store.answered(_request(number), f'{{"number": {number}, "text": "{"x" * 200}"}}')
    await store.remember("camera", "dji-p1-35mm")
    await store.remember("camera", "dji-x5s-15mm")
    await store.remember("declined mission", "m1")
    await store.remember("x", "y")
    await store.remember("x", None)
    for name in (path.name, path.name + "-wal"):
        shutil.copy(path.parent / name, killed)
    await store.close()


@pytest.fixture(scope="module", name="stores")
def the_stores(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A file that was closed, and one as a killed process leaves it."""
    folder = tmp_path_factory.mktemp("transactions")
    (folder / "closed").mkdir()
    (folder / "killed").mkdir()
    asyncio.run(_fill(folder / "closed" / "t.sqlite", folder / "killed"))
    return folder / "closed", folder / "killed"


async def _known(path: Path) -> tuple[list[Noted | str], str | None]:
    """What is known of each transaction and name, and whether something is told to be forgotten."""
    store = await Transactions.open(path, boot_id="c")
    found: list[Noted | str] = []
    forgotten = await store.recall(FORGOTTEN)
    for number in range(ROWS):
        try:
            found.append(await store.note(_request(number)))
        except RefusedRequestError as error:
            found.append(f"refused: {error.code}")
    found += [f"{key}: {await store.recall(key)}" for key in ("camera", "declined mission", "x")]
    await store.close()
    return found, forgotten


def test_a_flipped_bit_that_makes_a_table_no_text_is_told(stores: tuple[Path, Path], tmp_path: Path) -> None:
    truth, _ = asyncio.run(_known(Path(shutil.copytree(stores[0], tmp_path / "whole")) / "t.sqlite"))
    file = Path(shutil.copytree(stores[0], tmp_path / "copy")) / "t.sqlite"
    whole = file.read_bytes()
    places = [place for place in range(whole.index(b"CREATE TABLE"), 4096) if 32 < whole[place] < 127]
    for place in places[::60]:
        for part in file.parent.iterdir():
            part.unlink()
        data = bytearray(whole)
        data[place] ^= 0x80
        file.write_bytes(data)
        found, forgotten = asyncio.run(_known(file))
        assert forgotten is not None or found == truth, place


@pytest.mark.parametrize("name", ["t.sqlite", "t.sqlite-wal"])
def test_a_flipped_bit_is_harmless_or_told(stores: tuple[Path, Path], tmp_path: Path, name: str) -> None:
    source = stores[name.endswith("-wal")]
    shutil.copytree(source, tmp_path / "whole")
    truth, forgotten = asyncio.run(_known(tmp_path / "whole" / "t.sqlite"))
    assert forgotten is None
    assert truth[-3:] == ["camera: dji-x5s-15mm", "declined mission: m1", "x: None"]
    assert all(isinstance(noted, Noted) and noted.status == "answered" for noted in truth[:ROWS])
    rng = random.Random(name)
    whole = (source / name).read_bytes()
    outcomes: Counter[str] = Counter()
    for number in range(FLIPS // 2):
        folder = Path(shutil.copytree(source, tmp_path / str(number)))
        data = bytearray(whole)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        (folder / name).write_bytes(data)
        with capture_logs() as logs:
            found, forgotten = asyncio.run(_known(folder / "t.sqlite"))
        if forgotten is not None:
            outcomes["told"] += 1
            # what is kept is true, and what was damaged stays as it was
            lost = [one for one, true in zip(found, truth, strict=True) if one != true]
            for one in lost:
                assert one.endswith(": None") if isinstance(one, str) else one.status in {"new", "interrupted"}
            assert Path(forgotten).with_name(Path(forgotten).name + name.removeprefix("t.sqlite")).read_bytes() == data
        elif found != truth:
            outcomes["torn"] += 1
            assert any("the last transaction" in str(entry["event"]) for entry in logs)
            assert sum(one != other for one, other in zip(found, truth, strict=True)) == 1
        else:
            outcomes["same"] += 1
        shutil.rmtree(folder)
    print(name, dict(outcomes))
    assert outcomes["told"] > FLIPS // 8


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE transaction_rows SET response = 'x' WHERE number = 7",
        "UPDATE transaction_rows SET response = NULL WHERE number = 7",
        "UPDATE transaction_rows SET number = 99 WHERE number = 7",
        "DELETE FROM transaction_rows WHERE number = 7",
        "DELETE FROM transaction_rows WHERE number > 20",
        "UPDATE memory_rows SET value = 'y' WHERE key = 'camera'",
        "DELETE FROM memory_rows",
        "UPDATE total SET rows = rows + 1",
        "DELETE FROM total",
        "PRAGMA user_version = 0",
        "DROP VIEW memory",
    ],
)
async def test_what_was_changed_is_told_and_the_rest_is_kept(
    stores: tuple[Path, Path], tmp_path: Path, statement: str
) -> None:
    folder = Path(shutil.copytree(stores[0], tmp_path / "store"))
    with closing(sqlite3.connect(folder / "t.sqlite")) as connection:
        connection.executescript(statement)
    with capture_logs() as logs:
        found, forgotten = await _known(folder / "t.sqlite")
    assert forgotten == str(folder / "t-damaged-1.sqlite")
    assert [entry["log_level"] for entry in logs] == ["error"]
    assert "may act again" in logs[0]["event"]
    assert sum(isinstance(noted, Noted) and noted.status == "answered" for noted in found) >= 20
    # the new file is whole, and remembers that something was lost
    assert (await _known(folder / "t.sqlite"))[1] == forgotten


async def test_a_file_that_is_no_database_does_not_keep_the_daemon_from_starting(tmp_path: Path) -> None:
    (tmp_path / "t.sqlite").write_bytes(b"no database at all" * 100)
    for number in (1, 2):
        store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
        assert await store.recall(FORGOTTEN) == str(tmp_path / f"t-damaged-{number}.sqlite")
        assert (await store.note(_request(1))).status == "new"
        await store.close()
        (tmp_path / "t.sqlite").write_bytes(b"again")
    assert (tmp_path / "t-damaged-1.sqlite").read_bytes() == b"no database at all" * 100


async def test_a_file_that_another_daemon_has_is_not_set_aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    await store.note(_request(1))
    monkeypatch.setattr(transaction_file, "examine_log", lambda _: LogState(lost="a frame that is being written"))
    with pytest.raises(UsageError, match="in use by another panoexec"):
        await Transactions.open(tmp_path / "t.sqlite", boot_id="c")
    await store.answered(_request(1), "true")
    await store.close()


async def test_a_row_that_is_damaged_while_the_store_is_open_is_not_answered_from(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    await store.note(_request(1))
    await store.answered(_request(1), "true")
    store._database().execute("UPDATE transaction_rows SET response = 'false'")
    store._database().commit()
    with pytest.raises(RefusedRequestError) as refused:
        await store.note(_request(1))
    assert refused.value.code == "storage"
    await store.close()


async def test_a_file_without_seals_is_sealed_as_it_is(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "t.sqlite")) as old:
        old.executescript(
            "CREATE TABLE transactions (id TEXT PRIMARY KEY, command TEXT NOT NULL, digest TEXT NOT NULL,"
            " boot_id TEXT NOT NULL, response TEXT, number INTEGER NOT NULL) STRICT;"
            "CREATE TABLE memory (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;"
            "INSERT INTO transactions VALUES ('1', 'start', 'd', 'b', 'answer', 1), ('2', 'start', 'd', 'b', NULL, 2);"
            "INSERT INTO memory VALUES ('camera', 'x')"
        )
    for _ in range(2):
        with closing(open_transaction_file(tmp_path / "t.sqlite")) as found:
            rows = found.execute("SELECT * FROM transactions ORDER BY number").fetchall()
            assert rows == [("1", "start", "d", "b", "answer", 1), ("2", "start", "d", "b", None, 2)]
            assert found.execute("SELECT * FROM memory").fetchall() == [("camera", "x")]
            assert found.execute("SELECT rows FROM total").fetchone() == (3,)
