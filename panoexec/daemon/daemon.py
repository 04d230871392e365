"""The composition of the daemon: what it consists of, and the order in which that starts and stops."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import uuid
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import structlog

from panoexec.adapters.link.first_heartbeats import OpenedConnection
from panoexec.clock import Clock
from panoexec.daemon.auto_resume import AutoResume
from panoexec.daemon.camera_files import CameraFiles
from panoexec.daemon.commands import Commands
from panoexec.daemon.event_publisher import EventPublisher
from panoexec.daemon.examination import Examination
from panoexec.daemon.landed_photos import LandedPhotos
from panoexec.daemon.live_config import LiveConfig, Reloader
from panoexec.daemon.missions import Missions
from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.daemon.state_publisher import TWIN, StatePublisher
from panoexec.daemon.station_requests import StationRequests
from panoexec.daemon.stations.watcher import Stations
from panoexec.daemon.storage import StorageMonitor
from panoexec.daemon.thumbnails import Thumbnails
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.daemon.watchdog import Watchdog
from panoexec.inputs.config import Config
from panoexec.mission.log.events import Event
from panoexec.mqtt.discovery import discovery_messages
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink
from panoexec.mqtt.requests import RefusedRequestError, Request
from panoexec.mqtt.transactions import Transactions

_STOP_S: Final = 60.0
_FLUSH_S: Final = 5.0
_MOVING: Final = frozenset({"start", "resume"})

_log = structlog.get_logger(__name__)


class _Stopped(Exception):  # noqa: N818  (a signal, not an error)
    """Ends the task group."""


def _end() -> None:
    raise _Stopped


class Daemon:
    """Runs until `stop`.

    Attributes:
        vehicle: connection to the vehicle and its payload.
        missions: runs missions, one at a time.
        mqtt: broker connection; None if no broker is configured.
    """

    def __init__(
        self,
        config: Config,
        *,
        clock: Clock,
        reload: Reloader,
        notifier: SystemdNotifier,
        vehicle: VehicleLink | None = None,
        config_file: Path = Path("config.toml"),
        opened: OpenedConnection | None = None,
    ) -> None:
        """Create the components that do not need the storage.

        Args:
            config: checked.
            clock: of missions.
            reload: reads the configuration again at SIGHUP.
            notifier: to the service manager.
            vehicle: in place of the one that the configuration describes.
            config_file: the configuration's file, for advice.
            opened: the connection to the vehicle, if it is open already.
        """
        self._boot_id = uuid.uuid4().hex
        self._notifier = notifier
        self._clock = clock
        self._stopping = asyncio.Event()
        self._changed = asyncio.Event()
        self._config = LiveConfig(config, read=reload, notifier=notifier, status_line=self._status_line)
        self._commands: Commands | None = None
        self._storage: StorageMonitor | None = None
        self.mqtt: MqttLink | None = None
        if config.mqtt.host is not None:
            self.mqtt = MqttLink(
                config.mqtt,
                vehicle=config.vehicle.id,
                on_request=self._take,
                on_connected=self._connected,
                boot_id=self._boot_id,
            )
        self.vehicle = vehicle or VehicleLink(
            self._config, clock=clock, changed=self._changed.set, in_use=lambda: self.missions.busy, opened=opened
        )
        self._thumbnails = Thumbnails(config=self._config, mqtt=self.mqtt)
        self._stations: Stations | None = None
        events = EventPublisher(mqtt=self.mqtt, changed=self._changed.set, beside=self._beside)
        self._files = CameraFiles(self._config, self.vehicle)
        self.missions = Missions(
            config=self._config,
            clock=clock,
            sink=events,
            changed=self._mission_changed,
            fetchers=self._files.fetchers,
        )
        self._examination = Examination(
            config=self._config, config_file=config_file, missions=self.missions, vehicle=self.vehicle
        )
        self._files.in_flight = lambda: self.missions.busy
        self._landed = LandedPhotos(config=self._config, missions=self.missions, files=self._files)
        self._publisher = StatePublisher(
            boot_id=self._boot_id,
            missions=self.missions,
            vehicle=self.vehicle,
            marks=events.marks,
            storage_trouble=lambda: "" if self._storage is None else self._storage.trouble,
            mqtt=self.mqtt,
            notifier=notifier,
            changed=self._changed,
            tour=lambda: None if self._stations is None else self._stations.fields(),
        )
        pulses: dict[str, Callable[[], float]] = {
            "state": lambda: self._publisher.pulse_s,
            "vehicle link": lambda: self.vehicle.pulse_s,
        }
        if (mqtt := self.mqtt) is not None:
            pulses["mqtt link"] = lambda: mqtt.pulse_s
        self.vehicle.station_requests = StationRequests(
            config=self._config, take=self._take, say=self.vehicle.say, boot_id=self._boot_id
        )
        self._watchdog = Watchdog(notifier=notifier, pulses=pulses)
        self._mqtt_task: asyncio.Task[None] | None = None

    def stop(self) -> None:
        """End after the current exposure."""
        self._stopping.set()

    async def run(self) -> None:
        """Run until `stop`, or SIGTERM, or SIGINT.

        Raises:
            UsageError: the storage cannot be used, and not because it is full or read-only.
        """
        path = self._config().storage.path / "transactions.sqlite"
        transactions = await Transactions.open(path, boot_id=self._boot_id, patient=True)
        handlers = {signal.SIGTERM: self.stop, signal.SIGINT: self.stop, signal.SIGHUP: self._config.reload}
        try:
            with _handling(handlers):
                async with asyncio.TaskGroup() as group:
                    await self._start(group, transactions)
                    await self._stopping.wait()
                    await self._shut_down()
                    _end()
        except* _Stopped:
            pass
        finally:
            await self._files.close()
            await transactions.close()

    async def _start(self, group: asyncio.TaskGroup, transactions: Transactions) -> None:
        self._commands = Commands(
            config=self._config,
            missions=self.missions,
            vehicle=self.vehicle,
            transactions=transactions,
            group=group,
            respond=self._respond,
            refresh=self._refresh,
            examine=self._examination.run,
            thumbnails=self._thumbnails,
            check=self._check_alone,
        )
        resume = AutoResume(
            config=self._config, missions=self.missions, vehicle=self.vehicle, commands=self._commands, group=group
        )
        self._stations = Stations(
            config=self._config,
            vehicle=self.vehicle,
            missions=self.missions,
            take=self._take,
            plan_of=self._commands.plan_of_preset,
            clock=self._clock,
            changed=self._changed.set,
            boot_id=self._boot_id,
        )
        self._storage = StorageMonitor(
            section=lambda: self._config().storage,
            transactions=transactions,
            changed=self._changed.set,
            on_readable=resume.storage_readable,
            on_recovered=self.missions.look_again,
        )
        await self._storage.check()
        self._publisher.publish_plan()
        self._publisher.publish_state()
        if self.mqtt is not None:
            self._mqtt_task = group.create_task(self.mqtt.run(), name="mqtt link")
        group.create_task(self.vehicle.run(), name="vehicle link")
        group.create_task(self.missions.run(), name="missions")
        group.create_task(self._landed.run(), name="photos of landed missions")
        group.create_task(self._thumbnails.run(), name="thumbnails")
        group.create_task(self._stations.run(), name="stations")
        group.create_task(self._publisher.run(), name="state")
        group.create_task(self._storage.run(), name="storage")
        group.create_task(self._watchdog.run(), name="watchdog")
        self._notifier.ready(self._publisher.status_line())
        config = self._config()
        _log.info("ready", vehicle=config.vehicle.id, boot_id=self._boot_id, broker=config.mqtt.host)

    async def _shut_down(self) -> None:
        """Interrupt the mission after its photo, then publish the last state."""
        _log.info("stopping")
        self._notifier.stopping("stopping after the current photo")
        self._notifier.extend_timeout(_STOP_S + 2 * _FLUSH_S)
        if self._commands is not None:
            self._commands.stopping.call_off()
        await self._landed.make_way()
        try:
            async with asyncio.timeout(_STOP_S):
                await self.missions.interrupted("panoexec was stopped; the mission can be resumed")
        except TimeoutError:
            _log.error("mission did not stop in time; exiting", timeout_s=_STOP_S)
        if self.mqtt is None:
            return
        self._publisher.publish_state()
        self.mqtt.stop()
        if self._mqtt_task is not None:
            await asyncio.wait({self._mqtt_task}, timeout=_FLUSH_S)

    # --- callbacks between components

    def _connected(self) -> None:
        config = self._config()
        if self.mqtt is not None and config.mqtt.discovery:
            # at each connection: a broker that was restarted may have forgotten it
            for topic, payload in discovery_messages(self.mqtt.topics, config.vehicle.id):
                self.mqtt.publish(topic, payload, retain=True)
        self._changed.set()

    def _take(self, incoming: Incoming) -> None:
        if self._commands is not None and not self._stopping.is_set():
            self._commands.take(incoming)

    def _beside(self, event: Event) -> None:
        self._thumbnails.publish(event)
        if self._stations is not None:
            self._stations.heard(event)

    def _check_alone(self, request: Request) -> None:
        """Refuse to begin a mission while another daemon gets the same requests, and would begin one too."""
        if request.command in _MOVING and self.mqtt is not None and self.mqtt.twin:
            raise RefusedRequestError("refused", TWIN)

    def _respond(self, incoming: Incoming, payload: bytes) -> None:
        if incoming.reply is not None:
            incoming.reply(payload)
        elif self.mqtt is not None:
            self.mqtt.respond(incoming, payload)

    def _refresh(self) -> dict[str, Any]:
        return self._publisher.publish_all().model_dump(mode="json")

    def _status_line(self) -> str:
        return self._publisher.status_line()

    def _mission_changed(self) -> None:
        if self._storage is not None and self.missions.trouble:
            self._storage.check_soon()
        self._publisher.publish_plan()
        self._changed.set()


@contextlib.contextmanager
def _handling(handlers: Mapping[signal.Signals, Callable[[], None]]) -> Iterator[None]:
    """Handle signals on the running loop while the block runs."""
    loop = asyncio.get_running_loop()
    for number, handler in handlers.items():
        loop.add_signal_handler(number, handler)
    try:
        yield
    finally:
        for number in handlers:
            loop.remove_signal_handler(number)
