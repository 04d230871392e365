"""Pending requests of operator and guards, and the holds that pause a mission.

The mission reads them at its next safe point. No method waits: a command sets a request and wakes the mission, so it
may be sent at any time. A request that is withdrawn before the mission has executed it (pause, then resume) only
leaves its events.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass, replace
from typing import Literal

from panoexec.errors import MissionError
from panoexec.mission.guards import Finding, Hold, reasons


class CommandRefusedError(MissionError):
    """The mission cannot execute the command in its present state; the message says why."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The mission must end: `abort` by command, `interrupt` because the process ends, `fail` because of a fault."""

    kind: Literal["abort", "interrupt", "fail"]
    reason: str


class MissionRequests:
    """The requests to a mission.

    Attributes:
        stop: the mission must end, and why.
        over: the mission is ending by itself; commands are refused.
        finish: reason why shooting must end with the gaps accepted; None: it need not.
        skips: shots to skip.
        holds: active holds by code.
        interrupt: set while the current attempt must be cancelled: a stop, a hold, or a skip of its shot.
        changed: set when anything changed since `settled` was called.
        stopping: set once the mission must end.
        leaving: set once shooting must end.
    """

    def __init__(self) -> None:
        self.stop: Stop | None = None
        self.over = False
        self.finish: str | None = None
        self.skips: set[int] = set()
        self.holds: dict[str, Hold] = {}
        self.interrupt = asyncio.Event()
        self.changed = asyncio.Event()
        self.stopping = asyncio.Event()
        self.leaving = asyncio.Event()

    @property
    def must_end_shooting(self) -> bool:
        """Whether shooting must end."""
        return self.stop is not None or self.finish is not None

    def request_stop(self, stop: Stop) -> None:
        """End the mission; the first stop wins, and it overrides a finish."""
        if self.stop is None:
            self.stop = stop
        self.stopping.set()
        self.leaving.set()
        self._wake()

    def request_finish(self, reason: str) -> None:
        """End shooting and accept the gaps."""
        self.finish = reason
        self.leaving.set()
        self._wake()

    def request_skip(self, shot: int, *, current: bool) -> None:
        """Skip a shot; `current`: its attempt is in progress and must be cancelled."""
        self.skips.add(shot)
        if current:
            self.interrupt.set()
        self.changed.set()

    def request_pause(self, reason: str) -> None:
        """Hold until `resume`."""
        self.hold(Finding(code="command", reason=reason or "paused by command", automatic=False, retry=True))

    def resume(self) -> None:
        """Remove all holds that end by `resume`, and those whose cause is gone.

        Raises:
            CommandRefusedError: the cause of another hold persists; nothing was changed.
        """
        lasting = {
            code: hold for code, hold in self.holds.items() if not hold.finding.retry and math.isnan(hold.gone_since_s)
        }
        if lasting:
            raise CommandRefusedError(f"cannot resume yet: {reasons(lasting)}")
        self.holds.clear()
        self._release_attempt()

    def hold(self, finding: Finding) -> bool:
        """Add a hold; returns whether it is new."""
        old = self.holds.get(finding.code)
        self.holds[finding.code] = Hold(finding=finding)
        if old is None:
            self._wake()
        return old is None

    def clear(self, code: str, *, now_s: float, clear_s: float) -> None:
        """The cause `code` is absent now; an automatic hold ends after an absence of `clear_s`."""
        hold = self.holds.get(code)
        if hold is None:
            return
        if math.isnan(hold.gone_since_s):
            self.holds[code] = hold = replace(hold, gone_since_s=now_s)
        if hold.finding.automatic and now_s - hold.gone_since_s >= clear_s:
            del self.holds[code]
            self._release_attempt()

    def settled(self) -> None:
        """The mission has read its requests and has no attempt in progress."""
        self.changed.clear()
        if not self.must_end_shooting and not self.holds:
            self.interrupt.clear()

    def _release_attempt(self) -> None:
        self.changed.set()
        if not self.must_end_shooting and not self.holds:
            self.interrupt.clear()

    def _wake(self) -> None:
        self.interrupt.set()
        self.changed.set()
