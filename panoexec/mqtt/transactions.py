"""At most once: the same transaction gets the same answer and acts once, across restarts too.

Everything that decides so is here. A request that repeats one under way gets the answer of that one (`enter`). A
request that only reads is answered from memory if it repeats a recent one. One that acts is kept in an SQLite file in
the storage: it is noted before it acts and its answer after, both durable. A request that was noted and never answered
belongs to a process that died in between: nobody knows whether it acted, so it does not act again. The file also keeps
the few things that the daemon must remember (`remember`, `recall`).

A full or read-only disk may recover: the store can be opened nevertheless, rejects requests with an effect until then,
and tries to open its file again at the next use.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import sqlite3
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, Self, TypeAlias, TypeVar

import structlog

from panoexec.errors import UsageError
from panoexec.mqtt.messages import Response, dump, failed
from panoexec.mqtt.requests import RefusedRequestError, Request
from panoexec.mqtt.retention import Retention
from panoexec.mqtt.transaction_file import StorageDownError, open_transaction_file

T = TypeVar("T")
TransactionStatus: TypeAlias = Literal["new", "under way", "interrupted", "answered"]

KEPT_IN_MEMORY: Final = 200
"""Answers to requests that only read."""

MAX_UNDER_WAY: Final = 64
"""Requests that may be worked on at the same time, and repeats of one that get its answer."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Noted:
    """What is known of a transaction.

    Attributes:
        status: whether it may act now (`new`), acts already, acted in a process that died, or was answered.
        response: the answer that was given, as JSON; "" without one.
    """

    status: TransactionStatus
    response: str = ""


@dataclass(frozen=True, slots=True)
class _UnderWay:
    """A request that is worked on, and everybody who gets its answer."""

    digest: str
    replies: list[Callable[[bytes], None]] = field(default_factory=list)


class Transactions:
    """The store; `open` it and close it. Work is done in a thread of its own.

    Args:
        path: the file; made if it does not exist.
        boot_id: of this process.
    """

    def __init__(self, path: Path, boot_id: str) -> None:
        self.path = path
        self._boot_id = boot_id
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="transactions")
        self._connection: sqlite3.Connection | None = None
        self._retention = Retention()
        self._under_way: dict[str, _UnderWay] = {}
        self._read: OrderedDict[str, tuple[str, bytes]] = OrderedDict()

    # --- life

    @classmethod
    async def open(cls, path: Path, *, boot_id: str, patient: bool = False) -> Self:
        """Open the store, or make it.

        Args:
            path: the file.
            boot_id: of this process.
            patient: also if the storage is full or read-only: `opened` tries again.

        Raises:
            UsageError: it cannot be made, is damaged, or is in use by another daemon.
        """
        store = cls(path, boot_id)
        try:
            await store.opened(patient=patient)
        except BaseException:
            store._pool.shutdown(wait=False)
            raise
        return store

    async def opened(self, *, patient: bool = True) -> str:
        """Open the file if that was not possible yet; why the storage cannot be used, "" if it is open.

        Args:
            patient: return the reason instead of raising if the storage is full or read-only.

        Raises:
            UsageError: it cannot be made, is damaged, or is in use by another daemon.
        """
        if self._connection is not None:
            return ""
        try:
            await asyncio.get_running_loop().run_in_executor(self._pool, self._database)
        except StorageDownError as error:
            if not patient:
                raise
            return str(error)
        return ""

    async def close(self) -> None:
        """Let the file go."""
        if self._connection is not None:
            await asyncio.get_running_loop().run_in_executor(self._pool, self._connection.close)
        self._pool.shutdown(wait=False)

    def _database(self) -> sqlite3.Connection:
        if self._connection is None:
            connection = open_transaction_file(self.path)
            self._retention.load(connection)
            self._connection = connection
        return self._connection

    # --- at most once

    def enter(self, request: Request, reply: Callable[[bytes], None]) -> bool:
        """Take a request; `reply` gets its answer.

        Returns:
            Whether the caller must `serve` it: False for a repeat of one that is under way, which gets its answer, or
            none if it was repeated too often.

        Raises:
            RefusedRequestError: another request under way has this transaction, or too many are under way.
        """
        key, digest = _key(request), _digest(request)
        same = self._under_way.get(key)
        if same is not None and same.digest != digest:
            raise RefusedRequestError(
                "conflict",
                "another request has this transaction",
                field="transaction",
                transaction=request.transaction,
            )
        if same is not None:
            if len(same.replies) < MAX_UNDER_WAY:
                same.replies.append(reply)
            return False
        if len(self._under_way) >= MAX_UNDER_WAY:
            raise RefusedRequestError(
                "overload", f"{MAX_UNDER_WAY} requests are under way: ask again later", transaction=request.transaction
            )
        self._under_way[key] = _UnderWay(digest, [reply])
        return True

    async def serve(self, request: Request, obey: Callable[[], Awaitable[Response]]) -> None:
        """Send the answer to all who `enter`ed this request: the one that was given before, else that of `obey`."""
        try:
            payload = await self._answer(request, obey)
        finally:
            replies = self._under_way.pop(_key(request)).replies
        for reply in replies:
            reply(payload)

    async def _answer(self, request: Request, obey: Callable[[], Awaitable[Response]]) -> bytes:
        if not request.acts:
            return await self._answer_reading(request, obey)
        try:
            noted = await self.note(request)
            if noted.status == "answered":
                return noted.response.encode()
            _check_new(noted)
        except RefusedRequestError as error:
            _log.warning("request refused", command=request.command, code=error.code, error=error.message[:300])
            return dump(failed(error, request.transaction))
        payload = dump(await obey())
        try:
            await self.answered(request, payload.decode())
        except RefusedRequestError as error:
            _log.error("the answer could not be stored", error=error.message)
        return payload

    async def _answer_reading(self, request: Request, obey: Callable[[], Awaitable[Response]]) -> bytes:
        key, digest = _key(request), _digest(request)
        known = self._read.get(key)
        if known is not None and known[0] == digest:
            return known[1]
        payload = dump(await obey())
        self._read[key] = digest, payload
        while len(self._read) > KEPT_IN_MEMORY:
            self._read.popitem(last=False)
        return payload

    # --- what is kept on disk

    async def note(self, request: Request) -> Noted:
        """Note that a request is going to act, durably, unless it is known.

        Raises:
            RefusedRequestError: another request had the same transaction; or it cannot be written.
        """
        key, digest = _key(request), _fields_digest(request)
        return await self._run(lambda: self._note(key, request.command, digest))

    async def answered(self, request: Request, response: str) -> None:
        """Keep the answer, durably.

        Raises:
            RefusedRequestError: it cannot be written.
        """
        key = _key(request)

        def write() -> None:
            with self._database() as database:
                database.execute("UPDATE transactions SET response = ? WHERE id = ?", (response, key))
                for forgotten in self._retention.answered(key, request.command, response):
                    database.execute("DELETE FROM transactions WHERE id = ?", (forgotten,))

        await self._run(write)

    async def remember(self, key: str, value: str | None) -> None:
        """Keep something under a name, durably; None forgets it.

        Raises:
            RefusedRequestError: it cannot be written.
        """

        def write() -> None:
            with self._database() as database:
                if value is None:
                    database.execute("DELETE FROM memory WHERE key = ?", (key,))
                else:
                    database.execute("INSERT OR REPLACE INTO memory VALUES (?, ?)", (key, value))

        await self._run(write)

    async def recall(self, key: str) -> str | None:
        """What was kept under that name."""

        def read() -> str | None:
            row = self._database().execute("SELECT value FROM memory WHERE key = ?", (key,)).fetchone()
            return None if row is None else str(row[0])

        return await self._run(read)

    def _note(self, key: str, command: str, digest: str) -> Noted:
        with self._database() as database:
            row = database.execute(
                "SELECT command, digest, boot_id, response FROM transactions WHERE id = ?", (key,)
            ).fetchone()
            if row is None:
                database.execute(
                    "INSERT INTO transactions SELECT ?, ?, ?, ?, NULL, COALESCE(MAX(number), 0) + 1 FROM transactions",
                    (key, command, digest, self._boot_id),
                )
                return Noted(status="new")
        if (row[0], row[1]) != (command, digest):
            raise RefusedRequestError(
                "conflict",
                f"the transaction was used already for another request ({row[0]}): give each request its own",
                field="transaction",
            )
        if row[3] is not None:
            return Noted(status="answered", response=str(row[3]))
        return Noted(status="under way" if row[2] == self._boot_id else "interrupted")

    async def _run(self, work: Callable[[], T]) -> T:
        try:
            return await asyncio.get_running_loop().run_in_executor(self._pool, work)
        except sqlite3.Error as error:
            raise RefusedRequestError(
                "storage", f"{self.path}: cannot be written ({error}); nothing was done"
            ) from error
        except UsageError as error:
            raise RefusedRequestError("storage", f"{error}; nothing was done") from error


def _check_new(noted: Noted) -> None:
    if noted.status != "new":
        raise RefusedRequestError(
            "interrupted",
            "the daemon ended while it obeyed this request: the state tells whether it did; it does not act again",
        )


def _key(request: Request) -> str:
    return json.dumps(request.transaction)


def _digest(request: Request) -> str:
    return f"{request.command} {_fields_digest(request)}"


def _fields_digest(request: Request) -> str:
    fields = json.dumps(request.model_dump(mode="python"), sort_keys=True)
    return hashlib.sha256(fields.encode()).hexdigest()
