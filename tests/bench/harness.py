"""What all benchmarks share: taking times, and saying them as ratios between peers measured in one run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """One line of the table: ours beside a peer, or beside a goal.

    Attributes:
        what: what was measured.
        ours: our figure, in `unit`.
        unit: s, MB, images, ...
        peer: the peer's name, or "" if there is none.
        theirs: the peer's figure in the same unit and of the same run.
        goal: what was promised, as text; "" if nothing.
        met: whether it was kept.
    """

    what: str
    ours: float
    unit: str
    peer: str = ""
    theirs: float | None = None
    goal: str = ""
    met: bool | None = None

    @property
    def ratio(self) -> float | None:
        """How many times the peer's figure ours goes into it."""
        return self.theirs / self.ours if self.theirs is not None and self.ours else None


def best_time(work: Callable[[], object], *, repeats: int = 5, at_least_s: float = 0.0) -> float:
    """Shortest wall time of one call, seconds: the one that was disturbed least.

    Args:
        work: what to time.
        repeats: how often it is called at least.
        at_least_s: go on calling for this long.
    """
    best = float("inf")
    begin = time.perf_counter()
    calls = 0
    while calls < repeats or time.perf_counter() - begin < at_least_s:
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
        calls += 1
    return best
