"""Outgoing messages while the broker is lost or slow: bounded, in order, latest message per retained topic.

Answers, events and retained topics are kept apart, so that a flood of requests pushes no event out, and so that an
answer does not wait behind the events of a mission. Answers to stopping requests have a queue of their own before all
others: a flood of other requests neither delays them nor pushes them out.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

OVERDUE_S: Final = 10.0
"""A retained topic that has waited so long goes before events, of which there may be more than the link can carry."""

SLOW_OVERDUE_S: Final = 2.0
"""On a slow link, where states are small or important, one goes before events after so long: they may be far behind."""

_HEAD: Final = 100
"""Upper bound of the bytes of a packet without topic, payload and correlation data."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outgoing:
    """One outgoing message.

    Attributes:
        topic: complete topic.
        payload: payload bytes; an empty retained message clears the topic.
        retain: whether only the latest message of the topic is of interest, and is to be retained.
        answer: whether it answers a request.
        urgent: whether it is an answer that goes before all others.
        correlation: correlation data of the answered request (MQTT 5).
        stands_for: the message of a retained topic that this one is another form of, for a slow link; None if it is
            as it was published.
    """

    topic: str
    payload: bytes
    retain: bool = False
    answer: bool = False
    urgent: bool = False
    correlation: bytes | None = None
    stands_for: Outgoing | None = None

    @property
    def size(self) -> int:
        """Upper bound of the size of the packet in bytes."""
        return len(self.payload) + len(self.topic.encode()) + len(self.correlation or b"") + _HEAD


class _Bounded:
    """A queue that drops its oldest messages beyond a number of messages or bytes."""

    def __init__(self, limit: int, limit_bytes: int) -> None:
        self.messages: deque[Outgoing] = deque()
        self._limit = limit
        self._limit_bytes = limit_bytes
        self._bytes = 0

    def put(self, message: Outgoing) -> int:
        """Add a message; returns how many were dropped."""
        self.messages.append(message)
        self._bytes += len(message.payload)
        dropped = 0
        while len(self.messages) > self._limit or self._bytes > self._limit_bytes:
            self._bytes -= len(self.messages.popleft().payload)
            dropped += 1
        return dropped

    def remove(self, message: Outgoing) -> None:
        for place, one in enumerate(self.messages):
            if one is message:
                del self.messages[place]
                self._bytes -= len(message.payload)
                return


def _overdue_s(message: Outgoing) -> float:
    return OVERDUE_S if message.stands_for is None else SLOW_OVERDUE_S


class Outbox:
    """Queues of answers and of events, and the latest message of each retained topic, sent again at each connection.

    Args:
        limit: maximum number of events; the oldest ones are dropped beyond it.
        limit_bytes: maximum total size of their payloads.
        answers: maximum number of answers, and of urgent ones.
        answers_bytes: maximum total size of their payloads.
        clock: monotonic seconds.

    Attributes:
        dropped: number of dropped messages.
        filled: set when there is a new message; cleared when none is left.
    """

    def __init__(
        self,
        *,
        limit: int = 10_000,
        limit_bytes: int = 16 * 2**20,
        answers: int = 1_000,
        answers_bytes: int = 4 * 2**20,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.dropped = 0
        self.filled = asyncio.Event()
        self._clock = clock
        self._events = _Bounded(limit, limit_bytes)
        self._answers = _Bounded(answers, answers_bytes)
        self._urgent = _Bounded(answers, answers_bytes)
        self._retained: dict[str, Outgoing] = {}
        self._stale: dict[str, float] = {}
        """Topics whose latest message is to be sent, and since when."""
        self._held: dict[str, bytes] = {}
        """Payloads that the broker has acknowledged on this connection."""

    def __len__(self) -> int:
        return sum(len(queue.messages) for queue in (self._urgent, self._answers, self._events)) + len(self._stale)

    @property
    def urgent(self) -> tuple[Outgoing, ...]:
        """The urgent answers, oldest first."""
        return tuple(self._urgent.messages)

    def put(self, message: Outgoing) -> None:
        """Add a message."""
        if message.retain:
            self._retained[message.topic] = message
            self._stale.setdefault(message.topic, self._clock())
        else:
            self.dropped += self._queue_of(message).put(message)
        self.filled.set()

    def is_held(self, message: Outgoing) -> bool:
        """Whether the broker has acknowledged this very message of a retained topic on this connection."""
        return self._held.get(message.topic) == message.payload and message.topic not in self._stale

    def held(self, topic: str) -> bytes | None:
        """The payload of a retained topic that the broker has acknowledged last on this connection."""
        return self._held.get(topic)

    def renew(self) -> None:
        """Send all retained messages again after a new connection, because the broker may have lost them."""
        self._stale = dict.fromkeys(self._retained, self._clock())
        self._held.clear()
        if len(self):
            self.filled.set()

    def take(
        self,
        most: int,
        most_bytes: float = math.inf,
        *,
        form: Callable[[Outgoing, float], Outgoing | None] = lambda message, _waited_s: message,
    ) -> list[Outgoing]:
        """The next messages, each of which is returned again until it is `done`.

        Urgent answers come first, then other answers, events, retained topics.

        Args:
            most: maximum number.
            most_bytes: maximum size of all together; one message may be larger.
            form: as what a message of a retained topic may be sent now, from the message and how long it has waited;
                None if it has to wait.
        """
        out: list[Outgoing] = []
        size = 0
        for message in self._in_order(form):
            size += message.size
            if len(out) >= most or (out and size > most_bytes):
                break
            out.append(message)
        return out

    def _in_order(self, form: Callable[[Outgoing, float], Outgoing | None]) -> Iterator[Outgoing]:
        yield from self._urgent.messages
        yield from self._answers.messages
        now = self._clock()
        waiting = [(form(self._retained[topic], now - since), now - since) for topic, since in self._stale.items()]
        ready = [(message, waited) for message, waited in waiting if message is not None]
        overdue = {id(message) for message, waited in ready if waited >= _overdue_s(message)}
        yield from (message for message, _ in ready if id(message) in overdue)
        yield from self._events.messages
        yield from (message for message, _ in ready if id(message) not in overdue)

    def give_up(self, message: Outgoing) -> None:
        """Drop a message that the broker rejects."""
        latest = message.stands_for or message
        if not latest.retain:
            self._remove(message)
        elif message.retain and self._retained.get(latest.topic) is latest:
            del self._retained[latest.topic]
            self._stale.pop(latest.topic, None)
        self.dropped += 1
        self._clear_if_empty()

    def done(self, message: Outgoing) -> None:
        """Remove a message that the broker has acknowledged."""
        latest = message.stands_for or message
        if message.retain:
            self._held[message.topic] = message.payload
        if latest.retain:
            if self._retained.get(latest.topic) is latest:
                self._stale.pop(latest.topic, None)
            elif latest.topic in self._stale:
                self._stale[latest.topic] = self._clock()
        else:
            self._remove(message)
        self._clear_if_empty()

    def _queue_of(self, message: Outgoing) -> _Bounded:
        if message.urgent:
            return self._urgent
        return self._answers if message.answer else self._events

    def _remove(self, message: Outgoing) -> None:
        self._queue_of(message).remove(message)

    def _clear_if_empty(self) -> None:
        if not len(self):
            self.filled.clear()
