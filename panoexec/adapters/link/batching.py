"""Batches messages from MAVSDK's thread for the event loop.

What a message costs is mostly what it costs to begin with it: a thread that wakes up finds its code and data gone from
the processor's caches, so that the first report takes ten times as long as the next one (measured: 180 µs against
20 µs). So the vendor's thread only appends, and the loop ingests what has gathered when a reader says so (`ingest`).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Final

from panoexec.adapters.link.message_hub import MavMessage

GATHER_S: Final = 1.0
"""Real seconds after which what has gathered is ingested though no reader says so."""

MAX_WAITING: Final = 20_000
"""Queue length: 60 s at 300 Hz. When it is exceeded, the oldest message is dropped."""


class MessageBatcher:
    """A queue of messages. `put` is for MAVSDK's thread, the other methods for the event loop."""

    def __init__(
        self,
        take: Callable[[MavMessage], None],
        *,
        post: Callable[[Callable[[], None]], None],
        eager: Callable[[], bool],
    ) -> None:
        """Create it.

        Args:
            take: called on the event loop with each message, in the order of arrival.
            post: schedules a callback on the event loop; called in MAVSDK's thread.
            eager: whether a task waits for the next message; called in MAVSDK's thread.
        """
        self._take = take
        self._post = post
        self._eager = eager
        self._waiting: deque[MavMessage] = deque(maxlen=MAX_WAITING)
        self._posted = False
        self._ingested_s = time.monotonic()

    def put(self, message: MavMessage) -> None:
        """Queue a message; called in MAVSDK's thread."""
        self._waiting.append(message)
        # a waiting task registers before it reads the queue, and here the queue is filled before the check: no race
        if self._posted:
            return
        if self._eager() or message.heard_s - self._ingested_s >= GATHER_S:
            self._posted = True
            self._post(self._woken)

    @property
    def pending(self) -> tuple[MavMessage, ...]:
        """What has gathered and is not ingested yet, oldest first."""
        while True:
            try:
                return tuple(self._waiting)
            except RuntimeError:  # the vendor's thread appended meanwhile
                continue

    def ingest(self) -> None:
        """Take what has gathered."""
        self._ingested_s = time.monotonic()
        while self._waiting:
            self._take(self._waiting.popleft())

    def _woken(self) -> None:
        self._posted = False
        self.ingest()
