"""The tables of the transaction store, sealed: no damaged row is ever answered from.

The store's statements see two views, `transactions` and `memory`, and need not know of seals. A row is kept with its
seal (`panoexec.durable.seals`); reading the `command` of a transaction, or the `value` of a memory, checks it and fails
if the row was changed. `total` has the number of rows and the exclusive or of their seals, changed in the transaction
of every change, so that a row that disappeared, or came back, is noticed at the next start.
"""

from __future__ import annotations

import contextlib
import functools
import sqlite3
from collections.abc import Iterator
from typing import Final

from panoexec.durable.seals import SIZE, Field, seal

LAYOUT: Final = 0x5450_0002
"""`user_version`; many bits away from 0, the value of files without seals."""

_TABLES: Final = """
CREATE TABLE transaction_rows (
    id TEXT PRIMARY KEY, command TEXT NOT NULL, digest TEXT NOT NULL, boot_id TEXT NOT NULL, response TEXT,
    number INTEGER NOT NULL, seal BLOB NOT NULL
) STRICT;
CREATE TABLE memory_rows (key TEXT PRIMARY KEY, value TEXT NOT NULL, seal BLOB NOT NULL) STRICT;
CREATE TABLE total (id INTEGER PRIMARY KEY CHECK (id = 1), rows INTEGER NOT NULL, seals BLOB NOT NULL) STRICT;
INSERT INTO total VALUES (1, 0, zeroblob(16));
CREATE VIEW transactions AS
    SELECT id, checked(command, seal, id, command, digest, boot_id, response, number) AS command, digest, boot_id,
        response, number FROM transaction_rows;
CREATE VIEW memory AS SELECT key, checked(value, seal, key, value) AS value FROM memory_rows;
CREATE TRIGGER insert_transaction INSTEAD OF INSERT ON transactions BEGIN
    INSERT INTO transaction_rows VALUES (
        new.id, new.command, new.digest, new.boot_id, new.response, new.number,
        sealed(new.id, new.command, new.digest, new.boot_id, new.response, new.number)
    );
    UPDATE total SET rows = rows + 1,
        seals = combined(seals, (SELECT seal FROM transaction_rows WHERE id = new.id));
END;
CREATE TRIGGER update_transaction INSTEAD OF UPDATE ON transactions BEGIN
    UPDATE total SET seals = combined(seals, (SELECT seal FROM transaction_rows WHERE id = old.id));
    UPDATE transaction_rows SET response = new.response,
        seal = sealed(old.id, old.command, old.digest, old.boot_id, new.response, old.number) WHERE id = old.id;
    UPDATE total SET seals = combined(seals, (SELECT seal FROM transaction_rows WHERE id = old.id));
END;
CREATE TRIGGER delete_transaction INSTEAD OF DELETE ON transactions BEGIN
    UPDATE total SET rows = rows - 1,
        seals = combined(seals, (SELECT seal FROM transaction_rows WHERE id = old.id));
    DELETE FROM transaction_rows WHERE id = old.id;
END;
CREATE TRIGGER insert_memory INSTEAD OF INSERT ON memory BEGIN
    UPDATE total SET rows = rows - (SELECT COUNT(*) FROM memory_rows WHERE key = new.key),
        seals = combined(seals, (SELECT seal FROM memory_rows WHERE key = new.key));
    INSERT OR REPLACE INTO memory_rows VALUES (new.key, new.value, sealed(new.key, new.value));
    UPDATE total SET rows = rows + 1, seals = combined(seals, (SELECT seal FROM memory_rows WHERE key = new.key));
END;
CREATE TRIGGER delete_memory INSTEAD OF DELETE ON memory BEGIN
    UPDATE total SET rows = rows - 1, seals = combined(seals, (SELECT seal FROM memory_rows WHERE key = old.key));
    DELETE FROM memory_rows WHERE key = old.key;
END;
PRAGMA user_version = 1414529026;
"""
_SEAL_OLD: Final = f"""
BEGIN;
ALTER TABLE transactions RENAME TO old_transactions;
ALTER TABLE memory RENAME TO old_memory;
{_TABLES}
INSERT INTO transactions SELECT id, command, digest, boot_id, response, number FROM old_transactions;
INSERT INTO memory SELECT key, value FROM old_memory;
DROP TABLE old_transactions;
DROP TABLE old_memory;
COMMIT;
"""  # noqa: S608  (constants)
_READ: Final = (
    "SELECT id, command, digest, boot_id, response, number, seal FROM transaction_rows ORDER BY number",
    "SELECT key, value, seal FROM memory_rows",
)
_WRITE: Final = ("INSERT INTO transactions VALUES (?, ?, ?, ?, ?, ?)", "INSERT INTO memory VALUES (?, ?)")


class DamagedTablesError(Exception):
    """Stored rows differ from what was written."""


def prepare_functions(connection: sqlite3.Connection) -> None:
    """Give a connection the functions that the views and triggers call."""
    connection.create_function("sealed", -1, seal, deterministic=True)
    connection.create_function("checked", -1, _checked, deterministic=True)
    connection.create_function("combined", 2, _combined, deterministic=True)
    connection.execute("PRAGMA trusted_schema = ON")


def prepare_tables(connection: sqlite3.Connection) -> None:
    """Create the tables in an empty file, or seal those of an earlier version as they are found; check all others.

    Raises:
        DamagedTablesError: they are not as they were written.
        sqlite3.Error: they cannot be read or written.
    """
    found = connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
    if found != "ok":
        raise DamagedTablesError(" ".join(str(found).split()))
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    kinds = dict(connection.execute("SELECT name, type FROM sqlite_schema WHERE type IN ('table', 'view')").fetchall())
    if version == LAYOUT and _schema(connection) == _expected_schema():
        check_tables(connection)
    elif version == 0 and not kinds:
        connection.executescript(f"BEGIN; {_TABLES} COMMIT;")
    elif version == 0 and kinds == {"transactions": "table", "memory": "table"}:
        connection.executescript(_SEAL_OLD)
    else:
        raise DamagedTablesError(f"layout {version} with other tables than those of this layout")


def check_tables(connection: sqlite3.Connection) -> None:
    """Check every row, and that none is missing.

    Raises:
        DamagedTablesError: one was changed, or is missing.
    """
    seals, rows, damaged = bytes(SIZE), 0, 0
    for values, stored in _stored(connection):
        rows += 1
        damaged += seal(*values) != stored
        seals = _combined(seals, stored)
    if damaged:
        raise DamagedTablesError(f"{damaged} of {rows} rows were changed")
    if (total := connection.execute("SELECT rows, seals FROM total").fetchall()) != [(rows, seals)]:
        raise DamagedTablesError(f"{total[0][0] if total else 'some'} rows were written, {rows} are there")


def copy_true_rows(source: sqlite3.Connection, target: sqlite3.Connection, *, memory: bool) -> int:
    """Copy the rows whose seals hold; what SQLite cannot read is left out.

    Args:
        source: the damaged file.
        target: an empty file.
        memory: also what was remembered; not of an old state of the file, where it had other values.

    Returns:
        How many rows were copied.
    """
    copied = 0
    source.text_factory = _any_text
    for query, insert in list(zip(_READ, _WRITE, strict=True))[: 2 if memory else 1]:
        try:
            for *values, stored in source.execute(query):
                if seal(*values) == stored:
                    with target:
                        target.execute(insert, values)
                    copied += 1
        except (sqlite3.Error, UnicodeDecodeError):
            continue
    return copied


def _schema(connection: sqlite3.Connection) -> set[tuple[str, str, str]]:
    return set(connection.execute("SELECT type, name, sql FROM sqlite_schema WHERE sql IS NOT NULL").fetchall())


@functools.cache
def _expected_schema() -> set[tuple[str, str, str]]:
    with contextlib.closing(sqlite3.connect(":memory:")) as empty:
        prepare_functions(empty)
        empty.executescript(_TABLES)
        return _schema(empty)


def _stored(connection: sqlite3.Connection) -> Iterator[tuple[list[Field], bytes]]:
    usual, connection.text_factory = connection.text_factory, _any_text
    try:
        for query in _READ:
            for *values, stored in connection.execute(query):
                yield values, stored
    finally:
        connection.text_factory = usual


def _any_text(data: bytes) -> str:
    """A text that a damaged byte may have made none; `seal` takes it back to its bytes."""
    return data.decode("utf-8", "surrogateescape")


def _checked(value: Field, stored: bytes, *fields: Field) -> Field:
    if seal(*fields) != stored:
        raise ValueError("the row was changed since it was written")
    return value


def _combined(one: bytes, other: bytes | None) -> bytes:
    """Exclusive or; `other` is None for a row that is not there."""
    if other is None:
        return one
    return (int.from_bytes(one) ^ int.from_bytes(other)).to_bytes(SIZE)
