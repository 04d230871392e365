"""How long a ground station waits for an answer over a radio link of 1 kB/s, while a mission floods it with events.

The daemon as a process reaches a real mosquitto through a proxy that carries 1 kB/s each way and buffers what it cannot
carry yet, as radios do. The ground station is at the broker.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from panoexec.sim.config import SimConfig
from panoexec.sim.process import free_udp_port, running_simulator
from tests.bench.harness import Measurement
from tests.system.daemon import SMALL, Ground, ground_station, ready, serving
from tests.wire.broker import running_broker
from tests.wire.broker_proxy import broker_proxy

RATE = 1000.0
GETS = 8
PAUSE_S = 2.0
GET_GOAL_S = 2.0
START_GOAL_S = 3.0


@dataclass(frozen=True, slots=True)
class SlowAnswers:
    """Times until an answer, s; events of the mission that were missing at its end; how often the link was lost."""

    idle: list[float]
    plan: float
    start: float
    capturing: list[float]
    events_missing: int
    reconnections: int


def measure() -> Iterable[Measurement]:
    """All of them."""
    result = asyncio.run(slow_answers())
    yield from _lines("get, idle", result.idle)
    yield Measurement(what="plan, with the time to plan", ours=result.plan, unit="s")
    yield Measurement(
        what="start of what was planned",
        ours=result.start,
        unit="s",
        goal=f"≤ {START_GOAL_S:g} s",
        met=result.start <= START_GOAL_S,
    )
    yield from _lines("get, capturing", result.capturing)
    yield Measurement(
        what="events missing", ours=result.events_missing, unit="", goal="0", met=not result.events_missing
    )
    yield Measurement(what="reconnections", ours=result.reconnections, unit="")


async def slow_answers(*, rate: float = RATE, gets: int = GETS, speedup: float = 1.0) -> SlowAnswers:
    """Measure at a rate in bytes per second."""
    port = free_udp_port()
    with tempfile.TemporaryDirectory() as name, running_broker(Path(name)) as broker:
        async with (
            running_simulator(SimConfig(port=port, speedup=speedup)),
            broker_proxy(broker.port, rate=rate) as proxy,
            ground_station(broker) as ground,
            serving(Path(name), proxy, port, speedup=speedup),
        ):
            await ready(ground)
            idle = await _gets(ground, "idle", gets)
            begin = time.perf_counter()
            await ground.ask("plan", "plan", **SMALL)
            plan = time.perf_counter() - begin
            begin = time.perf_counter()
            answer = await ground.ask("start", "start", **SMALL)
            start = time.perf_counter() - begin
            assert answer["status"] == "ok", answer
            capturing = await _gets(ground, "capturing", gets)
            await ground.until(lambda: "mission_finished" in ground.types(), 60)
            missing = _missing(ground)
            return SlowAnswers(idle, plan, start, capturing, missing, proxy.connections - 1)


async def _gets(ground: Ground, name: str, number: int) -> list[float]:
    times = []
    for one in range(number):
        begin = time.perf_counter()
        await ground.ask("get", f"{name} {one}")
        times.append(time.perf_counter() - begin)
        await asyncio.sleep(PAUSE_S)
    return times


def _missing(ground: Ground) -> int:
    """How many of the events up to the last one never came."""
    numbers = {int(event["seq"]) for event in ground.events}
    return max(numbers) - min(numbers) + 1 - len(numbers)


def _lines(what: str, times: list[float]) -> Iterator[Measurement]:
    for name, share in (("median", 50), ("worst", 100)):
        ours = float(np.percentile(times, share))
        met = ours <= GET_GOAL_S if share == 100 else None
        goal = f"≤ {GET_GOAL_S:g} s" if share == 100 else ""
        yield Measurement(what=f"{what}, {name}", ours=ours, unit="s", goal=goal, met=met)
