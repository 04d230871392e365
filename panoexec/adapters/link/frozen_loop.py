"""Stops the heartbeats when the event loop stands still: they come from MAVSDK's own thread and would go on for ever.

To the autopilot and its ground station heartbeats say that somebody is in command. A loop that stands still neither
flies nor obeys, so its connection is closed by a thread of this class, and opened again when the loop runs. A process
whose threads all stand still is ended by the service manager's watchdog.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Final

FROZEN_S: Final = 2.0
"""A loop that has not run for so long is frozen: heartbeats end within 3 s."""
CHECK_S: Final = 0.5
PULSE_S: Final = 0.9
_LATE: Final = 2.0
"""A check that is late by more than its own interval counts nothing: then the computer is slow, and not the loop."""


class FrozenLoopGuard:
    """Calls `frozen` once each time that the loop stands still.

    Args:
        frozen: called in this guard's thread.
    """

    def __init__(self, frozen: Callable[[], None]) -> None:
        self._frozen = frozen
        self._pulses = 0
        self._seen = 0
        self._still_s = 0.0
        self._checked_s = time.monotonic()
        self._called = False
        self._over = threading.Event()

    async def run(self) -> None:
        """Tell the thread that the loop runs, until cancelled."""
        thread = threading.Thread(target=self._watch, name="frozen loop", daemon=True)
        thread.start()
        try:
            while True:
                self.pulse()
                await asyncio.sleep(PULSE_S)
        finally:
            self._over.set()

    def pulse(self) -> None:
        """The loop runs."""
        self._pulses += 1

    def _watch(self) -> None:
        while not self._over.wait(CHECK_S):
            if self.check(time.monotonic()):
                self._frozen()

    def check(self, now_s: float) -> bool:
        """Whether the loop has just been found frozen.

        Args:
            now_s: time.monotonic; about `CHECK_S` after the last one.
        """
        passed_s, self._checked_s = now_s - self._checked_s, now_s
        if self._pulses != self._seen:
            self._seen, self._still_s, self._called = self._pulses, 0.0, False
        elif passed_s <= _LATE * CHECK_S:
            self._still_s += passed_s
        if self._still_s < FROZEN_S or self._called:
            return False
        self._called = True
        return True
