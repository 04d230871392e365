"""Transactions act once, across restarts too."""

from __future__ import annotations

import asyncio
import errno
import json
import sqlite3
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.errors import UsageError
from panoexec.mqtt import transaction_file
from panoexec.mqtt.messages import Response, ok
from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.requests import RefusedRequestError, Request
from panoexec.mqtt.transaction_file import StorageDownError
from panoexec.mqtt.transactions import STOP_WRITE_S, Transactions


def a_request(transaction: object = '"a"', command: str = "pause", more: str = "") -> Request:
    return parse_request(command, f'{{"transaction": {transaction}{more}}}'.encode())


async def test_acts_once_across_restarts(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="first")
    assert (await store.note(a_request())).status == "new"
    assert (await store.note(a_request())).status == "under way"
    await store.answered(a_request(), '{"status": "ok"}')
    assert (await store.note(a_request('"b"'))).status == "new"
    await store.close()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="second")
    noted = await store.note(a_request())
    assert (noted.status, noted.response) == ("answered", '{"status": "ok"}')
    assert (await store.note(a_request('"b"'))).status == "interrupted", "nobody knows whether it acted"
    assert (await store.note(a_request("1"))).status == "new"
    assert (await store.note(a_request('"1"'))).status == "new", "the text 1 is not the number 1"
    await store.close()


async def test_one_transaction_is_one_request(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    await store.note(a_request())
    for other in (a_request(command="abort"), a_request(more=', "reason": "x"')):
        with pytest.raises(RefusedRequestError, match="used already") as caught:
            await store.note(other)
        assert (caught.value.code, caught.value.field) == ("conflict", "transaction")
    await store.close()


async def test_a_repeat_gets_the_answer_of_the_one_under_way_and_acts_once(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    answers: list[bytes] = []
    acted: list[str] = []

    async def obey() -> Response:
        acted.append("once")
        return ok("a", {"shot": 7})

    assert store.enter(a_request(), answers.append)
    assert not store.enter(a_request(), answers.append)
    with pytest.raises(RefusedRequestError) as caught:
        store.enter(a_request(command="abort"), answers.append)
    assert (caught.value.code, caught.value.field, caught.value.transaction) == ("conflict", "transaction", "a")
    await store.serve(a_request(), obey)
    assert store.enter(a_request(), answers.append), "it is not under way any more"
    await store.serve(a_request(), obey)
    assert [json.loads(answer)["data"] for answer in answers] == 3 * [{"shot": 7}]
    assert acted == ["once"]
    await store.close()


async def test_a_request_that_only_reads_is_not_kept_on_disk(tmp_path: Path) -> None:
    answers: list[bytes] = []

    async def obey() -> Response:
        return ok("a", {"boot": boot})

    for boot in ("first", "second"):
        store = await Transactions.open(tmp_path / "t.sqlite", boot_id=boot)
        for _ in range(2):
            assert store.enter(a_request(command="get"), answers.append)
            await store.serve(a_request(command="get"), obey)
        await store.close()
    assert [json.loads(answer)["data"]["boot"] for answer in answers] == ["first", "first", "second", "second"]


OK, NO = '{"status": "ok"}', '{"status": "error"}'


async def test_forgets_the_oldest_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoexec.mqtt.retention.KEPT", 3)
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    for number in range(5):
        await store.note(a_request(number))
        await store.answered(a_request(number), OK)
    statuses = [(await store.note(a_request(number))).status for number in range(5)]
    assert statuses == ["new", "new", "answered", "answered", "answered"]
    await store.close()


CHEAP = ["pause", "resume", "finish", "skip", "repeat", "abort"]


@settings(max_examples=10)
@given(st.lists(st.tuples(st.sampled_from(CHEAP), st.sampled_from([OK, NO])), max_size=40), st.integers(0, 40))
async def test_no_number_of_other_requests_lets_an_old_start_act_again(
    others: list[tuple[str, str]], restart_after: int
) -> None:
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr("panoexec.mqtt.retention.KEPT", 3)
        store = await Transactions.open(Path(folder) / "t.sqlite", boot_id="b")
        start, interrupted = a_request('"s"', "start"), a_request('"i"', "start")
        assert (await store.note(start)).status == "new"
        await store.answered(start, OK)
        refused = a_request('"r"', "start")
        assert (await store.note(refused)).status == "new"
        await store.answered(refused, NO)
        assert (await store.note(interrupted)).status == "new"
        for number, (command, response) in enumerate(others):
            if number == restart_after:
                await store.close()
                store = await Transactions.open(Path(folder) / "t.sqlite", boot_id="c")
            one = a_request(number, command)
            await store.note(one)
            await store.answered(one, response)
        assert (await store.note(start)).status == "answered"
        assert (await store.note(refused)).status == "answered"
        assert (await store.note(interrupted)).status in ("under way", "interrupted")
        kept = store._connection.execute("SELECT COUNT(*) FROM transactions").fetchone()[0] if store._connection else 0
        assert kept <= 3 + 3 * 2 * len(CHEAP), "and the store is bounded"
        await store.close()


async def test_a_flood_of_get_requests_reaches_no_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoexec.mqtt.retention.KEPT", 3)
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")

    async def obey() -> Response:
        return ok("a", {})

    start = a_request('"s"', "start")
    await store.note(start)
    await store.answered(start, OK)
    for number in range(300):
        request = a_request(number, "get")
        store.enter(request, lambda _: None)
        await store.serve(request, obey)
    assert (await store.note(start)).status == "answered"
    await store.close()


async def test_remembers(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    assert await store.recall("camera") is None
    await store.remember("camera", "x")
    await store.close()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="c")
    assert await store.recall("camera") == "x"
    await store.remember("camera", None)
    assert await store.recall("camera") is None
    await store.close()


async def test_a_value_that_waits_for_the_disk_outlives_one_that_the_disk_refuses(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    await store.remember("declined", "m1")
    store._database().execute("PRAGMA query_only = ON")
    store.remember_later("declined", "m2")
    with pytest.raises(RefusedRequestError, match="nothing was done"):
        await store.remember("declined", None)
    assert await store.recall("declined") == "m2"
    store._database().execute("PRAGMA query_only = OFF")
    assert await store.write_back()
    await store.close()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="c")
    assert await store.recall("declined") == "m2"
    await store.close()


async def test_two_daemons_cannot_share_a_storage(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    with pytest.raises(UsageError, match="in use by another panoexec"):
        await Transactions.open(tmp_path / "t.sqlite", boot_id="c")
    await store.close()


async def test_says_what_is_wrong_with_the_storage(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"cannot be used"):
        await Transactions.open(tmp_path / "file" / "t.sqlite", boot_id="b")


async def test_a_disk_that_is_full_may_be_well_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: sqlite3.Connection) -> sqlite3.Connection:
        error = sqlite3.OperationalError("database or disk is full")
        error.sqlite_errorcode = sqlite3.SQLITE_FULL
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(transaction_file, "_prepared", full)
        with pytest.raises(StorageDownError, match=r"cannot be written \(database or disk is full\); free space"):
            await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
        store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b", patient=True)
        assert "free space" in await store.opened()
        with pytest.raises(RefusedRequestError, match="nothing was done") as refused:
            await store.note(a_request())
        assert refused.value.code == "storage"
    assert (await store.note(a_request())).status == "new"
    assert await store.opened() == ""
    await store.close()


async def test_a_storage_that_never_was_well_can_be_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "mkdir", read_only)
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b", patient=True)
    assert "Read-only file system" in await store.opened()
    await store.close()


async def a_stop(store: Transactions, transaction: str = '"s"', more: str = "") -> list[dict[str, Any]]:
    """The answers to a stop that says which shot it was at."""
    request, answers = a_request(transaction, "abort", more), []

    async def executed() -> Response:
        acted.append(transaction)
        return ok(request.transaction, {"shot": len(acted)})

    if store.enter_stop(request, lambda payload: answers.append(json.loads(payload))):
        await store.serve_stop(request, executed(), received_s=time.monotonic())
    return answers


acted: list[str] = []


async def test_a_stop_acts_once_across_restarts_and_is_looked_up_without_the_disk(tmp_path: Path) -> None:
    acted.clear()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="first")
    first = await a_stop(store)
    assert [answer["data"] for answer in first] == [{"shot": 1}]
    assert await a_stop(store) == first
    await store.close()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="second")
    assert await a_stop(store) == first, "across restarts"
    assert acted == ['"s"']
    with pytest.raises(RefusedRequestError, match="used already"):
        await a_stop(store, more=', "reason": "x"')
    await store.note(a_request('"p"', "skip"))
    with pytest.raises(RefusedRequestError, match=r"used already for another request \(skip\)"):
        await a_stop(store, '"p"')
    await store.close()


async def test_a_stop_that_cannot_be_written_acts_once_and_is_written_when_the_disk_is_well(tmp_path: Path) -> None:
    acted.clear()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="first")
    store._database().execute("PRAGMA query_only = ON")
    first = await a_stop(store)
    assert [answer["status"] for answer in first] == ["ok"]
    assert await a_stop(store) == first
    assert acted == ['"s"']
    store.remember_later("declined", "m1")
    assert await store.recall("declined") == "m1"
    assert not await store.write_back()
    with pytest.raises(RefusedRequestError, match="used already") as refused:
        await store.note(a_request('"s"', "skip"))
    assert refused.value.code == "conflict"
    store._database().execute("PRAGMA query_only = OFF")
    assert await store.write_back()
    await store.close()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="second")
    assert await a_stop(store) == first
    assert await store.recall("declined") == "m1"
    assert acted == ['"s"']
    await store.close()


async def test_a_stop_does_not_wait_for_a_disk_that_hangs(tmp_path: Path) -> None:
    acted.clear()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="first")
    hangs = threading.Event()
    store._pool.submit(hangs.wait)
    assert STOP_WRITE_S < 1.0
    async with asyncio.timeout(60):  # the disk hangs for ever
        assert [answer["status"] for answer in await a_stop(store)] == ["ok"]
    hangs.set()
    assert await store.write_back()
    assert (await store.note(a_request('"s"', "abort"))).status == "answered"
    await store.close()


async def test_an_answer_that_could_not_be_stored_is_given_again_and_stored_later(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="first")
    answers: list[bytes] = []

    async def obey() -> Response:
        store._database().execute("PRAGMA query_only = ON")
        return ok("a", {"shot": 7})

    for _ in range(2):
        assert store.enter(a_request(command="skip"), answers.append)
        await store.serve(a_request(command="skip"), obey)
    assert answers[0] == answers[1]
    assert json.loads(answers[0])["data"] == {"shot": 7}
    store._database().execute("PRAGMA query_only = OFF")
    assert await store.write_back()
    await store.close()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="second")
    assert (await store.note(a_request(command="skip"))).response.encode() == answers[0]
    await store.close()


async def test_the_log_beside_the_file_stays_small(tmp_path: Path) -> None:
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="first")
    for number in range(100):
        await a_stop(store, f'"s{number}"')
    assert (tmp_path / "t.sqlite-wal").stat().st_size < 600_000
    await store.close()


async def test_a_stop_is_forgotten_when_the_disk_forgets_it_and_not_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.mqtt.retention.KEPT", 2)
    acted.clear()
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="first")

    def known() -> list[str]:
        return [one for one in ("a", "b", "c", "d", "e") if store._memory.find(a_request(f'"{one}"', "abort"))]

    for transaction in ('"a"', '"b"'):
        await a_stop(store, transaction)
    assert known() == ["a", "b"]
    store._database().execute("PRAGMA query_only = ON")
    for transaction in ('"c"', '"d"'):
        await a_stop(store, transaction)
    assert known() == ["a", "b", "c", "d"], "the disk has forgotten none"
    for transaction in ('"a"', '"b"', '"c"', '"d"'):
        await a_stop(store, transaction)
    assert acted == ['"a"', '"b"', '"c"', '"d"'], "none acts twice"

    store._database().execute("PRAGMA query_only = OFF")
    assert await store.write_back()
    assert known() == ["c", "d"]
    on_disk = store._database().execute("SELECT id FROM transactions ORDER BY number").fetchall()
    assert on_disk == [('"c"',), ('"d"',)]
    await a_stop(store, '"e"')
    assert known() == ["d", "e"], "what the disk refused counts once"
    await store.close()


async def test_what_the_disk_forgot_before_it_failed_is_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.mqtt.retention.KEPT", 1)
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="first")
    await a_stop(store, '"a"')
    store._database().execute("PRAGMA query_only = ON")
    for transaction in ('"b"', '"c"'):
        await a_stop(store, transaction)
    store._database().execute("PRAGMA query_only = OFF")
    real = store._store_response

    def fails_at_c(key: str, command: str, response: str) -> list[str]:
        if key == '"c"':
            raise sqlite3.OperationalError("disk full")
        return real(key, command, response)

    monkeypatch.setattr(store, "_store_response", fails_at_c)
    assert not await store.write_back()
    assert store._memory.find(a_request('"a"', "abort")) is None
    assert store._memory.find(a_request('"b"', "abort")) is not None
    monkeypatch.undo()
    await store.close()
