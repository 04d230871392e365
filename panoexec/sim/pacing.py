"""Limits of simulated time, set by the program that started the simulation.

By default a simulation follows the wall clock: its time advances even if its client, on a busy computer, has not yet
read what was sent a second ago. A paced simulation advances no further and no faster than permitted by lines
`UNTIL_S SPEED` on standard input. The client receives the simulated time in the stream of messages, before the messages
of each moment (NAMED_VALUE_INT, 252, from an otherwise unused component): when it receives a time, it has received all
earlier messages. A real vehicle does neither, so both are off by default.
"""

from __future__ import annotations

import asyncio
import math
from typing import Final, Self

TIME_MESSAGE: Final = "NAMED_VALUE_INT"
TIME_NAME: Final = "sim_clock"
TIME_COMPONENT: Final = 158
"""MAV_COMP_ID_PERIPHERAL; it sends no heartbeat, so no client lists it as a device."""


def time_fields(now_s: float) -> tuple[int, int]:
    """Milliseconds and microseconds for the fields of the time message."""
    us = round(now_s * 1e6)
    return us // 1000, us % 1000


def time_from_fields(boot_ms: int, value: int) -> float:
    """The simulated time encoded by `time_fields`, to the microsecond."""
    return boot_ms / 1e3 + value / 1e6


def limits_line(until_s: float, speed: float) -> bytes:
    """A line for `TimeLimits.feed`."""
    return f"{until_s!r} {speed!r}\n".encode()


class TimeLimits:
    """The current limits of simulated time.

    Attributes:
        until_s: simulated time must not exceed this.
        speed: maximum simulated seconds per second.
        changed: set when one of them changes.
    """

    def __init__(self) -> None:
        self.until_s = 0.0
        self.speed = 1.0
        self.changed = asyncio.Event()
        self._rest = b""

    @classmethod
    def long(cls, speed: float) -> Self:
        """Limits that only restrict the speed."""
        limits = cls()
        limits.let(math.inf, speed)
        return limits

    def let(self, until_s: float, speed: float) -> None:
        """Set new limits."""
        self.until_s, self.speed = until_s, speed
        self.changed.set()

    def feed(self, data: bytes) -> None:
        """Parse bytes of standard input; invalid lines are ignored."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            try:
                until_s, speed = (float(word) for word in line.split())
            except ValueError:
                continue
            if math.isfinite(until_s) and 0 < speed < math.inf:
                self.let(until_s, speed)
