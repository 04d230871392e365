"""Stops under load, on the living daemon with a simulated vehicle and a real broker: executed, and answered in 1 s.

`PANOEXEC_STOPS` sets how many aborts there are in all, divided among the conditions, each with a daemon and a seed of
its own. By default there is one in each condition, on a common daemon, but for the full disk.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import shutil
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any, TypeAlias

import aiomqtt
import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from panoexec.sim.config import AirframeConfig, SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.system.daemon import BASE, Ground, ready, serving
from tests.system.test_storage import disk, fill
from tests.waiting import eventually
from tests.wire.broker import Broker, needs_mosquitto, running_broker

__all__ = ["disk"]
pytestmark = needs_mosquitto

STOPS = int(os.environ.get("PANOEXEC_STOPS", "0"))
LIMIT_S = 1.0
TRIES = 3
"""In the suite: a machine that stands still for a second makes one answer late, a busy daemon makes each late."""
SPEEDUP = 4.0
REQUESTS = 64
REPEAT_S = 0.2
NICE = -5
"""Of the daemon, as in its systemd unit; and of ground station and broker, which measure it."""
FLYING = frozenset({"preflight", "capturing", "paused", "finishing"})
PLAN = {"shots": [{"pitch_deg": -20, "yaw_deg": 3 * number} for number in range(100)]}
TELE = {
    "name": "tele",
    "sensor_width_mm": 36.0,
    "sensor_height_mm": 24.0,
    "image_width_px": 6000,
    "image_height_px": 4000,
    "focal_length_mm": 400.0,
    "source": "the test",
}


class Clocked(Ground):
    """A ground station that notes when it heard an answer, and when the daemon's connection began."""

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self.heard_s: dict[Any, float] = {}
        self.online_s = 0.0
        self.connected_s = 0.0

    def _take(self, topic: str, payload: bytes) -> None:
        if topic.startswith("response/") and topic != "response/probe":  # where the doctor asks for its rights
            self.heard_s.setdefault(json.loads(payload)["transaction"], time.monotonic())
        if topic == "status" and payload == b"online":
            self.online_s = time.monotonic()
        super()._take(topic, payload)

    def _connected(self) -> None:
        self.connected_s = time.monotonic()

    async def answer(self, transaction: str, timeout_s: float = 60.0) -> dict[str, Any]:
        await eventually(lambda: transaction in self.answers, timeout_s)
        return self.answers[transaction]

    async def post(self, command: str, transaction: str, **fields: Any) -> None:
        await self.send(command, json.dumps({"transaction": transaction, **fields}).encode())

    async def start(self, transaction: str) -> str:
        """Start a mission; returns its id."""
        answer = await self._start(transaction)
        tries = 0
        while answer["status"] == "error" and answer["error"]["code"] == "busy":  # the last one tells the pilot
            tries += 1
            await asyncio.sleep(0.2)
            answer = await self._start(f"{transaction} {tries}")
        assert answer["status"] == "ok", answer
        return str(answer["data"]["mission_id"])

    async def _start(self, transaction: str) -> dict[str, Any]:
        """The answer to a request that is repeated until it is heard: a broker that was killed loses messages."""
        while True:
            await self.post("start", transaction, plan=PLAN)
            with contextlib.suppress(TimeoutError):
                return await self.answer(transaction, 5.0)

    async def aborted(self, mission: str | None) -> None:
        """Wait until nothing flies, and check that the mission was aborted."""
        await self.until(lambda: self.state["state"] not in FLYING and self.state["mission_id"] == mission)
        assert self.state["state"] == "aborted", (self.state, self.events[-10:])


class Bench:
    """A daemon with its ground station, a hostile client and a seed; `stop` measures."""

    def __init__(self, ground: Clocked, broker: Broker, folder: Path, rng: random.Random) -> None:
        self.ground, self.broker, self.folder, self.rng = ground, broker, folder, rng
        self.latencies_s: list[float] = []
        self.hostile: aiomqtt.Client | None = None

    async def stop(self, transaction: str) -> dict[str, Any]:
        """Abort; the answer, whose latency is recorded."""
        asked_s = time.monotonic()
        await self.ground.post("abort", transaction, reason="the test")
        answer = await self.ground.answer(transaction)
        self.latencies_s.append(self.ground.heard_s[transaction] - asked_s)
        return answer

    async def plans(self, prefix: str) -> None:
        """Send slow but valid plan requests, half of them as different senders."""
        assert self.hostile is not None
        for number in range(REQUESTS):
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            if number % 2:
                properties.ResponseTopic = f"{BASE}/response/sender{number}"
            overlap = round(self.rng.uniform(0.1, 0.3), 6)
            fields = {"camera": TELE, "elevation_deg": [-90, 90], "overlap": overlap}
            payload = json.dumps({"transaction": f"{prefix} plan {number}", **fields}).encode()
            await self.hostile.publish(f"{BASE}/request/plan", payload, qos=1, properties=properties)


def prioritise(pid: int, nice: int = NICE) -> None:
    """Set the priority within the session of a process, and of the session among others, as far as it is permitted."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, nice)
    with contextlib.suppress(OSError):  # a kernel without groups for sessions
        Path(f"/proc/{pid}/autogroup").write_text(str(nice), encoding="ascii")


@contextlib.contextmanager
def prioritised() -> Iterator[None]:
    """Run the block and the processes that it starts with the priority of the daemon."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    prioritise(os.getpid())
    try:
        yield
    finally:
        prioritise(os.getpid(), before)


Condition: TypeAlias = Callable[[Bench, str], Awaitable[None]]


async def lockout(bench: Bench, name: str) -> None:
    """64 slow plan requests in the middle of a mission."""
    mission = await bench.ground.start(f"{name} start")
    await bench.plans(name)
    await asyncio.sleep(bench.rng.uniform(0.0, 0.1))
    answer = await bench.stop(f"{name} abort")
    assert answer["status"] == "ok", answer
    await bench.ground.aborted(mission)


async def full_disk(bench: Bench, name: str) -> None:
    """Not a byte left."""
    await bench.ground.start(f"{name} start")
    await asyncio.sleep(bench.rng.uniform(0.0, 0.3))
    filler = fill(bench.folder / "data")
    answer = await bench.stop(f"{name} abort")
    # the mission may have ended by itself before, because its journal could not be written
    assert answer["status"] == "ok" or "no mission is under way" in answer["error"]["message"], answer
    await bench.ground.until(lambda: not FLYING.intersection({bench.ground.state["state"]}))
    filler.unlink()
    # the disk holds a few missions, and the files of the last one may still be written
    for old in sorted((bench.folder / "data" / "missions").iterdir())[:-1]:
        await asyncio.to_thread(shutil.rmtree, old)


async def beginning(bench: Bench, name: str) -> None:
    """In the window in which the mission begins, from before its request is stored until it takes the gimbal."""
    await bench.ground.post("start", f"{name} start", plan=PLAN)
    await asyncio.sleep(bench.rng.choice([0.0, bench.rng.uniform(0.0, 0.6)]))
    answer = await bench.stop(f"{name} abort")
    assert answer["status"] == "ok", answer
    started = await bench.ground.answer(f"{name} start")
    if started["status"] == "error":
        assert "aborted before it began" in started["error"]["message"]
    else:
        await bench.ground.aborted(started["data"]["mission_id"])


async def planning(bench: Bench, name: str) -> None:
    """While a long plan is computed for it."""
    overlap = round(bench.rng.uniform(0.1, 0.3), 6)
    fields = {"camera": TELE, "elevation_deg": [-90, 90], "overlap": overlap}
    await bench.ground.post("start", f"{name} start", **fields)
    await asyncio.sleep(bench.rng.uniform(0.0, 1.0))
    answer = await bench.stop(f"{name} abort")
    assert answer["status"] == "ok", answer
    started = await bench.ground.answer(f"{name} start")
    assert "aborted before it began" in started["error"]["message"]


async def restart(bench: Bench, name: str) -> None:
    """Around a restart of the broker.

    The time counts from when the request was sent, and both the daemon and the ground station were connected.
    """
    ground, asked_s = bench.ground, 0.0
    mission = await ground.start(f"{name} start")

    async def restarted() -> None:
        await asyncio.sleep(bench.rng.uniform(0.0, 0.05))
        await asyncio.to_thread(bench.broker.stop, kill=bench.rng.random() < 0.5)
        await asyncio.sleep(bench.rng.uniform(0.0, 0.3))
        await asyncio.to_thread(bench.broker.start)

    async def asked() -> None:
        nonlocal asked_s
        await asyncio.sleep(bench.rng.uniform(0.0, 0.1))
        asked_s = time.monotonic()
        while f"{name} abort" not in ground.answers:  # the same request again, as a broker that dies loses it
            with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                async with asyncio.timeout(REPEAT_S):  # a broker that died does not acknowledge it
                    await ground.post("abort", f"{name} abort", reason="the test")
            with contextlib.suppress(TimeoutError):
                await eventually(lambda: f"{name} abort" in ground.answers, REPEAT_S)

    await asyncio.gather(restarted(), asked())
    answer = ground.answers[f"{name} abort"]
    assert answer["status"] == "ok", answer
    heard_s = ground.heard_s[f"{name} abort"]
    connected_s = [one for one in (ground.online_s, ground.connected_s) if one < heard_s]
    bench.latencies_s.append(heard_s - max(asked_s, *connected_s))
    await ground.aborted(mission)


CONDITIONS: dict[str, Condition] = {
    "lockout": lockout,
    "full disk": full_disk,
    "beginning": beginning,
    "planning": planning,
    "broker restart": restart,
}


@asynccontextmanager
async def a_bench(folder: Path, rng: random.Random) -> AsyncIterator[Bench]:
    port = free_udp_port()
    async with AsyncExitStack() as stack:
        stack.enter_context(prioritised())
        broker = stack.enter_context(running_broker(folder, persistent=True))
        simulation = SimConfig(port=port, speedup=SPEEDUP, airframe=AirframeConfig(battery_minutes=10_000))
        await stack.enter_async_context(running_simulator(simulation))
        ground = Clocked(broker.port)
        listening = asyncio.create_task(ground.run(), name="ground station")
        try:
            async with serving(folder, broker, port, speedup=SPEEDUP, own_session=True) as process:
                prioritise(process.pid)
                await ready(ground)
                yield Bench(ground, broker, folder, rng)
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)


FULL_DISK = "full disk"
TOGETHER = [[name] for name in CONDITIONS] if STOPS else [sorted(CONDITIONS.keys() - {FULL_DISK}), [FULL_DISK]]


@pytest.mark.parametrize("conditions", TOGETHER, ids=",".join)
async def test_a_stop_is_answered_within_a_second_and_obeyed(
    conditions: list[str], request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if FULL_DISK in conditions:
        request.getfixturevalue("disk")
    count = max(1, STOPS // len(CONDITIONS))
    rng = random.Random(f"{','.join(sorted(conditions))} 20260101")
    async with a_bench(tmp_path, rng) as bench, AsyncExitStack() as stack:
        for condition in sorted(conditions):
            if condition == "lockout":
                client = aiomqtt.Client("127.0.0.1", bench.broker.port, protocol=aiomqtt.ProtocolVersion.V5)
                bench.hostile = await stack.enter_async_context(client)
            for number in range(count):
                for again in range(1 if STOPS else TRIES):
                    before = len(bench.latencies_s)
                    await CONDITIONS[condition](bench, f"{condition} {number}" + f" again {again}" * bool(again))
                    if bench.latencies_s[-1] <= LIMIT_S or STOPS or again == TRIES - 1:
                        break
                    del bench.latencies_s[before:]
            if condition == "lockout":
                await stack.aclose()
        latencies_s = sorted(bench.latencies_s)
    if STOPS:
        with capsys.disabled():
            late = [round(latency_s, 2) for latency_s in latencies_s if latency_s > LIMIT_S]
            middle, last = latencies_s[len(latencies_s) // 2], latencies_s[-1]
            print(f"\n{conditions[0]}: {count} aborts, median {middle:.3f} s, longest {last:.3f} s, late {late}")
    assert len(latencies_s) == count * len(conditions)
    assert latencies_s[-1] <= LIMIT_S
