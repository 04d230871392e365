"""A mission session: connects the executor with the devices, and with plan, journal and manifest on disk.

Used by the daemon and the dry-run.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager, closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from panoexec import __version__
from panoexec.clock import Clock, work
from panoexec.codec import decode, encode
from panoexec.devices import Camera, Gimbal, Severity, Vehicle
from panoexec.errors import MissionError, UsageError
from panoexec.inputs.plan_file import plan_from_data, plan_to_data, write_plan
from panoexec.mission.content_check import PictureSource
from panoexec.mission.executor import Mission
from panoexec.mission.log.events import Event, EventSink
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import FINISHED
from panoexec.mission.measured_certificate import ThreadedVerifier
from panoexec.mission.pilot_messages import PilotMessage, PilotMessenger
from panoexec.mission.protocols import Journal, PhotoFetcher
from panoexec.mission.settings import MissionSettings
from panoexec.mission.tour_stop import stop_in
from panoexec.mission.waiting import first_failure
from panoexec.pictures.process import PictureProcess
from panoexec.planning.model import Plan
from panoexec.store.catalogue import next_number
from panoexec.store.directory import MissionDirectory, new_mission_directory
from panoexec.store.journal import DamagedJournalError, SqliteJournal, load_journal
from panoexec.store.journal_layout import MISSION_ID, NUMBER, WRITTEN_BY
from panoexec.store.manifest import ManifestWriter
from panoexec.store.photo_collector import PhotoCollector
from panoexec.store.photo_store import PhotoStore


class NotResumableError(UsageError):
    """The mission has ended and cannot be resumed; nothing was changed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Devices:
    """The devices of a mission."""

    gimbal: Gimbal
    camera: Camera
    vehicle: Vehicle


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredMission:
    """A mission as stored in its journal.

    Attributes:
        directory: its directory.
        journal: open; the owner of this object closes it.
        plan: the plan at its start.
        settings: the settings at its start.
        extra: additional data of the daemon or the dry-run.
        events: all events so far.
        notes: what is to be told about the journal: content is unchecked, the last write was interrupted.
    """

    directory: MissionDirectory
    journal: SqliteJournal
    plan: Plan
    settings: MissionSettings
    extra: Mapping[str, Any]
    events: tuple[Event, ...]
    notes: tuple[str, ...] = ()


async def create_mission(
    storage: Path, *, plan: Plan, settings: MissionSettings, now_utc_s: float, extra: Mapping[str, Any] | None = None
) -> StoredMission:
    """Create the directory of a new mission, with its plan and journal.

    Args:
        storage: the storage root; the directory is created below its `missions` folder.
        plan: the plan of the mission.
        settings: the settings of the mission.
        now_utc_s: start time, which becomes the mission id; the order of missions does not depend on it.
        extra: additional data, stored as JSON.

    Raises:
        UsageError: the directory cannot be written.
    """
    number = await asyncio.to_thread(next_number, storage)
    directory = await asyncio.to_thread(new_mission_directory, storage, now_utc_s=now_utc_s)
    await asyncio.to_thread(write_plan, directory.plan, plan)
    head = {
        MISSION_ID: directory.mission_id,
        WRITTEN_BY: __version__,
        NUMBER: str(number),
        "plan": json.dumps(plan_to_data(plan)),
        "settings": json.dumps(encode(settings)),
        "extra": json.dumps(dict(extra or {})),
    }
    journal = await SqliteJournal.create(directory.journal, head)
    return StoredMission(
        directory=directory, journal=journal, plan=plan, settings=settings, extra=dict(extra or {}), events=()
    )


async def open_mission(directory: MissionDirectory) -> StoredMission:
    """Open a stored mission to resume it.

    Raises:
        NotResumableError: the mission has ended.
        JournalFileError: the journal is missing or unusable.
        InputFileError: the stored plan is invalid.
    """
    # checked read-only first: opening for writing merges the write-ahead log, and a rejected journal must stay
    # unchanged
    contents = await asyncio.to_thread(load_journal, directory.journal)
    head, events = contents.head, list(contents.events)
    try:
        plan_data = json.loads(head["plan"])
        settings = decode(MissionSettings, json.loads(head["settings"]))
        extra = json.loads(head["extra"])
    except (KeyError, ValueError) as error:
        raise DamagedJournalError(f"{directory.journal}: damaged ({error}); the file was not changed") from error
    plan = plan_from_data(plan_data, source=f"{directory.journal} (plan)").plan()
    _check_resumable(directory, plan, events)
    journal = await SqliteJournal.open(directory.journal)
    return StoredMission(
        directory=directory,
        journal=journal,
        plan=plan,
        settings=settings,
        extra=extra,
        events=tuple(events),
        notes=contents.notes,
    )


def _check_resumable(directory: MissionDirectory, plan: Plan, events: list[Event]) -> None:
    try:
        record = MissionRecord.from_events(mission_id=directory.mission_id, shots=plan.shots, events=events)
    except (MissionError, ValueError, LookupError) as error:
        raise DamagedJournalError(f"{directory.journal}: damaged ({error}); the file was not changed") from error
    if record.state in FINISHED:
        raise NotResumableError(
            f"{directory.path}: the mission is {record.state} ({record.reason}) and cannot be resumed; start a new one"
        )


class _Sinks:
    """An event sink that forwards events to several sinks."""

    def __init__(self, *sinks: EventSink) -> None:
        self._sinks = sinks

    def publish(self, event: Event) -> None:
        for sink in self._sinks:
            sink.publish(event)


class MissionSession:
    """A stored mission with its devices.

    Attributes:
        stored: directory, plan, settings, past events.
        mission: the executor; its commands may be used while `run` is running.
        photos: stores the photos' files.
    """

    def __init__(
        self,
        *,
        stored: StoredMission,
        mission: Mission,
        manifest: ManifestWriter,
        messenger: PilotMessenger,
        photos: PhotoStore,
        collector: PhotoCollector,
    ) -> None:
        self.stored = stored
        self.mission = mission
        self.photos = photos
        self._collector = collector
        self._manifest = manifest
        self._messenger = messenger

    @classmethod
    @asynccontextmanager
    async def opened(
        cls,
        stored: StoredMission,
        *,
        devices: Devices,
        clock: Clock,
        sink: EventSink,
        vehicle: Mapping[str, Any],
        reference: Literal["north", "heading"] = "north",
        settings: MissionSettings | None = None,
        fetchers: Sequence[PhotoFetcher] = (),
    ) -> AsyncIterator[Self]:
        """Open a session; the journal is closed when the block ends.

        Args:
            stored: from `create_mission` or `open_mission`; its journal is closed at the end.
            devices: the devices to use.
            clock: the mission's clock.
            sink: receives the events.
            vehicle: the manifest's data on the vehicle, as JSON.
            reference: for a new mission, the reference of the plan's yaw 0.
            settings: replace the stored ones.
            fetchers: ways to bring the camera's files into the mission directory while the mission flies.
        """
        sinks: list[EventSink] = []
        collectors: list[PhotoCollector] = []
        try:
            mission = Mission(
                mission_id=stored.directory.mission_id,
                plan=stored.plan,
                settings=settings or stored.settings,
                gimbal=devices.gimbal,
                camera=devices.camera,
                vehicle=devices.vehicle,
                clock=clock,
                journal=_ClockedJournal(stored.journal, clock),
                sink=_Sinks(_DeferredSinks(sinks), sink),
                verifier=ThreadedVerifier(plan=stored.plan),
                reference=reference,
                past=stored.events,
                pictures=PictureSource(
                    folder=stored.directory.path,
                    open=PictureProcess.running,
                    refused=lambda: collectors[0].refused() if collectors else {},
                    coming=lambda: (
                        {(one.shot, one.attempt) for one in collectors[0].remaining} if collectors else set()
                    ),
                ),
            )
            writer = ManifestWriter(
                path=stored.directory.manifest,
                plan=stored.plan,
                record=mission.record,
                vehicle=vehicle,
                clock=clock,
                certificate=lambda: mission.certificate,
                battery=lambda: devices.vehicle.status.battery_frac,
                name=str(stored.extra.get("name") or ""),
                tour=stop_in(stored.extra),
            )
            messenger = PilotMessenger(vehicle=devices.vehicle, record=mission.record)
            folder = stored.directory.path
            photos = PhotoStore(folder, record=mission.record, emit=mission.note)
            collector = PhotoCollector(folder, record=mission.record, store=photos, fetchers=fetchers)
            collectors.append(collector)
            sinks += [writer, messenger, collector]
            with closing(photos):
                yield cls(
                    stored=stored,
                    mission=mission,
                    manifest=writer,
                    messenger=messenger,
                    photos=photos,
                    collector=collector,
                )
        finally:
            await stored.journal.close()

    async def run(self) -> MissionRecord:
        """Execute the mission; the manifest is written when this ends, in any case.

        Raises:
            MissionError: the journal failed.
            UsageError: the manifest cannot be written.
        """
        try:
            async with asyncio.TaskGroup() as group:
                beside = [
                    group.create_task(self._manifest.run(), name="manifest"),
                    group.create_task(self._messenger.run(), name="pilot messages"),
                    group.create_task(self._collector.run(), name="photos"),
                ]
                record = await self.mission.run()
                for task in beside:
                    task.cancel()
        except BaseException as failure:
            if not isinstance(failure, asyncio.CancelledError):
                self._messenger.send(PilotMessage("stopped by an error, gimbal released", Severity.ERROR))
            await self._messenger.flush()
            with suppress(UsageError):  # the first error is reported
                await self._manifest.write()
            if isinstance(failure, BaseExceptionGroup):
                raise first_failure(failure) from None
            raise
        await self._messenger.flush()
        await self._manifest.write()
        return record


class _ClockedJournal:
    """A journal that announces its work to the clock."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal, self._clock = journal, clock

    async def append(self, events: Sequence[Event]) -> None:
        """See `Journal.append`."""
        with work(self._clock):
            await self._journal.append(events)


class _DeferredSinks:
    """A sink that forwards to sinks that are added later, because they need the mission's record."""

    def __init__(self, targets: list[EventSink]) -> None:
        self._targets = targets

    def publish(self, event: Event) -> None:
        for sink in self._targets:
            sink.publish(event)
