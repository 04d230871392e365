"""A mission that no process flies, to which photos are added: after landing, or from a card.

The journal is open only while events are appended: a mission that is resumed meanwhile finds it free.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Self

from panoexec.errors import MissionError, UsageError
from panoexec.inputs.plan_file import plan_from_data
from panoexec.mission.log.events import Event, PhotoStored
from panoexec.mission.log.record import MissionRecord
from panoexec.planning.model import Plan
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import DamagedJournalError, JournalFileError, SqliteJournal, load_journal
from panoexec.store.journal_layout import JournalContents
from panoexec.store.photo_store import PhotoStore, stored_photos


class LandedMission:
    """The record of a mission on disk, and a store for its photos.

    Attributes:
        directory: of the mission.
        plan: at its start.
        record: with the events that are queued, too.
        photos: stores photos; their events are queued until `flush`.
    """

    def __init__(self, directory: MissionDirectory, plan: Plan, record: MissionRecord) -> None:
        self.directory = directory
        self.plan = plan
        self.record = record
        self.photos = PhotoStore(directory.path, record=record, emit=self._emit)
        self._queue: list[Event] = []
        self._on_disk = record.seq

    @classmethod
    def read(cls, directory: MissionDirectory) -> Self:
        """Read the journal; blocks, and writes nothing.

        Raises:
            JournalFileError: it is missing, in use, or damaged.
        """
        contents = load_journal(directory.journal)
        record = record_of(directory, contents)
        plan = plan_from_data(json.loads(contents.head["plan"]), source=f"{directory.journal} (plan)").plan()
        return cls(directory, plan, record)

    def stored(self) -> Sequence[PhotoStored]:
        """All stored files."""
        return tuple(stored_photos(self.record))

    def close(self) -> None:
        """End the store's thread; events that were not flushed are lost."""
        self.photos.close()

    async def flush(self) -> Sequence[Event]:
        """Append the queued events to the journal, and return them.

        Raises:
            JournalFileError: it is in use, or another process has appended events since it was read.
            MissionError: it cannot be written.
        """
        if not self._queue:
            return ()
        journal = await SqliteJournal.open(self.directory.journal)
        try:
            last = await journal.last_seq()
            if last != self._on_disk:
                raise JournalFileError(f"{self.directory.journal}: was continued meanwhile (event {last})")
            events = tuple(self._queue)
            await journal.append(events)
        finally:
            await journal.close()
        self._queue.clear()
        self._on_disk = events[-1].seq
        return events

    def _emit(self, event: PhotoStored) -> PhotoStored:
        stamped = replace(
            event,
            mission_id=self.record.mission_id,
            seq=self.record.seq + 1,
            time_utc_s=time.time(),
            clock_s=math.nan,
            state=self.record.state,
        )
        self.record.apply(stamped)
        self._queue.append(stamped)
        return stamped


def record_of(directory: MissionDirectory, contents: JournalContents) -> MissionRecord:
    """The record that a journal tells.

    Raises:
        DamagedJournalError: the plan or an event makes no sense.
    """
    try:
        plan = plan_from_data(json.loads(contents.head["plan"]), source=f"{directory.journal} (plan)").plan()
        return MissionRecord.from_events(mission_id=directory.mission_id, shots=plan.shots, events=contents.events)
    except (ValueError, LookupError, MissionError, UsageError) as error:
        raise DamagedJournalError(f"{directory.journal}: damaged ({error}); the file was not changed") from error
