"""The server of the operator's page: from a vehicle's message to the page, its memory and processor time, a lost link.

The server is a process, the broker a real mosquitto on loopback, and twenty pages are open.
"""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import aiohttp
import numpy as np

from panoexec.sim.ports import free_tcp_port
from tests.bench.harness import Measurement
from tests.support.web import MISSION, FakeBrowser, FakeVehicle, fake_vehicle
from tests.waiting import eventually
from tests.wire.broker import running_broker
from tests.wire.broker_proxy import BrokerProxy, broker_proxy

PAGES = 20
EVENTS = 400
IDLE_S = 30.0
AWAY_S = 30.0
FLEET = 50
FLEET_S = 20.0


@dataclass(frozen=True, slots=True)
class Running:
    """The server as a process."""

    pid: int
    port: int

    def resident_mb(self) -> float:
        lines = Path(f"/proc/{self.pid}/status").read_text(encoding="utf-8").splitlines()
        return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1000

    def cpu_s(self) -> float:
        stat = Path(f"/proc/{self.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK")

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"


def measure() -> Iterable[Measurement]:
    """All of them."""
    return asyncio.run(_measure())


async def _measure() -> list[Measurement]:
    with tempfile.TemporaryDirectory() as name, running_broker(Path(name), verbose=False) as broker:
        async with broker_proxy(broker.port) as proxy, serving(proxy.port) as server, pages(server, PAGES) as opened:
            async with fake_vehicle(broker.port) as vehicle:
                for page in opened:
                    await page.say(type="follow", vehicle="drone")
                await vehicle.state()
                await opened[-1].until("state")
                out = await _idle(server, vehicle)
                out += await _events(vehicle, opened)
                out += await _away(proxy, broker.port, vehicle, opened)
            out += await _fleet(broker.port, server, opened)
            return out


async def _idle(server: Running, vehicle: FakeVehicle) -> list[Measurement]:
    before_s = server.cpu_s()
    end_s = time.monotonic() + IDLE_S
    while time.monotonic() < end_s:
        await asyncio.sleep(IDLE_S / 2)
        await vehicle.state()  # as an idle daemon does
    percent = 100 * (server.cpu_s() - before_s) / IDLE_S
    beside = f"beside one idle vehicle, {PAGES} pages"
    return [
        _at_most(f"memory, {beside}", server.resident_mb(), "MB", 60),
        _at_most(f"processor, {beside}", percent, "% of a core", 1),
    ]


async def _events(vehicle: FakeVehicle, opened: list[FakeBrowser]) -> list[Measurement]:
    times = []
    await vehicle.state(state="capturing", mission_id=MISSION, shots_total=EVENTS, shots="")
    for seq in range(1, EVENTS + 1):
        page = opened[seq % PAGES]
        began_s = time.monotonic()
        await vehicle.publish("event", an_event(seq))
        await page.until("event", lambda one, seq=seq: one["event"]["seq"] == seq)  # type: ignore[misc]
        times.append(time.monotonic() - began_s)
        if seq % 20 == 0:
            for one in opened:
                one.heard.clear()
    out = []
    for name, share in (("median", 50), ("95 %", 95)):
        ms = 1000 * float(np.percentile(times, share))
        out.append(_at_most(f"event to page, {name} of {EVENTS}", ms, "ms", 200))
    return out


async def _away(
    proxy: BrokerProxy, broker_port: int, vehicle: FakeVehicle, opened: list[FakeBrowser]
) -> list[Measurement]:
    for page in opened:
        page.heard.clear()
    began_s = time.monotonic()
    proxy.target = free_tcp_port()  # nobody listens there
    for task in list(proxy._tasks):
        task.cancel()
    await asyncio.gather(*(page.until("link", lambda one: not one["up"]) for page in opened))
    told_s = time.monotonic() - began_s
    for seq in range(EVENTS + 1, EVENTS + 31):
        await vehicle.publish("event", an_event(seq))
        await vehicle.state(state="capturing", mission_id=MISSION, shots_done=seq)
        await asyncio.sleep(AWAY_S / 30)
    proxy.target = broker_port
    back_s = time.monotonic()
    last = EVENTS + 30
    for page in opened:
        await page.until("event", lambda one: one["event"]["seq"] == last)
        await page.until("state", lambda one: one["state"]["shots_done"] == last)
    right_s = time.monotonic() - back_s
    heard = [one["event"]["seq"] for one in opened[0].of("event")]
    lost = len(set(range(EVENTS + 1, last + 1)) - set(heard))
    return [
        _at_most("all pages say that the link is broken", told_s, "s", 3),
        _at_most(f"all pages are right again after {AWAY_S:.0f} s without link", right_s, "s", 3),
        _at_most("events lost", lost, "", 0),
    ]


async def _fleet(broker_port: int, server: Running, opened: list[FakeBrowser]) -> list[Measurement]:
    async with AsyncExitStack() as stack:
        vehicles = [
            await stack.enter_async_context(fake_vehicle(broker_port, f"v{number:02}")) for number in range(FLEET)
        ]
        for page in opened:
            page.heard.clear()
            await page.say(type="follow", vehicle=None)
        await asyncio.gather(*(page.until("vehicles", lambda one: len(one["vehicles"]) > FLEET) for page in opened))
        before_s, seq = server.cpu_s(), 0
        end_s = time.monotonic() + FLEET_S
        while time.monotonic() < end_s:
            seq += 1
            for vehicle in vehicles:  # a state a second each, spread over it
                await vehicle.state(state="capturing", mission_id=MISSION, shots_total=99, shots_done=seq % 99)
                await asyncio.sleep(1 / FLEET)
            for page in opened:
                page.heard.clear()
        percent = 100 * (server.cpu_s() - before_s) / FLEET_S
        what = f"{FLEET} vehicles that fly, {PAGES} pages with the list"
        return [
            Measurement(what=f"memory, {what}", ours=server.resident_mb(), unit="MB"),
            Measurement(what=f"processor, {what}", ours=percent, unit="% of a core"),
        ]


def an_event(seq: int) -> dict[str, object]:
    return {
        "type": "shot_accepted", "id": f"{MISSION}/{seq}", "time": "2026-11-22T07:58:02.000Z", "mission_id": MISSION,
        "seq": seq, "time_utc_s": 1.0, "clock_s": 1.0, "state": "capturing", "shot": seq % 155,
        "attempt": 1 + seq // 155, "photos": [], "by": "tolerance",
    }  # fmt: skip


def _at_most(what: str, ours: float, unit: str, goal: float) -> Measurement:
    return Measurement(what=what, ours=ours, unit=unit, goal=f"≤ {goal:g} {unit}".strip(), met=ours <= goal)


@asynccontextmanager
async def serving(broker_port: int) -> AsyncIterator[Running]:
    """`panoexec web` for the broker."""
    port = free_tcp_port()
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "panoexec", "web", "--port", str(broker_port), "--listen", f"127.0.0.1:{port}"),
        stdout=asyncio.subprocess.DEVNULL,
    )
    running = Running(process.pid, port)
    try:
        async with aiohttp.ClientSession() as session:
            for _ in range(200):
                try:
                    async with session.get(running.url):
                        break
                except aiohttp.ClientConnectorError:
                    await asyncio.sleep(0.1)
        yield running
    finally:
        process.terminate()
        await process.wait()


@asynccontextmanager
async def pages(server: Running, count: int) -> AsyncIterator[list[FakeBrowser]]:
    """So many pages that are open."""
    async with AsyncExitStack() as stack:
        session = await stack.enter_async_context(aiohttp.ClientSession())
        opened, tasks = [], []
        for _ in range(count):
            socket = await stack.enter_async_context(session.ws_connect(f"{server.url}/socket", origin=server.url))
            page = FakeBrowser(socket)
            opened.append(page)
            tasks.append(asyncio.create_task(page.run(), name="page"))
        await eventually(lambda: any(one["up"] for one in opened[-1].of("link")))
        try:
            yield opened
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
