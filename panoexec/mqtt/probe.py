"""What a broker lets a vehicle do: tried out under a name of its own, so that a running daemon is not disturbed."""

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
    """What was tried at a broker.

    Attributes:
        connect_s: until it let us in.
        round_trip_s: of one acknowledged message.
        may_read: requests to this vehicle.
        may_write: answers of this vehicle; None with MQTT 3.1.1, which does not tell.
    """

    connect_s: float
    round_trip_s: float
    may_read: bool
    may_write: bool | None


async def probe_broker(settings: MqttSection, *, vehicle: str) -> BrokerReport:
    """Connect, ask for what a daemon needs, and leave.

    Args:
        settings: broker and credentials; `host` is set.
        vehicle: its id.

    Raises:
        LinkError: it cannot be reached, or refuses; with the meaning of what TLS says.
        UsageError: a password or certificate file is wrong, or a certificate has expired.
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
            # nobody waits for an answer there, and a consumer of answers knows none without a transaction
            await client.publish(topics.response("doctor"), b'{"transaction":null,"status":"ok"}', qos=1)
            round_trip_s = time.monotonic() - began
    except (aiomqtt.MqttError, TimeoutError, OSError) as error:
        why = explained(str(error) or "it does not answer", settings)
        raise LinkError(f"no broker at {settings.host}:{settings.port}: {why}") from error
    may_write = client.acknowledged < _REFUSED if five else None
    return BrokerReport(connect_s=connect_s, round_trip_s=round_trip_s, may_read=may_read, may_write=may_write)
