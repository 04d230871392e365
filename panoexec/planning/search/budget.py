"""How much a search may cost: processor time, which ends it, and work, which decides what else is tried.

A search without end would always find something to try. What it tries depends on the *work* done, a count of rows that
were compared, so that the same request always gives the same plan. Processor time differs from run to run, so it only
cuts the tail: a search that reaches its budget ends with the best plan so far, and the plan says so.
"""

from __future__ import annotations

import time

DEFAULT_BUDGET_S = 20.0
"""Processor time of a search, seconds."""

MOST_BUDGET_S = 240.0
"""The longest budget that the daemon grants, see `panoexec.daemon.planner_process`."""

_SEARCH_SHARE = 0.9
"""Part of the budget after which the search ends; the rest is for ordering the shots."""


class BudgetSpentError(Exception):
    """The processor time is used up; never leaves the search."""


class SearchBudget:
    """The budget of one search, in processor time of the calling thread.

    Attributes:
        seconds: the budget; None for none.
        work: pairs of rows compared so far.
    """

    def __init__(self, seconds: float | None = None) -> None:
        self.seconds = seconds
        self.work = 0
        self._end = None if seconds is None else time.thread_time() + _SEARCH_SHARE * seconds

    @property
    def spent(self) -> bool:
        """Whether the processor time is used up."""
        return self._end is not None and time.thread_time() >= self._end

    def use(self, work: int = 0) -> None:
        """Count work.

        Raises:
            BudgetSpentError: the processor time is used up.
        """
        self.work += work
        if self.spent:
            raise BudgetSpentError
