"""Simulated time, ordered events, seeded random numbers, and the ground-truth log.

Only `SimClock` reads the wall clock. Physics and messages happen at moments of simulated time, in order, however late
they are computed; so a seed gives the same numbers at every speed-up.
"""

from __future__ import annotations

import hashlib
import heapq
import itertools
import json
import math
import random
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, TypeAlias

Action: TypeAlias = Callable[[], None]


class SimClock:
    """Maps wall time to simulated seconds since the start, at `speedup` simulated seconds per second.

    A simulation that cannot keep up, or that is paused, continues from its current time: time slows down, nothing is
    skipped.

    Attributes:
        jump_s: error of its UTC (fault).
    """

    def __init__(self, speedup: float = 1.0, *, monotonic: Callable[[], float] = time.monotonic) -> None:
        if not (speedup > 0 and math.isfinite(speedup)):
            raise ValueError(f"speedup must be positive, got {speedup}")
        self.speedup = speedup
        self.jump_s = 0.0
        self._monotonic = monotonic
        self._zero_s = 0.0
        self._start = monotonic()
        self._start_utc = time.time()

    def now(self) -> float:
        """Simulated seconds since the start."""
        return self._zero_s + (self._monotonic() - self._start) * self.speedup

    def wall_delay(self, simulated_s: float) -> float:
        """Wall seconds from now until a simulated moment; negative if it has passed."""
        return self._start + (simulated_s - self._zero_s) / self.speedup - self._monotonic()

    def utc(self, simulated_s: float) -> float:
        """UTC, seconds since 1970, of a simulated moment: the wall time at which it happens."""
        return self._start_utc + (simulated_s - self._zero_s) / self.speedup + self.jump_s

    def go_on(self, simulated_s: float, speedup: float) -> None:
        """Continue from the given simulated moment now, at a new speed; any lag is discarded."""
        self._zero_s, self.speedup = simulated_s, speedup
        self._start = self._monotonic()
        self._start_utc = time.time()


def seeded(seed: int, name: str) -> random.Random:
    """A separate random generator for each purpose, so that they do not influence each other."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return random.Random(int.from_bytes(digest[:8], "big"))


class BoundedDrift:
    """A slow drift within ±`bound`: a sum of four sines of incommensurable periods, a pure function of time.

    Unlike a random walk it needs no steps, never exceeds its bound and is smooth; its standard deviation is 0.35 of the
    bound.
    """

    _PERIODS = (1.0, 1.618, 2.889, 5.43)

    def __init__(self, bound: float, shortest_period_s: float, rng: random.Random) -> None:
        self._amplitude = bound / len(self._PERIODS)
        self._omegas = [2 * math.pi / (shortest_period_s * period) for period in self._PERIODS]
        self._phases = [rng.uniform(0, 2 * math.pi) for _ in self._PERIODS]

    # unrolled: these run some ten thousand times per second at a speed-up of 20

    def at(self, t_s: float) -> float:
        """Its value at simulated time `t_s`."""
        (a, b, c, d), (e, f, g, h), sin = self._omegas, self._phases, math.sin
        return self._amplitude * (sin(a * t_s + e) + sin(b * t_s + f) + sin(c * t_s + g) + sin(d * t_s + h))

    def rate_at(self, t_s: float) -> float:
        """Its time derivative, per second, at simulated time `t_s`."""
        (a, b, c, d), (e, f, g, h), cos = self._omegas, self._phases, math.cos
        return self._amplitude * (
            a * cos(a * t_s + e) + b * cos(b * t_s + f) + c * cos(c * t_s + g) + d * cos(d * t_s + h)
        )


class ColouredNoise:
    """First-order low-passed white noise (Ornstein-Uhlenbeck) of standard deviation 1, exact for any fixed step."""

    def __init__(self, corner_hz: float, step_s: float, rng: random.Random) -> None:
        self._keep = math.exp(-2 * math.pi * corner_hz * step_s)
        self._add = math.sqrt(1 - self._keep**2)
        self._gauss = rng.gauss
        self.value = rng.gauss(0.0, 1.0)

    def step(self) -> float:
        """Advance by one step and return the new value."""
        self.value = self._keep * self.value + self._add * self._gauss(0.0, 1.0)
        return self.value


class Timeline:
    """Actions scheduled in simulated time, executed in order of time, then of scheduling."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Action]] = []
        self._count = itertools.count()
        self.now_s = 0.0

    @property
    def next_s(self) -> float:
        """Time of the next action; infinity if there is none."""
        return self._heap[0][0] if self._heap else math.inf

    def at(self, t_s: float, action: Action) -> None:
        """Schedule an action at `t_s`; if that has passed, at the next run."""
        heapq.heappush(self._heap, (t_s, next(self._count), action))

    def after(self, delay_s: float, action: Action) -> None:
        """Schedule an action `delay_s` from now."""
        self.at(self.now_s + delay_s, action)

    def run_until(self, t_s: float) -> None:
        """Run all actions due up to and including `t_s`, each with `now_s` at its own time."""
        heap = self._heap
        while heap and heap[0][0] <= t_s:
            due, _, action = heapq.heappop(heap)
            self.now_s = max(self.now_s, due)
            action()
        self.now_s = max(self.now_s, t_s)


class Repeater:
    """An action at a fixed interval on a timeline; it keeps its own time grid, so the rate is exact.

    Attributes:
        interval_s: between two runs; 0 = stopped.
    """

    def __init__(self, timeline: Timeline, action: Action) -> None:
        self._timeline = timeline
        self._action = action
        self._generation = 0
        self._first_s = 0.0
        self._runs = 0
        self.interval_s = 0.0

    def start(self, interval_s: float, *, first_after_s: float | None = None) -> None:
        """Run at this interval from now on, replacing an earlier interval."""
        self.stop()
        self.interval_s = interval_s
        self._first_s = self._timeline.now_s + (interval_s if first_after_s is None else first_after_s)
        self._runs = 0
        self._schedule()

    def stop(self) -> None:
        """Stop running."""
        self._generation += 1
        self.interval_s = 0.0

    def _schedule(self) -> None:
        generation = self._generation

        def due() -> None:
            if generation != self._generation:
                return
            self._runs += 1
            self._schedule()
            self._action()

        self._timeline.at(self._first_s + self._runs * self.interval_s, due)


class TruthLog:
    """Ground truth, one JSON object per line, for tests to compare with the reports.

    Without a path nothing is written.
    """

    def __init__(self, path: Path | None) -> None:
        self._file: IO[str] | None = path.open("a", encoding="utf-8") if path is not None else None

    def write(self, event: str, t_s: float, fields: Mapping[str, object]) -> None:
        """Append one event at simulated time `t_s`."""
        if self._file is not None:
            self._file.write(json.dumps({"event": event, "sim_s": round(t_s, 4), **fields}) + "\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
