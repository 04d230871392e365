"""How much a plan may cost: processor time, which ends the search, and work, which decides what else is tried.

A search without end would always find something to try. What it tries depends on the *work* done, a count of rows that
were compared, so that the same request always gives the same plan. Processor time differs from run to run, so it only
cuts the tail: a search that reaches its budget ends with the best plan so far, and the plan says so.

What follows the search (verdicts, ordering, or the reason why there is no plan) needs time too. It is *reserved*: the
search ends when no more than that is left. Anything long asks beforehand whether it still fits.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

DEFAULT_BUDGET_S = 20.0
"""Processor time of a plan, seconds."""

MOST_BUDGET_S = 240.0
"""The longest budget that the daemon grants, see `panoexec.daemon.planner_process`."""

_FIRST_RESERVE = 0.1
"""Part of the budget that is reserved as long as it is not known what follows."""

_MOST_RESERVED = 0.6
"""Largest part of the budget that is reserved."""


class BudgetSpentError(Exception):
    """The processor time is used up; never leaves the planner."""


class SearchBudget:
    """The budget of one plan, in processor time of the calling thread, from now on.

    Args:
        seconds: the budget; None for none.
        clock: the processor time used so far, seconds; None for that of the calling thread.

    Attributes:
        seconds: the budget; None for none.
        work: pairs of rows compared so far.
    """

    def __init__(self, seconds: float | None = None, *, clock: Callable[[], float] | None = None) -> None:
        self.seconds = seconds
        self.work = 0
        self.clock = clock or time.thread_time
        self._end = math.inf if seconds is None else self.clock() + seconds
        self._reserved = 0.0
        self.reserve(math.inf if seconds is None else _FIRST_RESERVE * seconds)

    def reserve(self, seconds: float) -> None:
        """Keep time for what follows the search, instead of what was kept before; at most a part of the budget."""
        self._reserved = 0.0 if self.seconds is None else min(seconds, _MOST_RESERVED * self.seconds)

    @property
    def left(self) -> float:
        """Processor time left, seconds, with what is reserved; infinite without a budget."""
        return math.inf if self.seconds is None else self._end - self.clock()

    @property
    def spent(self) -> bool:
        """Whether no more is left than is reserved."""
        return self.left <= self._reserved and self.seconds is not None

    def use(self, work: int = 0, *, seconds: float = 0.0) -> None:
        """Count work, and make sure that there is time for what follows at once.

        Args:
            work: pairs of rows compared.
            seconds: about how long the next piece takes, which cannot be ended in between.

        Raises:
            BudgetSpentError: the processor time is used up, or the next piece would use it up.
        """
        self.work += work
        if self.spent or (seconds > 0 and self.left - seconds < self._reserved):
            raise BudgetSpentError
