"""Messages on their way from the vendor's thread to the event loop, many at a time.

What a message costs is mostly what it costs to begin with it: a thread that wakes up finds its code and data gone from
the processor's caches, so that the first report takes ten times as long as the next one (measured: 180 µs against
20 µs). So the vendor's thread only appends, and the loop reads what has gathered when somebody asks.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Final

from panoexec.adapters.link.message_hub import MavMessage

MAX_DELAY_S: Final = 1.0
"""Real seconds after which what has gathered is read though nobody asks."""

MAX_WAITING: Final = 20_000
"""So many are kept while the loop is busy; 60 s at 300 Hz. The oldest go."""


class MessageBatcher:
    """`put` is for the vendor's thread, all else for the event loop."""

    def __init__(
        self,
        take: Callable[[MavMessage], None],
        *,
        post: Callable[[Callable[[], None]], None],
        eager: Callable[[], bool],
    ) -> None:
        """Describe it.

        Args:
            take: gets each message, in the order of arrival, on the loop.
            post: calls back on the loop; for the vendor's thread.
            eager: whether somebody waits for the next message; asked in the vendor's thread.
        """
        self._take = take
        self._post = post
        self._eager = eager
        self._waiting: deque[MavMessage] = deque(maxlen=MAX_WAITING)
        self._posted = False
        self._read_s = time.monotonic()

    def put(self, message: MavMessage) -> None:
        """Take a message; in the vendor's thread."""
        self._waiting.append(message)
        # who waits says so before looking in here, and we look for one after filling it: one of both sees the other
        if self._posted:
            return
        if self._eager() or message.heard_s - self._read_s >= MAX_DELAY_S:
            self._posted = True
            self._post(self._woken)

    def empty(self) -> None:
        """Read what has gathered."""
        self._read_s = time.monotonic()
        while self._waiting:
            self._take(self._waiting.popleft())

    def _woken(self) -> None:
        self._posted = False
        self.empty()
