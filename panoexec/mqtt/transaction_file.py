"""The SQLite file of the transaction store: opened for one process alone, every write durable."""

from __future__ import annotations

import errno
import os
import sqlite3
from pathlib import Path
from typing import Final

from panoexec.errors import UsageError

_RECOVERABLE: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})
_PRIMARY: Final = 0xFF
"""Mask of the primary result code in an extended result code of SQLite."""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS transactions (
    id TEXT PRIMARY KEY, command TEXT NOT NULL, digest TEXT NOT NULL, boot_id TEXT NOT NULL, response TEXT,
    number INTEGER NOT NULL
) STRICT;
CREATE TABLE IF NOT EXISTS memory (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
"""


class StorageDownError(UsageError):
    """The storage is full, read-only or broken: nothing is wrong with the configuration."""


def open_transaction_file(path: Path) -> sqlite3.Connection:
    """Open the file, or make it, and lock it.

    Raises:
        StorageDownError: the disk is full, read-only or broken; it may recover.
        UsageError: it cannot be made, is damaged, or is in use by another daemon.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return _prepared(sqlite3.connect(path, timeout=1.0, check_same_thread=False))
    except OSError as error:
        kind = StorageDownError if error.errno in _RECOVERABLE else UsageError
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
                f"storage.path {path.parent}: cannot be written ({error}); free space, or check the disk"
            ) from error
        raise UsageError(f"{path}: cannot be opened ({error}); give a folder that the service can write") from error
    except sqlite3.DatabaseError as error:
        raise UsageError(
            f"{path}: damaged ({error}); rename or delete it to start with an empty store; missions are elsewhere"
        ) from error


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
    """Whether the disk is full, failing or read-only, rather than the path or its permissions being wrong."""
    if error.sqlite_errorcode & _PRIMARY in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return True
    try:
        return bool(os.statvfs(folder).f_flag & os.ST_RDONLY)
    except OSError:
        return False
