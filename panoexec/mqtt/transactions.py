"""Executed requests and their responses, so that each request is executed at most once, also across restarts.

One SQLite file in the storage: a request is recorded before its execution and its response afterwards, both durably. A
recorded request without a response belongs to a process that ended in between. It is unknown whether it was executed,
so it is not executed again. The file also stores a few values for the daemon (`remember`, `recall`).

A full or read-only disk may recover: the store can be opened nevertheless, rejects requests with an effect until then,
and tries to open its file again at the next use.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import json
import os
import sqlite3
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, Self, TypeAlias, TypeVar

from panoexec.errors import UsageError
from panoexec.mqtt.requests import RefusedRequestError, Request

T = TypeVar("T")
ShotMark: TypeAlias = Literal["new", "under way", "interrupted", "answered"]

KEPT: Final = 10_000
"""Answers that are kept; older ones are forgotten."""

_MAY_HEAL: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})
_PRIMARY: Final = 0xFF
"""SQLite's error codes say in their low byte what happened, and above it where."""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS transactions (
    id TEXT PRIMARY KEY, command TEXT NOT NULL, digest TEXT NOT NULL, boot_id TEXT NOT NULL, response TEXT,
    number INTEGER NOT NULL
) STRICT;
CREATE TABLE IF NOT EXISTS memory (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
"""


class StorageDownError(UsageError):
    """The storage is full, read-only or broken: nothing is wrong with the configuration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noted:
    """What is known of a transaction.

    Attributes:
        standing: whether it may act now (`new`), acts already, acted in a process that died, or was answered.
        response: the answer that was given, as JSON; "" without one.
    """

    standing: ShotMark
    response: str = ""


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
            self._connection = _open(self.path)
        return self._connection

    async def note(self, request: Request) -> Noted:
        """Note that a request is going to act, durably, unless it is known.

        Raises:
            RefusedRequestError: another request had the same transaction; or it cannot be written.
        """
        key, digest = _key(request), _digest(request)
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
                database.execute(
                    "DELETE FROM transactions WHERE number <= (SELECT MAX(number) FROM transactions) - ?", (KEPT,)
                )

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
                return Noted(standing="new")
        if (row[0], row[1]) != (command, digest):
            raise RefusedRequestError(
                "conflict",
                f"the transaction was used already for another request ({row[0]}): give each request its own",
                field="transaction",
            )
        if row[3] is not None:
            return Noted(standing="answered", response=str(row[3]))
        return Noted(standing="under way" if row[2] == self._boot_id else "interrupted")

    async def _run(self, work: Callable[[], T]) -> T:
        try:
            return await asyncio.get_running_loop().run_in_executor(self._pool, work)
        except sqlite3.Error as error:
            raise RefusedRequestError(
                "storage", f"{self.path}: cannot be written ({error}); nothing was done"
            ) from error
        except UsageError as error:
            raise RefusedRequestError("storage", f"{error}; nothing was done") from error


def _key(request: Request) -> str:
    return json.dumps(request.transaction)


def _digest(request: Request) -> str:
    fields = json.dumps(request.model_dump(mode="python"), sort_keys=True)
    return hashlib.sha256(fields.encode()).hexdigest()


def _open(path: Path) -> sqlite3.Connection:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return _prepared(sqlite3.connect(path, timeout=1.0, check_same_thread=False))
    except OSError as error:
        kind = StorageDownError if error.errno in _MAY_HEAL else UsageError
        raise kind(
            f"storage.path {path.parent}: cannot be used ({error.strerror}); give a folder that the service can write"
        ) from error
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise UsageError(
                f"storage.path {path.parent}: in use by another panoexec; stop that one, or give each its own"
            ) from error
        if _is_down(error, path.parent):
            raise StorageDownError(
                f"storage.path {path.parent}: cannot be written ({error}); make room, or have the disk looked at"
            ) from error
        raise UsageError(f"{path}: cannot be opened ({error}); give a folder that the service can write") from error
    except sqlite3.DatabaseError as error:
        raise UsageError(f"{path}: damaged ({error}); move it away to start afresh, missions are not in it") from error


def _prepared(connection: sqlite3.Connection) -> sqlite3.Connection:
    try:
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("BEGIN EXCLUSIVE")  # takes the lock now: two daemons must not share a storage
        connection.execute("COMMIT")
        connection.executescript(_SCHEMA)
    except BaseException:
        connection.close()
        raise
    return connection


def _is_down(error: sqlite3.OperationalError, folder: Path) -> bool:
    """Whether it is the disk's fault, and not that of who was named as its user or of the name."""
    if error.sqlite_errorcode & _PRIMARY in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return True
    try:
        return bool(os.statvfs(folder).f_flag & os.ST_RDONLY)
    except OSError:
        return False
