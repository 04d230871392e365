"""A web server in this process, a vehicle that says what a test wants, and browsers."""

# ruff: noqa: SIM117  (what is open inside of what is easier to see)
from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import aiomqtt

from panoexec.inputs.service_sections import MqttSection, WebSection
from panoexec.web.server import Options, Server
from tests.waiting import eventually

IDLE: dict[str, Any] = {
    "state": "idle", "mission_id": None, "name": "", "shots_total": 0, "shots_done": 0, "attempts": 0, "retakes": 0,
    "shots": "", "content": {}, "current": None, "eta_s": None, "reason": "", "resumable": None,
    "link": {name: {"ok": True, "age_s": 0.1} for name in ("autopilot", "gimbal", "camera")},
    "battery_frac": 0.8, "boot_id": "boot", "seq": 0, "time": "2026-11-22T07:58:01.000Z",
}  # fmt: skip
MISSION = "20261122T075801.864Z"


@asynccontextmanager
async def web_server(broker_port: int, *, storage: Path | None = None, **section: Any) -> AsyncIterator[Server]:
    """A server on a free port of loopback."""
    options = Options(
        mqtt=MqttSection(host="127.0.0.1", port=broker_port),
        web=WebSection(**section),
        host="127.0.0.1",
        port=0,
        storage=storage,
    )
    server = Server(options)
    task = asyncio.create_task(server.run(), name="web server")
    try:
        await asyncio.wait({task, asyncio.create_task(server.ready.wait())}, return_when=asyncio.FIRST_COMPLETED)
        if task.done():
            task.result()
        await eventually(lambda: server._link.up)
        yield server
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


class FakeVehicle:
    """Publishes what a test says, and answers requests as a test says."""

    def __init__(self, client: aiomqtt.Client, name: str) -> None:
        self.name = name
        self.requests: list[tuple[str, dict[str, Any]]] = []
        self.answer: Callable[[str, dict[str, Any]], dict[str, Any] | None] = lambda _command, _fields: {"data": {}}
        self._client = client
        self._seq = 0

    async def publish(self, topic: str, payload: object, *, retain: bool = False) -> None:
        data = payload if isinstance(payload, str | bytes) else json.dumps(payload)
        await self._client.publish(f"panoexec/{self.name}/{topic}", data, qos=1, retain=retain)

    async def state(self, **fields: Any) -> None:
        self._seq += 1
        await self.publish("state", IDLE | {"seq": self._seq} | fields, retain=True)

    async def run(self) -> None:
        async for message in self._client.messages:
            command = str(message.topic).rpartition("/")[2]
            assert isinstance(message.payload, bytes)
            fields = json.loads(message.payload)
            self.requests.append((command, fields))
            answer = self.answer(command, fields)
            if answer is not None:
                whole = {"transaction": fields["transaction"], "status": "ok", "error": None, "data": None} | answer
                await self.publish(f"response/{command}", whole)


@asynccontextmanager
async def fake_vehicle(broker_port: int, name: str = "drone") -> AsyncIterator[FakeVehicle]:
    """A vehicle that is online and idle."""
    will = aiomqtt.Will(f"panoexec/{name}/status", b"offline", 1, retain=True)
    async with aiomqtt.Client("127.0.0.1", broker_port, will=will) as client:
        await client.subscribe(f"panoexec/{name}/request/#", qos=1)
        vehicle = FakeVehicle(client, name)
        task = asyncio.create_task(vehicle.run(), name="vehicle")
        await vehicle.publish("status", "online", retain=True)
        await vehicle.state()
        try:
            yield vehicle
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


class FakeBrowser:
    """What a page would have heard."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.heard: list[dict[str, Any]] = []
        self.closed = asyncio.Event()
        self._socket = socket

    async def run(self) -> None:
        async for message in self._socket:
            assert message.type is aiohttp.WSMsgType.TEXT, message
            self.heard.append(json.loads(message.data))
        self.closed.set()

    async def say(self, **message: Any) -> None:
        await self._socket.send_str(json.dumps(message))

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [one for one in self.heard if one["type"] == kind]

    async def until(self, kind: str, condition: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        """The first message of a kind for which the condition holds."""
        await eventually(lambda: any(condition(one) for one in self.of(kind)), 120)
        return next(one for one in self.of(kind) if condition(one))

    async def command(self, number: str, command: str, vehicle: str = "drone", **fields: Any) -> dict[str, Any]:
        """Send a command; its last answer."""
        await self.say(type="command", id=number, vehicle=vehicle, command=command, fields=fields)
        return await self.until(
            "answer", lambda one: one["id"] == number and one["stage"] in {"done", "refused", "failed"}
        )


def base(server: Server) -> str:
    return f"http://127.0.0.1:{server.port}"


@asynccontextmanager
async def browser(
    server: Server, *, follow: str | None = None, name: str = "", known: bool = True, **options: Any
) -> AsyncIterator[FakeBrowser]:
    """A browser whose page is open; `known`: the server has heard the vehicle."""
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        async with session.ws_connect(f"{base(server)}/socket", origin=base(server), **options) as socket:
            one = FakeBrowser(socket)
            task = asyncio.create_task(one.run(), name="browser")
            try:
                if name:
                    await one.say(type="name", name=name)
                if follow is not None:
                    await eventually(lambda: server._fleet.vehicles.get(follow) or not known)
                    await one.say(type="follow", vehicle=follow)
                    await one.until("vehicle")
                yield one
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)
