"""Who waits for the journal learns that it failed."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from panoexec.clock import SystemClock
from panoexec.errors import MissionError
from panoexec.mission.log.events import Event, Warned
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.recorder import Recorder


class Sink:
    def publish(self, _event: Event) -> None: ...


class FullDisk:
    def __init__(self) -> None:
        self.full = asyncio.Event()

    async def append(self, _events: Sequence[Event]) -> None:
        await self.full.wait()
        raise MissionError("the journal cannot be written (disk is full)")


def recorder_on(journal: FullDisk) -> Recorder:
    record = MissionRecord.from_events(mission_id="m", shots=(), events=())
    return Recorder(record=record, journal=journal, sink=Sink(), clock=SystemClock())


async def test_who_waits_for_a_journal_that_fails_is_told() -> None:
    disk = FullDisk()
    recorder = recorder_on(disk)
    running = asyncio.create_task(recorder.run(), name="recorder")
    recorder.emit(Warned(code="c", text="t"))
    before = asyncio.create_task(recorder.durable(), name="waits already")
    await asyncio.sleep(0)
    disk.full.set()
    async with asyncio.timeout(60):
        with pytest.raises(MissionError, match=r"not written any more: the journal cannot be written \(disk is full\)"):
            await before
        with pytest.raises(MissionError, match="disk is full"):
            await recorder.durable()
        with pytest.raises(MissionError, match="disk is full"):
            await running


async def test_who_waits_for_a_journal_whose_writing_is_cancelled_is_told() -> None:
    recorder = recorder_on(FullDisk())
    running = asyncio.create_task(recorder.run(), name="recorder")
    recorder.emit(Warned(code="c", text="t"))
    await asyncio.sleep(0)
    running.cancel()
    async with asyncio.timeout(60):
        with pytest.raises(MissionError, match="not written any more"):
            await recorder.durable()
    with pytest.raises(asyncio.CancelledError):
        await running
