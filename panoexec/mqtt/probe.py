"""Test of the permissions at a broker, with a separate client id so that a running daemon is not disconnected."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from typing import Any, Final

import aiomqtt

from panoexec.errors import LinkError
from panoexec.inputs.config import MqttSection
from panoexec.mqtt.certificates import explained
from panoexec.mqtt.client import CONNECT_S, broker_client
from panoexec.mqtt.topics import Topics

_REFUSED: Final = 128


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerReport:
    """The result of the test.

    Attributes:
        connect_s: time to connect.
        round_trip_s: time until a message was acknowledged.
        may_read: whether the vehicle can subscribe to its requests.
        may_write: whether the vehicle can publish responses; None with MQTT 3.1.1, which does not report it.
    """

    connect_s: float
    round_trip_s: float
    may_read: bool
    may_write: bool | None


async def probe_broker(settings: MqttSection, *, vehicle: str) -> BrokerReport:
    """Connect, test the permissions that the daemon needs, and disconnect.

    Args:
        settings: broker and credentials; `host` is set.
        vehicle: vehicle id.

    Raises:
        LinkError: the broker cannot be reached or rejects the connection; the text explains TLS errors.
        UsageError: a password or certificate file is invalid, or a certificate has expired.
    """
    assert settings.host is not None
    topics, five = Topics(settings.prefix, vehicle), settings.protocol == "5"
    client = await broker_client(settings, identifier="panoexec-doctor-")
    began = time.monotonic()
    try:
        async with asyncio.timeout(2 * CONNECT_S), client:
            connect_s = time.monotonic() - began
            granted: Any = (await client.subscribe(topics.requests, qos=1))[0]
            may_read = int(getattr(granted, "value", granted)) < _REFUSED
            began = time.monotonic()
            # no client waits for this response, and clients ignore a response without a transaction
            await client.publish(topics.response("doctor"), b'{"transaction":null,"status":"ok"}', qos=1)
            round_trip_s = time.monotonic() - began
    except (aiomqtt.MqttError, TimeoutError, OSError) as error:
        why = explained(str(error) or "it does not respond", settings)
        raise LinkError(f"no connection to broker {settings.host}:{settings.port}: {why}") from error
    may_write = client.acknowledged < _REFUSED if five else None
    return BrokerReport(connect_s=connect_s, round_trip_s=round_trip_s, may_read=may_read, may_write=may_write)
