"""Requests as received from the broker: size, age, flags and response topic."""

from __future__ import annotations

import asyncio
import math
import time
from dataclasses import dataclass

import aiomqtt

from panoexec.mqtt.requests import MAX_PAYLOAD
from panoexec.mqtt.topics import Topics


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
    """

    command: str
    payload: bytes
    size: int
    retained: bool = False
    response_topic: str = ""
    correlation: bytes | None = None
    received_s: float = 0.0
    expires_s: float = math.inf


class _Cut(aiomqtt.Message):
    """A message whose payload was discarded because of its size."""

    size: int = 0


class Inbox(asyncio.Queue[aiomqtt.Message]):
    """A queue that discards oversized payloads, so that a flood of them cannot exhaust the memory."""

    def _put(self, item: aiomqtt.Message) -> None:
        payload = item.payload
        if isinstance(payload, bytes) and len(payload) > MAX_PAYLOAD:
            cut = _Cut(item.topic, b"", item.qos, item.retain, item.mid, item.properties)
            cut.size = len(payload)
            item = cut
        super()._put(item)


def incoming_of(message: aiomqtt.Message, topics: Topics) -> Incoming | None:
    """The request in a message; None if the message only clears a retained request."""
    payload = message.payload if isinstance(message.payload, bytes) else b""
    retained = bool(message.retain)
    size = len(payload)
    if isinstance(message, _Cut):
        size = message.size
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
    )
