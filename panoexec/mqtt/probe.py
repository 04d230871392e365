"""Test of a broker for the doctor: what the daemon would find, by the same code, without disturbing a running daemon.

The client has an id of its own, its will and its messages are on the topic `response/probe`, for which no client
waits, and the permission to publish the daemon's topics is asked for without publishing there.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Final

import aiomqtt

from panoexec.errors import LinkError
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.certificates import explained
from panoexec.mqtt.client import CONNECT_S, REFUSED, BrokerClient, broker_client
from panoexec.mqtt.client_id import client_id
from panoexec.mqtt.dialer import TAKEN_OVER, Dialer, Terms
from panoexec.mqtt.sender import with_reason
from panoexec.mqtt.subscribing import subscribe_requests, subscribe_state
from panoexec.mqtt.topics import Topics

_NOTHING: Final = b'{"transaction":null,"status":"ok"}'
"""Clients ignore a response without a transaction."""

_EXACTLY_ONCE: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerReport:
    """The result of the test.

    Attributes:
        connect_s: time to connect.
        round_trip_s: time until a message was acknowledged.
        limitations: what the broker does not offer, and what the daemon does about it, one sentence each.
        largest_packet: its maximum packet size in bytes; None if it does not announce one.
        may_read: whether the vehicle can subscribe to its requests.
        sees_twin: whether the vehicle can read its own state, and so notice another daemon.
        may_write: whether the vehicle can publish, by topic below the base topic; None where the broker does not tell.
    """

    connect_s: float
    round_trip_s: float
    limitations: list[str]
    largest_packet: int | None
    may_read: bool
    sees_twin: bool
    may_write: dict[str, bool | None]


async def probe_broker(settings: MqttSection, *, vehicle: str) -> BrokerReport:
    """Connect, test what the daemon needs, and disconnect.

    Args:
        settings: broker and credentials; `host` is set.
        vehicle: vehicle id.

    Raises:
        LinkError: the broker cannot be reached or rejects the connection; the text explains the error.
        UsageError: a password or certificate file is invalid, or a certificate has expired.
    """
    assert settings.host is not None
    topics, five = Topics(settings.prefix, vehicle), settings.protocol == "5"

    async def make(terms: Terms) -> BrokerClient:
        will = aiomqtt.Will(topics.response("probe"), _NOTHING, qos=terms.qos, retain=terms.retain)
        return await broker_client(settings, identifier=f"{client_id(topics)}:doctor-", will=will)

    dialer = Dialer(make, five=five)
    try:
        try:
            return await _examined(dialer, topics, five=five)
        except _EndedAtRetainedError:
            return await _examined(dialer, topics, five=five)  # without retained messages if that is the cause
    except (aiomqtt.MqttError, TimeoutError, OSError) as error:
        if getattr(getattr(error, "rc", None), "value", None) == TAKEN_OVER:
            why = (
                "another client took the connection over: the broker gives client ids by user name, and a daemon with "
            )
            why += "this user name is running; ask that one (panoexec send doctor)"
        else:
            why = explained(str(error) or "it does not respond", settings)
        raise LinkError(f"no connection to broker {settings.host}:{settings.port}: {why}") from error


class _EndedAtRetainedError(aiomqtt.MqttError):
    """The connection ended at a retained message."""


async def _examined(dialer: Dialer, topics: Topics, *, five: bool) -> BrokerReport:
    began = time.monotonic()
    async with asyncio.timeout(2 * CONNECT_S), AsyncExitStack() as stack:
        client = await dialer.dial(stack)
        connect_s = time.monotonic() - began
        try:
            return await _tested(client, dialer, topics, connect_s=connect_s, five=five)
        except _EndedAtRetainedError:
            raise
        except aiomqtt.MqttError as error:
            raise with_reason(client, error) from error


async def _tested(
    client: BrokerClient, dialer: Dialer, topics: Topics, *, connect_s: float, five: bool
) -> BrokerReport:
    terms = dialer.terms
    try:
        await subscribe_requests(client, topics, five=five)
        may_read = True
    except aiomqtt.MqttError:
        if client.is_lost:
            raise
        may_read = False
    began = time.monotonic()
    code = await client.send(topics.response("probe"), _NOTHING, qos=terms.qos, retain=False)
    round_trip_s = time.monotonic() - began
    try:
        # an empty retained message leaves nothing behind
        await client.send(topics.response("probe"), b"", qos=terms.qos, retain=terms.retain)
    except aiomqtt.MqttError as error:
        dialer.ended_at_greeting()
        dialer.ended_at_greeting()
        raise _EndedAtRetainedError(str(with_reason(client, error))) from error
    may_write: dict[str, bool | None] = {"response": code < REFUSED if five and terms.qos else None}
    asks = five and client.limits.max_qos == _EXACTLY_ONCE
    for name in ("status", "state", "state/delta", "plan", "event"):
        may_write[name] = await client.may_publish(f"{topics.base}/{name}") if asks else None
    return BrokerReport(
        connect_s=connect_s,
        round_trip_s=round_trip_s,
        limitations=terms.limitations(),
        largest_packet=client.limits.largest_packet,
        may_read=may_read,
        sees_twin=await _sees_twin(client, topics, five=five),
        may_write=may_write,
    )


async def _sees_twin(client: BrokerClient, topics: Topics, *, five: bool) -> bool:
    try:
        return await subscribe_state(client, topics, five=five)
    except aiomqtt.MqttError:
        return False  # some brokers close the connection instead
