"""Lockstep of vehicle and mission: neither gets ahead of the other, whatever their delays."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import random
import threading
from collections.abc import AsyncIterator, Callable

import pytest

from panoexec.adapters.link.message_hub import Handler, MavMessage
from panoexec.clock import VehicleClock
from panoexec.dryrun.lockstep import AHEAD_S, BEGIN_EVERY_S, STEP_S, Lockstep
from panoexec.sim.pacing import TIME_COMPONENT, TIME_MESSAGE, TIME_NAME, time_fields


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A computer that stands still for a while is no lost word."""
    monkeypatch.setattr("panoexec.dryrun.lockstep._LOOK_S", 20.0)


class VehicleInAThread:
    """Lives as far as it is allowed to and says so, a little late each time."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.steps: list[tuple[float, float, float]] = []
        """(from, until, speed) of each allowance that it lived."""
        self.lose_next = False
        self.heard: Handler = lambda _: None
        self._allowed: queue.SimpleQueue[tuple[float, float] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        assert name == TIME_MESSAGE
        self.heard = handler
        return lambda: None

    def allow(self, until_s: float, speed: float) -> None:
        self._allowed.put((until_s, speed))

    def stop(self) -> None:
        self._allowed.put(None)
        self._thread.join()

    def _live(self) -> None:
        late = random.Random(1)
        while (allowance := self._allowed.get()) is not None:
            until_s, speed = allowance
            if until_s <= self.now_s:
                continue
            self.steps.append((self.now_s, until_s, speed))
            self.now_s = until_s
            threading.Event().wait(late.choice((0.0, 0.0, 0.003)))
            if self.lose_next:
                self.lose_next = False
                continue
            boot_ms, value = time_fields(until_s)
            fields = {"time_boot_ms": boot_ms, "name": TIME_NAME, "value": value}
            self.heard(MavMessage(TIME_MESSAGE, TIME_COMPONENT, fields, 0.0))


@contextlib.asynccontextmanager
async def together(vehicle: VehicleInAThread) -> AsyncIterator[tuple[VehicleClock, Lockstep]]:
    clock = VehicleClock()
    keeper = Lockstep(clock, vehicle.allow, speedup=20.0)
    try:
        async with asyncio.timeout(30):
            with keeper.keeping(vehicle):
                yield clock, keeper
    finally:
        vehicle.stop()


async def test_sleepers_wake_at_the_exact_vehicle_time() -> None:
    vehicle = VehicleInAThread()
    async with together(vehicle) as (clock, keeper):
        await keeper.begin()
        for seconds in (0.3, 0.0171, 0.05, 0.1234567):
            due_s = clock.monotonic() + seconds
            await clock.sleep(seconds)
            assert clock.monotonic() == pytest.approx(due_s, abs=3e-6)
            assert vehicle.now_s == pytest.approx(due_s, abs=3e-6)


async def test_missions_begin_at_round_moments_and_go_at_full_speed_from_then_on() -> None:
    vehicle = VehicleInAThread()
    async with together(vehicle) as (clock, keeper):
        await clock.sleep(0.1)
        assert {speed for _, _, speed in vehicle.steps} == {1.0}
        await keeper.begin()
        assert clock.monotonic() == pytest.approx(BEGIN_EVERY_S, abs=3e-6)
        await clock.sleep(0.1)
        assert vehicle.steps[-1][2] == 20.0


async def test_the_vehicle_is_never_further_ahead_than_it_may_be() -> None:
    vehicle = VehicleInAThread()
    async with together(vehicle) as (clock, keeper):
        await keeper.begin()
        for _ in range(100):
            await clock.sleep(0.013)
            # a loop that is held up by something else
            held_up = clock.monotonic()
            threading.Event().wait(0.002)
            assert vehicle.now_s <= held_up + AHEAD_S + 3e-6


async def test_real_work_takes_small_steps_no_faster_than_real_time() -> None:
    vehicle = VehicleInAThread()
    async with together(vehicle) as (clock, keeper):
        await keeper.begin()
        await clock.sleep(0.1)
        with clock.work():
            lived = len(vehicle.steps)
            await clock.sleep(0.1)
            # the first may have been allowed before
            during = vehicle.steps[lived + 1 :]
            assert during
            assert all(until - begin <= STEP_S + 3e-6 and speed == 1.0 for begin, until, speed in during)
        await clock.sleep(0.1)
        assert vehicle.steps[-1][2] == 20.0


async def test_before_a_mission_begins_a_vehicle_needs_few_steps() -> None:
    """On a starved computer each step takes long, and the vehicle's heartbeats must come in time to find it."""
    vehicle = VehicleInAThread()
    async with together(vehicle) as (clock, _):
        await clock.sleep(0.1)
        with clock.work():
            lived, began_s = len(vehicle.steps), vehicle.now_s
            await clock.sleep(2.0)
            during = vehicle.steps[lived:]
            assert len(during) <= 2 * (vehicle.now_s - began_s) / 0.1
            assert {speed for _, _, speed in during} == {1.0}


async def test_lost_time_message_delays_only_briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoexec.dryrun.lockstep._LOOK_S", 0.05)
    vehicle = VehicleInAThread()
    async with together(vehicle) as (clock, keeper):
        await keeper.begin()
        vehicle.lose_next = True
        await clock.sleep(1.0)
        assert not vehicle.lose_next
        assert vehicle.now_s == pytest.approx(clock.monotonic(), abs=AHEAD_S)


async def test_time_advances_without_a_lost_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoexec.dryrun.lockstep._LOOK_S", 0.01)
    vehicle = VehicleInAThread()
    async with together(vehicle) as (clock, keeper):
        await keeper.begin()
        vehicle.heard = lambda _: None
        died_s = clock.monotonic()
        await clock.sleep(0.2)
        assert clock.monotonic() >= died_s + 0.2 - 1e-5


async def test_vehicle_advances_in_real_time_before_the_first_message() -> None:
    clock, allowed, enough = VehicleClock(), list[tuple[float, float]](), asyncio.Event()

    def allow(until_s: float, speed: float) -> None:
        allowed.append((until_s, speed))
        if until_s > 0.05:
            enough.set()

    loop = asyncio.get_running_loop()
    keeper = Lockstep(clock, allow, speedup=20.0)
    began_s = loop.time()
    async with asyncio.timeout(20):
        with keeper.keeping(_Nobody()):
            await enough.wait()
    assert allowed == sorted(allowed)
    assert {speed for _, speed in allowed} == {1.0}
    assert allowed[-1][0] <= loop.time() - began_s
    assert clock.monotonic() == 0.0


class _Nobody:
    """Says nothing."""

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        del name, handler
        return lambda: None
