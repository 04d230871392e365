"""The SQLite file of the transaction store: opened for one process alone, every write durable."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sqlite3
import tempfile
from pathlib import Path
from typing import Final

import structlog

from panoexec.durable.wal_check import examine_log
from panoexec.errors import UsageError
from panoexec.mqtt.sealed_tables import DamagedTablesError, copy_true_rows, prepare_functions, prepare_tables

_LOG_PAGES: Final = 100
"""Pages of 4 kB after which the write-ahead log is merged into the file; by default it would take 4 MB of the disk."""

_RECOVERABLE: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})
_PRIMARY: Final = 0xFF
"""Mask of the primary result code in an extended result code of SQLite."""

FORGOTTEN: Final = "forgotten"
"""Key in `memory` if the file was set aside: what was remembered before may be lost."""

_log = structlog.get_logger(__name__)


class StorageDownError(UsageError):
    """The storage is full, read-only or broken: nothing is wrong with the configuration."""


class _DamagedFileError(Exception):
    """The file is not as it was written.

    Attributes:
        is_old: without its damaged log, the file is that of an earlier time.
    """

    def __init__(self, damage: str, *, is_old: bool = False) -> None:
        super().__init__(damage)
        self.is_old = is_old


def open_transaction_file(path: Path) -> sqlite3.Connection:
    """Open the file, or create it, and lock it.

    A damaged file is set aside, unchanged, and a new one takes its place with the rows that are true. At most once does
    not hold any more for the requests of the others; that is logged, and remembered under `FORGOTTEN`.

    Raises:
        StorageDownError: the disk is full, read-only or broken; it may recover.
        UsageError: it cannot be created, or is in use by another daemon.
    """
    try:
        return _opened(path)
    except _DamagedFileError as error:
        return _begun_anew(path, error)


def _begun_anew(path: Path, damage: _DamagedFileError) -> sqlite3.Connection:
    _check_unused(path)
    number = 1
    while (aside := path.with_name(f"{path.stem}-damaged-{number}{path.suffix}")).exists():
        number += 1
    try:
        for suffix in ("-wal", ""):
            if (part := path.with_name(path.name + suffix)).exists():
                part.rename(aside.with_name(aside.name + suffix))
        path.with_name(f"{path.name}-shm").unlink(missing_ok=True)
        copied, connection = 0, _opened(path)
        with tempfile.TemporaryDirectory(prefix="panoexec-") as folder:
            for suffix in ("-wal", ""):  # a copy: SQLite would merge the log into the file
                if (part := aside.with_name(aside.name + suffix)).exists():
                    shutil.copyfile(part, Path(folder, path.name + suffix))
            with (
                contextlib.suppress(sqlite3.Error, UnicodeDecodeError),
                contextlib.closing(sqlite3.connect(Path(folder, path.name))) as old,
            ):
                copied = copy_true_rows(old, connection, memory=not damage.is_old)
        with connection:
            connection.execute("INSERT OR REPLACE INTO memory VALUES (?, ?)", (FORGOTTEN, str(aside)))
    except (OSError, sqlite3.Error, _DamagedFileError) as error:
        raise UsageError(f"{path}: damaged ({damage}), and cannot be set aside ({error})") from error
    _log.error(
        "the stored transactions are damaged: a request from before may act again if it is repeated, "
        "and an interrupted mission does not go on by itself",
        error=str(damage),
        set_aside=str(aside),
        kept=copied,
    )
    return connection


def _check_unused(path: Path) -> None:
    """Raise if another process has the file open, which must not be taken away from under it."""
    try:
        with contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=1.0)) as found:
            found.execute("SELECT COUNT(*) FROM sqlite_schema").fetchone()
    except sqlite3.Error as error:
        if "locked" in str(error):
            raise _in_use(path) from error
    except UnicodeDecodeError:
        return  # SQLite quotes the damaged text of a table in its error


def _in_use(path: Path) -> UsageError:
    return UsageError(f"storage.path {path.parent}: in use by another panoexec; stop that one, or give each its own")


def _opened(path: Path) -> sqlite3.Connection:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        log = examine_log(path.with_name(f"{path.name}-wal"))
        if log.lost:
            raise _DamagedFileError(log.lost, is_old=True)
        if log.torn:
            _log.warning("the last transaction is not stored", path=str(path), note=log.torn)
        return _prepared(sqlite3.connect(path, timeout=1.0, check_same_thread=False))
    except OSError as error:
        kind = StorageDownError if error.errno in _RECOVERABLE else UsageError
        raise kind(
            f"storage.path {path.parent}: cannot be used ({error.strerror}); give a folder that the service can write"
        ) from error
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise _in_use(path) from error
        if any(part in str(error) for part in ("malformed", "decode", "no such", "user-defined")):
            raise _DamagedFileError(str(error)) from error
        if _is_down(error, path.parent):
            raise StorageDownError(
                f"storage.path {path.parent}: cannot be written ({error}); free space, or check the disk"
            ) from error
        raise UsageError(f"{path}: cannot be opened ({error}); give a folder that the service can write") from error
    except (sqlite3.DatabaseError, DamagedTablesError, UnicodeDecodeError) as error:
        raise _DamagedFileError(str(error)) from error


def _prepared(connection: sqlite3.Connection) -> sqlite3.Connection:
    try:
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA wal_autocheckpoint = {_LOG_PAGES}")
        connection.execute("BEGIN EXCLUSIVE")  # takes the lock now: two daemons must not share a storage
        connection.execute("COMMIT")
        prepare_functions(connection)
        prepare_tables(connection)
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
