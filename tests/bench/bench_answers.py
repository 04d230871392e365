"""How long a ground station waits for an answer: the daemon as a process, a real mosquitto, loopback.

A thousand requests, one after the other: `get`, which changes nothing, and `pause` without a mission, which is written
to disk twice. The peer is a message that goes to the broker and straight back.
"""

from __future__ import annotations

import asyncio
import json
import tempfile
import time
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiomqtt
import numpy as np

from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.ground_station import GroundStation
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.bench.harness import Measurement
from tests.system.daemon import BASE, SMALL, ground_station, ready, serving
from tests.wire.broker import Broker, running_broker

REQUESTS = 1000
PLAIN = 200
GOAL_MS = 50.0


def measure() -> Iterable[Measurement]:
    """All of them."""
    return asyncio.run(_measure())


async def _measure() -> list[Measurement]:
    port = free_udp_port()
    with tempfile.TemporaryDirectory() as name, running_broker(Path(name)) as broker:
        simulator = running_simulator(SimConfig(port=port))
        async with simulator, ground_station(broker) as ground, serving(Path(name), broker, port, speedup=1.0):
            await ready(ground)
            there_and_back = await _there_and_back(broker)
            out = []
            for what, command, requests in (
                ("get, idle", "get", REQUESTS),
                ("pause, idle (durable)", "pause", REQUESTS),
            ):
                out += list(_lines(what, await _answers(broker, command, requests), there_and_back))
            out += list(
                _lines(
                    "get, idle, a client that collects small packets", await _plain(broker), there_and_back, goal=False
                )
            )
            start = await ground.ask("start", "bench", **SMALL)
            assert start["status"] == "ok", start
            await ground.until(lambda: ground.state["state"] == "capturing")
            times = await _answers(broker, "get", REQUESTS, until=lambda: ground.state["state"] != "capturing")
            out += list(_lines(f"get, capturing ({len(times)} requests)", times, there_and_back))
            return out


def _lines(what: str, times: list[float], peer: list[float], *, goal: bool = True) -> Iterator[Measurement]:
    for name, share in (("median", 50), ("99 %", 99)):
        ours = 1000 * float(np.percentile(times, share))
        yield Measurement(
            what=f"{what}, {name}",
            ours=ours,
            unit="ms",
            peer="broker alone",
            theirs=1000 * float(np.percentile(peer, share)),
            goal=f"≤ {GOAL_MS:g} ms" if goal and share == 99 else "",
            met=ours <= GOAL_MS if goal and share == 99 else None,
        )


async def _answers(broker: Broker, command: str, requests: int, until: object = None) -> list[float]:
    times = []
    async with _station(broker) as station:
        for number in range(requests):
            if callable(until) and until():
                break
            begin = time.perf_counter()
            await station.request("drone", command, {"transaction": f"{command} {number} {begin}"}, timeout_s=30)
            times.append(time.perf_counter() - begin)
    return times


@asynccontextmanager
async def _station(broker: Broker) -> AsyncIterator[GroundStation]:
    async with GroundStation(MqttSection(host="127.0.0.1", port=broker.port)) as station:
        yield station


async def _plain(broker: Broker) -> list[float]:
    """With a client as libraries make them: its own kernel, and the broker's, hold small packets back (Nagle)."""
    times = []
    async with aiomqtt.Client("127.0.0.1", broker.port) as client:
        await client.subscribe(f"{BASE}/response/get", qos=1)
        for number in range(PLAIN):
            begin = time.perf_counter()
            await client.publish(f"{BASE}/request/get", json.dumps({"transaction": f"plain {number}"}), qos=1)
            await anext(aiter(client.messages))
            times.append(time.perf_counter() - begin)
    return times


async def _there_and_back(broker: Broker) -> list[float]:
    times = []
    async with aiomqtt.Client("127.0.0.1", broker.port) as client:
        await client.subscribe(f"{BASE}/nothing", qos=1)
        for number in range(REQUESTS):
            begin = time.perf_counter()
            await client.publish(f"{BASE}/nothing", json.dumps(number), qos=1)
            await anext(aiter(client.messages))
            times.append(time.perf_counter() - begin)
    return times
