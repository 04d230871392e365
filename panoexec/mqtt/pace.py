"""The pace of sending: how much may be under way on a slow radio link, from how fast messages are acknowledged.

What has been handed to the kernel leaves in order: an answer waits until all of it is through. On a link of 1 kB/s a
few states are seconds. So no more is sent than half a second takes, and what is large or repeated waits.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

BATCH_S: Final = 0.5
"""How long the messages under way may take, s."""

LARGE_S: Final = 2.0
"""A message of a retained topic that takes longer waits for a quiet moment, s."""

QUIET_S: Final = 10.0
"""A moment is quiet so long after the last answer, s."""

LONGEST_WAIT_S: Final = 300.0
"""A large message waits at most so long, s."""

SHARE: Final = 3.0
"""Messages of retained topics take at most one part in so many of the time."""

DELTA_SHARE: Final = 10.0
"""Deltas of the state take at most one part in so many: they are as fresh as whole states would be."""

SLOW_RATE: Final = 4000.0
"""A link with less bytes per second is slow enough for deltas, if it stays so."""

_SEEN: Final = 8
_TAKES_S: Final = 0.1
"""What is acknowledged faster says nothing about the rate, which may be the computer's."""

_SAMPLES: Final = 4
_LEAST_S: Final = 0.5
"""A link that has taken less time than this for the last batches is not slow."""

_FIRST_BYTES: Final = 2048
_PATIENCE_S: Final = 10.0
_SLOWEST: Final = 100.0
"""Bytes per second below which a link is considered lost."""


class Pace:
    """Measures one connection.

    Attributes:
        rate: bytes per second; infinity for a link that is not slow.
        lastingly_slow: whether it has been slow for several batches, so that states are better sent as deltas.
    """

    def __init__(self, round_trip_s: float = 0.0) -> None:
        """Begin with a connection.

        Args:
            round_trip_s: time until a small message was acknowledged: the latency of the link.
        """
        self.rate = math.inf
        self.lastingly_slow = False
        self._seen: deque[bool] = deque(maxlen=_SEEN)
        self._round_trip_s = round_trip_s
        self._samples: deque[tuple[int, float]] = deque(maxlen=_SAMPLES)
        self._next_latest_s = 0.0
        self._next_delta_s = 0.0

    @property
    def window(self) -> float:
        """How many bytes may be under way."""
        if not self._samples:
            return _FIRST_BYTES
        return self.rate * BATCH_S

    def takes_s(self, size: int) -> float:
        """How long a message takes; 0 on a link that is not slow."""
        return size / self.rate

    def timeout_s(self, size: int) -> float:
        """How long to wait for the acknowledgement of so many bytes."""
        return _PATIENCE_S + size / _SLOWEST

    def acknowledged(self, size: int, took_s: float, *, now_s: float, latest: int, deltas: int = 0) -> None:
        """Learn from a batch.

        Args:
            size: its bytes.
            took_s: time from sending it to its last acknowledgement.
            now_s: monotonic time.
            latest: how many of the bytes belong to retained topics.
            deltas: how many to deltas of the state.
        """
        self._round_trip_s = min(self._round_trip_s, took_s)
        self._samples.append((size, took_s - self._round_trip_s))
        busy_s = sum(took for _, took in self._samples)
        self.rate = math.inf if busy_s < _LEAST_S else sum(size for size, _ in self._samples) / busy_s
        self._note_slow(size, took_s - self._round_trip_s)
        if latest:
            self._next_latest_s = now_s + (SHARE - 1.0) * self.takes_s(latest)
        if deltas:
            self._next_delta_s = now_s + (DELTA_SHARE - 1.0) * self.takes_s(deltas)

    def _note_slow(self, size: int, busy_s: float) -> None:
        self._seen.append(busy_s > _TAKES_S and size / busy_s < SLOW_RATE)
        slow = sum(self._seen)
        if slow >= 3 * _SEEN // 4:
            self.lastingly_slow = True
        elif slow <= _SEEN // 4:
            self.lastingly_slow = False

    def may_go(self, size: int, *, waited_s: float, now_s: float, answered_s: float, delta: bool = False) -> bool:
        """Whether a message of a retained topic may be sent.

        Args:
            size: its bytes.
            waited_s: since when it waits.
            now_s: monotonic time.
            answered_s: monotonic time of the last answer.
            delta: whether it is a delta in place of the state, for which a plan makes no difference.
        """
        if self.takes_s(size) > LARGE_S:
            return now_s - answered_s >= QUIET_S or waited_s >= LONGEST_WAIT_S
        return now_s >= (self._next_delta_s if delta else self._next_latest_s)
