"""Fifty vehicles on one mosquitto: fifty daemon processes, each with a light stand-in for its vehicle.

All fly a mission of 12 shots at the same time, at real time, commanded and watched by one ground station; a second one
asks vehicle after vehicle for its state meanwhile. What the broker costs is read from /proc.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import aiomqtt
import numpy as np

from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.client import broker_client
from panoexec.mqtt.ground_station import GroundStation
from tests.bench.harness import Measurement
from tests.wire.broker import Broker, running_broker

VEHICLES = int(os.environ.get("PANOEXEC_FLEET", "50"))
PLAN = {"shots": [{"pitch_deg": -20, "yaw_deg": 30 * number} for number in range(12)]}
START_S = 240.0


class Tower:
    """Hears all vehicles."""

    def __init__(self) -> None:
        self.status: dict[str, str] = {}
        self.state: dict[str, dict[str, Any]] = {}
        self.events: dict[str, list[int]] = defaultdict(list)
        self.ended: dict[str, str] = {}
        self.answered: dict[str, float] = {}
        self.refused: dict[str, str] = {}
        self.delays_s: list[float] = []
        self.messages = 0
        self.bytes = 0
        self.changed = asyncio.Event()

    async def listen(self, client: aiomqtt.Client) -> None:
        async for message in client.messages:
            _, vehicle, *rest = str(message.topic).split("/")
            self.messages += 1
            self.bytes += len(bytes(message.payload))
            self.take(vehicle, "/".join(rest), bytes(message.payload))
            self.changed.set()

    def take(self, vehicle: str, kind: str, payload: bytes) -> None:
        if kind == "status":
            self.status[vehicle] = payload.decode()
        elif kind == "state":
            self.state[vehicle] = json.loads(payload)
            sent = datetime.fromisoformat(self.state[vehicle]["time"]).timestamp()
            if self.state[vehicle]["state"] == "capturing":
                self.delays_s.append(max(0.0, time.time() - sent))
        elif kind == "event":
            event = json.loads(payload)
            self.events[vehicle].append(int(event["id"].rpartition("/")[2]))
            if event["type"] == "mission_finished":
                self.ended[vehicle] = vehicle
        elif kind == "response/start":
            self.answered[vehicle] = time.perf_counter()
            answer = json.loads(payload)
            if answer["status"] != "ok":
                self.refused[vehicle] = str(answer["error"])

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        async with asyncio.timeout(timeout_s):
            while not condition():
                self.changed.clear()
                await self.changed.wait()


def measure() -> Iterable[Measurement]:
    """All of them."""
    return asyncio.run(_measure())


async def _measure() -> list[Measurement]:
    with tempfile.TemporaryDirectory() as name, running_broker(Path(name), verbose=False) as broker:
        section = MqttSection(host="127.0.0.1", port=broker.port)
        async with await broker_client(section, identifier="tower") as client:
            tower = Tower()
            for kind in ("status", "state", "event", "response/start"):
                await client.subscribe(f"panoexec/+/{kind}", qos=1)
            listening = asyncio.create_task(tower.listen(client), name="tower")
            try:
                async with _fleet(Path(name), broker) as processes:
                    return await _flown(tower, client, section, broker, processes)
            finally:
                listening.cancel()
                await asyncio.gather(listening, return_exceptions=True)


async def _flown(
    tower: Tower,
    client: aiomqtt.Client,
    section: MqttSection,
    broker: Broker,
    processes: list[asyncio.subprocess.Process],
) -> list[Measurement]:
    vehicles = [f"v{number:02d}" for number in range(VEHICLES)]
    await tower.until(lambda: sum(status == "online" for status in tower.status.values()) == VEHICLES, START_S)
    await tower.until(lambda: len(tower.state) == VEHICLES, 30)
    before = tower.messages, tower.bytes, broker.cpu_s(), time.perf_counter()
    asked: dict[str, float] = {}
    for vehicle in vehicles:
        asked[vehicle] = time.perf_counter()
        request = json.dumps({"transaction": "fleet", "plan": PLAN})
        await client.publish(f"panoexec/{vehicle}/request/start", request, qos=1)
    await tower.until(lambda: len(tower.answered) == VEHICLES, 120)
    assert not tower.refused, tower.refused
    asking = asyncio.create_task(_ask_round(section, vehicles), name="asking")
    await tower.until(lambda: len(tower.ended) == VEHICLES, 300)
    asking.cancel()
    times = (await asyncio.gather(asking))[0]
    took_s = time.perf_counter() - before[3]
    messages, size = tower.messages - before[0], tower.bytes - before[1]
    broker_frac, broker_mb = (broker.cpu_s() - before[2]) / took_s, broker.resident_mb()
    starts = [tower.answered[vehicle] - asked[vehicle] for vehicle in vehicles]
    await tower.until(lambda: all(state["state"] in ("complete", "incomplete") for state in tower.state.values()), 60)
    complete = sum(state["state"] == "complete" for state in tower.state.values())
    lost = sum(max(numbers) - min(numbers) + 1 - len(set(numbers)) for numbers in tower.events.values())
    daemon_mb = float(np.median([_resident_mb(process.pid) for process in processes]))
    return [
        _line("missions that ended complete", complete, "of them", goal=f"{VEHICLES}", met=complete == VEHICLES),
        _line("events lost", lost, "events", goal="0", met=lost == 0),
        _line("start to answer, all at once, median", float(np.median(starts)), "s"),
        _line("start to answer, all at once, the last", max(starts), "s"),
        _line(f"get while all fly, median of {len(times)}", 1000 * float(np.median(times)), "ms"),
        _line("get while all fly, 99 %", 1000 * float(np.percentile(times, 99)), "ms"),
        _line("state to ground station, 99 %", 1000 * float(np.percentile(tower.delays_s, 99)), "ms"),
        _line("messages to one ground station", messages / took_s, "a second"),
        _line("bytes to one ground station", size / took_s / 1000, "kB a second"),
        _line("broker, of one core", 100 * broker_frac, "%"),
        _line("broker, resident", broker_mb, "MB"),
        _line("a daemon with its stand-in, resident, median", daemon_mb, "MB"),
        _line("all missions took", took_s, "s"),
    ]


async def _ask_round(section: MqttSection, vehicles: list[str]) -> list[float]:
    """Ask one vehicle after the other until cancelled; how long each answer took."""
    times: list[float] = []
    try:
        async with GroundStation(section) as station:
            while True:
                for vehicle in vehicles:
                    begin = time.perf_counter()
                    await station.request(vehicle, "get", {}, timeout_s=60)
                    times.append(time.perf_counter() - begin)
                    await asyncio.sleep(0.02)
    except asyncio.CancelledError:
        return times


@asynccontextmanager
async def _fleet(folder: Path, broker: Broker) -> AsyncIterator[list[asyncio.subprocess.Process]]:
    processes = []
    try:
        for number in range(VEHICLES):
            home = folder / f"v{number:02d}"
            home.mkdir()
            (home / "config.toml").write_text(
                f'[vehicle]\nid = "{home.name}"\nconnection = "udpin://127.0.0.1:1"\n[storage]\npath = "{home}/data"\n'
                f'min_free_mb = 1\n[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\n'
                "[guards]\nallowed_modes = []\nbattery_floor_frac = 0\n"
            )
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "tests.bench.fleet_daemon", str(home / "config.toml")),
                stdout=asyncio.subprocess.DEVNULL,
            )
            processes.append(process)
        yield processes
    finally:
        for process in processes:
            if process.returncode is None:
                process.terminate()
        for process in processes:
            await process.wait()


def _resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1000


def _line(what: str, ours: float, unit: str, *, goal: str = "", met: bool | None = None) -> Measurement:
    return Measurement(what=f"{VEHICLES} vehicles: {what}", ours=ours, unit=unit, goal=goal, met=met)
