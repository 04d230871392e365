"""What waits to be published while the broker is away or slow: bounded, in order, the newest of each retained topic."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Outgoing:
    """One message.

    Attributes:
        topic: whole.
        payload: as it goes out; empty and retained clears the topic.
        retain: the broker keeps it for those who come later.
        correlation: of the request that it answers (MQTT 5).
    """

    topic: str
    payload: bytes
    retain: bool = False
    correlation: bytes | None = None


class Outbox:
    """Retained topics hold their newest message and send it again to each new connection; all else is a queue.

    Args:
        limit: messages of the queue at most; beyond it the oldest are dropped.
        limit_bytes: of their payloads likewise.

    Attributes:
        dropped: messages that were given up.
        filled: set while something waits.
    """

    def __init__(self, *, limit: int = 10_000, limit_bytes: int = 16 * 2**20) -> None:
        self.dropped = 0
        self.filled = asyncio.Event()
        self._limit = limit
        self._limit_bytes = limit_bytes
        self._bytes = 0
        self._queue: deque[Outgoing] = deque()
        self._retained: dict[str, Outgoing] = {}
        self._stale: dict[str, None] = {}

    def __len__(self) -> int:
        return len(self._queue) + len(self._stale)

    def put(self, message: Outgoing) -> None:
        """Take a message."""
        if message.retain:
            self._retained[message.topic] = message
            self._stale[message.topic] = None
        else:
            self._queue.append(message)
            self._bytes += len(message.payload)
            while len(self._queue) > self._limit or self._bytes > self._limit_bytes:
                self._bytes -= len(self._queue.popleft().payload)
                self.dropped += 1
        self.filled.set()

    def renew(self) -> None:
        """A new connection: what is retained goes out again, as the broker may have lost it."""
        self._stale = dict.fromkeys(self._retained)
        if len(self):
            self.filled.set()

    def take(self, most: int) -> list[Outgoing]:
        """The next messages, retained ones first; each must be `done` or goes out again."""
        out = [self._retained[topic] for topic in self._stale][:most]
        for message in self._queue:
            if len(out) >= most:
                break
            out.append(message)
        return out

    def give_up(self, message: Outgoing) -> None:
        """No broker connection survives it: it does not go out any more."""
        if message.retain:
            if self._retained.get(message.topic) is message:
                del self._retained[message.topic]
                self._stale.pop(message.topic, None)
        elif message in self._queue:
            self._queue.remove(message)
            self._bytes -= len(message.payload)
        self.dropped += 1
        if not len(self):
            self.filled.clear()

    def done(self, message: Outgoing) -> None:
        """The broker has it."""
        if message.retain:
            if self._retained.get(message.topic) is message:
                self._stale.pop(message.topic, None)
        elif self._queue and self._queue[0] is message:
            self._bytes -= len(self._queue.popleft().payload)
        if not len(self):
            self.filled.clear()


class Suspicion:
    """Finds the message at which a broker ends the connection, for ever, if it is too large for it, say.

    After a connection that ended while several were on their way, they go one by one; the one at which the connection
    ends `STRIKES` times in a row is guilty.
    """

    STRIKES = 3

    def __init__(self) -> None:
        self.wary = False
        """Whether messages should go one by one."""
        self._suspect: Outgoing | None = None
        self._strikes = 0

    def ended(self, message: Outgoing, *, alone: bool) -> bool:
        """The connection ended with this message on its way; whether it is guilty."""
        self.wary = True
        if not alone:
            return False
        self._strikes = self._strikes + 1 if message is self._suspect else 1
        self._suspect = message
        return self._strikes >= self.STRIKES

    def acknowledged(self, messages: Sequence[Outgoing], *, left: int) -> None:
        """The broker has these; so many others wait."""
        if any(message is self._suspect for message in messages):
            self._suspect, self._strikes = None, 0
        if not left:
            self.wary = False
