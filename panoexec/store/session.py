"""A mission with its directory: plan, journal and manifest on disk, the executor between them and the devices.

The composition that the daemon and the dry-run share.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from panoexec import __version__
from panoexec.clock import Clock, work
from panoexec.codec import decode, encode
from panoexec.devices import Camera, Gimbal, Severity, Vehicle
from panoexec.errors import MissionError, UsageError
from panoexec.inputs.plan_file import plan_from_data, plan_to_data, write_plan
from panoexec.mission.executor import Mission
from panoexec.mission.log.events import Event, EventSink
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import FINISHED
from panoexec.mission.pilot_messages import PilotMessage, PilotMessenger
from panoexec.mission.protocols import Journal
from panoexec.mission.settings import MissionSettings
from panoexec.mission.verifier import ThreadedVerifier
from panoexec.mission.waiting import first_failure
from panoexec.planning.model import Plan
from panoexec.store.directory import MissionDirectory, new_mission_directory
from panoexec.store.journal import WRITTEN_BY, JournalFileError, SqliteJournal, read_journal
from panoexec.store.manifest import ManifestWriter


class NotResumableError(UsageError):
    """A mission that is over, and cannot be resumed; nothing was changed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Devices:
    """What a mission is flown with."""

    gimbal: Gimbal
    camera: Camera
    vehicle: Vehicle


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredMission:
    """A mission as its journal tells it, to go on with it.

    Attributes:
        directory: where it lives.
        journal: open; whoever has this closes it.
        plan: as it began.
        settings: as it began.
        extra: what its owner stored beside (the daemon, the dry-run).
        events: everything that happened.
    """

    directory: MissionDirectory
    journal: SqliteJournal
    plan: Plan
    settings: MissionSettings
    extra: Mapping[str, Any]
    events: tuple[Event, ...]


async def create_mission(
    storage: Path, *, plan: Plan, settings: MissionSettings, now_utc_s: float, extra: Mapping[str, Any] | None = None
) -> StoredMission:
    """Make the directory of a new mission, with its plan and its journal.

    Args:
        storage: the mission gets a directory below `missions` in it.
        plan: to be flown.
        settings: how.
        now_utc_s: names the mission.
        extra: kept beside, as JSON.

    Raises:
        UsageError: it cannot be written.
    """
    directory = await asyncio.to_thread(new_mission_directory, storage, now_utc_s=now_utc_s)
    await asyncio.to_thread(write_plan, directory.plan, plan)
    head = {
        "mission_id": directory.mission_id,
        WRITTEN_BY: __version__,
        "plan": json.dumps(plan_to_data(plan)),
        "settings": json.dumps(encode(settings)),
        "extra": json.dumps(dict(extra or {})),
    }
    journal = await SqliteJournal.create(directory.journal, head)
    return StoredMission(
        directory=directory, journal=journal, plan=plan, settings=settings, extra=dict(extra or {}), events=()
    )


async def open_mission(directory: MissionDirectory) -> StoredMission:
    """Open a mission to go on with it.

    Raises:
        NotResumableError: it is over.
        JournalFileError: no journal, or one that cannot be used.
        InputFileError: the plan in it is wrong.
    """
    # looked at before it is opened to be written: that folds in what a killed process left beside it, and what is
    # refused must be left as it is
    head, events = await asyncio.to_thread(read_journal, directory.journal)
    try:
        plan_data = json.loads(head["plan"])
        settings = decode(MissionSettings, json.loads(head["settings"]))
        extra = json.loads(head["extra"])
    except (KeyError, ValueError) as error:
        raise JournalFileError(f"{directory.journal}: damaged ({error}); it was left as it is") from error
    plan = plan_from_data(plan_data, source=f"{directory.journal} (plan)").plan()
    _check_resumable(directory, plan, events)
    journal = await SqliteJournal.open(directory.journal)
    return StoredMission(
        directory=directory, journal=journal, plan=plan, settings=settings, extra=extra, events=tuple(events)
    )


def _check_resumable(directory: MissionDirectory, plan: Plan, events: list[Event]) -> None:
    try:
        record = MissionRecord.from_events(mission_id=directory.mission_id, shots=plan.shots, events=events)
    except (MissionError, ValueError, LookupError) as error:
        raise JournalFileError(f"{directory.journal}: damaged ({error}); it was left as it is") from error
    if record.state in FINISHED:
        raise NotResumableError(
            f"{directory.path}: the mission is {record.state} ({record.reason}) and cannot be resumed; start a new one"
        )


class _Sinks:
    """Hands events to several sinks."""

    def __init__(self, *sinks: EventSink) -> None:
        self._sinks = sinks

    def publish(self, event: Event) -> None:
        for sink in self._sinks:
            sink.publish(event)


class MissionSession:
    """A stored mission and the devices to fly it with.

    Attributes:
        stored: directory, plan, settings, past.
        mission: the executor; its verbs may be used while `run` is under way.
    """

    def __init__(
        self, *, stored: StoredMission, mission: Mission, manifest: ManifestWriter, voice: PilotMessenger
    ) -> None:
        self.stored = stored
        self.mission = mission
        self._manifest = manifest
        self._messenger = voice

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
    ) -> AsyncIterator[Self]:
        """The session while the block runs; at its end the manifest is written and the journal closed.

        Args:
            stored: from `create_mission` or `open_mission`; its journal is closed at the end.
            devices: to fly with.
            clock: the mission's time.
            sink: gets the events.
            vehicle: what the manifest says of the vehicle, as JSON.
            reference: for a new mission, what yaw 0 means.
            settings: instead of the stored ones.
        """
        sinks: list[EventSink] = []
        try:
            mission = Mission(
                mission_id=stored.directory.mission_id,
                plan=stored.plan,
                settings=settings or stored.settings,
                gimbal=devices.gimbal,
                camera=devices.camera,
                vehicle=devices.vehicle,
                clock=clock,
                journal=_Announced(stored.journal, clock),
                sink=_Sinks(_Late(sinks), sink),
                verifier=ThreadedVerifier(plan=stored.plan),
                reference=reference,
                past=stored.events,
            )
            writer = ManifestWriter(
                path=stored.directory.manifest,
                plan=stored.plan,
                record=mission.record,
                vehicle=vehicle,
                clock=clock,
                certificate=lambda: mission.certificate,
                battery=lambda: devices.vehicle.status.battery_frac,
            )
            voice = PilotMessenger(vehicle=devices.vehicle, record=mission.record)
            sinks += [writer, voice]
            yield cls(stored=stored, mission=mission, manifest=writer, voice=voice)
        finally:
            await stored.journal.close()

    async def run(self) -> MissionRecord:
        """Fly; the manifest is up to date when this ends, however it ends.

        Raises:
            MissionError: the journal failed.
            UsageError: the manifest cannot be written.
        """
        try:
            async with asyncio.TaskGroup() as group:
                beside = [
                    group.create_task(self._manifest.run(), name="manifest"),
                    group.create_task(self._messenger.run(), name="words to the pilot"),
                ]
                record = await self.mission.run()
                for task in beside:
                    task.cancel()
        except BaseException as failure:
            if not isinstance(failure, asyncio.CancelledError):
                self._messenger.send(PilotMessage("stopped by an error, gimbal is free", Severity.ERROR))
            await self._messenger.flush()
            with suppress(UsageError):  # what went wrong first is what counts
                await self._manifest.write()
            if isinstance(failure, BaseExceptionGroup):
                raise first_failure(failure) from None
            raise
        await self._messenger.flush()
        await self._manifest.write()
        return record


class _Announced:
    """A journal of whose work the clock knows."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal, self._clock = journal, clock

    async def append(self, events: Sequence[Event]) -> None:
        """See `Journal.append`."""
        with work(self._clock):
            await self._journal.append(events)


class _Late:
    """A sink that is there before those are that read the mission's record."""

    def __init__(self, targets: list[EventSink]) -> None:
        self._targets = targets

    def publish(self, event: Event) -> None:
        for sink in self._targets:
            sink.publish(event)
