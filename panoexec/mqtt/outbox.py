"""Queue of outgoing messages while the broker is lost or slow: bounded, in order, latest message per retained topic."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Outgoing:
    """One outgoing message.

    Attributes:
        topic: complete topic.
        payload: payload bytes; an empty retained message clears the topic.
        retain: retain flag.
        correlation: correlation data of the answered request (MQTT 5).
    """

    topic: str
    payload: bytes
    retain: bool = False
    correlation: bytes | None = None


class Outbox:
    """The latest message of each retained topic, sent again at each connection, and a queue of all other messages.

    Args:
        limit: maximum number of queued messages; the oldest ones are dropped beyond it.
        limit_bytes: maximum total size of their payloads.

    Attributes:
        dropped: number of dropped messages.
        filled: set while messages are waiting.
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
        """Add a message."""
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
        """Send all retained messages again after a new connection, because the broker may have lost them."""
        self._stale = dict.fromkeys(self._retained)
        if len(self):
            self.filled.set()

    def take(self, most: int) -> list[Outgoing]:
        """The next messages, retained ones first; each is returned again until it is `done`."""
        out = [self._retained[topic] for topic in self._stale][:most]
        for message in self._queue:
            if len(out) >= most:
                break
            out.append(message)
        return out

    def give_up(self, message: Outgoing) -> None:
        """Drop a message that the broker rejects."""
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
        """Remove a message that the broker has acknowledged."""
        if message.retain:
            if self._retained.get(message.topic) is message:
                self._stale.pop(message.topic, None)
        elif self._queue and self._queue[0] is message:
            self._bytes -= len(self._queue.popleft().payload)
        if not len(self):
            self.filled.clear()


class Suspicion:
    """Finds a message that repeatedly makes the broker close the connection, for example because it is too large.

    After a connection has ended with several unacknowledged messages, messages are sent one by one. A message with
    which the connection ends `STRIKES` times in a row is identified as the cause.
    """

    STRIKES = 3

    def __init__(self) -> None:
        self.wary = False
        """Whether messages should be sent one by one."""
        self._suspect: Outgoing | None = None
        self._strikes = 0

    def ended(self, message: Outgoing, *, alone: bool) -> bool:
        """Record that the connection ended with this unacknowledged message; returns whether it is the cause."""
        self.wary = True
        if not alone:
            return False
        self._strikes = self._strikes + 1 if message is self._suspect else 1
        self._suspect = message
        return self._strikes >= self.STRIKES

    def acknowledged(self, messages: Sequence[Outgoing], *, left: int) -> None:
        """Record acknowledged messages and the number of messages that are still waiting."""
        if any(message is self._suspect for message in messages):
            self._suspect, self._strikes = None, 0
        if not left:
            self.wary = False
