"""A server of the operator's page that says what a test wants: the page's files, one socket, thumbnails, missions.

What it says has the form of `panoexec.web.protocol`; the real server is tested elsewhere.
"""

from __future__ import annotations

import asyncio
import json
import threading
from types import TracebackType
from typing import Any, Self

from aiohttp import WSMsgType, web

from panoexec.web.headers import PAGE_POLICY
from panoexec.web.static_files import read_static_files

MISSION = "20261130T100000.000Z"
LIMIT_S = 180.0
READY = dict.fromkeys(("plan", "start", "pause", "resume", "skip", "repeat", "finish", "abort"), "")


def links(*, lost: str = "") -> dict[str, Any]:
    """The links of a state."""
    return {name: {"ok": name != lost, "age_s": 0.2} for name in ("autopilot", "gimbal", "camera")}


def state(**fields: Any) -> dict[str, Any]:
    """A state as the topic has it."""
    return {
        "state": "idle", "mission_id": None, "name": "", "shots_total": 0, "shots_done": 0, "attempts": 0, "retakes": 0,
        "shots": "", "content": {}, "current": None, "eta_s": None, "reason": "", "resumable": None, "link": links(),
        "battery_frac": 0.71, "boot_id": "b", "seq": 1, "time": "2026-11-30T10:00:00Z",
    } | fields  # fmt: skip


def vehicle(name: str = "drone", **fields: Any) -> dict[str, Any]:
    """The answer to `follow`."""
    return {
        "type": "vehicle", "vehicle": name, "status": "online", "state": state(), "may": READY, "marks": "",
        "mission": None, "log": [], "silent_s": 0.1,
    } | fields  # fmt: skip


class PageServer:
    """A context manager; `say` may be called from any thread.

    Attributes:
        url: where the page is.
        heard: what browsers sent, in order.
        vehicles: the answers to `follow` by vehicle.
        first: messages that every browser gets first.
        missions: the answer of `/api/missions`.
        thumbnail: the JPEG of every shot.
        beating: whether beats are sent.
    """

    def __init__(self) -> None:
        self.url = ""
        self.heard: list[dict[str, Any]] = []
        self.vehicles: dict[str, dict[str, Any]] = {"drone": vehicle()}
        self.first: list[dict[str, Any]] = [
            {"type": "hello", "protocol": 1, "version": "0", "user": "", "name": "browser 1", "role": "operator",
             "login": False, "missions": True, "stitch": "", "cameras": [], "time": "2026-11-30T10:00:00Z"},
            {"type": "link", "up": True, "since": "2026-11-30T10:00:00Z", "reason": ""},
        ]  # fmt: skip
        self.missions: list[dict[str, Any]] = []
        self.deleted: list[tuple[str, str]] = []
        self.thumbnail = b""
        self.beating = True
        self._sockets: set[web.WebSocketResponse] = set()
        self._files = read_static_files()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)

    def __enter__(self) -> Self:
        self._thread.start()
        self._do(self._start())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._do(self._stop())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def say(self, *messages: dict[str, Any]) -> None:
        """Send messages to every browser, in order."""
        self._do(self._say(messages))

    def hang_up(self) -> None:
        """Close every socket."""
        self._do(self._hang_up())

    def wait_for(self, kind: str, **fields: Any) -> dict[str, Any]:
        """The first message of a browser with this type and these fields, which is then forgotten."""

        async def found() -> dict[str, Any]:
            while True:
                for message in self.heard:
                    if message["type"] == kind and all(message.get(key) == value for key, value in fields.items()):
                        self.heard.remove(message)
                        return message
                await asyncio.sleep(0.02)

        return dict(self._do(asyncio.wait_for(found(), LIMIT_S)))

    def _do(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(LIMIT_S + 5)

    async def _start(self) -> None:
        app = web.Application()
        app.router.add_get("/socket", self._socket)
        app.router.add_get("/assets/{name:.+}", self._asset)
        app.router.add_get("/thumbnails/{rest:.+}", self._thumbnail)
        app.router.add_get("/api/missions", self._missions)
        app.router.add_delete("/missions/{id}", self._delete)
        app.router.add_get("/", self._page)
        app.router.add_get("/login", self._page)
        app.router.add_get("/v/{vehicle}", self._page)
        self._runner = web.AppRunner(app)
        await self._runner.setup()
        site = web.TCPSite(self._runner, "127.0.0.1", 0)
        await site.start()
        port = self._runner.addresses[0][1]
        self.url = f"http://127.0.0.1:{port}"
        self._beats = asyncio.create_task(self._beat())

    async def _stop(self) -> None:
        self._beats.cancel()
        await asyncio.gather(self._beats, return_exceptions=True)
        await self._hang_up()
        await self._runner.cleanup()

    async def _beat(self) -> None:
        while True:
            if self.beating:
                await self._say(({"type": "beat", "time": "2026-11-30T10:00:00Z", "silent_s": 0.2},))
            await asyncio.sleep(0.5)

    async def _say(self, messages: tuple[dict[str, Any], ...]) -> None:
        for socket in list(self._sockets):
            for message in messages:
                await socket.send_str(json.dumps(message))

    async def _hang_up(self) -> None:
        for socket in list(self._sockets):
            await socket.close()

    async def _socket(self, request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        for message in self.first:
            await socket.send_str(json.dumps(message))
        self._sockets.add(socket)
        try:
            async for frame in socket:
                if frame.type is not WSMsgType.TEXT:
                    continue
                told = json.loads(frame.data)
                self.heard.append(told)
                if told["type"] == "follow":
                    answer = self.vehicles.get(
                        told["vehicle"] or "", {"type": "vehicles", "vehicles": self._summaries()}
                    )
                    await socket.send_str(json.dumps(answer))
        finally:
            self._sockets.discard(socket)
        return socket

    def _summaries(self) -> list[dict[str, Any]]:
        return [
            {"id": name, "status": one["status"], "state": one["state"], "silent_s": one["silent_s"]}
            for name, one in self.vehicles.items()
        ]

    async def _page(self, request: web.Request) -> web.Response:
        page = self._files["login.html" if request.path == "/login" else "index.html"].content
        return web.Response(body=page, content_type="text/html", headers={"Content-Security-Policy": PAGE_POLICY})

    async def _asset(self, request: web.Request) -> web.Response:
        found = self._files.get(request.match_info["name"])
        if found is None:
            raise web.HTTPNotFound
        return web.Response(body=found.content, content_type=found.kind, charset=found.charset)

    async def _thumbnail(self, request: web.Request) -> web.Response:
        return web.Response(body=self.thumbnail, content_type="image/jpeg")

    async def _missions(self, request: web.Request) -> web.Response:
        return web.json_response({"storage": True, "missions": self.missions})

    async def _delete(self, request: web.Request) -> web.Response:
        self.deleted.append((request.match_info["id"], request.headers.get("X-Confirm", "")))
        self.missions = [one for one in self.missions if one["mission_id"] != request.match_info["id"]]
        await self._say(({"type": "library"},))
        return web.Response(status=204)
