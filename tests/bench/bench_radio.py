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
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.bench.harness import Measurement
from tests.system.daemon import BASE, Ground, ground_station, ready, serving
from tests.wire.broker import running_broker
from tests.wire.broker_proxy import PUBLISH, broker_proxy, varint

RATE = 1000.0
GETS = 8
PAUSE_S = 2.0
PAUSED_S = 30.0
GET_GOAL_S = 2.0
START_GOAL_S = 3.0
PLANNED = {"elevation_deg": [-40, 30], "method": "paper"}
_DELTAS = "from panoexec.mqtt.state_forms import StateForms; StateForms.connected = lambda *_, **__: None"
"""What takes the deltas away."""


@dataclass(frozen=True, slots=True)
class SlowAnswers:
    """Times until an answer, s; events of the mission that were missing at its end; how often the link was lost.

    Of states and deltas in whole packets: how many arrived a second while events flooded the link, and what they took
    of it while the mission was paused, when there was room for each.
    """

    idle: list[float]
    plan: float
    start: float
    capturing: list[float]
    events_missing: int
    reconnections: int
    states_s: float
    state_bytes_s: float


def measure() -> Iterable[Measurement]:
    """All of them."""
    result = asyncio.run(slow_answers())
    whole = asyncio.run(slow_answers(without=_DELTAS))
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
    peer, most = "whole states", 0.6 * whole.state_bytes_s
    yield Measurement(
        what="paused: states on the link",
        ours=result.state_bytes_s,
        unit="B/s",
        peer=peer,
        theirs=whole.state_bytes_s,
        goal=f"≤ {most:.0f} B/s",
        met=result.state_bytes_s <= most,
    )
    yield Measurement(what="capturing: states", ours=result.states_s, unit="/s", peer=peer, theirs=whole.states_s)
    for what, ours, theirs in (
        ("get, idle, worst", max(result.idle), max(whole.idle)),
        ("start of what was planned", result.start, whole.start),
        ("get, capturing, median", float(np.median(result.capturing)), float(np.median(whole.capturing))),
        ("get, capturing, worst", max(result.capturing), max(whole.capturing)),
    ):
        yield Measurement(what=f"beside: {what}", ours=ours, unit="s", peer=peer, theirs=theirs)


async def slow_answers(*, rate: float = RATE, gets: int = GETS, speedup: float = 1.0, without: str = "") -> SlowAnswers:
    """Measure at a rate in bytes per second, a daemon without what that code takes away."""
    port = free_udp_port()
    with tempfile.TemporaryDirectory() as name, running_broker(Path(name)) as broker:
        async with (
            running_simulator(SimConfig(port=port, speedup=speedup)),
            broker_proxy(broker.port, rate=rate) as proxy,
            ground_station(broker) as ground,
            serving(Path(name), proxy, port, speedup=speedup, without=without),
        ):
            states = _States()
            proxy.closes_at = states.note
            await ready(ground)
            idle = await _gets(ground, "idle", gets)
            begin = time.perf_counter()
            await ground.ask("plan", "plan", **PLANNED)
            plan = time.perf_counter() - begin
            begin = time.perf_counter()
            answer = await ground.ask("start", "start", **PLANNED)
            start = time.perf_counter() - begin
            assert answer["status"] == "ok", answer
            number, begin = states.number, time.perf_counter()
            capturing = await _gets(ground, "capturing", gets)
            states_s = (states.number - number) / (time.perf_counter() - begin)
            assert (await ground.ask("pause", "pause"))["status"] == "ok"
            await ground.until(lambda: "mission_paused" in ground.types(), 120)
            size, begin = states.size, time.perf_counter()
            await asyncio.sleep(PAUSED_S)
            state_bytes_s = (states.size - size) / (time.perf_counter() - begin)
            await ground.ask("resume", "resume")
            await ground.until(lambda: "mission_finished" in ground.types(), 120)
            return SlowAnswers(
                idle=idle,
                plan=plan,
                start=start,
                capturing=capturing,
                events_missing=_missing(ground),
                reconnections=proxy.connections - 1,
                states_s=states_s,
                state_bytes_s=state_bytes_s,
            )


class _States:
    """States and deltas that pass the proxy."""

    def __init__(self) -> None:
        self.number = 0
        self.size = 0

    def note(self, first: int, content: bytes) -> bool:
        """Count a packet; it closes nothing."""
        topic = content[2 : 2 + int.from_bytes(content[:2], "big")]
        if first >> 4 == PUBLISH and topic in (f"{BASE}/state".encode(), f"{BASE}/state/delta".encode()):
            self.number += 1
            self.size += 1 + len(varint(len(content))) + len(content)
        return False


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
