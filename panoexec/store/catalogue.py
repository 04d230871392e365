"""The missions of a storage in the order in which they were begun, each with what its journal says of it.

The order is that of the numbers that missions get at their creation, not that of their names: a name is the wall time,
and a computer without a battery-backed clock begins at 1970, or at the time of its last shutdown.
"""

from __future__ import annotations

import json
import sqlite3
from dataclasses import dataclass
from pathlib import Path

from panoexec.errors import UsageError
from panoexec.mission.log.states import MissionState
from panoexec.store import journal_layout as layout
from panoexec.store.directory import MissionDirectory, mission_directories
from panoexec.store.journal import DamagedJournalError, JournalFileError, check_journal_file, reading


@dataclass(frozen=True, slots=True, kw_only=True)
class Glance:
    """What the first and the last rows of a journal say; the events between are not looked at.

    Attributes:
        number: of the mission in its storage; 0 if an earlier version began it.
        events: how many there are.
        state: after the last event.
    """

    number: int
    events: int
    state: MissionState


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredJournal:
    """A mission of a storage.

    Attributes:
        directory: its directory.
        glance: what its journal says; None if that cannot be read.
        problem: why not.
    """

    directory: MissionDirectory
    glance: Glance | None
    problem: str = ""


def glance(path: Path) -> Glance:
    """Look at a journal that is not in use; takes about a millisecond, whatever its length.

    Raises:
        JournalFileError: it is missing, damaged, of a newer version, not a panoexec journal, or in use.
    """
    check_journal_file(path)
    try:
        with reading(path, timeout_s=0.0) as connection:
            sealed = layout.is_sealed(connection)
            head = layout.checked_head(connection) if sealed else layout.unsealed_head(connection)
            last = connection.execute("SELECT * FROM events ORDER BY seq DESC LIMIT 1").fetchone()
            events = 0 if last is None else int(last[0])
            if sealed:
                end = layout.genesis(head.get(layout.MISSION_ID, "")) if last is None else last[4]
                if layout.read_tail(connection)[:2] != (events, end):
                    raise layout.BrokenSealError("the last events are missing")
            state = MissionState.IDLE if last is None else MissionState(json.loads(last[3])["state"])
            return Glance(number=int(head.get(layout.NUMBER, 0)), events=events, state=state)
    except (sqlite3.Error, ValueError, TypeError, KeyError) as error:
        raise DamagedJournalError(f"{path}: damaged ({str(error)[:200]}); the file was not changed") from error


def check_copy_goes_no_further(copy: Path, original: Path) -> None:
    """Keep a copy of a mission from being replaced by an original that knows less than it.

    Args:
        copy: journal of the copy; need not exist.
        original: journal that is to take its place.

    Raises:
        UsageError: the copy has events that the original does not have, those of a card's photos for example.
    """
    try:
        here, there = glance(copy).events, glance(original).events
    except JournalFileError:
        return  # there is none, or one of them says nothing
    if here > there:
        raise UsageError(
            f"{copy.parent} has {here - there} events more than the mission there (a card imported here, for example):"
            " it is left as it is; choose another folder for a second copy"
        )


def catalogue(storage: Path) -> list[StoredJournal]:
    """The missions of a storage, oldest first.

    A directory without a journal is left out: the process ended before the mission began. A mission whose journal
    cannot be read is placed by its name.
    """
    found: list[tuple[float, str, StoredJournal]] = []
    number = 0.0
    for directory in mission_directories(storage):
        if not directory.journal.exists():
            continue
        try:
            seen = glance(directory.journal)
        except JournalFileError as error:
            stored = StoredJournal(directory=directory, glance=None, problem=str(error))
            found.append((number + 0.5, directory.mission_id, stored))
            continue
        number = seen.number
        found.append((number, directory.mission_id, StoredJournal(directory=directory, glance=seen)))
    return [stored for _, _, stored in sorted(found, key=lambda item: item[:2])]


def next_number(storage: Path) -> int:
    """The number of a new mission: above those of all missions of the storage."""
    return 1 + max((stored.glance.number for stored in catalogue(storage) if stored.glance is not None), default=0)
