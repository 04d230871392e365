"""What is written to and read from the file of transactions; the caller's thread waits for the disk."""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from panoexec.mqtt.requests import STOPPING
from panoexec.mqtt.transaction_memory import Known, conflict

TransactionStatus: TypeAlias = Literal["new", "under way", "interrupted", "answered"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Noted:
    """A transaction in the store.

    Attributes:
        status: not stored before (`new`), in progress, in progress when its process died, or answered.
        response: the response that was sent, as JSON; "" without one.
    """

    status: TransactionStatus
    response: str = ""


def note(database: sqlite3.Connection, key: str, command: str, digest: str, *, boot_id: str) -> Noted:
    """Store that a request is going to be executed, unless its transaction is there already.

    Args:
        database: the file.
        key: the transaction.
        command: of the request.
        digest: of the fields of the request.
        boot_id: id of this process.

    Raises:
        RefusedRequestError: another request has the transaction.
        sqlite3.Error: the disk refuses.
    """
    with database:
        row = database.execute(
            "SELECT command, digest, boot_id, response FROM transactions WHERE id = ?", (key,)
        ).fetchone()
        if row is None:
            database.execute(
                "INSERT INTO transactions SELECT ?, ?, ?, ?, NULL, COALESCE(MAX(number), 0) + 1 FROM transactions",
                (key, command, digest, boot_id),
            )
            return Noted(status="new")
    if (row[0], row[1]) != (command, digest):
        raise conflict(str(row[0]))
    if row[3] is not None:
        return Noted(status="answered", response=str(row[3]))
    return Noted(status="under way" if row[2] == boot_id else "interrupted")


def store_response(database: sqlite3.Connection, key: str, response: str, forgotten: Sequence[str]) -> None:
    """Store a response, and forget other transactions.

    Raises:
        sqlite3.Error: the disk refuses; nothing has changed.
    """
    with database:
        database.execute("UPDATE transactions SET response = ? WHERE id = ?", (response, key))
        database.executemany("DELETE FROM transactions WHERE id = ?", [(one,) for one in forgotten])


def store_value(database: sqlite3.Connection, key: str, value: str | None) -> None:
    """Store a value under a name; None deletes it.

    Raises:
        sqlite3.Error: the disk refuses; nothing has changed.
    """
    with database:
        if value is None:
            database.execute("DELETE FROM memory WHERE key = ?", (key,))
        else:
            database.execute("INSERT OR REPLACE INTO memory VALUES (?, ?)", (key, value))


def recalled(database: sqlite3.Connection, key: str) -> str | None:
    """The value under a name, None without one."""
    row = database.execute("SELECT value FROM memory WHERE key = ?", (key,)).fetchone()
    return None if row is None else str(row[0])


def stored(database: sqlite3.Connection) -> dict[str, Known]:
    """The transactions in the file, oldest first; with the response of stopping requests."""
    rows = database.execute("SELECT id, command, digest, response FROM transactions ORDER BY number")
    return {
        key: Known(sys.intern(command), digest, response.encode() if response and command in STOPPING else None)
        for key, command, digest, response in rows
    }
