"""The connection to autopilot, gimbal and camera: kept open, and reopened after losses, while the daemon runs."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import structlog

from panoexec.adapters.autopilot_mission import MISSION_STREAM, AutopilotMission
from panoexec.adapters.camera.camera_kind import OpenCamera
from panoexec.adapters.camera.open_camera import open_camera
from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.command_inbox import CommandInbox, Result
from panoexec.adapters.link.connection_url import ConnectionUrl
from panoexec.adapters.link.first_heartbeats import OpenedConnection
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.serial_ports import connection_of
from panoexec.adapters.link.stream_health import DEFAULT_STREAMS, POSITION, Stream
from panoexec.adapters.linked_vehicle import LinkedVehicle, file_hosts, linked_vehicle
from panoexec.adapters.mavsdk_vehicle import MavsdkVehicle
from panoexec.adapters.rc_switches import RC_STREAM, RcSwitches
from panoexec.clock import Clock
from panoexec.daemon.errors import VehicleNotReadyError
from panoexec.daemon.station_requests import StationRequests
from panoexec.devices import VehicleStatus
from panoexec.errors import DeviceError
from panoexec.inputs.config import Config
from panoexec.mqtt.messages import LinkFields, LinksFields
from panoexec.planning.model import TurnLimits
from panoexec.store.session import Devices

_FIND_S: Final = 8.0
_BACKOFF_S: Final = 1.0
_BACKOFF_MOST_S: Final = 15.0
_GIMBAL_SILENT_S: Final = 3.0
_LOOK_S: Final = 1.0
_NAMES: Final = ("autopilot", "gimbal", "camera")

_log = structlog.get_logger(__name__)


class _ReconfiguredError(Exception):
    """Gimbal or camera are configured differently from what the link was opened with."""


class VehicleLink:
    """Opens the link, discovers gimbal and camera, and retries forever; `run` it in a task.

    Attributes:
        devices: the devices for missions; None until all were found.
        reason: what is missing, "" if nothing is.
        pulse_s: time.monotonic of the task's last progress, for the watchdog.
        station_requests: executes the commands of MAVLink ground stations; None: nobody does.
        autopilot_mission: what the autopilot flies; None without `[stations]`, and while the link is closed.
    """

    def __init__(
        self,
        config: Callable[[], Config],
        *,
        clock: Clock,
        changed: Callable[[], None] = lambda: None,
        in_use: Callable[[], bool] = lambda: False,
        opened: OpenedConnection | None = None,
    ) -> None:
        """Create it.

        Args:
            config: returns the daemon's configuration as of now. The link is opened again when that of gimbal or
                camera changes.
            clock: the mission clock.
            changed: called when a link is established or lost.
            in_use: whether a mission needs the devices as they are.
            opened: the connection, if it is open already.
        """
        self.devices: Devices | None = None
        self.reason = "not connected yet"
        self.pulse_s = time.monotonic()
        self.station_requests: StationRequests | None = None
        self.autopilot_mission: AutopilotMission | None = None
        self._newest = config
        self._in_use = in_use
        self._config = config()
        self._clock = clock
        self._changed = changed
        self._opened = opened
        self._submitted: set[asyncio.Future[Result]] = set()
        self._linked: LinkedVehicle | None = None
        self._link: MavsdkLink | None = None
        self._gimbal: MavsdkGimbal | None = None
        self._camera: OpenCamera | None = None
        self._vehicle: MavsdkVehicle | None = None
        self._turn_limits = TurnLimits()
        self._oks: tuple[bool, ...] = ()
        self._doubt = ""
        self._url: ConnectionUrl | None = None

    @property
    def file_hosts(self) -> tuple[str, ...]:
        """The hosts that may serve the camera's photos."""
        return () if self._url is None else file_hosts(self._config, self._url)

    @property
    def status(self) -> VehicleStatus:
        """Status of the vehicle, unknown without one."""
        return VehicleStatus() if self._vehicle is None else self._vehicle.status

    @property
    def turn_limits(self) -> TurnLimits:
        """How fast the autopilot turns the vehicle; as it was told last, unknown if the vehicle does not pan."""
        return self._turn_limits

    @property
    def _channels(self) -> dict[int, Callable[[], None]]:
        """What the switches of the transmitter do."""
        rc, requests = self._config.rc, self.station_requests
        if requests is None:
            return {}
        start = {} if rc.preset is None else {"preset": rc.preset}
        actions = {rc.start_channel: ("start", start), rc.abort_channel: ("abort", {"reason": "RC switch"})}
        return {
            channel: partial(self._submit, requests, *action)
            for channel, action in actions.items()
            if channel is not None
        }

    def _submit(self, requests: StationRequests, verb: str, fields: dict[str, str]) -> None:
        _log.info("switch of the transmitter", request=verb)
        task = asyncio.ensure_future(requests.submit(verb, fields, by="the transmitter"))
        self._submitted.add(task)
        task.add_done_callback(self._submitted.discard)

    @property
    def linked(self) -> LinkedVehicle | None:
        """The open link and what is on it, for an examination; None while it is closed."""
        return self._linked

    @property
    def camera(self) -> OpenCamera | None:
        """The open camera, found or not; None before the gimbal was found."""
        return self._camera

    def links(self) -> LinksFields:
        """Status of the links to autopilot, gimbal and camera."""
        autopilot, gimbal, camera = (_fields(ok, age_s) for ok, age_s in self._standing())
        return LinksFields(autopilot=autopilot, gimbal=gimbal, camera=camera)

    @property
    def lacking(self) -> str:
        """What is missing, was lost after all devices had been found, or is uncertain; "" for nothing."""
        if self.reason:
            return self.reason
        lost = [name for name, (ok, _) in zip(_NAMES, self._standing(), strict=True) if not ok]
        return "; ".join(part for part in (f"lost: {', '.join(lost)}" if lost else "", self.doubt) if part)

    @property
    def doubt(self) -> str:
        """Why it is not certain that this is the right vehicle, and what to set; "" if it is certain."""
        return "" if self._link is None else self._link.identity.problem

    def _standing(self) -> tuple[tuple[bool, float], tuple[bool, float], tuple[bool, float]]:
        """For autopilot, gimbal and camera: whether the link is up, and seconds since the last message."""
        autopilot = math.inf if self._link is None else self._link.heartbeat_age_s
        gimbal = math.inf if self._gimbal is None else self._gimbal.age_s
        connected = self._link is not None and self._link.connected
        camera = math.inf if self._camera is None else self._camera.age_s
        has_camera = self._camera is not None and self._camera.is_present
        return (
            (connected, autopilot),
            (connected and gimbal < _GIMBAL_SILENT_S, gimbal),
            (connected and has_camera, camera),
        )

    def ready_devices(self) -> Devices:
        """The devices, all of them there.

        Raises:
            VehicleNotReadyError: one is missing, or another vehicle may be meant.
        """
        if self.devices is None or not self.links().autopilot.ok:
            raise VehicleNotReadyError(f"the vehicle is not ready: {self.lacking or 'no heartbeats'}")
        if self.doubt:
            raise VehicleNotReadyError(f"the vehicle is not certain: {self.doubt}")
        return self.devices

    async def run(self) -> None:
        """Keep the link forever."""
        patience_s = _BACKOFF_S
        while True:
            self.pulse_s = began = time.monotonic()
            try:
                await self._hold()
            except DeviceError as error:
                self._missing(str(error))
            except _ReconfiguredError:
                self._missing("gimbal or camera are configured anew: connecting again")
            if time.monotonic() - began > _BACKOFF_MOST_S:
                patience_s = _BACKOFF_S
            await asyncio.sleep(patience_s)
            patience_s = min(2 * patience_s, _BACKOFF_MOST_S)

    async def _hold(self) -> None:
        """One link, until it fails permanently or is configured otherwise."""
        self._config = self._newest()
        self._url = url = await asyncio.to_thread(connection_of, self._config.vehicle)
        opened, self._opened = self._opened, None
        # idle streams are checked once per second of real time, which is a long silence at a speed-up
        throttling = getattr(self._clock, "speedup", 1.0) <= 1.0
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(self._forget)
            linked = await stack.enter_async_context(
                linked_vehicle(
                    self._config,
                    url,
                    clock=self._clock,
                    patient=True,
                    throttling=throttling,
                    opened=opened,
                    guarded=True,
                    streams=self._streams(),
                )
            )
            link = linked.link
            self._linked, self._link, self._gimbal, self._vehicle = linked, link, linked.gimbal, linked.vehicle
            if self.station_requests is not None:
                inbox = CommandInbox(
                    link,
                    commanders=self._config.vehicle.commanders,
                    execute=self.station_requests.execute,
                    stops=self.station_requests.stops,
                )
                serving = asyncio.create_task(inbox.run(), name="station commands")
                stack.push_async_callback(_ended, serving)
                stack.callback(RcSwitches(link, self._channels).close)
            if self._config.stations.enabled:
                self.autopilot_mission = await stack.enter_async_context(AutopilotMission(link))
            await self._find(link, self._gimbal)
            self._camera = await stack.enter_async_context(
                open_camera(self._config.camera, link, spool=self._config.storage.path / "incoming")
            )
            await self._find_camera(self._camera)
            if self._config.gimbal.yaw != "gimbal":
                self._turn_limits = await linked.vehicle.turn_limits()
            await link.use_rates(active=False)
            self.devices = Devices(gimbal=self._gimbal, camera=self._camera, vehicle=self._vehicle)
            self.reason = ""
            _log.info("vehicle ready", url=str(url))
            self._changed()
            while True:
                self._look()
                await asyncio.sleep(_LOOK_S)

    def _streams(self) -> tuple[Stream, ...]:
        rc = (RC_STREAM,) if self._channels else ()
        if not self._config.stations.enabled:
            return (*DEFAULT_STREAMS, *rc)
        # an arrival at a station is seen by the position
        often = (replace(one, idle_rate_hz=one.rate_hz) if one.name == POSITION else one for one in DEFAULT_STREAMS)
        return (*often, *rc, MISSION_STREAM)

    async def say(self, text: str) -> None:
        """Send text to the ground stations, if there is a link."""
        if self._link is not None:
            await self._link.requests.say(text)

    async def _find(self, link: MavsdkLink, gimbal: MavsdkGimbal) -> None:
        """Return when autopilot and gimbal are found."""
        while True:
            self._look()
            try:
                await link.wait_autopilot(_FIND_S)
                self._look()
                await gimbal.discover(_FIND_S)
            except DeviceError as error:
                self._missing(str(error))
            else:
                return

    async def _find_camera(self, camera: OpenCamera) -> None:
        """Return when the camera is there."""
        while True:
            self._look()
            try:
                await camera.discover(_FIND_S)
            except DeviceError as error:
                self._missing(str(error))
            else:
                return

    def _look(self) -> None:
        """Update the watchdog pulse and report changes.

        Raises:
            _ReconfiguredError: the link is to be opened again.
        """
        self.pulse_s = time.monotonic()
        now, opened = self._newest(), self._config
        if (now.gimbal, now.camera) != (opened.gimbal, opened.camera) and not self._in_use():
            raise _ReconfiguredError
        if self._gimbal is not None:
            self._gimbal.feed.ingest()  # while nobody else reads, on the loop's own wake-ups
        oks, doubt = tuple(ok for ok, _ in self._standing()), self.doubt
        if oks != self._oks:
            self._oks = oks
            _log.info("links", autopilot=oks[0], gimbal=oks[1], camera=oks[2])
            self._changed()
        if doubt != self._doubt:
            self._doubt = doubt
            self._changed()

    def _missing(self, reason: str) -> None:
        if reason != self.reason:
            _log.warning("vehicle not ready", reason=reason)
            self.reason = reason
            self._changed()

    def _forget(self) -> None:
        self._linked = self.autopilot_mission = None
        self.devices = self._link = self._gimbal = self._camera = self._vehicle = None


async def _ended(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def _fields(ok: bool, age_s: float) -> LinkFields:
    return LinkFields(ok=ok, age_s=round(age_s, 3) if math.isfinite(age_s) else None)
