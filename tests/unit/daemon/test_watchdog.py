"""The watchdog is fed while every task shows a pulse, and withheld from a stalled one."""

from __future__ import annotations

import asyncio

from structlog.testing import capture_logs

from panoexec.daemon.sdnotify import SystemdNotifier
from panoexec.daemon.watchdog import STALLED_S, Watchdog


class Notifier(SystemdNotifier):
    """Counts what it is told."""

    def __init__(self, watchdog_s: float | None) -> None:
        usec = "" if watchdog_s is None else str(round(watchdog_s * 1e6))
        super().__init__({"WATCHDOG_USEC": usec})
        self.fed = asyncio.Semaphore(0)

    def watchdog(self) -> None:
        self.fed.release()


def test_a_task_is_stalled_once_its_pulse_is_too_old() -> None:
    now_s = 1000.0
    pulses = {"state": 1000.0, "mqtt link": 1000.0}
    watchdog = Watchdog(
        notifier=Notifier(None),
        pulses={"state": lambda: pulses["state"], "mqtt link": lambda: pulses["mqtt link"]},
        monotonic=lambda: now_s,
    )
    assert watchdog.stalled() == []
    now_s += STALLED_S
    assert watchdog.stalled() == []
    now_s += 0.1
    pulses["state"] = now_s
    assert watchdog.stalled() == ["mqtt link"]
    pulses["mqtt link"] = now_s
    assert watchdog.stalled() == [], "it moves again"


async def test_the_watchdog_is_fed_in_each_period() -> None:
    notifier = Notifier(0.03)
    running = asyncio.create_task(Watchdog(notifier=notifier, pulses={}).run())
    async with asyncio.timeout(60):
        for _ in range(3):
            await notifier.fed.acquire()
    assert not running.done()
    running.cancel()


async def test_the_watchdog_is_withheld_while_a_task_is_stalled() -> None:
    pulse_s, asked = 0.0, asyncio.Semaphore(0)

    def pulse() -> float:
        asked.release()
        return pulse_s

    notifier = Notifier(0.03)
    watchdog = Watchdog(notifier=notifier, pulses={"state": pulse}, monotonic=lambda: 100.0)
    with capture_logs() as logs:
        running = asyncio.create_task(watchdog.run())
        async with asyncio.timeout(60):
            for _ in range(3):
                await asked.acquire()
            assert notifier.fed.locked(), "nothing was fed"
            assert logs[0]["event"] == "task stalled; watchdog withheld"
            assert logs[0]["tasks"] == ["state"]
            pulse_s = 100.0
            await notifier.fed.acquire()
    running.cancel()


async def test_nothing_is_fed_where_the_service_manager_has_no_watchdog() -> None:
    notifier = Notifier(None)
    await Watchdog(notifier=notifier, pulses={}).run()
    assert notifier.fed.locked()
