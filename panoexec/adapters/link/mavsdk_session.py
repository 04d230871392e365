"""One `Mavsdk` instance with its connection, systems and plugins: open, reopen, destroy."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeAlias, TypeVar

import structlog
from mavsdk import Mavsdk, System
from mavsdk.plugins.mavlink_direct import MavlinkDirect

from panoexec.adapters.link.connection import close_connection, open_connection
from panoexec.adapters.link.connection_url import ConnectionUrl
from panoexec.adapters.link.first_heartbeats import OpenedConnection, new_mavsdk
from panoexec.adapters.link.thread_state import keep_thread_state
from panoexec.adapters.link.worker_calls import WorkerCalls
from panoexec.errors import LinkError

P = TypeVar("P")
Beat: TypeAlias = Callable[[int, int, int, int], None]
"""Takes a heartbeat: system, component, MAV_TYPE, MAV_AUTOPILOT."""

_DRAIN_S: Final = 3.0
_DESTROY_S: Final = 3.0
_FOLDERS: Final = "mavsdk-component-metadata-*"
"""What MAVSDK creates for each system in the folder for temporary files, and leaves there."""
_REOPEN_S: Final = 1.0
_MAX_REOPEN_S: Final = 10.0

_log = structlog.get_logger(__name__)


class MavsdkSession:
    """Owns resources that must be released in order. For the event loop; blocking calls run in worker threads."""

    def __init__(self, url: ConnectionUrl, calls: WorkerCalls, *, opened: OpenedConnection | None = None) -> None:
        """Create it, with a connection that is open already, if there is one; it is used if it has the right ids."""
        self.system: System | None = None
        """The vehicle, once it was found."""
        self._url = url
        self._calls = calls
        self._opened = opened
        self._cut_s = math.nan
        self._mavsdk: Mavsdk | None = None
        self._instances: list[Mavsdk] = []
        self._connection: Any = None
        self._plugins: dict[Any, Any] = {}
        self._watched: dict[int, tuple[System, MavlinkDirect | None]] = {}
        self._others: dict[str, Callable[[Any], None]] = {}
        self._next_open_s = 0.0
        self._delay_s = _REOPEN_S
        self._began_s = time.time()

    @property
    def is_open(self) -> bool:
        """Whether there is a connection, alive or not."""
        return self._connection is not None

    async def open(self, system_id: int, component_id: int) -> None:
        """Create MAVSDK with these ids and open the connection.

        Raises:
            LinkError: the connection cannot be opened; `reopen` can try again.
        """
        opened, self._opened = self._opened, None
        if opened is not None:
            self._instances.append(opened.mavsdk)
            if (opened.url, opened.ids) == (self._url, (system_id, component_id)):
                self._mavsdk, self._connection = opened.mavsdk, opened.handle
                return
            await self._calls.run(lambda: close_connection(opened.mavsdk, opened.handle))

        def create() -> Mavsdk:
            mavsdk = new_mavsdk(system_id, component_id)
            self._instances.append(mavsdk)  # it must be destroyed even if the waiting task is cancelled
            return mavsdk

        self._mavsdk = mavsdk = await self._calls.run(create)
        self._connection = await self._calls.run(lambda: open_connection(mavsdk, self._url))

    async def reopen(self) -> None:
        """Reopen the connection if the retry interval is over; may be called at any rate."""
        mavsdk, now = self._mavsdk, time.monotonic()
        if mavsdk is None or now < self._next_open_s:
            return
        self._next_open_s = now + self._delay_s
        self._delay_s = min(2 * self._delay_s, _MAX_REOPEN_S)
        old, self._connection = self._connection, None
        if old is not None:
            await self._calls.run(lambda: close_connection(mavsdk, old))
        try:
            self._connection = await self._calls.run(lambda: open_connection(mavsdk, self._url))
        except LinkError as error:
            _log.debug("connection failed, retrying", error=str(error))
        else:
            _log.info("connection reopened", url=str(self._url))

    def cut(self) -> None:
        """Close the connection at once, and with it the heartbeats; for another thread while the loop stands still."""
        mavsdk, handle, self._connection = self._mavsdk, self._connection, None
        if mavsdk is not None and handle is not None:
            self._cut_s = time.monotonic()
            close_connection(mavsdk, handle)

    async def mend(self) -> None:
        """Open the connection again after `cut`; may be called at any rate."""
        if math.isfinite(self._cut_s):
            silent_s, self._cut_s = time.monotonic() - self._cut_s, math.nan
            _log.error("the event loop stood still; heartbeats were stopped meanwhile", silent_s=round(silent_s, 1))
            self.heard()
            await self.reopen()

    def heard(self) -> None:
        """The vehicle was heard: reset the retry interval."""
        self._delay_s = _REOPEN_S
        self._next_open_s = 0.0

    async def watch_systems(self, heard: Beat) -> None:
        """Subscribe to the heartbeats of the systems that are new on this connection.

        Args:
            heard: called in MAVSDK's thread.
        """
        mavsdk = self._mavsdk
        if mavsdk is None:
            return
        for system in await self._calls.run(mavsdk.get_systems):
            system_id = system.get_system_id()
            if system_id not in self._watched and mavsdk is self._mavsdk:
                direct = MavlinkDirect(system)
                self._watched[system_id] = system, direct
                direct.subscribe_message("HEARTBEAT", lambda message, _user_data: _take_beat(message, heard))
                for name in self._others:
                    self._subscribe(direct, name)

    def on_others(self, name: str, handler: Callable[[Any], None]) -> None:
        """Call `handler` in MAVSDK's thread with each MavlinkMessage of that name from other systems."""
        known = name in self._others
        self._others[name] = handler
        for _, direct in self._watched.values():
            if direct is not None and not known:
                self._subscribe(direct, name)

    def _subscribe(self, direct: MavlinkDirect, name: str) -> None:
        def deliver(message: Any, _user_data: Any) -> None:
            keep_thread_state()
            self._others[name](message)

        direct.subscribe_message(name, deliver)

    def known(self, system_id: int) -> System | None:
        """That system, None until `watch_systems` has seen it with an autopilot."""
        system, _ = self._watched.get(system_id, (None, None))
        return system if system is not None and system.has_autopilot() and system.is_connected() else None

    def unwatch(self, system_id: int) -> None:
        """End the subscription to the heartbeats of that system."""
        system, direct = self._watched.get(system_id, (None, None))
        if system is not None and direct is not None:
            self._watched[system_id] = system, None
            direct.destroy()

    def plugin(self, kind: Callable[[System], P]) -> P:
        """The plugin of that kind, created at the first call.

        Raises:
            LinkError: there is no vehicle yet.
        """
        if self.system is None:
            raise LinkError(f"no autopilot on {self._url} yet")
        if kind not in self._plugins:
            self._plugins[kind] = kind(self.system)
        plugin: P = self._plugins[kind]
        return plugin

    async def close(self) -> None:
        """Wait for running calls, then destroy MAVSDK; takes at most 6 s, and milliseconds if no call is running.

        A call that is still running then (one for which the autopilot keeps reporting progress) blocks its daemon
        thread for ever.
        """
        self._mavsdk = self.system = self._connection = None
        self._plugins.clear()
        self._watched.clear()
        if not await self._calls.drain(_DRAIN_S):
            _log.warning("MAVSDK call timed out")
        self._calls.refuse()  # one that waits for its thread on a busy machine would find MAVSDK destroyed
        made, self._instances = self._instances, []
        if not made:
            return
        loop, gone = asyncio.get_running_loop(), asyncio.Event()

        def destroy() -> None:
            for mavsdk in made:
                mavsdk.destroy()
            _remove_folders(self._began_s)
            with contextlib.suppress(RuntimeError):  # the loop was closed: no task waits any more
                loop.call_soon_threadsafe(gone.set)

        threading.Thread(target=destroy, name="mavsdk destroy", daemon=True).start()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_DESTROY_S):
                await gone.wait()


def _take_beat(message: Any, heard: Beat) -> None:
    keep_thread_state()
    with contextlib.suppress(LookupError, TypeError, ValueError):  # no heartbeat of the standard
        fields = json.loads(message.fields_json)
        heard(message.system_id, message.component_id, int(fields["type"]), int(fields["autopilot"]))


def _remove_folders(since_s: float) -> None:
    """Remove MAVSDK's folders for component metadata that are empty, ours, and no older than that (Unix time).

    Another session may be using one, but none needs it: panoexec asks for no metadata.
    """
    for folder in Path(tempfile.gettempdir()).glob(_FOLDERS):
        with contextlib.suppress(OSError):  # not empty, or removed by somebody else
            status = folder.stat()
            if status.st_uid == os.getuid() and status.st_mtime >= since_s - 1.0:
                folder.rmdir()
