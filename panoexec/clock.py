"""Time as the mission sees it: one protocol, so that tests drive it and a dry-run can speed it up."""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import itertools
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol


class Clock(Protocol):
    """Seconds for durations, wall time for stamps only."""

    def monotonic(self) -> float:
        """Seconds since some fixed moment; never goes back, differences are durations."""
        ...

    def time(self) -> float:
        """Wall time, seconds since 1970 UTC; for stamps only, it may jump."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Return after `seconds` of this clock."""
        ...


class SystemClock:
    """The real clock, optionally running `speedup` times faster than real time.

    A simulated vehicle that runs at the same `speedup` and a mission on this clock see the same seconds. Wall time is
    never sped up: stamps say when it really happened.
    """

    def __init__(self, speedup: float = 1.0) -> None:
        if not speedup > 0:
            raise ValueError(f"speedup must be positive, got {speedup}")
        self.speedup = speedup

    def monotonic(self) -> float:
        """See `Clock.monotonic`."""
        return time.monotonic() * self.speedup

    def time(self) -> float:
        """See `Clock.time`."""
        return time.time()

    async def sleep(self, seconds: float) -> None:
        """See `Clock.sleep`."""
        await asyncio.sleep(max(0.0, seconds) / self.speedup)


RESOLUTION_S = 2e-6
"""What a vehicle may round the time to that it tells."""


class VehicleClock:
    """The clock of a simulated vehicle, which says itself how far it has come: no time passes that it has not lived.

    So a mission on this clock takes the same seconds however late a busy computer gets to it, on either side. What the
    vehicle does not wait for by itself (a thread, the disk) is announced by `work`: whoever paces the simulation lets
    it go slowly meanwhile.

    Attributes:
        on_told: called when somebody's sleep is over, or `look_at_s` is reached, in the thread that told the time, and
            when work has ended; it shall see to it that `wake` is called on the loop.
        on_work: called on the loop when work begins.
        look_at_s: time from which on `on_told` is called in any case.
        allowed_s: the furthest that the vehicle was ever allowed to come.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self.on_told: Callable[[], None] = lambda: None
        self.on_work: Callable[[], None] = lambda: None
        self.look_at_s = math.inf
        self.allowed_s = start_s
        self._now_s = start_s
        self._sleepers: list[tuple[float, int, asyncio.Future[None]]] = []
        self._number = itertools.count()
        self._works = 0
        self._telling = threading.Lock()

    def monotonic(self) -> float:
        """See `Clock.monotonic`."""
        return self._now_s

    def time(self) -> float:
        """See `Clock.time`: when it really happens."""
        return time.time()

    async def sleep(self, seconds: float) -> None:
        """See `Clock.sleep`."""
        due_s = self._now_s + max(0.0, seconds)
        woken: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (due_s, next(self._number), woken))
        # whoever tells the time looks for sleepers after setting it, we look at it after lying down: one of both sees
        if due_s <= self._now_s:
            self.wake()
            await asyncio.sleep(0)
            return
        await woken

    @property
    def next_s(self) -> float:
        """When the next sleep is over; infinity if nobody sleeps. On the loop."""
        while self._sleepers and self._sleepers[0][2].done():
            heapq.heappop(self._sleepers)
        return self._sleepers[0][0] if self._sleepers else math.inf

    @property
    def is_at_work(self) -> bool:
        """Whether something runs that takes real time."""
        return self._works > 0

    @contextlib.contextmanager
    def work(self) -> Iterator[None]:
        """While the block runs, something takes real time."""
        self._works += 1
        if self._works == 1:
            self.on_work()
        try:
            yield
        finally:
            self._works -= 1
            if not self._works:
                self.on_told()

    def tell(self, now_s: float) -> None:
        """Take the vehicle's time, from any thread; what lies in the past is ignored."""
        self._go_on(now_s)
        first = self._sleepers[:1]  # the loop may take it away at any moment
        if self._now_s >= self.look_at_s or (first and first[0][0] <= self._now_s + RESOLUTION_S):
            self.on_told()

    def wake(self) -> None:
        """End the sleeps that are over; on the loop."""
        while (due_s := self.next_s) <= self._now_s + RESOLUTION_S:
            self._go_on(due_s)
            heapq.heappop(self._sleepers)[2].set_result(None)

    def _go_on(self, now_s: float) -> None:
        with self._telling:
            self._now_s = max(self._now_s, now_s)


def latest_s(clock: Clock) -> float:
    """The latest time that it may be: a vehicle may already be a little further than it was heard to be."""
    return max(clock.monotonic(), clock.allowed_s) if isinstance(clock, VehicleClock) else clock.monotonic()


def work(clock: Clock) -> contextlib.AbstractContextManager[None]:
    """While the block runs, something takes real time and not the clock's; only a vehicle's clock minds."""
    return clock.work() if isinstance(clock, VehicleClock) else contextlib.nullcontext()
