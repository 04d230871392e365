"""The least interval between two photos that a camera really needs: told by a parameter, or learned. Pure logic.

A busy camera refuses triggers (TEMPORARILY_REJECTED, DENIED), and an autopilot may defer them. Both tell something of
the interval:

* a refusal sooner after the last accepted trigger than any other was accepted means that the interval is longer than
  that; the next trigger waits half as long again, and the first that is accepted bounds the interval from above;
* a trigger that an autopilot deferred follows the one before at the interval.

A refusal that comes later than another trigger was accepted has other reasons (a full card, video mode) and teaches
nothing. Nor does a single one: a camera may refuse for reasons of its own.
"""

from __future__ import annotations

import math
from typing import Final

_LONGEST_S: Final = 15.0
"""A refusal longer than this after the last photo is not the interval's."""
_GROWTH: Final = 1.5
_MARGIN: Final = 1.1
_FEWEST: Final = 2
_DEFERRED_S: Final = 0.3
"""An autopilot reports a trigger sooner than this, unless it deferred it."""
_PARAMETER_MARGIN_S: Final = 0.05


class CameraPace:
    """Learns from what became of each trigger. All times are seconds of the mission's clock."""

    def __init__(self) -> None:
        self._told_s = self._learned_s = 0.0
        self._accepted_s = math.nan
        self._shortest_s = math.inf
        self._refused_s = 0.0
        self._streak = self._streaks = 0
        self._retry_s = -math.inf
        self._triggered_s = math.nan

    @property
    def interval_s(self) -> float:
        """The least time between two triggers, as far as it is known; 0 if nothing is."""
        return max(self._told_s, self._learned_s)

    @property
    def ready_s(self) -> float:
        """When the next trigger is likely to be accepted; -inf if nothing speaks against it."""
        if math.isnan(self._accepted_s) or not self.interval_s:
            return self._retry_s
        return max(self._accepted_s + self.interval_s, self._retry_s)

    def told(self, interval_s: float) -> None:
        """A parameter of the autopilot is the least interval."""
        if 0 < interval_s <= _LONGEST_S:
            self._told_s = interval_s + _PARAMETER_MARGIN_S

    def refused(self, sent_s: float) -> None:
        """A trigger was refused."""
        elapsed_s = sent_s - self._accepted_s
        if not 0 <= elapsed_s < min(self._shortest_s, _LONGEST_S):  # NaN: no photo yet
            return
        self._streak += 1
        self._refused_s = elapsed_s
        self._retry_s = self._accepted_s + _GROWTH * elapsed_s
        self._learn()

    def accepted(self, sent_s: float) -> None:
        """A trigger was accepted."""
        elapsed_s = sent_s - self._accepted_s
        if self._streak and elapsed_s > self._refused_s:
            self._streaks += 1
            self._learn()
            self._learned_s = min(self._learned_s, max(elapsed_s, self._told_s))
        if elapsed_s > 0:
            self._shortest_s = min(self._shortest_s, elapsed_s)
        self._streak, self._refused_s, self._retry_s = 0, 0.0, -math.inf
        self._accepted_s = sent_s

    def _learn(self) -> None:
        if self._streak >= _FEWEST or self._streaks >= _FEWEST:
            self._learned_s = max(self._learned_s, _MARGIN * self._refused_s)

    def triggered(self, triggered_s: float, commanded_s: float) -> None:
        """An autopilot reported its trigger: one that is late was deferred until its least interval was over."""
        gap_s = triggered_s - self._triggered_s
        self._triggered_s = triggered_s
        if triggered_s - commanded_s > _DEFERRED_S and 0 < gap_s <= _LONGEST_S:
            self._learned_s = max(self._learned_s, gap_s)
