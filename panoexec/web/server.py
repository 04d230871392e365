"""The web server: the page, its files, one WebSocket a browser, and the missions of this computer."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import structlog
from aiohttp import web

from panoexec.errors import UsageError
from panoexec.inputs.service_sections import MqttSection, WebSection
from panoexec.web.access import Access, is_loopback
from panoexec.web.audience import Browsers
from panoexec.web.broker import BrokerLink
from panoexec.web.checks import needs_users, server_tls
from panoexec.web.commands import Commands
from panoexec.web.fleet import Fleet
from panoexec.web.library import Library, ended
from panoexec.web.pages import Pages
from panoexec.web.protocol import encode
from panoexec.web.refill import Refill
from panoexec.web.sockets import Sockets

_IDLE_S: Final = 20.0
"""A connection without a whole request is closed after so long."""

_OPEN_FILES: Final = 8192

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """What the server is made of.

    Attributes:
        mqtt: the broker; `host` is set.
        web: section `[web]`.
        storage: where missions are kept on this computer; None without any.
        host, port: where it listens; port 0 is a free one.
    """

    mqtt: MqttSection
    web: WebSection
    host: str
    port: int
    storage: Path | None = None


class Server:
    """Serves in `run`, until cancelled.

    Attributes:
        port: where it listens, once `ready` is set.
    """

    def __init__(self, options: Options) -> None:
        """Check the options.

        Raises:
            UsageError: the address needs logins and there are no users, or a file cannot be used.
        """
        self.port = options.port
        self.ready = asyncio.Event()
        self._options = options
        section = options.web
        if not is_loopback(options.host) and section.users_file is None:
            raise UsageError(needs_users(options.host))
        self._tls = server_tls(section)
        self._access = Access(section.users_file, origins=section.origins)
        self._browsers = Browsers()
        self._fleet = Fleet(self._browsers)
        self._link = BrokerLink(options.mqtt, listener=self._fleet)
        self._tasks: asyncio.TaskGroup | None = None
        self._commands = Commands(link=self._link, fleet=self._fleet, browsers=self._browsers, spawn=self._spawn)
        self._fleet.on_response = self._commands.hear
        self._fleet.is_starting = self._commands.is_starting
        secure = self._tls is not None or any(one.startswith("https:") for one in section.origins)
        self._pages = Pages(access=self._access, fleet=self._fleet, tls=secure)
        self._cameras: list[Any] = []
        self._refill = Refill(link=self._link, fleet=self._fleet, spawn=self._spawn)
        self._fleet.on_link = self._refill.link_lost
        self._library = Library(options.storage, browsers=self._browsers, spawn=self._spawn)
        self._sockets = Sockets(
            access=self._access,
            browsers=self._browsers,
            fleet=self._fleet,
            link=self._link,
            commands=self._commands,
            greeting=self._greeting,
            stitch=self._library.stitch,
            followed=self._refill.look,
        )

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            UsageError: the address cannot be listened at.
        """
        _allow_open_files()
        runner = web.AppRunner(self._application(), access_log=None, shutdown_timeout=2.0, keepalive_timeout=_IDLE_S)
        await runner.setup()
        try:
            site = web.TCPSite(runner, self._options.host, self._options.port, ssl_context=self._tls, backlog=512)
            try:
                await site.start()
            except OSError as error:
                where = f"{self._options.host}:{self._options.port}"
                raise UsageError(f"cannot listen at {where}: {error.strerror or error}") from error
            self.port = int(runner.addresses[0][1])
            _log.info(
                "listening",
                address=f"{self._options.host}:{self.port}",
                tls=self._tls is not None,
                login=self._access.needs_login,
                broker=f"{self._options.mqtt.host}:{self._options.mqtt.port}",
            )
            async with asyncio.TaskGroup() as group:
                group.create_task(self._read_cameras(), name="cameras")
                self._tasks = group
                group.create_task(self._link.run(), name="broker link")
                group.create_task(self._sockets.beat(), name="beat")
                self.ready.set()
        finally:
            for browser in list(self._browsers.all):
                browser.end()
            await runner.cleanup()

    def _application(self) -> web.Application:
        app = web.Application(middlewares=[self._pages.guard], client_max_size=16 * 1024)
        self._pages.add_routes(app)
        app.router.add_get("/socket", self._sockets.handle)
        self._library.add_routes(app)
        return app

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        assert self._tasks is not None
        return self._tasks.create_task(work)

    def _greeting(self) -> dict[str, Any]:
        return {"missions": self._library.has_storage, "stitch": self._library.cannot_stitch, "cameras": self._cameras}

    async def _read_cameras(self) -> None:
        """Read the camera profiles in a process of their own: what that imports is larger than the server."""
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "panoexec", "cameras", "--json"),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
        )
        try:
            out, _ = await process.communicate()
        finally:
            await ended(process)
        with contextlib.suppress(ValueError):
            self._cameras = json.loads(out)
        self._browsers.tell_all(encode("cameras", cameras=self._cameras))


def _allow_open_files() -> None:
    """Raise the soft limit of open files, so that many connections do not keep others out."""
    if os.name == "nt":
        return
    import resource  # noqa: PLC0415  (not on Windows)

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _OPEN_FILES if hard == resource.RLIM_INFINITY else min(_OPEN_FILES, hard)
    if soft < wanted:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
