"""The connection to an autopilot: opens it, finds the autopilot, reconnects, and requests streams again after a reboot.

`MavsdkLink` recovers by itself: an autopilot may be absent at first, reboot, or disappear; a serial device may be
unplugged. The devices built on it (`MavsdkGimbal`, `MavsdkCamera`, `MavsdkVehicle`) stay valid throughout.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Final, Self

import structlog
from mavsdk.plugins.mavlink_direct import MavlinkDirect

from panoexec.adapters.link.bpf_filter import DatagramFilter
from panoexec.adapters.link.connection_url import ConnectionUrl, parse_connection
from panoexec.adapters.link.file_urls import MESSAGE, FileUrls
from panoexec.adapters.link.first_heartbeats import OpenedConnection
from panoexec.adapters.link.frozen_loop import FrozenLoopGuard
from panoexec.adapters.link.mavsdk_errors import quiet_mavsdk_log
from panoexec.adapters.link.mavsdk_requests import MavsdkRequests
from panoexec.adapters.link.mavsdk_session import MavsdkSession
from panoexec.adapters.link.message_hub import Handler, MavMessage, MessageHub
from panoexec.adapters.link.roster import AutopilotKind, Roster
from panoexec.adapters.link.stream_health import DEFAULT_STREAMS, HEARTBEAT_LOST_S, Stream
from panoexec.adapters.link.stream_keeper import AUTOPILOT, StreamKeeper
from panoexec.adapters.link.vehicle_identity import VehicleIdentity
from panoexec.adapters.link.worker_calls import WorkerCalls
from panoexec.clock import Clock
from panoexec.errors import LinkError

DEFAULT_COMPONENT: Final = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER."""

FAST_STREAMS: Final = ("GIMBAL_DEVICE_ATTITUDE_STATUS", "ATTITUDE")
_GIMBAL_REPORTS: Final = ("GIMBAL_DEVICE_ATTITUDE_STATUS", 285)
_TICK_S: Final = 0.25
_IDLE_TICK_S: Final = 1.0
_DISCOVER_TICK_S: Final = 0.05
_WATCH_S: Final = 1.0
_SILENT_REOPEN_S: Final = 5.0

_log = structlog.get_logger(__name__)


class MavsdkLink:
    """An async context manager around one MAVSDK connection.

    Attributes:
        url: the address of the autopilot.
        clock: of the mission; stamps messages.
        requests: requests to the vehicle.
        streams: the requested message streams.
        components: components of the vehicle with heartbeats: id to (MAV_TYPE, real time of the last heartbeat).
        roster: everybody with heartbeats, other systems too.
        identity: which vehicle this is, and whether that is certain.
        files: which files a camera may name.
    """

    def __init__(
        self,
        url: str | ConnectionUrl,
        *,
        clock: Clock,
        component_id: int = DEFAULT_COMPONENT,
        system_id: int | None = None,
        vehicle_system_id: int | None = None,
        streams: Sequence[Stream] = DEFAULT_STREAMS,
        patient: bool = False,
        throttling: bool = False,
        files: FileUrls | None = None,
        opened: OpenedConnection | None = None,
        guarded: bool = False,
    ) -> None:
        """Create the link; entering the context opens it.

        Args:
            url: the address of the autopilot; see `parse_connection`.
            clock: of the mission.
            component_id: own MAVLink component id, unique on the vehicle.
            system_id: own MAVLink system id; None: that of the vehicle, once it is known.
            vehicle_system_id: the vehicle's system id (`[vehicle] system_id`); None: the first vehicle that is heard.
            streams: messages to request.
            patient: wait for a serial device or a host that is absent when the link is opened, instead of raising.
            throttling: after `use_rates(active=False)`, receive fast streams only once a second of real time.
            files: which files a camera may name; None: none but names on its card.
            opened: the connection, if it is open already.
            guarded: stop the heartbeats while the event loop stands still.

        Raises:
            UsageError: the URL is invalid.
        """
        self.url = parse_connection(url) if isinstance(url, str) else url
        self.clock = clock
        self.components: dict[int, tuple[int, float]] = {}
        self.roster = Roster()
        self.identity = VehicleIdentity(self.roster, pinned=vehicle_system_id)
        self._component = component_id
        self._own_system = system_id if system_id is not None else vehicle_system_id
        self._vehicle_system = vehicle_system_id
        self._patient = patient
        self._throttling = throttling
        self._calls = WorkerCalls("mavsdk")
        self._session = MavsdkSession(self.url, self._calls, opened=opened)
        self._datagram_filter = DatagramFilter(self.url, _GIMBAL_REPORTS[1])
        self._hub = MessageHub(clock, self.post, mute=self._mute)
        self.files = files or FileUrls()
        self._hub.screen(MESSAGE, self.files.screen)
        self.requests = MavsdkRequests(
            self._session,
            self._calls,
            self._hub,
            clock=clock,
            system_id=vehicle_system_id or 1,
            connected=lambda: self.connected,
            post=self.post,
        )
        self.streams = StreamKeeper(
            streams,
            hub=self._hub,
            clock=clock,
            command=self.requests.command,
            rebooted=lambda: self.post(self._came_back),
        )
        self._on_attached: list[Callable[[], None]] = []
        self._on_return: list[Callable[[], None]] = []
        self._found = asyncio.Event()
        self._alive = asyncio.Event()
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._guard = FrozenLoopGuard(self._session.cut) if guarded else None
        self._stack = contextlib.AsyncExitStack()
        self._heartbeat_s = -math.inf
        self._watched_s = -math.inf
        self._conflict_heartbeats = 0
        self._hub.on("HEARTBEAT", self._heartbeat)

    # --- state

    @property
    def connected(self) -> bool:
        """Whether heartbeats of the autopilot arrive."""
        return self.heartbeat_age_s < HEARTBEAT_LOST_S

    @property
    def heartbeat_age_s(self) -> float:
        """Real seconds since the autopilot's last heartbeat; infinity before the first."""
        return time.monotonic() - self._heartbeat_s

    @property
    def boot_count(self) -> int:
        """Number of detected reboots of the autopilot."""
        return self.streams.boots.reboots

    @property
    def vehicle_system_id(self) -> int | None:
        """MAVLink system id of the vehicle, None until it was found."""
        return self._vehicle_system if self._found.is_set() else None

    @property
    def autopilot(self) -> AutopilotKind | None:
        """Which autopilot it is, by its own heartbeats; None until it was found."""
        return self.identity.autopilot if self._found.is_set() else None

    @property
    def is_ardupilot(self) -> bool:
        """Whether the autopilot is an ArduPilot; False before it was found."""
        return self.autopilot == "ardupilot"

    @property
    def own_ids(self) -> tuple[int, int]:
        """Own MAVLink system and component ids."""
        return self._own_system or 1, self._component

    @property
    def has_id_conflict(self) -> bool:
        """Whether another sender on the vehicle uses the same ids: two daemons, or a wrong component_id."""
        return self._conflict_heartbeats >= 2

    # --- life cycle

    async def __aenter__(self) -> Self:
        """Open the connection; does not wait for the autopilot.

        Raises:
            LinkError: the port is in use, or the device cannot be opened (unless `patient`).
        """
        quiet_mavsdk_log()
        self._loop = asyncio.get_running_loop()
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(self._calls.stop)
            stack.push_async_callback(self._close)
            await self._open()
            group = await stack.enter_async_context(asyncio.TaskGroup())
            keeper = group.create_task(self._keep(), name="mavsdk link")
            stack.callback(keeper.cancel)
            if self._guard is not None:
                stack.callback(group.create_task(self._guard.run(), name="frozen loop").cancel)
            self._stack = stack.pop_all()
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> bool | None:
        """Close the connection; see `MavsdkSession.close` for how long that takes."""
        try:
            return await self._stack.__aexit__(exc_type, exc, traceback)
        except BaseExceptionGroup as failures:
            ours = [failure for failure in failures.exceptions if failure is not exc]
            if ours:
                raise ours[0] from exc
            return None  # the block's own exception propagates unwrapped

    async def wait_autopilot(self, timeout_s: float) -> None:
        """Return when the autopilot was found and its heartbeats arrive.

        Args:
            timeout_s: real seconds.

        Raises:
            LinkError: it was not found in time; the message says what to check.
        """
        try:
            async with asyncio.timeout(timeout_s):
                await self._alive.wait()
        except TimeoutError as error:
            hint = {
                "serial": "is it powered, is the cable in the right port, does the baud rate match SERIALx_BAUD?",
                "udpin": "is it on, and does it (or the router) send to this port?",
            }.get(self.url.kind, "is it on, and does it listen on this port?")
            hint = self.identity.why_not_found or hint
            raise LinkError(f"no autopilot on {self.url} within {timeout_s:g} s: {hint}") from error

    # --- for the devices

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        """Call `handler` in MAVSDK's thread with each message of that name; returns a function that unsubscribes it."""
        return self._hub.on(name, handler)

    def on_any_system(self, name: str, handler: Handler) -> Callable[[], None]:
        """The same with messages of other systems, too, such as ground stations; one handler for a name."""

        def deliver(message: Any) -> None:
            fields = message.fields_json
            handler(MavMessage(name, message.component_id, fields, self.clock.monotonic(), system_id=message.system_id))

        self._session.on_others(name, deliver)
        off = self.on(name, handler)

        def ends() -> None:
            self._session.on_others(name, lambda _message: None)
            off()

        return ends

    def when_attached(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Call `callback` on the loop once plugins can be created, possibly now; returns a function that removes it."""
        if self._session.system is not None:
            callback()
        return _registered(self._on_attached, callback)

    def when_back(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Call `callback` on the loop when the autopilot rebooted or reconnected; returns a removal function."""
        return _registered(self._on_return, callback)

    def post(self, callback: Callable[..., None], *args: object) -> None:
        """Schedule `callback` on the loop; for MAVSDK's thread. Does nothing after the loop was closed."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(callback, *args)

    async def use_rates(self, *, active: bool) -> None:
        """Request the rates of a running mission, or the idle rates. Failed requests are repeated automatically."""
        self.streams.active = active
        self._wake.set()
        self._hub.throttle(FAST_STREAMS if self._throttling and not active else ())
        if self.connected:
            await self.streams.ask()

    # --- in MAVSDK's thread

    def _heartbeat(self, message: MavMessage) -> None:
        now, kind = time.monotonic(), int(message.fields["type"])
        self.components[message.component_id] = (kind, now)
        self.roster.note(message.system_id, message.component_id, kind, int(message.fields["autopilot"]), now)
        if message.component_id == AUTOPILOT and self.identity.is_own(message.fields):
            was_away = now - self._heartbeat_s >= HEARTBEAT_LOST_S
            self._heartbeat_s = now
            self.streams.autopilot = int(message.fields["autopilot"])
            if was_away:
                self.post(self._came_back)
        elif (self._vehicle_system, message.component_id) == self.own_ids:
            self._conflict_heartbeats += 1

    def _other_heartbeat(self, system: int, component: int, kind: int, autopilot: int) -> None:
        """A heartbeat of a system that the hub does not receive."""
        self.roster.note(system, component, kind, autopilot, time.monotonic())

    # --- on the loop

    def _came_back(self) -> None:
        _log.info("autopilot rebooted or reconnected", reboots=self.boot_count)
        self._alive.set()
        self._session.heard()
        self.streams.forget()
        self._wake.set()
        for callback in tuple(self._on_return):
            callback()

    async def _keep(self) -> None:
        """Find the autopilot, then maintain its streams and the connection until cancelled."""
        await self._discover()
        conflict_logged = False
        while True:
            self._wake.clear()
            await self._session.mend()
            self.streams.measure()
            self._hub.listen_again()
            await self._watch_others()
            if self.connected:
                await self.streams.ask()
            else:
                self._alive.clear()
                if self.url.kind in ("serial", "tcpout") and self.heartbeat_age_s > _SILENT_REOPEN_S:
                    await self._session.reopen()
            if self.has_id_conflict and not conflict_logged:
                conflict_logged = True
                _log.error("another component uses the same MAVLink ids", ids=self.own_ids)
            with contextlib.suppress(TimeoutError):
                # each check is a wakeup: an idle daemon checks less often
                waits = self._throttling and not self.streams.active and self.connected
                async with asyncio.timeout(_IDLE_TICK_S if waits else _TICK_S):
                    await self._wake.wait()

    async def _watch_others(self) -> None:
        """Learn of other systems on the link, and say so when one of them is a vehicle."""
        if time.monotonic() - self._watched_s >= _WATCH_S:
            self._watched_s = time.monotonic()
            await self._session.watch_systems(self._other_heartbeat)
        if news := self.identity.news():
            _log.warning("vehicle identity", problem=news)

    async def _discover(self) -> None:
        since = time.monotonic()
        while True:
            await self._session.watch_systems(self._other_heartbeat)
            chosen = self.roster.choose(self._vehicle_system, time.monotonic())
            system = None if chosen is None else self._session.known(chosen.system)
            if chosen is not None and system is not None:
                break
            await self._session.mend()
            silent = time.monotonic() - since > _SILENT_REOPEN_S
            if not self._session.is_open or (silent and self.url.kind == "serial"):
                await self._session.reopen()
            await asyncio.sleep(_TICK_S if silent else _DISCOVER_TICK_S)
        vehicle = chosen.system
        self._vehicle_system = self.requests.system_id = self.identity.system = vehicle
        if self._own_system is None:
            self._own_system = vehicle
            if vehicle != 1:  # components of a vehicle share its system id, which is known only now
                del system
                await self._close()
                await self._open()
                await self._discover()
                return
        self._heartbeat_s = time.monotonic()
        self._session.system = system
        self._session.unwatch(vehicle)
        self._hub.attach(self.requests.plugin(MavlinkDirect), vehicle)
        # nothing is throttled before `use_rates`: discovery of the devices needs all messages
        await self.streams.ask()
        _log.info("autopilot found", url=str(self.url), vehicle=self.identity.label)
        self._found.set()
        for callback in tuple(self._on_attached):
            callback()
        self._alive.set()

    def _mute(self, name: str, muted: bool) -> None:
        if name == _GIMBAL_REPORTS[0]:
            if muted:
                self._datagram_filter.mute()
            else:
                self._datagram_filter.unmute()

    async def _open(self) -> None:
        try:
            await self._session.open(*self.own_ids)
        except LinkError as error:
            if not self._patient or self.url.listens:
                raise
            _log.warning("connection failed, retrying", error=str(error))

    async def _close(self) -> None:
        self._hub.detach()
        await self._session.close()


def _registered(callbacks: list[Callable[[], None]], callback: Callable[[], None]) -> Callable[[], None]:
    callbacks.append(callback)

    def off() -> None:
        with contextlib.suppress(ValueError):
            callbacks.remove(callback)

    return off
