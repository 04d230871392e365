"""Requests as received from the broker: size, age, flags, response topic and order of arrival.

Stopping requests (`STOPPING`) are received on a lane of their own: they are returned before all other requests that
wait, and are never discarded because too many wait.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import aiomqtt

from panoexec.mission.tour_stop import TourStop
from panoexec.mqtt.requests import MAX_PAYLOAD, MOVING, STOPPING, RefusedRequestError
from panoexec.mqtt.topics import Topics

_READ_ON_S: Final = 0.1
"""For so long, arriving messages are read before the next request is executed."""

_arrivals = itertools.count(1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Incoming:
    """A received request.

    Attributes:
        command: the part of the topic after `request/`.
        payload: bytes; empty if there were more than `MAX_PAYLOAD`.
        size: size of the original payload in bytes.
        retained: whether the message was retained or published with the retain flag.
        response_topic: additional topic for the response (MQTT 5); "" for none.
        correlation: correlation data of the request (MQTT 5).
        received_s: arrival time (time.monotonic).
        expires_s: expiry time (time.monotonic); infinity without an expiry.
        arrival: number of the message in the order of arrival, across connections.
        overtakes: commands that can set the vehicle in motion (`MOVING`), arrived earlier and still waiting.
        reply: takes the response of a request that did not come by MQTT.
        stop: for a `start` from inside the daemon: the stop of a tour that the panorama is flown at.
    """

    command: str
    payload: bytes
    size: int
    retained: bool = False
    response_topic: str = ""
    correlation: bytes | None = None
    received_s: float = 0.0
    expires_s: float = math.inf
    arrival: int = 0
    overtakes: frozenset[str] = frozenset()
    reply: Callable[[bytes], None] | None = None
    stop: TourStop | None = None

    @property
    def sender(self) -> str:
        """Who asked, as far as MQTT tells: the response topic; "" for all requests without one."""
        return self.response_topic

    def check_fresh(self) -> None:
        """Raise if the message has expired.

        Raises:
            RefusedRequestError: `expired`.
        """
        if time.monotonic() > self.expires_s:
            raise expired()


def expired() -> RefusedRequestError:
    """The error for a request whose message expiry has passed."""
    return RefusedRequestError("expired", "the request's message expiry passed before it was executed")


def next_arrival() -> int:
    """The number of a request that arrives now, for `Incoming.arrival`."""
    return next(_arrivals)


class _Arrived(aiomqtt.Message):
    """A message in the inbox; an oversized payload was discarded, and `size` is what it had."""

    size: int = 0
    arrival: int = 0
    overtakes: frozenset[str] = frozenset()


class Inbox(asyncio.Queue[aiomqtt.Message]):
    """A queue with a lane for stopping requests, which are returned first and are not limited in number.

    It discards oversized payloads, so that a flood of them cannot exhaust the memory.
    """

    def _init(self, maxsize: int) -> None:
        super()._init(maxsize)
        self._stops: deque[_Arrived] = deque()
        self._others: deque[_Arrived] = deque()
        self._is_stop = False
        self._newest = 0

    def qsize(self) -> int:
        """Number of messages that wait."""
        return len(self._stops) + len(self._others)

    def empty(self) -> bool:
        """Whether no message waits."""
        return not self.qsize()

    def full(self) -> bool:
        """Whether no request is accepted, except stopping ones."""
        return not self._is_stop and 0 < self.maxsize <= len(self._others)

    def put_nowait(self, item: aiomqtt.Message) -> None:
        """Add a message.

        Raises:
            asyncio.QueueFull: too many wait, and it is not a stopping request.
        """
        self._is_stop = _command(item) in STOPPING
        try:
            super().put_nowait(item)
        finally:
            self._is_stop = False

    def _put(self, item: aiomqtt.Message) -> None:
        payload = item.payload
        size = len(payload) if isinstance(payload, bytes) else 0
        kept = b"" if size > MAX_PAYLOAD else payload
        arrived = _Arrived(item.topic, kept, item.qos, item.retain, item.mid, item.properties)
        arrived.size, arrived.arrival = size, next(_arrivals)
        self._newest = arrived.arrival
        (self._stops if self._is_stop else self._others).append(arrived)

    def _get(self) -> aiomqtt.Message:
        if not self._stops:
            return self._others.popleft()
        stop = self._stops.popleft()
        # those that arrived later were not overtaken
        waiting = (one for one in self._others if one.arrival < stop.arrival)
        stop.overtakes = MOVING.intersection(_command(one) for one in waiting)
        return stop

    async def read_on(self) -> None:
        """Let the connection read what has arrived, for `_READ_ON_S` at most.

        The connection reads one message in each iteration of the event loop. Without this pause a stopping request
        would be seen only when all requests that arrived before it have been parsed.
        """
        end_s = time.monotonic() + _READ_ON_S
        seen = -1
        while self._newest != seen and not self._stops and time.monotonic() < end_s:
            seen = self._newest
            await asyncio.sleep(0)
            await asyncio.sleep(0)


def _command(message: aiomqtt.Message) -> str:
    return str(message.topic).rpartition("/")[2]


def incoming_of(message: aiomqtt.Message, topics: Topics) -> Incoming | None:
    """The request in a message; None if the message only clears a retained request."""
    payload = message.payload if isinstance(message.payload, bytes) else b""
    retained = bool(message.retain)
    size, arrival, overtakes = len(payload), 0, frozenset[str]()
    if isinstance(message, _Arrived):
        size, arrival, overtakes = message.size, message.arrival, message.overtakes
    if retained and not size:
        return None
    properties = message.properties
    now = time.monotonic()
    expiry = getattr(properties, "MessageExpiryInterval", None)
    return Incoming(
        command=str(message.topic).removeprefix(f"{topics.base}/request/"),
        payload=payload,
        size=size,
        retained=retained,
        response_topic=str(getattr(properties, "ResponseTopic", "") or ""),
        correlation=getattr(properties, "CorrelationData", None),
        received_s=now,
        expires_s=math.inf if expiry is None else now + float(expiry),
        arrival=arrival,
        overtakes=overtakes,
    )
