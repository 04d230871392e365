"""A radio link of 1 kB/s: answers go before events, events before the state, and nothing is lost."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.inputs.config import MqttSection
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink, running
from tests.waiting import eventually
from tests.wire.broker import Broker, needs_mosquitto, running_broker
from tests.wire.broker_proxy import broker_proxy
from tests.wire.test_mqtt_link import ground_station

pytestmark = needs_mosquitto
RATE = 1000.0
ANSWER_S = 2.0


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with running_broker(tmp_path) as one:
        yield one


async def test_an_answer_does_not_wait_behind_events_and_states(broker: Broker) -> None:
    requests: list[Incoming] = []
    section = MqttSection(host="127.0.0.1", port=broker.port)
    async with broker_proxy(broker.port, rate=RATE) as proxy, ground_station(broker) as ground:
        section = section.model_copy(update={"port": proxy.port})
        link = MqttLink(section, vehicle="drone", on_request=requests.append)
        async with running(link):
            await eventually(lambda: link.connected)
            link.publish(link.topics.state, 600 * b"s", retain=True)
            await eventually(lambda: ground.payloads(link.topics.state))
            link.publish(link.topics.plan, 6000 * b"p", retain=True)
            for number in range(4):
                link.publish(link.topics.event, json.dumps({"number": number, "more": 300 * "e"}).encode())
            link.publish(link.topics.state, 600 * b"t", retain=True)
            for number in range(2):
                await ground.client.publish("panoexec/drone/request/get", b"{}", qos=1)
                await eventually(lambda n=number: len(requests) == n + 1)  # type: ignore[misc]
                began = time.monotonic()
                link.respond(requests[number], 500 * b"a")
                await eventually(lambda n=number: len(ground.payloads("panoexec/drone/response/get")) == n + 1)  # type: ignore[misc]
                assert time.monotonic() - began < ANSWER_S
                await asyncio.sleep(0.2)
            await eventually(lambda: len(ground.payloads(link.topics.event)) == 4)
            await eventually(lambda: ground.payloads(link.topics.state)[-1] == 600 * b"t")
            assert ground.payloads(link.topics.plan) == [], "it waits for a quiet moment"
            events = [json.loads(payload)["number"] for payload in ground.payloads(link.topics.event)]
            assert events == list(range(4))
            assert (link.outbox.dropped, proxy.connections) == (0, 1)


async def test_a_plan_that_takes_longer_than_an_acknowledgement_usually_does_arrives(
    broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.mqtt.pace.QUIET_S", 0.0)
    monkeypatch.setattr("panoexec.mqtt.pace._PATIENCE_S", 1.0)
    async with broker_proxy(broker.port, rate=2000.0) as proxy, ground_station(broker) as ground:
        section = MqttSection(host="127.0.0.1", port=proxy.port)
        link = MqttLink(section, vehicle="drone", on_request=lambda _: None)
        async with running(link):
            await eventually(lambda: link.connected)
            link.publish(link.topics.plan, 4000 * b"p", retain=True)
            await eventually(lambda: ground.payloads(link.topics.plan) == [4000 * b"p"])
            assert proxy.connections == 1
            link.publish(link.topics.plan, 100_000 * b"p", retain=True)
            await eventually(lambda: ground.payloads(link.topics.plan)[-1] == b"")
            assert proxy.connections == 1, "what would outlast keepalive is not sent"
