"""Stamps events, applies them to the record, and publishes an event only after the journal has stored it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from panoexec.clock import Clock
from panoexec.errors import MissionError
from panoexec.mission.log.events import Event, EventSink
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState
from panoexec.mission.protocols import Journal

E = TypeVar("E", bound=Event)


class Recorder:
    """The single entry point for a mission's events.

    `emit` changes the record at once, in memory; the `run` task writes all queued events in one transaction and then
    publishes them, so that the mission waits for the disk only in `durable`.
    """

    def __init__(self, *, record: MissionRecord, journal: Journal, sink: EventSink, clock: Clock) -> None:
        self.record = record
        self._journal = journal
        self._sink = sink
        self._clock = clock
        self._queue: list[Event] = []
        self._durable_seq = record.seq
        self._progress = asyncio.Event()
        self._work = asyncio.Event()
        self._closing = False
        self._failure = ""
        self._failed = asyncio.Event()

    def emit(self, event: E, state: MissionState | None = None) -> E:
        """Stamp the event, apply it to the record and queue it for the journal.

        Args:
            event: without its stamp.
            state: the mission's state from now on; None: unchanged.

        Raises:
            MissionError: an illegal state transition (a bug).
            ValueError: the event contradicts earlier ones (a bug).
        """
        stamped = replace(
            event,
            mission_id=self.record.mission_id,
            seq=self.record.seq + 1,
            time_utc_s=self._clock.time(),
            clock_s=self._clock.monotonic(),
            state=self.record.state if state is None else state,
        )
        self.record.apply(stamped)
        self._queue.append(stamped)
        self._work.set()
        return stamped

    def blocker(self, seq: int) -> asyncio.Event | None:
        """None if event `seq` is on disk and published; else an `asyncio.Event` to await before calling again."""
        return None if self._durable_seq >= seq else self._progress

    async def durable(self) -> None:
        """Return when everything emitted so far is on disk and published.

        Raises:
            MissionError: it never will be, as `run` has failed or was cancelled.
        """
        seq = self.record.seq
        while (blocker := self.blocker(seq)) is not None:
            if self._failed.is_set():
                raise MissionError(f"not in the mission's journal, which is not written any more: {self._failure}")
            waits = [asyncio.ensure_future(event.wait()) for event in (blocker, self._failed)]
            try:
                await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for one in waits:
                    one.cancel()
                await asyncio.gather(*waits, return_exceptions=True)

    async def run(self) -> None:
        """Write and publish events until closed.

        Raises:
            MissionError: the journal cannot be written; the mission must end.
        """
        try:
            await self._write()
        except BaseException as error:
            self._failure = str(error) or type(error).__name__
            self._failed.set()
            raise

    async def _write(self) -> None:
        while True:
            await self._work.wait()
            self._work.clear()
            batch: Sequence[Event] = tuple(self._queue)
            self._queue.clear()
            if batch:
                await self._journal.append(batch)
                for event in batch:
                    self._sink.publish(event)
                self._durable_seq = batch[-1].seq
                done, self._progress = self._progress, asyncio.Event()
                done.set()
            elif self._closing:
                return
            if self._queue or self._closing:
                self._work.set()

    @property
    def closed(self) -> bool:
        """Whether it takes no more events."""
        return self._closing

    def close(self) -> None:
        """Let `run` return when all events are written."""
        self._closing = True
        self._work.set()
