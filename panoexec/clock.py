"""Time as the mission sees it: one protocol, so that tests drive it and a dry-run can speed it up."""

from __future__ import annotations

import asyncio
import time
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
