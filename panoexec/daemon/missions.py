"""The daemon's missions, one at a time: begin, resume, run to the end, store."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import structlog

from panoexec.clock import Clock
from panoexec.daemon.beginnings import Beginning, StopCommand
from panoexec.daemon.errors import MissionBusyError, MissionStorageError
from panoexec.daemon.storage import storage_trouble
from panoexec.devices import Severity, Vehicle
from panoexec.errors import PanoexecError, UsageError
from panoexec.inputs.config import Config
from panoexec.mission.executor import Mission
from panoexec.mission.log.events import Event, EventSink
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import ENDED, MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.mission.protocols import PhotoFetcher
from panoexec.mission.settings import MissionSettings
from panoexec.mission.tour_stop import TOUR, TourStop, stop_in
from panoexec.planning.model import Plan
from panoexec.report.mission_outputs import write_mission_outputs
from panoexec.store.catalogue import catalogue
from panoexec.store.directory import mission_directories
from panoexec.store.rebuilding import NAME, VEHICLE, mission_name
from panoexec.store.session import (
    Devices,
    MissionSession,
    NotResumableError,
    StoredMission,
    create_mission,
    open_mission,
)

Reference = Literal["north", "heading"]

REFERENCE: Final = "reference"
"""Extra data that a mission's journal stores: the request that the mission began with."""

_ENDING_S: Final = 30.0
_SAY_S: Final = 3.0

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """An interrupted mission that can be resumed.

    Attributes:
        stored_id: its mission id.
        record: its record so far.
        plan: its plan.
        stop: the stop of a tour that it was flown at (`TourStop.to_json`); None for none.
    """

    stored_id: str
    record: MissionRecord
    plan: Plan
    stop: dict[str, Any] | None = None


class Missions:
    """Runs missions in `run`, which is one task of the daemon; the other methods may be called from any task.

    Attributes:
        record: of the running, the last, or the offered mission; None without one.
        plan: its plan.
        name: its name for people, "" for none.
        mission: the executor while a mission runs.
        beginning: the mission that has the mission slot and does not exist yet.
        offer: the interrupted mission that `resume` continues.
        trouble: the error that ended the last mission; "" for none.
        make_way: awaited before a mission uses the devices: ends whatever else uses them.
        damage: why the newest mission on disk cannot be read; "" for nothing.
        writing: held while files of a mission are written that does not fly.
    """

    def __init__(
        self,
        *,
        config: Callable[[], Config],
        clock: Clock,
        sink: EventSink,
        changed: Callable[[], None],
        fetchers: Callable[[], Sequence[PhotoFetcher]] = tuple,
    ) -> None:
        """Create it.

        Args:
            config: returns the current configuration.
            clock: the mission clock.
            sink: receives the events.
            changed: called when a mission begins or ends.
            fetchers: returns the ways to bring the camera's files here.
        """
        self.record: MissionRecord | None = None
        self.name = ""
        self.plan: Plan | None = None
        self.mission: Mission | None = None
        self.beginning: Beginning | None = None
        self.offer: Offer | None = None
        self.trouble = ""
        self.make_way: Callable[[], Awaitable[None]] = _nothing_in_the_way
        self.damage = ""
        self.writing = asyncio.Lock()
        self._config = config
        self._clock = clock
        self._sink = sink
        self._changed = changed
        self._fetchers = fetchers
        self._next: asyncio.Queue[tuple[StoredMission, Devices, Reference]] = asyncio.Queue()
        self._claimed = False
        self._over = False
        self._unread = False
        self._idle = asyncio.Event()
        self._idle.set()
        self._begun = asyncio.Event()
        self._begun.set()
        self._taken = asyncio.Event()

    @property
    def busy(self) -> bool:
        """Whether a mission runs or is starting."""
        return self._claimed

    @property
    def _ending(self) -> bool:
        begins, flies = self.beginning, self.mission
        return self._over or (begins is not None and begins.ends) or (flies is not None and flies.commands.ending)

    async def idle(self) -> None:
        """Return when no mission runs or is starting, and the files of the last one are written."""
        await self._idle.wait()

    async def taken(self) -> None:
        """Return when a mission runs or is starting."""
        await self._taken.wait()

    def stop(self, command: StopCommand) -> None:
        """Give a stop to the running mission.

        Raises:
            CommandRefusedError: none runs, or its state does not allow it.
        """
        if self.mission is None:
            raise CommandRefusedError(f"cannot {command.verb}: no mission is under way")
        _give(self.mission, command)

    async def under_way(self) -> Mission | None:
        """The running mission; waits for one that is starting, so that it can be commanded at once."""
        await self._begun.wait()
        return self.mission

    def publish(self, event: Event) -> None:
        """Publish an event of the running mission (`EventSink`)."""
        if event.state is not MissionState.IDLE:
            self._begun.set()
        self._over = event.state in ENDED
        self._sink.publish(event)

    def added(self, event: Event) -> None:
        """Publish an event that was appended to the journal of a mission that does not fly."""
        for record in {
            id(record): record for record in (self.record, self.offer and self.offer.record) if record
        }.values():
            if record.mission_id == event.mission_id and record.seq == event.seq - 1:
                record.apply(event)
        self._sink.publish(event)

    @contextlib.asynccontextmanager
    async def claimed(self, beginning: Beginning) -> AsyncIterator[None]:
        """Reserve the mission slot; it is released if the block fails.

        Waits for a mission that is ending: one that was told to end and takes its last photo, releases the gimbal or
        writes its files. So a `start` may follow an answered `abort` at once.

        Args:
            beginning: of the mission that is to have the slot.

        Raises:
            MissionBusyError: a mission flies.
        """
        if self._claimed and self._ending:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_ENDING_S):
                    await self._idle.wait()
        if self._claimed:
            name = self.record.mission_id if self.mission is not None and self.record is not None else "a mission"
            raise MissionBusyError(f"{name} is under way: abort it first, or wait for its end")
        self._claimed, self._over = True, False
        self.beginning = beginning
        self._idle.clear()
        self._taken.set()
        try:
            await self.make_way()
            yield
        except BaseException:
            self._free()
            raise

    async def begin(
        self,
        plan: Plan,
        settings: MissionSettings,
        devices: Devices,
        reference: Reference,
        *,
        name: str = "",
        stop: TourStop | None = None,
    ) -> str:
        """Create a new mission, which people call `name`, and start it; returns its id. Only while `claimed`.

        At a `stop` of a tour it is flown in the stop's flight modes alone.

        Raises:
            MissionStorageError: it cannot be stored.
            CommandRefusedError: it was called off.
        """
        self._commit()
        storage = self._config().storage
        try:
            await asyncio.to_thread(self._check_space)
            stored = await create_mission(
                storage.path,
                plan=plan,
                settings=settings,
                now_utc_s=self._clock.time(),
                extra={REFERENCE: reference, VEHICLE: self._about_vehicle(), NAME: name}
                | ({} if stop is None else {TOUR: stop.to_json()}),
            )
        except PanoexecError as error:
            raise MissionStorageError(str(error)) from error
        self.offer, self.damage = None, ""
        self._next.put_nowait((stored, devices, reference))
        return stored.directory.mission_id

    async def go_on(self, devices: Devices) -> str:
        """Resume the offered mission; returns its id. Only while `claimed`.

        Raises:
            NotResumableError: none is offered, or it cannot be resumed.
            CommandRefusedError: it was called off.
        """
        self._commit()
        if self.offer is None:
            raise NotResumableError("cannot resume: no mission is paused and none was interrupted")
        storage = self._config().storage.path
        directory = next((d for d in mission_directories(storage) if d.mission_id == self.offer.stored_id), None)
        if directory is None:
            raise NotResumableError(f"cannot resume: mission {self.offer.stored_id} is gone from {storage}")
        try:
            async with self.writing:
                stored = await open_mission(directory)
        except PanoexecError as error:
            raise NotResumableError(str(error)) from error
        self.offer = None
        # only relevant if the process died before its first event was on disk
        self._next.put_nowait((stored, devices, "heading" if stored.extra.get(REFERENCE) == "heading" else "north"))
        return directory.mission_id

    async def find_interrupted(self) -> bool:
        """Offer the newest mission on disk if it can be resumed; the newest by its journal, not by its name.

        Returns:
            Whether it may resume automatically: the process died during the mission, and no pause was requested.
        """
        missions = await asyncio.to_thread(catalogue, self._config().storage.path)
        self.damage = ""
        if not missions:
            return False
        newest = missions[-1]
        try:
            if newest.glance is None:
                raise UsageError(newest.problem)
            stored = await open_mission(newest.directory)
        except NotResumableError:
            return False
        except PanoexecError as error:
            # an older one is not offered instead: nobody knows what this one was
            self.damage = f"the newest mission cannot be read: panoexec salvage {newest.directory.path}"
            _log.error("the newest mission cannot be resumed", error=str(error), advice=self.damage)
            return False
        for text in stored.notes:
            _log.warning("journal", mission_id=stored.directory.mission_id, note=text)
        await stored.journal.close()
        name = stored.directory.mission_id
        record = MissionRecord.from_events(mission_id=name, shots=stored.plan.shots, events=stored.events)
        self.offer = Offer(stored_id=name, record=record, plan=stored.plan, stop=stop_in(stored.extra))
        self.record, self.plan, self.name = record, stored.plan, mission_name(stored.extra)
        _log.info("an interrupted mission can be resumed", mission_id=name, state=record.state.value)
        return record.state is not MissionState.FAILED and not record.asked.pause

    async def run(self) -> None:
        """Run the missions that begin, one after the other, forever."""
        while True:
            stored, devices, reference = await self._next.get()
            self.trouble = ""
            try:
                await self._flown(stored, devices, reference)
                await self._leave(stored)
            finally:
                self._free()
            await self._offer_again()
            self._changed()

    async def _flown(self, stored: StoredMission, devices: Devices, reference: Reference) -> None:
        """Run a mission to its end, successful or not."""
        try:
            await self._fly(stored, devices, reference)
        except (PanoexecError, ValueError, OSError) as error:
            self.trouble = str(error)
            _log.error("mission ended by an error", mission_id=stored.directory.mission_id, error=str(error))
            await self._tell_pilot(devices.vehicle)
        except Exception as error:  # noqa: BLE001  (a bug in a mission must not end the daemon)
            self.trouble = f"{type(error).__name__}: {error}"
            _log.exception("mission ended by an internal error", mission_id=stored.directory.mission_id)
            await self._tell_pilot(devices.vehicle)
        finally:
            self.mission, self._over = None, True

    async def _tell_pilot(self, vehicle: Vehicle) -> None:
        """Announce the end of a mission whose journal failed, which cannot do so itself (STATUSTEXT, 253)."""
        with contextlib.suppress(PanoexecError, TimeoutError):
            async with asyncio.timeout(_SAY_S):
                await vehicle.say(f"Pano: ended by an error: {self.trouble}", Severity.ERROR)

    async def _leave(self, stored: StoredMission) -> None:
        """Write the mission's outputs while the mission slot is still reserved: a stop waits for it."""
        try:
            async with self.writing:
                await asyncio.to_thread(write_mission_outputs, stored.directory)
        except (PanoexecError, ValueError, OSError) as error:
            _log.error("mission outputs could not be written", mission_id=stored.directory.mission_id, error=str(error))

    async def _fly(self, stored: StoredMission, devices: Devices, reference: Reference) -> None:
        opened = MissionSession.opened(
            stored,
            devices=devices,
            clock=self._clock,
            sink=self,
            vehicle=self._about_vehicle(),
            reference=reference,
            fetchers=self._fetchers(),
        )
        with structlog.contextvars.bound_contextvars(mission_id=stored.directory.mission_id):
            async with opened as session:
                self.mission, self.record, self.plan = session.mission, session.mission.record, stored.plan
                self.name = mission_name(stored.extra)
                self._give_stops(session.mission)
                self._changed()
                record = await session.run()
                _log.info("mission ended", state=record.state.value, reason=record.reason)

    def _about_vehicle(self) -> dict[str, str]:
        section = self._config().vehicle
        return {"id": section.id, "connection": section.connection or f"serial {section.serial}"}

    async def _offer_again(self) -> None:
        """Offer a failed or interrupted mission for resuming in this process."""
        record = self.record
        if record is not None and record.state in (MissionState.FAILED, MissionState.PAUSED):
            await self.find_interrupted()
            self._unread = self.offer is None

    async def look_again(self) -> None:
        """Offer the mission that a failed storage has ended, if it could not be read then."""
        if self._unread and not self._claimed:
            await self.find_interrupted()
            self._unread = self.offer is None
            self._changed()

    async def interrupted(self, reason: str) -> None:
        """Stop the mission after the current photo and return when it is on disk; it can be resumed."""
        command = StopCommand("interrupt", reason)
        if self.beginning is not None:
            self.beginning.stop(command)
        with contextlib.suppress(CommandRefusedError):
            self.stop(command)
        if self._claimed:
            await self._idle.wait()

    def _commit(self) -> None:
        """From here on, the mission is created: stops are kept for it, and other commands wait for it."""
        assert self.beginning is not None
        self.beginning.commit()
        self._begun.clear()

    def _give_stops(self, mission: Mission) -> None:
        """Give the mission the stops that arrived before it existed."""
        beginning, self.beginning = self.beginning, None
        for command in beginning.stops if beginning is not None else ():
            _give(mission, command)

    def _free(self) -> None:
        self._claimed = False
        self.beginning = None
        self._taken.clear()
        self._idle.set()
        self._begun.set()

    def _check_space(self) -> None:
        storage = self._config().storage
        storage.path.mkdir(parents=True, exist_ok=True)
        trouble = storage_trouble(storage)
        if trouble:
            raise MissionStorageError(trouble)


async def _nothing_in_the_way() -> None:
    """Nobody else uses the devices."""


def _give(mission: Mission, command: StopCommand) -> None:
    commands = mission.commands
    match command.verb:
        case "abort":
            commands.abort(command.reason, by=command.by)
        case "finish":
            commands.finish(command.reason, by=command.by)
        case "pause":
            commands.pause(command.reason, by=command.by)
        case "interrupt":
            commands.interrupt(command.reason)
