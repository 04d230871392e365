"""Subscriptions of the daemon, and what they need of the broker; the doctor subscribes by the same code."""

from __future__ import annotations

from typing import Final

import aiomqtt
from paho.mqtt.subscribeoptions import SubscribeOptions

from panoexec.mqtt.client import REFUSED, BrokerClient
from panoexec.mqtt.requests import REQUESTS
from panoexec.mqtt.topics import Topics

WILDCARDS_NOT_SUPPORTED: Final = 0xA2


async def subscribe_requests(client: BrokerClient, topics: Topics, *, five: bool) -> None:
    """Subscribe to the requests of a vehicle; to each command's topic if the broker has no wildcards.

    Raises:
        aiomqtt.MqttError: it is not permitted, or the connection is lost.
    """
    code = WILDCARDS_NOT_SUPPORTED
    if client.limits.wildcards:
        code = await _subscribe(client, topics.requests, five=five)
    if code == WILDCARDS_NOT_SUPPORTED:
        codes = [await _subscribe(client, topics.request(command), five=five) for command in REQUESTS]
        code = max(codes)
    if code >= REFUSED:
        raise aiomqtt.MqttError(f"not permitted to subscribe to {topics.requests}: check the ACL of the broker")


async def subscribe_state(client: BrokerClient, topics: Topics, *, five: bool) -> bool:
    """Subscribe to the vehicle's state, as another daemon would publish it; whether the broker accepts that.

    Raises:
        aiomqtt.MqttError: the connection is lost.
    """
    options = SubscribeOptions(qos=0, retainHandling=2) if five else None
    return await client.ask_for(topics.state, options=options) < REFUSED


async def _subscribe(client: BrokerClient, topic: str, *, five: bool) -> int:
    if five:
        # with retainAsPublished the retain flag of live requests is visible, so that they can be rejected
        options = SubscribeOptions(qos=1, retainAsPublished=True, retainHandling=0)
        return await client.ask_for(topic, options=options)
    return await client.ask_for(topic, qos=1)
