"""What a broker lets a vehicle do: tried out under a name of its own, so that a running daemon is not disturbed."""

from __future__ import annotations

import asyncio
import os
import time
import uuid
from dataclasses import dataclass
from typing import Any, Final

import aiomqtt

from panoexec.config import MqttSection
from panoexec.errors import LinkError
from panoexec.mqtt.certificates import check_dates, explained
from panoexec.mqtt.credentials import read_password, tls_context
from panoexec.mqtt.link import Topics

_CONNECT_S: Final = 10.0
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


class _Client(aiomqtt.Client):
    """Keeps the reason code of the last acknowledged message, which aiomqtt throws away."""

    acknowledged = 0

    def _on_publish(self, client: Any, userdata: Any, mid: int, reason_code: Any, properties: Any) -> None:
        self.acknowledged = int(getattr(reason_code, "value", 0))
        super()._on_publish(client, userdata, mid, reason_code, properties)


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
    await asyncio.to_thread(check_dates, settings)
    client = _Client(
        hostname=settings.host,
        port=settings.port,
        username=settings.username,
        password=await asyncio.to_thread(read_password, settings),
        identifier=f"panoexec-doctor-{os.getpid()}-{uuid.uuid4().hex[:8]}",
        protocol=aiomqtt.ProtocolVersion.V5 if five else aiomqtt.ProtocolVersion.V311,
        keepalive=settings.keepalive_s,
        timeout=_CONNECT_S,
        tls_context=await asyncio.to_thread(tls_context, settings),
    )
    began = time.monotonic()
    try:
        async with asyncio.timeout(2 * _CONNECT_S), client:
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
