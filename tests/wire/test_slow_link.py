"""A radio link of 1 kB/s: answers go before events, events before the state, and nothing is lost."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.ground_station import GroundStation
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink, running
from panoexec.mqtt.messages import dump
from tests.unit.mqtt.test_state_deltas import plain
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
    """It waits no longer than what is sent before it takes, and that is counted in bytes."""
    requests: list[Incoming] = []
    passed: list[bytes] = []

    def note(_first: int, content: bytes) -> bool:
        passed.append(content)
        return False

    section = MqttSection(host="127.0.0.1", port=broker.port)
    async with broker_proxy(broker.port, rate=RATE, closes_at=note) as proxy, ground_station(broker) as ground:
        section = section.model_copy(update={"port": proxy.port})
        link = MqttLink(section, vehicle="drone", on_request=requests.append)
        async with running(link):
            await eventually(lambda: link.connected)
            link.publish(link.topics.state, dump(plain(reason=200 * "s")), retain=True)
            await eventually(lambda: ground.payloads(link.topics.state))
            link.publish(link.topics.plan, 6000 * b"p", retain=True)
            for number in range(4):
                link.publish(link.topics.event, json.dumps({"number": number, "more": 300 * "e"}).encode())
            link.publish(link.topics.state, dump(plain(reason=200 * "t")), retain=True)
            for number in range(2):
                await ground.client.publish("panoexec/drone/request/get", b"{}", qos=1)
                await eventually(lambda n=number: len(requests) == n + 1)  # type: ignore[misc]
                before = len(passed)
                link.respond(requests[number], 500 * b"a")
                await eventually(lambda n=number: len(ground.payloads("panoexec/drone/response/get")) == n + 1)  # type: ignore[misc]
                answer = next(place for place in range(before, len(passed)) if 500 * b"a" in passed[place])
                assert sum(map(len, passed[before : answer + 1])) / RATE < ANSWER_S
                await asyncio.sleep(0.2)
            await eventually(lambda: len(ground.payloads(link.topics.event)) == 4)
            await eventually(lambda: 200 * b"t" in ground.payloads(link.topics.state)[-1])
            assert ground.payloads(link.topics.plan) == [], "it waits for a quiet moment"
            events = [json.loads(payload)["number"] for payload in ground.payloads(link.topics.event)]
            assert events == list(range(4))
            assert (link.outbox.dropped, proxy.connections) == (0, 1)


async def test_a_plan_that_takes_longer_than_an_acknowledgement_usually_does_arrives(
    broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.mqtt.pace.QUIET_S", 0.0)
    async with broker_proxy(broker.port, rate=2000.0) as proxy, ground_station(broker) as ground:
        section = MqttSection(host="127.0.0.1", port=proxy.port)
        link = MqttLink(section, vehicle="drone", on_request=lambda _: None)
        async with running(link):
            await eventually(lambda: link.connected and not len(link.outbox))
            with monkeypatch.context() as impatient:  # of the plan alone: a small message may be held up for longer
                impatient.setattr("panoexec.mqtt.pace._PATIENCE_S", 1.0)
                link.publish(link.topics.plan, 4000 * b"p", retain=True)
                await eventually(lambda: ground.payloads(link.topics.plan) == [4000 * b"p"])
                await eventually(lambda: not len(link.outbox))
            assert proxy.connections == 1
            link.publish(link.topics.plan, 100_000 * b"p", retain=True)
            await eventually(lambda: ground.payloads(link.topics.plan)[-1] == b"")
            assert proxy.connections == 1, "what would outlast keepalive is not sent"


async def test_states_over_a_slow_link_are_deltas_and_the_ground_station_shows_whole_ones(
    broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.mqtt.pace.BATCH_S", 0.15)
    async with (
        broker_proxy(broker.port, rate=RATE) as proxy,
        ground_station(broker) as ground,
        GroundStation(MqttSection(host="127.0.0.1", port=broker.port)) as station,
    ):
        link = MqttLink(MqttSection(host="127.0.0.1", port=proxy.port), vehicle="drone", on_request=lambda _: None)
        shown: list[dict[str, Any]] = [{}]

        async def show() -> None:
            async for heard in station.listen("drone"):
                shown[-1] = heard.document if heard.kind == "state" else shown[-1]

        async with running(link), asyncio.TaskGroup() as group:
            showing = group.create_task(show())
            await eventually(lambda: link.connected)
            link.publish(link.topics.state, dump(plain(attempts=0)), retain=True)
            for _ in range(12):
                link.publish(link.topics.event, 200 * b"e")
            await eventually(lambda: link._sender.pace.lastingly_slow and not len(link.outbox) and shown[-1])
            for attempts in (1, 2, 3):
                link.publish(link.topics.state, dump(plain(attempts=attempts, eta_s=None)), retain=True)
                await eventually(lambda n=attempts: shown[-1]["attempts"] == n)  # type: ignore[misc]
            showing.cancel()
        deltas = ground.payloads(link.topics.state_delta)
        assert len(deltas) == 3
        assert all(len(delta) < 150 for delta in deltas)
        assert len(ground.payloads(link.topics.state)) == 1
        coarse = {name: shown[-1][name] for name in ("link", "pose")}
        assert shown[-1] == json.loads(dump(plain(attempts=3, eta_s=None))) | coarse
