"""One WebSocket a browser: what it asks for, and what it is told."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Final

from aiohttp import WSMsgType, web

from panoexec import __version__
from panoexec.web.access import COOKIE, Access
from panoexec.web.audience import Browser, Browsers
from panoexec.web.broker import BrokerLink
from panoexec.web.commands import Commands
from panoexec.web.fleet import Fleet, link_message
from panoexec.web.pages import USER
from panoexec.web.protocol import (
    MAX_FRAME,
    PROTOCOL,
    Command,
    Follow,
    Name,
    RefusedMessageError,
    Stitch,
    encode,
    from_browser,
)

MOST: Final = 256
"""Browsers at the same time."""

_LISTS_S: Final = 0.5
_PING_S: Final = 10.0
_BURST: Final = 60
_A_SECOND: Final = 20.0
"""Messages of one browser; more than this ends its connection."""


class Sockets:
    """Greets browsers and obeys them; `beat` is one task of the server."""

    def __init__(
        self,
        *,
        access: Access,
        browsers: Browsers,
        fleet: Fleet,
        link: BrokerLink,
        commands: Commands,
        greeting: Callable[[], dict[str, Any]],
        stitch: Callable[[Browser, str], None],
        followed: Callable[[str], None],
    ) -> None:
        """Describe it.

        Args:
            access: sessions.
            browsers: all of them.
            fleet: the vehicles.
            link: to the broker.
            commands: takes commands.
            greeting: further fields of `hello`.
            stitch: takes the request to stitch a mission.
            followed: called with a vehicle that a browser follows, again once a second.
        """
        self._access = access
        self._browsers = browsers
        self._fleet = fleet
        self._link = link
        self._commands = commands
        self._greeting = greeting
        self._stitch = stitch
        self._followed = followed
        self._count = 0

    async def beat(self) -> None:
        """Tell every browser once a second that the server is there, and lists what changed."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        half = False
        while True:
            if changes := self._fleet.changes():
                self._browsers.tell_lists(encode("summaries", vehicles=changes))
            half = not half
            if half:
                self._beat_once()
            due = max(due + _LISTS_S, loop.time())
            await asyncio.sleep(due - loop.time())

    def _beat_once(self) -> None:
        now = _now()
        for vehicle_id in self._browsers.followed():
            self._followed(vehicle_id)
        for browser in self._browsers.all:
            if self._access.user(browser.token) != browser.user:
                browser.end()  # logged out, removed, or with another role
                continue
            vehicle = self._fleet.vehicles.get(browser.follows or "")
            browser.put(encode("beat", time=now, silent_s=None if vehicle is None else vehicle.silent_s))

    async def handle(self, request: web.Request) -> web.StreamResponse:
        """Serve one browser until it goes."""
        if len(self._browsers.all) >= MOST:
            raise web.HTTPServiceUnavailable
        socket = web.WebSocketResponse(heartbeat=_PING_S, max_msg_size=MAX_FRAME, compress=False)
        if not socket.can_prepare(request).ok:
            raise web.HTTPBadRequest
        self._count += 1
        browser = Browser(request[USER], name=f"browser {self._count}", token=request.cookies.get(COOKIE))
        self._browsers.add(browser)
        delivering = None
        try:
            await socket.prepare(request)
            # without the handshake of closing, for which a slow browser would be waited
            browser.on_end = request.transport.abort if request.transport is not None else browser.on_end
            delivering = asyncio.create_task(_deliver(browser, socket), name="browser")
            self._greet(browser)
            await self._listen(browser, socket)
        finally:
            self._browsers.remove(browser)
            self._commands.gone(browser)
            if delivering is not None:
                delivering.cancel()
                await asyncio.gather(delivering, return_exceptions=True)
        return socket

    async def _listen(self, browser: Browser, socket: web.WebSocketResponse) -> None:
        room, last = float(_BURST), time.monotonic()
        async for message in socket:
            now = time.monotonic()
            room, last = min(_BURST, room + _A_SECOND * (now - last)) - 1, now
            if message.type is not WSMsgType.TEXT or room < 0:
                return
            self._obey(browser, message.data)

    def _greet(self, browser: Browser) -> None:
        browser.put(
            encode(
                "hello",
                protocol=PROTOCOL,
                version=__version__,
                user=browser.user.name,
                name=browser.user.name or browser.name,
                role=browser.user.role,
                login=self._access.needs_login,
                time=_now(),
                **self._greeting(),
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
        match message:
            case Follow(vehicle=vehicle):
                self._follow(browser, vehicle)
            case Name(name=name):
                browser.name = name or browser.name
            case Command():
                self._commands.take(browser, message)
            case Stitch(mission_id=mission_id):
                self._stitch(browser, mission_id)

    def _follow(self, browser: Browser, vehicle: str | None) -> None:
        self._browsers.follow(browser, vehicle)
        if vehicle is None:
            browser.put(encode("vehicles", vehicles=self._fleet.summaries()))
            return
        browser.put(self._fleet.snapshot(vehicle, self._commands.log(vehicle)))
        self._followed(vehicle)


async def _deliver(browser: Browser, socket: web.WebSocketResponse) -> None:
    with contextlib.suppress(TimeoutError, ConnectionError, RuntimeError):
        await browser.deliver(socket.send_str)
    browser.end()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
