"""Strangers' requests to the living daemon: each answered with an error, none obeyed, memory bounded.

A mission by mosquitto's own clients follows on the same daemon: it is as good as new.

PANOEXEC_FUZZ=20000 sends as many; 500 otherwise.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
from collections import Counter
from itertools import islice
from pathlib import Path

import aiomqtt
import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.fuzzing import Stranger, strangers
from tests.system.daemon import BASE, SPEEDUP, Ground, ground_station, ready, serving
from tests.system.shell_mission import flown_from_a_shell
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto

REQUESTS = int(os.environ.get("PANOEXEC_FUZZ", "500"))
WARM_UP = 200
IN_FLIGHT = 40
GROWTH_MB = 25.0
STILL_THERE = "still there"


class Crowd:
    """Sends strangers' requests and counts the answers."""

    def __init__(self, client: aiomqtt.Client) -> None:
        self.sent = 0
        self.kinds: Counter[str] = Counter()
        self.retained: set[str] = set()
        self.codes: Counter[str] = Counter()
        self.oks: list[str] = []
        self._client = client
        self._answered = asyncio.Event()

    @property
    def answers(self) -> int:
        return self.codes.total() + len(self.oks)

    async def listen(self) -> None:
        async for message in self._client.messages:
            if str(message.topic) == f"{BASE}/response/me":
                continue  # the same once more, where it was asked for
            answer = json.loads(bytes(message.payload))
            if answer["transaction"] == STILL_THERE:
                continue
            if answer["status"] == "error":
                self.codes[answer["error"]["code"]] += 1
            elif (answer["data"] or {}).get("mission_id", "") is None and "durable" in answer["data"]:
                self.codes["called off"] += 1  # an abort that overtook a start or resume: nothing flew
            else:
                self.oks.append(f"{message.topic}: {answer}")
            self._answered.set()

    async def send(self, one: Stranger) -> None:
        topic = f"{BASE}/request/{one.command}"
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        if one.response_topic:
            properties.ResponseTopic = one.response_topic
            properties.CorrelationData = bytes(range(20))
        await self._client.publish(topic, one.payload, qos=1, retain=one.retain, properties=properties)
        self.sent += 1
        self.kinds[one.kind] += 1
        if one.retain:
            self.retained.add(topic)
        await self.settle(IN_FLIGHT)

    async def settle(self, unanswered: int) -> None:
        """Wait until no more than so many are without an answer."""
        async with asyncio.timeout(180):
            while self.sent - self.answers > unanswered:
                self._answered.clear()
                await self._answered.wait()

    async def clear(self) -> None:
        """Take back what the broker keeps."""
        for topic in self.retained:
            await self._client.publish(topic, b"", qos=1, retain=True)


def resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1000


def threads_and_files(pid: int) -> tuple[int, int]:
    return len(list(Path(f"/proc/{pid}/task").iterdir())), len(list(Path(f"/proc/{pid}/fd").iterdir()))


async def crowd_at(ground: Ground, port: int, pid: int) -> tuple[Crowd, float]:
    """Send them all; returns what came of it and by how much the daemon's memory grew, MB."""
    async with aiomqtt.Client(
        "127.0.0.1",
        port,
        protocol=aiomqtt.ProtocolVersion.V5,
        socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
    ) as client:
        await client.subscribe(f"{BASE}/response/#", qos=1)
        crowd = Crowd(client)
        listening = asyncio.create_task(crowd.listen(), name="answers")
        try:
            source = strangers(seed=20260101)
            for one in islice(source, min(WARM_UP, REQUESTS)):
                await crowd.send(one)
            before_mb = resident_mb(pid)
            for one in islice(source, max(0, REQUESTS - WARM_UP)):
                await crowd.send(one)
            await crowd.settle(0)
            await crowd.clear()
            assert (await ground.ask("get", STILL_THERE))["status"] == "ok"
            return crowd, resident_mb(pid) - before_mb
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)


async def test_strangers_get_errors_and_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    port = free_udp_port()
    with running_broker(tmp_path, settings="allow_anonymous true\nmessage_size_limit 1000000") as broker:
        simulator = running_simulator(SimConfig(port=port, speedup=SPEEDUP))
        async with simulator, ground_station(broker) as ground, serving(tmp_path, broker, port) as process:
            await ready(ground)
            threads, files = threads_and_files(process.pid)
            crowd, grown_mb = await crowd_at(ground, broker.port, process.pid)
            assert process.returncode is None
            assert crowd.oks == []
            assert crowd.codes.total() == REQUESTS, "each was answered once"
            assert grown_mb < GROWTH_MB
            now_threads, now_files = threads_and_files(process.pid)
            assert now_threads <= threads + 8
            assert now_files <= files + 4
            assert ground.state["state"] == "idle"
            assert ground.events == []
            assert ground.misfits == []
            assert not (tmp_path / "data" / "missions").exists()
            if len(set(crowd.kinds)) > 1 and REQUESTS >= 500:
                assert len(crowd.kinds) == 12
                assert crowd.codes.keys() >= {"not_json", "invalid", "unknown_command", "retained", "refused"}
            tell(crowd, grown_mb, capsys)
            await flown_from_a_shell(broker, tmp_path)
            assert ground.misfits == []


def tell(crowd: Crowd, grown_mb: float, capsys: pytest.CaptureFixture[str]) -> None:
    """The figures of a long run."""
    with capsys.disabled():
        if REQUESTS > 500:
            print(f"\n{REQUESTS} requests: {dict(crowd.codes)}; kinds {dict(crowd.kinds)}; memory +{grown_mb:.1f} MB")
