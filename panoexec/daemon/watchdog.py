"""The service manager's watchdog: fed as long as no task of the daemon is stalled."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from typing import Final

import structlog

from panoexec.daemon.sdnotify import SystemdNotifier

STALLED_S: Final = 45.0
"""A task that has not updated its pulse for so long is stalled."""

_log = structlog.get_logger(__name__)


class Watchdog:
    """Watches tasks by their pulses; `run` it in a task."""

    def __init__(
        self,
        *,
        notifier: SystemdNotifier,
        pulses: Mapping[str, Callable[[], float]],
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """Describe it.

        Args:
            notifier: to the service manager.
            pulses: by the name of each task, when it last proved that it is not stalled.
            monotonic: the clock of the pulses, seconds.
        """
        self._notifier = notifier
        self._pulses = pulses
        self._monotonic = monotonic

    def stalled(self) -> list[str]:
        """The tasks that have not proved life for `STALLED_S`."""
        now_s = self._monotonic()
        return [name for name, pulse_s in self._pulses.items() if now_s - pulse_s() > STALLED_S]

    async def run(self) -> None:
        """Feed the service manager's watchdog three times in its period; returns at once if it has none."""
        period_s = self._notifier.watchdog_s
        if period_s is None:
            return
        while True:
            stalled = self.stalled()
            if stalled:
                _log.error("task stalled; watchdog withheld", tasks=stalled)
            else:
                self._notifier.watchdog()
            await asyncio.sleep(period_s / 3)
