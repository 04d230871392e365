"""A vehicle's clock: no time passes that was not told, every sleep ends at its moment, none is missed."""

from __future__ import annotations

import asyncio
import math
import threading

import pytest

from panoexec.clock import SystemClock, VehicleClock, latest_s, work


def on_this_loop(clock: VehicleClock) -> None:
    """Wake sleepers as a simulated clock does."""
    loop = asyncio.get_running_loop()

    def told() -> None:
        loop.call_soon_threadsafe(clock.wake)

    clock.on_told = told


async def test_time_stands_still_until_it_is_told() -> None:
    clock = VehicleClock()
    on_this_loop(clock)
    sleeping = asyncio.create_task(clock.sleep(0.5))
    await asyncio.sleep(0.02)
    assert clock.monotonic() == 0.0
    assert clock.next_s == 0.5
    clock.tell(0.499)
    await asyncio.sleep(0.02)
    assert not sleeping.done()
    clock.tell(0.5)
    await sleeping
    clock.tell(0.2)
    assert clock.monotonic() == 0.5
    assert clock.next_s == math.inf


async def test_a_sleep_is_never_over_before_its_moment() -> None:
    """The time is told rounded; whoever looks at the clock after a sleep must find it over."""
    clock = VehicleClock(0.1)
    on_this_loop(clock)
    due_s = clock.monotonic() + 1 / 3
    sleeping = asyncio.create_task(clock.sleep(1 / 3))
    await asyncio.sleep(0)
    clock.tell(math.floor(due_s * 1e6) / 1e6)
    await sleeping
    assert clock.monotonic() >= due_s


async def test_sleepers_wake_in_order_and_cancelled_ones_hold_nobody() -> None:
    clock, woken = VehicleClock(), list[float]()
    on_this_loop(clock)

    async def sleep(seconds: float) -> None:
        await clock.sleep(seconds)
        woken.append(seconds)

    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(sleep(seconds)) for seconds in (3.0, 1.0, 2.0, 0.0)]
        await asyncio.sleep(0.02)
        tasks[1].cancel()
        await asyncio.sleep(0)
        assert clock.next_s == 2.0
        clock.tell(5.0)
    assert woken == [0.0, 2.0, 3.0]


async def test_sleepers_are_woken_from_another_thread_however_it_falls() -> None:
    clock, loop = VehicleClock(), asyncio.get_running_loop()
    over = threading.Event()
    room = threading.Semaphore(20)  # so far may it be ahead: the loop could not keep up with a thread that never waits

    def woken() -> None:
        clock.wake()
        room.release()

    def told() -> None:
        room.acquire()
        loop.call_soon_threadsafe(woken)

    clock.on_told = told

    def vehicle() -> None:
        now_s = 0.0
        while not over.is_set():
            now_s += 0.001
            clock.tell(now_s)

    thread = threading.Thread(target=vehicle)
    thread.start()
    try:
        async with asyncio.timeout(120):
            for _ in range(500):
                before_s = clock.monotonic()
                await clock.sleep(0.0017)
                assert clock.monotonic() >= before_s + 0.0017
    finally:
        over.set()
        room.release()
        thread.join()


async def test_work_is_announced_once_however_it_is_nested() -> None:
    clock, calls = VehicleClock(), list[str]()
    clock.on_work = lambda: calls.append("begins")
    clock.on_told = lambda: calls.append("ends")
    with work(clock), work(clock):
        assert clock.is_at_work
    with pytest.raises(ZeroDivisionError), work(clock):
        raise ZeroDivisionError
    assert calls == ["begins", "ends"] * 2
    assert not clock.is_at_work
    with work(SystemClock()):  # which does not care
        pass


def test_the_latest_time_is_what_was_allowed() -> None:
    clock = VehicleClock()
    clock.allowed_s = 2.0
    clock.tell(1.5)
    assert latest_s(clock) == 2.0
    clock.tell(2.5)
    assert latest_s(clock) == 2.5
    system = SystemClock()
    assert system.monotonic() <= latest_s(system) <= system.monotonic()
