"""The web server: the page, its files, and one WebSocket a browser."""

from __future__ import annotations

import asyncio
import contextlib
import os
import ssl
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import structlog
from aiohttp import WSMsgType, web

from panoexec import __version__
from panoexec.errors import UsageError
from panoexec.inputs.config import MqttSection, WebSection
from panoexec.web.access import ANYBODY, User
from panoexec.web.audience import Browser, Browsers
from panoexec.web.broker import BrokerLink
from panoexec.web.commands import Commands
from panoexec.web.fleet import Fleet, link_message
from panoexec.web.headers import PAGE_POLICY, secured
from panoexec.web.protocol import (
    MAX_FRAME,
    PROTOCOL,
    Command,
    Follow,
    Name,
    RefusedMessageError,
    encode,
    from_browser,
    is_mission,
    is_vehicle,
)
from panoexec.web.static_files import read_static_files

BEAT_S: Final = 1.0
_LISTS_S: Final = 0.5
_PING_S: Final = 10.0
_FIRST_S: Final = 10.0
_FRESH: Final = bool(os.environ.get("PANOEXEC_WEB_ASSETS_FRESH"))
"""Read the page's files at each request: for whoever changes them."""

_log = structlog.get_logger(__name__)

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


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
        self.port = options.port
        self.ready = asyncio.Event()
        self._options = options
        self._browsers = Browsers()
        self._fleet = Fleet(self._browsers)
        self._link = BrokerLink(options.mqtt, listener=self._fleet)
        self._tasks: asyncio.TaskGroup | None = None
        self._commands = Commands(link=self._link, fleet=self._fleet, browsers=self._browsers, spawn=self._spawn)
        self._fleet.on_response = self._commands.hear
        self._assets = read_static_files()
        self._names = 0

    # --- running

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            UsageError: the address cannot be listened at.
        """
        app = self._application()
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=2.0)
        await runner.setup()
        try:
            site = web.TCPSite(runner, self._options.host, self._options.port, ssl_context=self._tls(), backlog=512)
            try:
                await site.start()
            except OSError as error:
                where = f"{self._options.host}:{self._options.port}"
                raise UsageError(f"cannot listen at {where}: {error.strerror or error}") from error
            self.port = runner.addresses[0][1]
            _log.info("listening", host=self._options.host, port=self.port, broker=self._options.mqtt.host)
            async with asyncio.TaskGroup() as group:
                self._tasks = group
                group.create_task(self._link.run(), name="broker link")
                group.create_task(self._beat(), name="beat")
                self.ready.set()
        finally:
            await runner.cleanup()

    def _tls(self) -> ssl.SSLContext | None:
        section = self._options.web
        if section.cert_file is None or section.key_file is None:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(section.cert_file, section.key_file)
        except (OSError, ssl.SSLError) as error:
            raise UsageError(f"[web] cert_file {section.cert_file}, key_file {section.key_file}: {error}") from error
        return context

    def _application(self) -> web.Application:
        app = web.Application(middlewares=[self._guarded], client_max_size=64 * 1024)
        app.router.add_get("/", self._page)
        app.router.add_get("/v/{vehicle}", self._page)
        app.router.add_get("/assets/{name:[^{}]+}", self._asset)
        app.router.add_get("/socket", self._socket)
        app.router.add_get("/thumbnails/{vehicle}/{mission}/{shot}", self._thumbnail)
        app.router.add_get("/api/missions", self._missions)
        return app

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        assert self._tasks is not None
        return self._tasks.create_task(work)

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            response = await handler(request)
        except web.HTTPException as refused:
            response = secured(web.Response(status=refused.status, text=f"{refused.status}: {refused.reason}\n"))
            if "Location" in refused.headers:
                response.headers["Location"] = refused.headers["Location"]
            return response
        return response if response.prepared else secured(response)

    async def _beat(self) -> None:
        """Tell every browser once a second that the server is there, and lists what changed."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        half = False
        while True:
            if changes := self._fleet.changes():
                self._browsers.tell_lists(encode("summaries", vehicles=changes))
            if half := not half:
                now = _now()
                for browser in self._browsers.all:
                    vehicle = self._fleet.vehicles.get(browser.follows or "")
                    browser.put(encode("beat", time=now, silent_s=None if vehicle is None else vehicle.silent_s))
            due = max(due + _LISTS_S, loop.time())
            await asyncio.sleep(due - loop.time())

    # --- requests

    def _user(self, request: web.Request) -> User | None:
        """Who asks; None if nobody is logged in and somebody has to be."""
        del request
        return ANYBODY

    async def _page(self, request: web.Request) -> web.StreamResponse:
        vehicle = request.match_info.get("vehicle")
        if vehicle is not None and not is_vehicle(vehicle):
            raise web.HTTPNotFound
        response = self._file("index.html")
        response.headers["Content-Security-Policy"] = PAGE_POLICY
        return response

    async def _asset(self, request: web.Request) -> web.StreamResponse:
        return self._file(request.match_info["name"], request.headers.get("If-None-Match", ""))

    def _file(self, name: str, known: str = "") -> web.Response:
        if _FRESH:
            self._assets = read_static_files()
        asset = self._assets.get(name)
        if asset is None:
            raise web.HTTPNotFound
        headers = {"ETag": asset.etag, "Cache-Control": "no-cache"}
        if known == asset.etag:
            return web.Response(status=304, headers=headers)
        return web.Response(body=asset.content, content_type=asset.kind, charset=asset.charset, headers=headers)

    async def _thumbnail(self, request: web.Request) -> web.StreamResponse:
        where = request.match_info
        if not is_vehicle(where["vehicle"]) or not is_mission(where["mission"]) or not where["shot"].isdecimal():
            raise web.HTTPNotFound
        jpeg = self._fleet.thumbnail(where["vehicle"], where["mission"], int(where["shot"][:9]))
        if jpeg is None:
            raise web.HTTPNotFound
        kept = {"Cache-Control": "private, max-age=86400, immutable"}
        return web.Response(body=jpeg, content_type="image/jpeg", headers=kept)

    async def _missions(self, request: web.Request) -> web.StreamResponse:
        del request
        return web.json_response({"storage": False, "missions": []})

    # --- the socket

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        user = self._user(request)
        if user is None:
            raise web.HTTPUnauthorized
        socket = web.WebSocketResponse(heartbeat=_PING_S, max_msg_size=MAX_FRAME, compress=False)
        if not socket.can_prepare(request).ok:
            raise web.HTTPUpgradeRequired(headers={"Upgrade": "websocket"})
        await socket.prepare(request)
        self._names += 1
        browser = Browser(user, name=f"browser {self._names}")
        self._browsers.add(browser)
        delivering = asyncio.create_task(self._deliver(browser, socket), name="browser")
        try:
            self._greet(browser)
            async for message in socket:
                if message.type is not WSMsgType.TEXT:
                    break
                self._obey(browser, message.data)
        finally:
            self._browsers.remove(browser)
            self._commands.gone(browser)
            delivering.cancel()
            await asyncio.gather(delivering, return_exceptions=True)
        return socket

    async def _deliver(self, browser: Browser, socket: web.WebSocketResponse) -> None:
        with contextlib.suppress(TimeoutError, ConnectionError, RuntimeError):
            await browser.deliver(socket.send_str)
        # without the handshake of closing, for which a slow browser would be waited
        transport = socket._req.transport if socket._req is not None else None  # noqa: SLF001
        if transport is not None:
            transport.abort()

    def _greet(self, browser: Browser) -> None:
        browser.put(
            encode(
                "hello",
                protocol=PROTOCOL,
                version=__version__,
                user=browser.user.name,
                name=browser.user.name or browser.name,
                role=browser.user.role,
                login=False,
                missions=self._options.storage is not None,
                stitch="no missions are stored on this computer" if self._options.storage is None else "",
                cameras=[],
                time=_now(),
            )
        )
        browser.put(link_message(self._link))
        browser.put(encode("vehicles", vehicles=self._fleet.summaries()))

    def _obey(self, browser: Browser, text: str) -> None:
        try:
            message = from_browser(text)
        except RefusedMessageError as error:
            browser.put(encode("problem", text=str(error)))
            return
        if isinstance(message, Follow):
            self._browsers.follow(browser, message.vehicle)
            if message.vehicle is None:
                browser.put(encode("vehicles", vehicles=self._fleet.summaries()))
            else:
                browser.put(self._fleet.snapshot(message.vehicle, self._commands.log(message.vehicle)))
        elif isinstance(message, Name):
            browser.name = message.name or browser.name
        elif isinstance(message, Command):
            self._commands.take(browser, message)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
