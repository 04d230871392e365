"""Simulated time, ordered events in it, seeded randomness, and the record of the truth.

Nothing in the simulation reads the wall clock but `SimClock`. Physics and messages happen at moments of simulated time,
in order, however late the process gets to them; so a seed gives the same numbers at every speed-up.
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
    """Maps the wall to simulated seconds since the start, `speedup` of them a second.

    A simulation that cannot keep up, or that is held, goes on from where it is: time slows down, nothing is skipped.

    Attributes:
        jump_s: what is wrong with its UTC (fault).
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
        """Wall seconds from now until that simulated moment; negative when it is over."""
        return self._start + (simulated_s - self._zero_s) / self.speedup - self._monotonic()

    def utc(self, simulated_s: float) -> float:
        """UTC, seconds since 1970, of a simulated moment: when it really happens on the wall."""
        return self._start_utc + (simulated_s - self._zero_s) / self.speedup + self.jump_s

    def go_on(self, simulated_s: float, speedup: float) -> None:
        """From that moment on, which is now, at this speed: what the wall is ahead is forgotten."""
        self._zero_s, self.speedup = simulated_s, speedup
        self._start = self._monotonic()
        self._start_utc = time.time()


def seeded(seed: int, name: str) -> random.Random:
    """A generator of its own for each purpose, so that one's appetite does not change another's numbers."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return random.Random(int.from_bytes(digest[:8], "big"))


class BoundedDrift:
    """A slow wandering within ±`bound`: a sum of four sines of unrelated periods, a pure function of time.

    Unlike a random walk it needs no steps, never leaves its bound and is smooth; its standard deviation is 0.35 of the
    bound.
    """

    _PERIODS = (1.0, 1.618, 2.889, 5.43)

    def __init__(self, bound: float, shortest_period_s: float, rng: random.Random) -> None:
        self._amplitude = bound / len(self._PERIODS)
        self._omegas = [2 * math.pi / (shortest_period_s * period) for period in self._PERIODS]
        self._phases = [rng.uniform(0, 2 * math.pi) for _ in self._PERIODS]

    # written out: these run some ten thousand times a second at a speed-up of 20

    def at(self, t_s: float) -> float:
        """Its value at simulated time `t_s`."""
        (a, b, c, d), (e, f, g, h), sin = self._omegas, self._phases, math.sin
        return self._amplitude * (sin(a * t_s + e) + sin(b * t_s + f) + sin(c * t_s + g) + sin(d * t_s + h))

    def rate_at(self, t_s: float) -> float:
        """Its derivative, a second, at simulated time `t_s`."""
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
    """Actions at moments of simulated time, run in order of time, then of scheduling."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, Action]] = []
        self._count = itertools.count()
        self.now_s = 0.0

    @property
    def next_s(self) -> float:
        """When the next action is due; infinity if none is."""
        return self._heap[0][0] if self._heap else math.inf

    def at(self, t_s: float, action: Action) -> None:
        """Run the action at `t_s`, or at once on the next run if that is over."""
        heapq.heappush(self._heap, (t_s, next(self._count), action))

    def after(self, delay_s: float, action: Action) -> None:
        """Run the action `delay_s` from now."""
        self.at(self.now_s + delay_s, action)

    def run_until(self, t_s: float) -> None:
        """Run everything due up to and including `t_s`, each with `now_s` at its own moment."""
        heap = self._heap
        while heap and heap[0][0] <= t_s:
            due, _, action = heapq.heappop(heap)
            self.now_s = max(self.now_s, due)
            action()
        self.now_s = max(self.now_s, t_s)


class Repeater:
    """An action at a fixed interval on a timeline, on a grid of its own so that the rate is exact.

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
        """Run at this interval from now on; a former interval ends."""
        self.stop()
        self.interval_s = interval_s
        self._first_s = self._timeline.now_s + (interval_s if first_after_s is None else first_after_s)
        self._runs = 0
        self._schedule()

    def stop(self) -> None:
        """Run no more."""
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
    """What really happened, one JSON object a line, for tests to compare with what was reported.

    Without a path it keeps nothing.
    """

    def __init__(self, path: Path | None) -> None:
        self._file: IO[str] | None = path.open("a", encoding="utf-8") if path is not None else None

    def write(self, event: str, t_s: float, fields: Mapping[str, object]) -> None:
        """Append one event at simulated time `t_s`."""
        if self._file is not None:
            self._file.write(json.dumps({"event": event, "sim_s": round(t_s, 4), **fields}) + "\n")
            self._file.flush()

    def close(self) -> None:
        """Write no more."""
        if self._file is not None:
            self._file.close()
            self._file = None
