"""Transactions: the same request twice gets the same response and is executed once, across restarts too.

A request that repeats one in progress gets its response (`enter`). A request that only reads is answered from memory if
it repeats a recent one. One that acts is kept in an SQLite file in the storage: the request is stored before it is
executed and its response afterwards, both durably. A request that was stored and never answered belongs to a process
that died in between; whether it was executed is unknown, so it is not executed again.

A stopping request does not wait for the disk (`enter_stop`): it is looked up in memory, where all stored transactions
are known, and stored after it was executed. What cannot be stored is kept in memory and stored when the disk recovers
(`write_back`).

The file also keeps the few values that the daemon must remember (`remember`, `recall`). A full or read-only disk may
recover: the store can be opened nevertheless, rejects requests with an effect until then, and tries to open its file
again at the next use.
"""

from __future__ import annotations

import asyncio
import contextlib
import sqlite3
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self, TypeVar

import structlog

from panoexec.errors import UsageError
from panoexec.mqtt.messages import Response, dump, failed
from panoexec.mqtt.requests import RefusedRequestError, Request
from panoexec.mqtt.retention import Retention
from panoexec.mqtt.transaction_file import StorageDownError, open_transaction_file
from panoexec.mqtt.transaction_memory import (
    Known,
    TransactionMemory,
    fields_digest,
    interrupted,
    key_of,
)
from panoexec.mqtt.transaction_rows import Noted, note, recalled, store_response, store_value, stored

T = TypeVar("T")

KEPT_IN_MEMORY: Final = 200
"""Responses to requests that only read."""

MAX_UNDER_WAY: Final = 64
"""Requests that may be in progress at the same time, and repeats of one that get its response."""

STOP_WRITE_S: Final = 0.5
"""How long after its arrival a stopping request is answered at the latest, whether its response is on disk or not."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class _UnderWay:
    """A request in progress, and all receivers of its response."""

    digest: str
    replies: list[Callable[[bytes], None]] = field(default_factory=list)
    stops: bool = False


class Transactions:
    """The store; must be opened (`open`) and closed. File access runs in a thread of its own.

    Args:
        path: the file; created if it does not exist.
        boot_id: id of this process.
    """

    def __init__(self, path: Path, boot_id: str) -> None:
        self.path = path
        self._boot_id = boot_id
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="transactions")
        self._connection: sqlite3.Connection | None = None
        self._retention = Retention()
        self._under_way: dict[str, _UnderWay] = {}
        self._read: OrderedDict[str, tuple[str, bytes]] = OrderedDict()
        self._memory = TransactionMemory()
        self._writing = asyncio.Lock()

    # --- opening and closing

    @classmethod
    async def open(cls, path: Path, *, boot_id: str, patient: bool = False) -> Self:
        """Open the store, or create it.

        Args:
            path: the file.
            boot_id: id of this process.
            patient: also if the storage is full or read-only: `opened` tries again.

        Raises:
            UsageError: it cannot be created, is damaged, or is in use by another daemon.
        """
        store = cls(path, boot_id)
        try:
            await store.opened(patient=patient)
        except BaseException:
            store._pool.shutdown(wait=False)
            raise
        return store

    async def opened(self, *, patient: bool = True) -> str:
        """Open the file if it is not open yet; returns why the storage cannot be used, "" if the file is open.

        Args:
            patient: return the reason instead of raising if the storage is full or read-only.

        Raises:
            UsageError: it cannot be created, is damaged, or is in use by another daemon.
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
        """Close the file."""
        if self._connection is not None:
            await asyncio.get_running_loop().run_in_executor(self._pool, self._connection.close)
        self._pool.shutdown(wait=False)

    def _database(self) -> sqlite3.Connection:
        if self._connection is None:
            connection = open_transaction_file(self.path)
            self._retention.load(connection)
            self._memory.add_stored(stored(connection))
            self._connection = connection
        return self._connection

    # --- executed at most once

    def enter(self, request: Request, reply: Callable[[bytes], None]) -> bool:
        """Accept a request; `reply` is called with its response.

        Returns:
            Whether the caller must `serve` it: False for a repeat of one in progress, which gets the same response, or
            none if it was repeated too often.

        Raises:
            RefusedRequestError: another request in progress has this transaction, or too many are in progress.
        """
        if self._joins(request, reply):
            return False
        if sum(not one.stops for one in self._under_way.values()) >= MAX_UNDER_WAY:
            raise RefusedRequestError(
                "overload", f"{MAX_UNDER_WAY} requests are under way: ask again later", transaction=request.transaction
            )
        self._under_way[key_of(request)] = _UnderWay(_digest(request), [reply])
        return True

    def enter_stop(self, request: Request, reply: Callable[[bytes], None]) -> bool:
        """Accept a stopping request, however many are in progress; `reply` is called with its response.

        Returns:
            Whether the caller must execute it now and `serve_stop` it: False for a repeat of one that was executed, or
            is in progress.

        Raises:
            RefusedRequestError: another request has this transaction, or it was in progress when a process died.
        """
        if self._joins(request, reply):
            return False
        known = self._memory.find(request)
        if known is not None:
            if known.response is None:
                raise interrupted(request)
            reply(known.response)
            return False
        self._under_way[key_of(request)] = _UnderWay(_digest(request), [reply], stops=True)
        return True

    def _joins(self, request: Request, reply: Callable[[bytes], None]) -> bool:
        """Whether the request repeats one in progress, whose response it gets."""
        same = self._under_way.get(key_of(request))
        if same is None:
            return False
        if same.digest != _digest(request):
            raise RefusedRequestError(
                "conflict",
                "another request has this transaction",
                field="transaction",
                transaction=request.transaction,
            )
        if len(same.replies) < MAX_UNDER_WAY:
            same.replies.append(reply)
        return True

    async def serve_stop(self, request: Request, executed: Awaitable[Response], *, received_s: float) -> None:
        """Send the response to all who entered this stopping request, when it is stored or `STOP_WRITE_S` have passed.

        Args:
            request: the request, which was executed.
            executed: returns its response.
            received_s: time.monotonic of its arrival, the event loop's clock.
        """
        key = key_of(request)
        try:
            payload = dump(await executed)
            self._memory.answered(request, payload)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(received_s + STOP_WRITE_S):
                    await self.write_back()
        finally:
            replies = self._under_way.pop(key).replies
        for reply in replies:
            reply(payload)

    async def serve(self, request: Request, obey: Callable[[], Awaitable[Response]]) -> None:
        """Send the response to all who `enter`ed this request: the stored one, else that of `obey`."""
        try:
            payload = await self._answer(request, obey)
        finally:
            replies = self._under_way.pop(key_of(request)).replies
        for reply in replies:
            reply(payload)

    async def _answer(self, request: Request, obey: Callable[[], Awaitable[Response]]) -> bytes:
        if not request.acts:
            return await self._answer_reading(request, obey)
        try:
            noted = await self.note(request)
            if noted.status == "answered":
                return noted.response.encode()
            if noted.status != "new":
                raise interrupted(request)
        except RefusedRequestError as error:
            _log.warning("request refused", command=request.command, code=error.code, error=error.message[:300])
            return dump(failed(error, request.transaction))
        payload = dump(await obey())
        try:
            await self.answered(request, payload.decode())
        except RefusedRequestError as error:
            _log.error("the response could not be stored", error=error.message)
            self._memory.answered(request, payload)
        return payload

    async def _answer_reading(self, request: Request, obey: Callable[[], Awaitable[Response]]) -> bytes:
        key, digest = key_of(request), _digest(request)
        known = self._read.get(key)
        if known is not None and known[0] == digest:
            return known[1]
        payload = dump(await obey())
        self._read[key] = digest, payload
        while len(self._read) > KEPT_IN_MEMORY:
            self._read.popitem(last=False)
        return payload

    # --- on disk

    async def note(self, request: Request) -> Noted:
        """Store that a request is going to be executed, durably, unless it is known.

        Raises:
            RefusedRequestError: another request had the same transaction; or it cannot be written.
        """
        unwritten = self._memory.find_unwritten(request)
        if unwritten is not None:
            return Noted(status="answered", response=unwritten.decode())
        key, digest = key_of(request), fields_digest(request)
        noted = await self._run(lambda: self._note(key, request.command, digest))
        if noted.status == "new":
            self._memory.add(request)
        return noted

    async def answered(self, request: Request, response: str) -> None:
        """Store the response, durably.

        Raises:
            RefusedRequestError: it cannot be written.
        """
        key = key_of(request)
        self._memory.forget(await self._run(lambda: self._store_response(key, request.command, response)))

    async def remember(self, key: str, value: str | None) -> None:
        """Store a value under a name, durably; None deletes it.

        Raises:
            RefusedRequestError: it cannot be written.
        """
        kept = {name: self._memory.values.pop(name) for name in (key,) if name in self._memory.values}
        try:
            await self._run(lambda: store_value(self._database(), key, value))
        except RefusedRequestError:
            self._memory.values = kept | self._memory.values
            raise

    def remember_later(self, key: str, value: str | None) -> None:
        """Keep a value under a name in memory until the next `write_back` stores it."""
        self._memory.values[key] = value

    async def recall(self, key: str) -> str | None:
        """The value that was kept under that name, None without one."""
        if key in self._memory.values:
            return self._memory.values[key]
        return await self._run(lambda: recalled(self._database(), key))

    async def write_back(self) -> bool:
        """Store what could not be stored before; returns whether nothing is left, and never raises for the disk."""
        async with self._writing:
            rows, values = dict(self._memory.rows), dict(self._memory.values)
            if not rows and not values:
                return True
            forgotten: list[str] = []
            try:
                await self._run(lambda: self._store_all(rows, values, forgotten))
            except RefusedRequestError as error:
                _log.error("responses could not be stored, kept in memory", count=len(rows), error=error.message)
                return False
            finally:
                self._memory.forget(forgotten)
            self._memory.written(rows, values)
            return True

    def _store_all(self, rows: Mapping[str, Known], values: Mapping[str, str | None], forgotten: list[str]) -> None:
        """Adds the transactions that the disk forgets to `forgotten`, also if it refuses a later one."""
        for name, value in values.items():
            store_value(self._database(), name, value)
        for key, known in rows.items():
            assert known.response is not None
            # one stored meanwhile for a different request keeps the transaction
            with contextlib.suppress(RefusedRequestError):
                if self._note(key, known.command, known.digest).status != "answered":
                    forgotten += self._store_response(key, known.command, known.response.decode())

    def _store_response(self, key: str, command: str, response: str) -> list[str]:
        """Returns the transactions that are forgotten."""
        forgotten = self._retention.due(command, response)
        store_response(self._database(), key, response, forgotten)
        self._retention.answered(key, command, response)
        return forgotten

    def _note(self, key: str, command: str, digest: str) -> Noted:
        return note(self._database(), key, command, digest, boot_id=self._boot_id)

    async def _run(self, work: Callable[[], T]) -> T:
        try:
            return await asyncio.get_running_loop().run_in_executor(self._pool, work)
        except sqlite3.Error as error:
            raise RefusedRequestError(
                "storage", f"{self.path}: cannot be written ({error}); nothing was done"
            ) from error
        except UsageError as error:
            raise RefusedRequestError("storage", f"{error}; nothing was done") from error


def _digest(request: Request) -> str:
    return f"{request.command} {fields_digest(request)}"
