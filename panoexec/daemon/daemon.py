"""The composition of the daemon: every link, every mission, every sign of life, in one task group."""

from __future__ import annotations

import asyncio
import math
import signal
import time
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Final, Protocol

import structlog

from panoexec.clock import Clock
from panoexec.daemon.commands import Commands
from panoexec.daemon.missions import Missions
from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.daemon.storage import storage_trouble
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.errors import PanoexecError
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import plan_to_data
from panoexec.logs import configure_logs
from panoexec.mission.log.events import Event
from panoexec.mission.log.shot_marks import ShotMarks
from panoexec.mission.log.states import MissionState
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink
from panoexec.mqtt.messages import State, dump, dump_json
from panoexec.mqtt.requests import RefusedRequestError
from panoexec.mqtt.transactions import Transactions
from panoexec.planning.model import Plan

FLYING: Final = frozenset({MissionState.PREFLIGHT, MissionState.CAPTURING, MissionState.PAUSED, MissionState.FINISHING})

_BEAT_S: Final = 1.0
_IDLE_BEAT_S: Final = 15.0
_STUCK_S: Final = 45.0
_STOP_S: Final = 60.0
_FAREWELL_S: Final = 5.0
_STORAGE_S: Final = 15.0
_RELOADABLE: Final = ("gimbal", "camera", "pointing", "guards", "mission", "log")

_log = structlog.get_logger(__name__)


class _Stopped(Exception):  # noqa: N818  (a signal, not an error)
    """Ends the task group."""


def _end() -> None:
    raise _Stopped


class Reloader(Protocol):
    """Reads the configuration again."""

    def __call__(self) -> Config:
        """The new configuration.

        Raises:
            PanoexecError: it is wrong; the old one stays in force.
        """
        ...


class Daemon:
    """Runs until `stop`.

    Args:
        config: checked.
        clock: of missions.
        reload: reads the configuration again at SIGHUP.
        notifier: to the service manager.
    """

    def __init__(self, config: Config, *, clock: Clock, reload: Reloader, notifier: SystemdNotifier) -> None:
        self.boot_id = uuid.uuid4().hex
        self.config = config
        self._clock = clock
        self._reload = reload
        self._notifier = notifier
        self._stopping = asyncio.Event()
        self._changed = asyncio.Event()
        self._seq = 0
        self._beat_s = time.monotonic()
        self._published_plan: Plan | None = None
        self._marks = ShotMarks()
        self._storage_trouble = ""
        self._taken_up = False
        self.vehicle = VehicleLink(config, clock=clock, changed=self._changed.set)
        self.missions = Missions(config=lambda: self.config, clock=clock, sink=self, changed=self._mission_changed)
        self.mqtt: MqttLink | None = None
        self._mqtt_task: asyncio.Task[None] | None = None
        self._commands: Commands | None = None

    # --- life

    def stop(self) -> None:
        """End after the current exposure."""
        self._stopping.set()

    async def run(self) -> None:
        """Run until `stop`, or SIGTERM, or SIGINT.

        Raises:
            UsageError: the storage cannot be used, and not because it is full or read-only.
        """
        transactions = await Transactions.open(
            self.config.storage.path / "transactions.sqlite", boot_id=self.boot_id, patient=True
        )
        loop = asyncio.get_running_loop()
        handlers: dict[signal.Signals, Callable[[], None]] = {
            signal.SIGTERM: self.stop,
            signal.SIGINT: self.stop,
            signal.SIGHUP: self.reload,
        }
        for number, handler in handlers.items():
            loop.add_signal_handler(number, handler)
        try:
            async with asyncio.TaskGroup() as group:
                await self._start(group, transactions)
                await self._stopping.wait()
                await self._farewell()
                _end()
        except* _Stopped:
            pass
        finally:
            for number in handlers:
                loop.remove_signal_handler(number)
            await transactions.close()

    async def _start(self, group: asyncio.TaskGroup, transactions: Transactions) -> None:
        if self.config.mqtt.host is not None:
            self.mqtt = MqttLink(
                self.config.mqtt,
                vehicle=self.config.vehicle.id,
                on_request=self._take,
                on_connected=self._changed.set,
            )
        self._commands = Commands(
            config=lambda: self.config,
            missions=self.missions,
            vehicle=self.vehicle,
            transactions=transactions,
            group=group,
            respond=self._respond,
            refresh=self._refresh,
        )
        go_on = await self._look_at_storage(transactions)
        self._publish_plan()
        self._publish_state()
        if self.mqtt is not None:
            self._mqtt_task = group.create_task(self.mqtt.run(), name="mqtt link")
        group.create_task(self.vehicle.run(), name="vehicle link")
        group.create_task(self.missions.run(), name="missions")
        group.create_task(self._publish(), name="state")
        group.create_task(self._keep_looking(group, transactions), name="storage")
        if self._notifier.watchdog_s is not None:
            group.create_task(self._feed_watchdog(self._notifier.watchdog_s), name="watchdog")
        if go_on:
            group.create_task(self._go_on(), name="resume")
        self._notifier.ready(self._status_line())
        _log.info("ready", vehicle=self.config.vehicle.id, boot_id=self.boot_id, broker=self.config.mqtt.host)

    async def _look_at_storage(self, transactions: Transactions) -> bool:
        """See whether missions can be kept; once they can be read, whether to go on with one by ourselves."""
        closed = await transactions.opened()
        trouble = closed or await asyncio.to_thread(storage_trouble, self.config.storage)
        if trouble != self._storage_trouble:
            self._storage_trouble = trouble
            _log.warning("storage failed" if trouble else "storage recovered", trouble=trouble)
            self._changed.set()
        if closed or self._taken_up:
            return False
        self._taken_up = True
        assert self._commands is not None
        await self._commands.restore()
        if self.missions.busy:
            return False
        return await self.missions.find_interrupted() and self.config.mission.resume == "auto"

    async def _keep_looking(self, group: asyncio.TaskGroup, transactions: Transactions) -> None:
        while True:
            await asyncio.sleep(_STORAGE_S)
            if await self._look_at_storage(transactions):
                group.create_task(self._go_on(), name="resume")

    async def _farewell(self) -> None:
        _log.info("stopping")
        self._notifier.stopping("stopping after the current photo")
        self._notifier.extend_timeout(_STOP_S + 2 * _FAREWELL_S)
        try:
            async with asyncio.timeout(_STOP_S):
                await self.missions.interrupted("panoexec was stopped; the mission can be resumed")
        except TimeoutError:
            _log.error("the mission did not stop in time: cancelled")
        if self.mqtt is None:
            return
        self._publish_state()
        self.mqtt.stop()
        if self._mqtt_task is not None:
            await asyncio.wait({self._mqtt_task}, timeout=_FAREWELL_S)

    def reload(self) -> None:
        """Read the configuration again; what cannot change while running is told."""
        self._notifier.reloading(time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000)
        try:
            new = self._reload()
        except PanoexecError as error:
            _log.error("invalid configuration: the previous one remains in force", error=str(error))
        else:
            keep = {name: getattr(self.config, name) for name in type(new).model_fields if name not in _RELOADABLE}
            fixed = [name for name in keep if getattr(new, name) != keep[name]]
            self.config = new.model_copy(update=keep)
            configure_logs(self.config.log.level, self.config.log.format)
            _log.info("configuration reloaded", needs_restart=fixed)
        self._notifier.ready(self._status_line())

    # --- missions

    def publish(self, event: Event) -> None:
        """Take an event of a mission (`EventSink`)."""
        self._marks.note(event)
        where = {name: value for name in ("shot", "attempt") if (value := getattr(event, name, None)) is not None}
        _log.info(event.type, seq=event.seq, mission_id=event.mission_id, state=event.state.value, **where)
        if self.mqtt is not None:
            self.mqtt.publish(self.mqtt.topics.event, dump_json(event.to_json()))
        self._changed.set()

    async def _go_on(self) -> None:
        """Resume the mission in which a process died, as soon as the vehicle is there."""
        commands = self._commands
        assert commands is not None
        while self.missions.offer is not None and await commands.may_go_on_by_itself():
            devices = self.vehicle.devices
            if devices is not None and self.vehicle.links().autopilot.ok:
                try:
                    async with self.missions.claimed():
                        await self.missions.go_on(devices)
                except RefusedRequestError as error:
                    _log.warning("the interrupted mission does not go on", error=error.message)
                return
            await asyncio.sleep(0.5)

    # --- requests

    def _take(self, incoming: Incoming) -> None:
        if self._commands is not None and not self._stopping.is_set():
            self._commands.take(incoming)

    def _respond(self, incoming: Incoming, payload: bytes) -> None:
        if self.mqtt is not None:
            self.mqtt.respond(incoming, payload)

    def _refresh(self) -> dict[str, Any]:
        self._publish_plan(anew=True)
        return self._publish_state().model_dump(mode="json")

    # --- state

    def state(self) -> State:
        """The state as of now."""
        self._seq += 1
        record, mission, offer = self.missions.record, self.missions.mission, self.missions.offer
        offered = offer is not None and mission is None
        battery = self.vehicle.status.battery_frac
        eta = mission.eta_s if mission is not None and record is not None and record.state in FLYING else math.nan
        state, reason = MissionState.IDLE, self._lacking
        if record is not None and not (offered and record.state in FLYING):
            state, reason = record.state, record.reason
        elif offered:
            reason = "the mission was interrupted and can be resumed"
            reason += f": {self.missions.trouble}" if self.missions.trouble else ""
        return State(
            state=state,
            mission_id=None if record is None else record.mission_id,
            shots_total=0 if record is None else record.shots_total,
            shots_done=0 if record is None else record.shots_done,
            attempts=0 if record is None else record.attempts,
            retakes=0 if record is None else record.retakes,
            shots=self._marks.text(record),
            current=record.current if record is not None and mission is not None else None,
            eta_s=round(eta, 1) if math.isfinite(eta) else None,
            reason=reason,
            resumable=offer.stored_id if offered and offer is not None else None,
            link=self.vehicle.links(),
            battery_frac=battery if math.isfinite(battery) else None,
            boot_id=self.boot_id,
            seq=self._seq,
            time=datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        )

    @property
    def _lacking(self) -> str:
        """Why no mission could begin; "" if one could."""
        return "; ".join(part for part in (self.vehicle.lacking, self._storage_trouble) if part)

    def _mission_changed(self) -> None:
        self._publish_plan()
        self._changed.set()

    async def _publish(self) -> None:
        """The state on change, each second while a mission flies, and slowly otherwise."""
        status = ""
        while True:
            self._beat_s = time.monotonic()
            self._changed.clear()
            self._publish_state()
            line = self._status_line()
            if line != status:
                status = line
                self._notifier.status(line)
            beat_s = _BEAT_S if self.missions.busy else _IDLE_BEAT_S
            deadline = time.monotonic() + beat_s
            while not self._changed.is_set() and (left := deadline - time.monotonic()) > 0:
                self._beat_s = time.monotonic()
                try:
                    async with asyncio.timeout(min(left, 5.0)):
                        await self._changed.wait()
                except TimeoutError:
                    continue

    def _publish_state(self) -> State:
        state = self.state()
        if self.mqtt is not None:
            self.mqtt.publish(self.mqtt.topics.state, dump(state), retain=True)
        return state

    def _publish_plan(self, *, anew: bool = False) -> None:
        """The current plan; nothing, if there is none, so that none from before a restart stays."""
        plan = self.missions.plan
        if self.mqtt is None or (plan is self._published_plan and plan is not None and not anew):
            return
        self._published_plan = plan
        payload = b"" if plan is None else dump_json(plan_to_data(plan))
        self.mqtt.publish(self.mqtt.topics.plan, payload, retain=True)

    def _status_line(self) -> str:
        record = self.missions.record
        if record is None or not self.missions.busy:
            return f"idle; {self._lacking or 'vehicle ready'}"
        return f"{record.state.value}: shot {record.shots_done}/{record.shots_total} of {record.mission_id}"

    # --- signs of life

    async def _feed_watchdog(self, period_s: float) -> None:
        """Signs of life, as long as every task that never rests has given one of its own."""
        while True:
            stuck = self.stuck()
            if stuck:
                _log.error("task stalled; watchdog withheld", stuck=stuck)
            else:
                self._notifier.watchdog()
            await asyncio.sleep(period_s / 3)

    def stuck(self) -> list[str]:
        """The tasks that have not moved for too long."""
        now = time.monotonic()
        pulses = {"state": self._beat_s, "vehicle link": self.vehicle.pulse_s}
        if self.mqtt is not None:
            pulses["mqtt link"] = self.mqtt.pulse_s
        return [name for name, pulse_s in pulses.items() if now - pulse_s > _STUCK_S]
