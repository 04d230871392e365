"""How far and how fast simulated time may go, where the program that started the simulation says so.

Of its own accord a simulation follows the wall: its time goes on while its client, on a busy computer, has not yet read
what was sent a second ago. On a leash it goes no further than it is allowed to, and no faster than it is told to. Lines
`UNTIL_S SPEED` on standard input say so. The client learns the time in the stream of messages itself, before the
messages of each moment (NAMED_VALUE_INT, 252, from a component that is nobody else): when it hears of a moment, it has
heard of everything before. Neither is what a real vehicle does; both are left out unless they are asked for.
"""

from __future__ import annotations

import asyncio
import math
from typing import Final, Self

TIME_MESSAGE: Final = "NAMED_VALUE_INT"
TIME_NAME: Final = "sim_clock"
TIME_COMPONENT: Final = 158
"""MAV_COMP_ID_PERIPHERAL; it never beats, so nobody takes it for a device."""


def time_fields(now_s: float) -> tuple[int, int]:
    """Milliseconds and microseconds for the message that tells the time."""
    us = round(now_s * 1e6)
    return us // 1000, us % 1000


def told_time_s(boot_ms: int, value: int) -> float:
    """The time that `time_fields` made the fields of, to the microsecond."""
    return boot_ms / 1e3 + value / 1e6


def allowance_line(until_s: float, speed: float) -> bytes:
    """What `Leash.feed` reads."""
    return f"{until_s!r} {speed!r}\n".encode()


class Leash:
    """What the simulation is held by.

    Attributes:
        until_s: simulated time goes no further than this.
        speed: simulated seconds a second at most.
        changed: set when one of them was told.
    """

    def __init__(self) -> None:
        self.until_s = 0.0
        self.speed = 1.0
        self.changed = asyncio.Event()
        self._rest = b""

    @classmethod
    def long(cls, speed: float) -> Self:
        """One that holds nobody."""
        leash = cls()
        leash.let(math.inf, speed)
        return leash

    def let(self, until_s: float, speed: float) -> None:
        """Allow to go on."""
        self.until_s, self.speed = until_s, speed
        self.changed.set()

    def feed(self, data: bytes) -> None:
        """Take bytes of standard input; a line that means nothing is ignored."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            try:
                until_s, speed = (float(word) for word in line.split())
            except ValueError:
                continue
            if math.isfinite(until_s) and 0 < speed < math.inf:
                self.let(until_s, speed)
