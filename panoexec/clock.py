"""The mission's clock: a protocol, so that tests can control time and a dry-run can accelerate it."""

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
    """Monotonic seconds for durations, wall time for time stamps only."""

    def monotonic(self) -> float:
        """Monotonic seconds since an arbitrary start; differences are durations."""
        ...

    def time(self) -> float:
        """Wall time, seconds since 1970 UTC; for time stamps only, because it may jump."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Return after `seconds` of this clock."""
        ...


class SystemClock:
    """The real clock, optionally running `speedup` times faster than real time.

    A simulated vehicle that runs at the same `speedup` and a mission on this clock see the same seconds. Wall time is
    not accelerated.
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
"""Resolution of the time that a vehicle reports."""


class VehicleClock:
    """The clock of a simulated vehicle: its time is what the vehicle reports.

    So a mission on this clock takes the same number of seconds regardless of the computer's load. Work that the
    simulation does not wait for by itself (a thread, the disk) is announced by `work`; the simulation is slowed down
    meanwhile.

    Attributes:
        on_told: called when a sleep is over or `look_at_s` is reached, in the thread that set the time, and at the end
            of work; must cause a call of `wake` on the loop.
        on_work: called on the loop when work begins.
        look_at_s: time from which `on_told` is called in any case.
        allowed_s: the latest time up to which the vehicle was allowed to run.
        between: the time now as estimated since the vehicle last told it, where it does not wait for anybody.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self.on_told: Callable[[], None] = lambda: None
        self.on_work: Callable[[], None] = lambda: None
        self.look_at_s = math.inf
        self.allowed_s = start_s
        self.between: Callable[[], float] | None = None
        self._now_s = start_s
        self._sleepers: list[tuple[float, int, asyncio.Future[None]]] = []
        self._number = itertools.count()
        self._works = 0
        self._telling = threading.Lock()

    def monotonic(self) -> float:
        """See `Clock.monotonic`."""
        if self.between is not None:
            self._go_on(self.between())
        return self._now_s

    def time(self) -> float:
        """See `Clock.time`; not simulated."""
        return time.time()

    async def sleep(self, seconds: float) -> None:
        """See `Clock.sleep`."""
        due_s = self._now_s + max(0.0, seconds)
        woken: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (due_s, next(self._number), woken))
        # `tell` checks for sleepers after setting the time, and here the time is checked after registering: no race
        if due_s <= self._now_s:
            self.wake()
            await asyncio.sleep(0)
            return
        await woken

    @property
    def next_s(self) -> float:
        """End of the next sleep; infinity if there is none. For the event loop."""
        while self._sleepers and self._sleepers[0][2].done():
            heapq.heappop(self._sleepers)
        return self._sleepers[0][0] if self._sleepers else math.inf

    @property
    def is_at_work(self) -> bool:
        """Whether work that takes real time is running."""
        return self._works > 0

    @contextlib.contextmanager
    def work(self) -> Iterator[None]:
        """Mark the block as work that takes real time."""
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
        """Set the time that the vehicle reported, from any thread; earlier times are ignored."""
        self._go_on(now_s)
        first = self._sleepers[:1]  # the loop may remove it at any time
        if self._now_s >= self.look_at_s or (first and first[0][0] <= self._now_s + RESOLUTION_S):
            self.on_told()

    def wake(self) -> None:
        """Wake the sleepers whose time has come; for the event loop."""
        while (due_s := self.next_s) <= self._now_s + RESOLUTION_S:
            self._go_on(due_s)
            heapq.heappop(self._sleepers)[2].set_result(None)

    def _go_on(self, now_s: float) -> None:
        with self._telling:
            self._now_s = max(self._now_s, now_s)


def latest_s(clock: Clock) -> float:
    """Upper bound of the current time: a simulated vehicle may be ahead of its last report."""
    return max(clock.monotonic(), clock.allowed_s) if isinstance(clock, VehicleClock) else clock.monotonic()


def work(clock: Clock) -> contextlib.AbstractContextManager[None]:
    """Mark the block as work that takes real time, not the clock's; only a `VehicleClock` needs it."""
    return clock.work() if isinstance(clock, VehicleClock) else contextlib.nullcontext()
