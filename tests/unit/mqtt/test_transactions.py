"""Transactions act once, across restarts too."""

from __future__ import annotations

import errno
import json
import sqlite3
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from panoexec.errors import UsageError
from panoexec.mqtt import transaction_file
from panoexec.mqtt.messages import Response, ok
from panoexec.mqtt.outbox import Outbox, Outgoing, Suspicion
from panoexec.mqtt.requests import RefusedRequestError, Request, parse_request
from panoexec.mqtt.transaction_file import StorageDownError
from panoexec.mqtt.transactions import Transactions


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


async def test_forgets_the_oldest_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoexec.mqtt.transactions.KEPT", 3)
    store = await Transactions.open(tmp_path / "t.sqlite", boot_id="b")
    for number in range(5):
        await store.note(a_request(number))
        await store.answered(a_request(number), str(number))
    statuses = [(await store.note(a_request(number))).status for number in range(5)]
    assert statuses == ["new", "new", "answered", "answered", "answered"]
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
        await store.serve_stop(request, executed())
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
    began = time.monotonic()
    assert [answer["status"] for answer in await a_stop(store)] == ["ok"]
    assert time.monotonic() - began < 1.0
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


def message(topic: str, payload: bytes = b"x", *, retain: bool = False) -> Outgoing:
    return Outgoing(topic=topic, payload=payload, retain=retain)


async def test_the_outbox_keeps_order_and_only_the_newest_retained() -> None:
    box = Outbox()
    first, second = message("event", b"1"), message("event", b"2")
    box.put(first)
    box.put(message("state", b"old", retain=True))
    box.put(message("state", b"new", retain=True))
    box.put(second)
    batch = box.take(10)
    assert [one.payload for one in batch] == [b"new", b"1", b"2"]
    for one in batch:
        box.done(one)
    assert len(box) == 0
    assert not box.filled.is_set()
    box.renew()
    assert [one.payload for one in box.take(10)] == [b"new"], "a new connection gets the state again"


async def test_a_state_that_changed_while_the_old_one_was_sent_goes_out_too() -> None:
    box = Outbox()
    box.put(message("state", b"old", retain=True))
    sent = box.take(1)[0]
    box.put(message("state", b"new", retain=True))
    box.done(sent)
    assert [one.payload for one in box.take(1)] == [b"new"]


async def test_the_outbox_is_bounded_by_number_and_bytes() -> None:
    box = Outbox(limit=3, limit_bytes=10)
    for number in range(5):
        box.put(message("event", str(number).encode()))
    assert [one.payload for one in box.take(10)] == [b"2", b"3", b"4"]
    box.put(message("event", b"12345678"))
    assert [one.payload for one in box.take(10)] == [b"3", b"4", b"12345678"]
    assert box.dropped == 3


def test_the_message_at_which_the_connection_ends_again_and_again_is_found() -> None:
    good, bad = message("event", b"good"), message("event", b"bad")
    suspicion = Suspicion()
    assert not suspicion.ended(good, alone=False)
    assert suspicion.wary, "one by one from now on"
    assert not suspicion.ended(good, alone=True)
    suspicion.acknowledged([good], left=1)
    assert [suspicion.ended(bad, alone=True) for _ in range(3)] == [False, False, True]
    suspicion.acknowledged([good], left=0)
    assert not suspicion.wary


def test_links_that_are_lost_now_and_then_condemn_nothing() -> None:
    suspicion, event = Suspicion(), message("event")
    for _ in range(10):
        assert not suspicion.ended(event, alone=True)
        assert not suspicion.ended(event, alone=True)
        suspicion.acknowledged([event], left=0)


async def test_what_is_given_up_goes_out_no_more() -> None:
    box = Outbox()
    event, state = message("event"), message("state", retain=True)
    box.put(event)
    box.put(state)
    box.give_up(event)
    assert box.take(9) == [state]
    box.give_up(state)
    box.renew()
    assert box.take(9) == []
    assert not box.filled.is_set()
    assert box.dropped == 2
