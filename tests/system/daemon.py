"""The daemon as a process for tests, and a ground station that holds every message to the AsyncAPI document."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiomqtt

from panoexec.mqtt.state_deltas import StateFollower
from tests.schemas import DOCUMENT, misfits
from tests.waiting import eventually
from tests.wire.broker import Broker
from tests.wire.broker_proxy import BrokerProxy

SPEEDUP = 4.0
"""Missions last long enough for what a busy computer does in their middle."""
BASE = "panoexec/drone"
SMALL = {"elevation_deg": [-40, 0], "method": "paper"}


class Ground:
    """What a ground station with an ordinary MQTT library sees; survives a restart of the broker."""

    def __init__(self, port: int) -> None:
        self._port = port
        self.misfits: list[str] = []
        self.heard: dict[str, int] = {}
        self.events: list[dict[str, Any]] = []
        self.answers: dict[Any, dict[str, Any]] = {}
        self.state: dict[str, Any] = {}
        self.follower = StateFollower()
        self.states: list[str] = []
        self.status = ""
        self.plan: dict[str, Any] | None = None
        self._client: aiomqtt.Client | None = None

    async def run(self) -> None:
        while True:
            try:
                async with aiomqtt.Client(
                    "127.0.0.1", self._port, identifier="gcs", clean_session=False, timeout=20
                ) as client:
                    await client.subscribe(f"{BASE}/#", qos=1)
                    self._client = client
                    self._connected()
                    async for message in client.messages:
                        self._take(str(message.topic).removeprefix(f"{BASE}/"), bytes(message.payload))
            except aiomqtt.MqttError:
                self._client = None
                await asyncio.sleep(0.05)

    def _connected(self) -> None:
        """Called at each connection."""

    def _take(self, topic: str, payload: bytes) -> None:
        self._hold_to_document(topic, payload)
        if topic == "status":
            self.status = payload.decode()
        elif topic == "state":
            self.state = self.follower.whole(json.loads(payload))
            self.states.append(self.state["state"])
        elif topic == "state/delta":
            self.state = self.follower.delta(json.loads(payload)) or self.state
        elif topic == "plan":
            self.plan = json.loads(payload) if payload else None
        elif topic == "event":
            self.events.append(json.loads(payload))
        elif topic.startswith("response/") and topic != "response/probe":  # where the doctor asks for its rights
            answer = json.loads(payload)
            self.answers[answer["transaction"]] = answer

    def _hold_to_document(self, topic: str, payload: bytes) -> None:
        channel = topic.replace("/", "_")
        if topic.startswith("request/") or channel not in DOCUMENT["channels"]:
            return
        self.heard[channel] = self.heard.get(channel, 0) + 1
        if topic == "plan" and not payload:
            return  # the topic is cleared
        document = payload.decode() if topic == "status" else json.loads(payload)
        self.misfits += [f"{topic}: {one}" for one in misfits(channel, document)]

    async def ask(self, command: str, transaction: object, **fields: Any) -> dict[str, Any]:
        """The answer to a request."""
        self.answers.pop(transaction, None)
        await self.send(command, json.dumps({"transaction": transaction, **fields}).encode())
        await eventually(lambda: transaction in self.answers, 90)
        return self.answers[transaction]

    async def send(self, command: str, payload: bytes, *, retain: bool = False) -> None:
        await eventually(lambda: self._client is not None, 60)
        assert self._client is not None
        await self._client.publish(f"{BASE}/request/{command}", payload, qos=1, retain=retain)

    async def until(self, condition: Callable[[], object], timeout_s: float = 300.0) -> None:
        try:
            await eventually(condition, timeout_s)
        except TimeoutError:
            told = f"{self.status!r}, {self.state}, {self.types()[-5:]}"
            raise AssertionError(f"not within {timeout_s:g} s; the last that the daemon told: {told}") from None

    def types(self) -> list[str]:
        return [event["type"] for event in self.events]


@asynccontextmanager
async def ground_station(broker: Broker) -> AsyncIterator[Ground]:
    ground = Ground(broker.port)
    task = asyncio.create_task(ground.run(), name="ground station")
    try:
        yield ground
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def write_config(folder: Path, broker: Broker | BrokerProxy, port: int, *, more: str = "", mqtt: str = "") -> Path:
    """A configuration for a simulated vehicle that sends to that UDP port."""
    config = folder / "config.toml"
    config.write_text(
        f'[vehicle]\nconnection = "udpin://127.0.0.1:{port}"\n'
        f'[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\n{mqtt}[storage]\npath = "{folder}/data"\nmin_free_mb = 1\n'
        f"[guards]\nallowed_modes = []\nbattery_floor_frac = 0\n{more}"
    )
    return config


@asynccontextmanager
async def serving(
    folder: Path,
    broker: Broker | BrokerProxy,
    port: int,
    *,
    more: str = "",
    mqtt: str = "",
    notify: Path | None = None,
    speedup: float = SPEEDUP,
    own_session: bool = False,
    without: str = "",
) -> AsyncIterator[asyncio.subprocess.Process]:
    """The daemon while the block runs; killed at its end if it still runs.

    With a session of its own, the kernel schedules it as a group of its own, as it does a service. `without` is Python
    code that takes something away from the daemon before it begins.
    """
    config = write_config(folder, broker, port, more=more, mqtt=mqtt)
    environment = {name: value for name, value in os.environ.items() if name != "NOTIFY_SOCKET"}
    if notify is not None:
        environment["NOTIFY_SOCKET"] = str(notify)
        environment["WATCHDOG_USEC"] = "1500000"
    main = "import sys\nfrom panoexec.__main__ import main\nsys.exit(main())"
    program = ("-c", f"{without}\n{main}") if without else ("-m", "panoexec")
    with (folder / "serve.log").open("ab") as log:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, *program, "serve", "--config", str(config), "--speedup", str(speedup)),
            stdout=log,
            stderr=log,
            env=environment,
            start_new_session=own_session,
        )
        try:
            yield process
        finally:
            if process.returncode is None:
                process.kill()
            await process.wait()


async def ready(ground: Ground) -> None:
    """Wait until a mission can begin."""

    def is_ready() -> bool:
        has_all = ground.status == "online" and ground.state.get("reason") == ""
        return has_all and all(link["ok"] for link in ground.state["link"].values())

    await ground.until(is_ready)
