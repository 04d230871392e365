"""What was asked of a running mission, and what holds it: level-triggered wishes that it obeys at its next safe point.

Nothing here waits. A command changes a wish and wakes the mission; so no command can come at a wrong moment, and one
that is taken back before the mission got to it (pause, then resume) leaves no trace but its event.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass, replace
from typing import Literal

from panoexec.errors import MissionError
from panoexec.mission.guards import Finding, Hold, reasons


class CommandRefusedError(MissionError):
    """The mission cannot do this now; the message says why."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The mission must end: `abort` somebody said so, `interrupt` the process ends, `fail` it cannot go on."""

    kind: Literal["abort", "interrupt", "fail"]
    reason: str


class MissionRequests:
    """The wishes of a mission.

    Attributes:
        stop: the mission must end, and why.
        over: it is ending by itself, and nothing can be asked of it any more.
        finish: shooting must end, the gaps are accepted.
        skips: shots that are not wanted any more.
        holds: what holds the mission, by code.
        interrupt: set while an attempt on its way should give up: a stop, a hold, or a skip of the current shot.
        changed: set when anything changed since the mission last looked.
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
    def must_leave(self) -> bool:
        """Whether shooting must end."""
        return self.stop is not None or self.finish is not None

    def ask_stop(self, stop: Stop) -> None:
        """End the mission; the first reason given stays, but an abort overrules a finish."""
        if self.stop is None:
            self.stop = stop
        self.stopping.set()
        self.leaving.set()
        self._wake()

    def ask_finish(self, reason: str) -> None:
        """End shooting."""
        self.finish = reason
        self.leaving.set()
        self._wake()

    def ask_skip(self, shot: int, *, current: bool) -> None:
        """Leave a shot out."""
        self.skips.add(shot)
        if current:
            self.interrupt.set()
        self.changed.set()

    def ask_pause(self, reason: str) -> None:
        """Hold until `resume`."""
        self.hold(Finding(code="command", reason=reason or "paused by command", automatic=False))

    def resume(self) -> None:
        """Let everything go whose cause is gone; the command's own hold included.

        Raises:
            CommandRefusedError: something still holds the mission; then nothing changed.
        """
        lasting = {
            code: hold for code, hold in self.holds.items() if code != "command" and math.isnan(hold.gone_since_s)
        }
        if lasting:
            raise CommandRefusedError(f"cannot resume yet: {reasons(lasting)}")
        self.holds.clear()
        self._calm()

    def hold(self, finding: Finding) -> bool:
        """Something holds the mission; returns whether that is news."""
        old = self.holds.get(finding.code)
        self.holds[finding.code] = Hold(finding=finding)
        if old is None:
            self._wake()
        return old is None

    def clear(self, code: str, *, now_s: float, clear_s: float) -> None:
        """The cause `code` is gone at this moment; an automatic hold ends when it stays gone for `clear_s`."""
        hold = self.holds.get(code)
        if hold is None:
            return
        if math.isnan(hold.gone_since_s):
            self.holds[code] = hold = replace(hold, gone_since_s=now_s)
        if hold.finding.automatic and now_s - hold.gone_since_s >= clear_s:
            del self.holds[code]
            self._calm()

    def settled(self) -> None:
        """The mission looked at its wishes and has no attempt on its way."""
        self.changed.clear()
        if not self.must_leave and not self.holds:
            self.interrupt.clear()

    def _calm(self) -> None:
        self.changed.set()
        if not self.must_leave and not self.holds:
            self.interrupt.clear()

    def _wake(self) -> None:
        self.interrupt.set()
        self.changed.set()
