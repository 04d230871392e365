"""The journal of a mission: its events, written to disk before they are published.

One SQLite file (`journal.sqlite`) in the mission's directory, in WAL mode with synchronous FULL: events survive kill -9
and power cuts once `append` has returned. The plan and the settings at the mission's start are stored as JSON texts.
The file is locked exclusively; a second process gets an error. Everything is sealed (`panoexec.store.journal_layout`):
a journal is read as it was written, or not at all.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, Self, TypeVar

from panoexec import __version__
from panoexec.durable.wal_check import examine_log
from panoexec.errors import MissionError, UsageError
from panoexec.mission.log.events import Event, UnknownEventError
from panoexec.store import journal_layout as layout
from panoexec.store.journal_layout import APPLICATION_ID, MISSION_ID, SCHEMA_VERSION, WRITTEN_BY, JournalContents

_ROOM_BYTES: Final = 64 * 1024
"""Free space that SQLite needs to read the write-ahead log of a killed process: 32 KiB, rounded up."""

T = TypeVar("T")


class JournalFileError(UsageError):
    """A journal cannot be opened or created; nothing was written to it."""


class JournalInUseError(JournalFileError):
    """Another process has the journal open."""


class DamagedJournalError(JournalFileError):
    """A journal is not as it was written; `panoexec salvage` recovers its longest true part."""


class JournalWriteError(MissionError):
    """An open journal can no longer be written; the mission must end."""

    exit_code = 3


class SqliteJournal:
    """An open journal, from `create` or `open`; must be closed (it is an asynchronous context manager).

    File access runs in a thread of its own; methods may be cancelled, file access then completes in the background.
    """

    def __init__(self, path: Path, pool: ThreadPoolExecutor, connection: sqlite3.Connection, end: bytes) -> None:
        self.path = path
        self._pool = pool
        self._connection = connection
        self._end = end
        stat = path.stat()
        self._identity = (stat.st_dev, stat.st_ino)
        self._closed = False

    @classmethod
    async def create(cls, path: Path, head: Mapping[str, str]) -> Self:
        """Create a new journal.

        Args:
            path: a file that does not exist, in an existing folder.
            head: constant data: `mission_id`, `plan`, `settings`, … as texts.

        Raises:
            JournalFileError: the file exists, or cannot be created.
        """
        return await cls._in_thread(path, lambda: _create(path, head))

    @classmethod
    async def open(cls, path: Path) -> Self:
        """Open a journal to resume its mission; one that an earlier version wrote without seals is sealed.

        Raises:
            JournalFileError: it is missing, damaged, of a newer version, not a panoexec journal, or in use.
        """
        return await cls._in_thread(path, lambda: _open(path))

    @classmethod
    async def _in_thread(cls, path: Path, connect: Callable[[], tuple[sqlite3.Connection, bytes]]) -> Self:
        pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="journal")
        try:
            connection, end = await asyncio.get_running_loop().run_in_executor(pool, connect)
        except BaseException:
            pool.shutdown(wait=False)
            raise
        return cls(path, pool, connection, end)

    async def __aenter__(self) -> Self:
        """Return the journal."""
        return self

    async def __aexit__(self, *exc: object) -> None:
        """Close the journal."""
        await self.close()

    async def close(self) -> None:
        """Merge the write-ahead log into the file and close it; may be called twice."""
        if self._closed:
            return
        self._closed = True
        await asyncio.get_running_loop().run_in_executor(self._pool, self._connection.close)
        self._pool.shutdown(wait=False)

    async def append(self, events: Sequence[Event]) -> None:
        """Append events in one transaction; they are on disk when this returns.

        Raises:
            JournalWriteError: the disk is full, or the file was deleted or replaced.
        """
        await self._run(lambda: self._write(events))

    async def last_seq(self) -> int:
        """Number of the last event; 0 without one."""
        last = await self._run(lambda: self._connection.execute("SELECT MAX(seq) FROM events").fetchone())
        return int(last[0] or 0)

    async def events(self) -> list[Event]:
        """All events, in order.

        Raises:
            JournalFileError: an event cannot be read: the journal is damaged.
        """
        return list((await self._run(lambda: _contents(self.path, self._connection))).events)

    async def head(self) -> dict[str, str]:
        """The head with which the journal was created.

        Raises:
            JournalFileError: it cannot be read: the journal is damaged.
        """
        return dict((await self._run(lambda: _contents(self.path, self._connection))).head)

    def _write(self, events: Sequence[Event]) -> None:
        try:
            stat = self.path.stat()
        except OSError:
            raise JournalWriteError(f"{self.path}: the journal was deleted while the mission was running") from None
        if (stat.st_dev, stat.st_ino) != self._identity:
            raise JournalWriteError(f"{self.path}: the journal was replaced while the mission was running")
        rows, end = [], self._end
        for event in events:
            rows.append(layout.sealed(event, end))
            end = rows[-1].seal
        try:
            layout.append(self._connection, rows)
        except sqlite3.Error as error:
            raise JournalWriteError(f"{self.path}: the journal cannot be written ({error})") from error
        self._end = end

    async def _run(self, work: Callable[[], T]) -> T:
        if self._closed:
            raise JournalWriteError(f"{self.path}: the journal is closed")
        return await asyncio.get_running_loop().run_in_executor(self._pool, work)


def read_journal(path: Path) -> tuple[dict[str, str], list[Event]]:
    """Read the head and the events of a journal that is not in use; nothing is written to it.

    Raises:
        JournalFileError: it is missing, damaged, of a newer version, not a panoexec journal, or in use.
    """
    contents = load_journal(path)
    return dict(contents.head), list(contents.events)


def load_journal(path: Path) -> JournalContents:
    """Read a journal that is not in use, with what is to be told about it; nothing is written to it.

    Raises:
        JournalFileError: it is missing, damaged, of a newer version, not a panoexec journal, or in use.
    """
    torn = check_journal_file(path)
    with reading(path) as connection:
        _check_pages(path, connection)
        return _contents(path, connection, torn)


def check_journal_file(path: Path) -> str:
    """Reject a foreign, newer or damaged file by its bytes, without opening it in SQLite, so that it is not changed.

    Returns:
        What is to be told about the last write; "" for nothing.

    Raises:
        JournalFileError: it is missing, damaged, of a newer version, or not a panoexec journal.
    """
    if not path.is_file():
        raise JournalFileError(f"{path}: there is no journal; only a mission directory with one can be read or resumed")
    try:
        with path.open("rb") as file:
            header = file.read(100)
    except OSError as error:
        raise JournalFileError(f"{path}: cannot be read ({error.strerror})") from error
    # the database header: magic at 0, user version at 60, application id at 68, big endian
    if len(header) < 100 or header[:16] != b"SQLite format 3\x00":
        raise DamagedJournalError(f"{path}: damaged or not a journal (not an SQLite file); the file was not changed")
    application, version = int.from_bytes(header[68:72]), int.from_bytes(header[60:64])
    if application != APPLICATION_ID:
        raise JournalFileError(f"{path}: an SQLite file, but not a panoexec journal")
    if version > SCHEMA_VERSION:
        raise JournalFileError(
            f"{path}: written by a newer panoexec (layout {version}, this one reads up to {SCHEMA_VERSION});"
            " update panoexec to resume it"
        )
    try:
        log = examine_log(path.with_name(path.name + "-wal"))
    except OSError as error:
        raise JournalFileError(f"{path}-wal: cannot be read ({error.strerror})") from error
    if log.lost:
        raise DamagedJournalError(f"{path}: damaged ({log.lost}); the file was not changed")
    return log.torn


@contextlib.contextmanager
def reading(path: Path, *, timeout_s: float = 1.0) -> Iterator[sqlite3.Connection]:
    """A read-only connection, which leaves no new files.

    Args:
        path: the journal.
        timeout_s: how long to wait for another process to release it.

    Raises:
        JournalFileError: SQLite cannot read the file.
    """
    # a killed process leaves a write-ahead log; without one, SQLite can read the file as immutable, creating no files
    beside, shared = path.with_name(path.name + "-wal"), path.with_name(path.name + "-shm")
    how = "mode=ro" if beside.exists() and beside.stat().st_size else "mode=ro&immutable=1"
    was_there = shared.exists()
    try:
        with contextlib.closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?{how}", uri=True, timeout=timeout_s)
        ) as found:
            yield found
    except sqlite3.Error as error:
        raise _unusable(path, error) from error
    finally:
        if not was_there:  # SQLite's index of the write-ahead log, which a read-only connection does not remove
            shared.unlink(missing_ok=True)


def _create(path: Path, head: Mapping[str, str]) -> tuple[sqlite3.Connection, bytes]:
    if path.exists():
        raise JournalFileError(f"{path}: already exists; a new mission needs a new directory")
    write_journal(path, head)
    try:
        return _connect(path), layout.genesis(head.get(MISSION_ID, ""))
    except sqlite3.Error as error:
        raise JournalFileError(f"{path}: cannot be created ({error})") from error


def write_journal(path: Path, head: Mapping[str, str], rows: Sequence[layout.Row] = ()) -> None:
    """Write a whole journal; it appears under its name when it is complete and on disk.

    Raises:
        JournalFileError: it cannot be created.
    """
    unfinished = path.with_name(f".{path.name}-new")
    try:
        unfinished.unlink(missing_ok=True)
        descriptor = os.open(unfinished, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644)
        os.close(descriptor)
        # completed before WAL mode starts: later changes are in another file until they are merged, and the header must
        # identify the journal even if the process is killed right after its creation
        with contextlib.closing(sqlite3.connect(unfinished)) as new:
            new.execute("PRAGMA synchronous = FULL")
            new.executescript(f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {SCHEMA_VERSION};")
            layout.fill(new, head, rows)
        unfinished.rename(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise JournalFileError(f"{path}: cannot be created ({error.strerror})") from error
    except sqlite3.Error as error:
        raise JournalFileError(f"{path}: cannot be created ({error})") from error


def _open(path: Path) -> tuple[sqlite3.Connection, bytes]:
    check_journal_file(path)
    try:
        connection = _connect(path)
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise _unusable(path, error) from error
    try:
        _check_pages(path, connection)
        contents = _contents(path, connection)
        if not layout.is_sealed(connection):
            layout.seal_as_found(connection)
            # the version of the layout stands in the header of the file, where the next reader looks first
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            contents = _contents(path, connection)
    except sqlite3.Error as error:
        connection.close()
        raise _unusable(path, error) from error
    except BaseException:
        connection.close()
        raise
    return connection, contents.end


def _unusable(path: Path, error: sqlite3.Error | UnicodeDecodeError) -> JournalFileError:
    """The error for a journal that SQLite cannot open."""
    if "locked" in str(error):
        return JournalInUseError(f"{path}: in use by another panoexec; stop that one first")
    if isinstance(error, sqlite3.OperationalError) and "malformed" not in str(error):
        full = shutil.disk_usage(path.parent).free < _ROOM_BYTES
        why = f"no space left in {path.parent}" if full else str(error)
        return JournalFileError(f"{path}: cannot be opened ({why})")
    return DamagedJournalError(f"{path}: damaged ({error}); the file was not changed")


def _check_pages(path: Path, connection: sqlite3.Connection) -> None:
    """Raise if SQLite's consistency check of the pages fails."""
    try:
        damaged = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    except UnicodeDecodeError as error:  # in SQLite's description of the damage
        raise DamagedJournalError(f"{path}: damaged ({error}); the file was not changed") from error
    if damaged != "ok":
        raise DamagedJournalError(f"{path}: damaged ({' '.join(str(damaged).split())}); the file was not changed")


def _connect(path: Path) -> sqlite3.Connection:
    beside = path.with_name(f"{path.name}-wal")
    was_there = beside.exists()
    connection = sqlite3.connect(path, timeout=1.0, check_same_thread=False)
    try:
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("BEGIN EXCLUSIVE")  # take the lock now, not at the first write
        connection.execute("COMMIT")
    except sqlite3.DatabaseError as error:
        connection.close()
        if not was_there and "locked" not in str(error) and beside.exists() and not beside.stat().st_size:
            beside.unlink()  # leave no new files beside a rejected journal
        raise
    return connection


def _contents(path: Path, connection: sqlite3.Connection, torn: str = "") -> JournalContents:
    """Everything, checked against its seals.

    Raises:
        JournalFileError: it is damaged, or of another version.
    """
    notes = [torn] if torn else []
    head: dict[str, str] = {}
    try:
        if layout.is_sealed(connection):
            head = layout.checked_head(connection)
            start = layout.genesis(head.get(MISSION_ID, ""))
            rows = layout.checked_rows(connection, start)
            events, end = layout.parsed([row.json for row in rows]), rows[-1].seal if rows else start
            if layout.SEALED_LATER in head:
                notes.append(f"events up to {head[layout.SEALED_LATER]} were sealed later: before that, unchecked")
        else:
            head, end = layout.unsealed_head(connection), b""
            events = layout.parsed(layout.unsealed_texts(connection))
            notes.append(f"written by panoexec {head.get(WRITTEN_BY, '')} without seals: its content is unchecked")
    except UnknownEventError as error:
        by = head.get(WRITTEN_BY, __version__)
        if by == __version__:
            raise _damaged(path, error) from error
        raise JournalFileError(
            f"{path}: written by panoexec {by}, with content that this version ({__version__}) does not know ({error});"
            " resume it with that version"
        ) from error
    except (sqlite3.Error, ValueError, TypeError, AttributeError) as error:
        raise _damaged(path, error) from error
    return JournalContents(head=head, events=events, end=end, notes=tuple(notes))


def _damaged(path: Path, error: Exception) -> JournalFileError:
    if "locked" in str(error):
        return JournalInUseError(f"{path}: in use by another panoexec; stop that one first")
    return DamagedJournalError(f"{path}: damaged ({str(error)[:200]}); the file was not changed")


def _sync_folder(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
