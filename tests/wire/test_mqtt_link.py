"""The link against a real broker: availability, requests, retained state, restarts, rights."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Literal

import aiomqtt
import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.client import broker_client
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink, running
from panoexec.mqtt.topics import Topics
from tests.waiting import eventually
from tests.wire.broker import Broker, needs_mosquitto, running_broker

pytestmark = needs_mosquitto
Protocol = Literal["5", "3.1.1"]


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with running_broker(tmp_path) as one:
        yield one


class Ground:
    """A ground station that listens to everything."""

    def __init__(self, client: aiomqtt.Client) -> None:
        self.client = client
        self.seen: list[tuple[str, bytes, bool]] = []
        self.properties: list[Any] = []

    async def listen(self) -> None:
        async for message in self.client.messages:
            self.seen.append((str(message.topic), bytes(message.payload), message.retain))
            self.properties.append(message.properties)

    def payloads(self, topic: str) -> list[bytes]:
        return [payload for name, payload, _ in self.seen if name == topic]


@asynccontextmanager
async def ground_station(broker: Broker, **options: Any) -> AsyncIterator[Ground]:
    async with aiomqtt.Client("127.0.0.1", broker.port, protocol=aiomqtt.ProtocolVersion.V5, **options) as client:
        ground = Ground(client)
        await client.subscribe("panoexec/#", qos=1)
        task = asyncio.create_task(ground.listen(), name="ground station")
        try:
            yield ground
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


def a_link(broker: Broker, requests: list[Incoming], *, protocol: Protocol = "5", **settings: Any) -> MqttLink:
    section = MqttSection(host="127.0.0.1", port=broker.port, protocol=protocol, **settings)
    return MqttLink(section, vehicle="drone", on_request=requests.append, backoff_s=0.05)


def request_properties(**values: Any) -> Properties:
    properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    for name, value in values.items():
        setattr(properties, name, value)
    return properties


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
async def test_says_online_then_offline_and_takes_requests(broker: Broker, protocol: Protocol) -> None:
    requests: list[Incoming] = []
    async with ground_station(broker) as ground:
        async with running(a_link(broker, requests, protocol=protocol)) as link:
            await eventually(lambda: ground.payloads("panoexec/drone/status") == [b"online"])
            await ground.client.publish("panoexec/drone/request/get", b'{"transaction": 1}', qos=1)
            await eventually(lambda: requests)
            assert (requests[0].command, requests[0].payload) == ("get", b'{"transaction": 1}')
            assert requests[0].size == 18
            assert not requests[0].retained
            assert requests[0].expires_s == math.inf
            link.respond(requests[0], b"{}")
            await eventually(lambda: ground.payloads("panoexec/drone/response/get") == [b"{}"])
        await eventually(lambda: ground.payloads("panoexec/drone/status") == [b"online", b"offline"])


async def test_says_offline_when_its_task_is_cancelled(broker: Broker) -> None:
    requests: list[Incoming] = []
    task = asyncio.create_task(a_link(broker, requests).run(), name="link")
    async with ground_station(broker) as ground:
        await eventually(lambda: b"online" in ground.payloads("panoexec/drone/status"))
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    async with ground_station(broker) as late:
        await eventually(lambda: late.payloads("panoexec/drone/status"))
        assert late.seen[0][1:] == (b"offline", True)


async def test_answers_at_the_response_topic_below_the_base_topic_only(broker: Broker) -> None:
    requests: list[Incoming] = []
    async with ground_station(broker) as ground, running(a_link(broker, requests)) as link:
        await eventually(lambda: link.connected)
        for topic in ("panoexec/drone/response/gcs-7", "panoexec/other/response/x", "panoexec/drone/request/abort"):
            properties = request_properties(ResponseTopic=topic, CorrelationData=b"\x01\x02", MessageExpiryInterval=60)
            await ground.client.publish("panoexec/drone/request/get", b"{}", qos=1, properties=properties)
        await eventually(lambda: len(requests) == 3)
        assert 50 < requests[0].expires_s - requests[0].received_s <= 60
        for request in requests:
            link.respond(request, b'"answer"')
        await eventually(lambda: len(ground.payloads("panoexec/drone/response/get")) == 3)
        await eventually(lambda: ground.payloads("panoexec/drone/response/gcs-7") == [b'"answer"'])
        assert ground.payloads("panoexec/other/response/x") == []
        assert ground.payloads("panoexec/drone/request/abort") == []
        answers = [p for (t, _, _), p in zip(ground.seen, ground.properties, strict=True) if "response" in t]
        assert all(answer.CorrelationData == b"\x01\x02" for answer in answers)
        assert all(answer.ContentType == "application/json" for answer in answers)


@pytest.mark.parametrize(
    ("topic", "allowed"),
    [
        ("panoexec/drone/response/gcs-7", True),
        ("panoexec/drone/gcs/a/b/c", True),
        ("panoexec/drone/response/" + "x" * 400, True),
        ("panoexec/drone/response/" + "x" * 500, False),
        ("panoexec/drone/response" + "/a" * 300, False),
        ("panoexec/drone/response/\x85", False),
        ("panoexec/drone/response/+", False),
        ("panoexec/drone/", False),
        ("panoexec/drone/state", False),
        ("panoexec/drone/state/x", False),
        ("panoexec/drone/request/abort", False),
        ("panoexec/drone2/response/x", False),
        ("$SYS/broker", False),
    ],
)
def test_where_an_answer_may_go(topic: str, allowed: bool) -> None:
    assert Topics("panoexec", "drone").may_answer_at(topic) is allowed


async def test_a_response_topic_that_the_broker_does_not_bear_costs_nobody_the_link(broker: Broker) -> None:
    requests: list[Incoming] = []
    async with ground_station(broker) as ground, running(a_link(broker, requests)) as link:
        await eventually(lambda: link.connected)
        for topic in ("panoexec/drone/response" + "/a" * 300, "panoexec/drone/response/" + "a" * 60_000):
            properties = request_properties(ResponseTopic=topic)
            await ground.client.publish("panoexec/drone/request/get", b"{}", qos=1, properties=properties)
        await eventually(lambda: len(requests) == 2)
        for request in requests:
            link.respond(request, b'"answer"')
        link.publish(link.topics.event, b"afterwards")
        await eventually(lambda: ground.payloads(link.topics.event) == [b"afterwards"])
        assert len(ground.payloads("panoexec/drone/response/get")) == 2
        assert (link.connected, link.outbox.dropped) == (True, 0)
    assert broker.log.read_text().count("as panoexec-panoexec:drone") == 1, "one connection all the time"


@pytest.mark.parametrize(
    ("protocol", "setting"),
    [
        ("5", "max_packet_size 2000"),  # told at the connection
        ("3.1.1", "max_packet_size 2000"),  # told to nobody
        ("5", "message_size_limit 2000"),  # told to nobody either
    ],
)
async def test_what_a_broker_does_not_bear_is_given_up_and_all_else_arrives(
    tmp_path: Path, protocol: Protocol, setting: str
) -> None:
    requests: list[Incoming] = []
    with running_broker(tmp_path, settings=f"allow_anonymous true\n{setting}") as broker:
        async with ground_station(broker) as ground, running(a_link(broker, requests, protocol=protocol)) as link:
            await eventually(lambda: link.connected)
            link.publish(link.topics.state, b"state", retain=True)
            link.publish(link.topics.plan, b"p" * 3000, retain=True)
            for number in range(20):
                link.publish(link.topics.event, b"%d" % number)
            link.publish(link.topics.event, b"x" * 3000)
            link.publish(link.topics.event, b"20")
            await eventually(lambda: b"20" in ground.payloads(link.topics.event))
            await eventually(lambda: link.connected and not len(link.outbox))
            heard = dict.fromkeys(ground.payloads(link.topics.event))
            assert list(heard) == [b"%d" % number for number in range(21)]
            assert ground.payloads(link.topics.plan) == [b""], "no plan of an earlier mission stays"
            assert link.outbox.dropped == 2


async def test_no_more_is_sent_than_the_broker_takes_unacknowledged(tmp_path: Path) -> None:
    with running_broker(tmp_path, settings="allow_anonymous true\nmax_inflight_messages 3") as broker:
        client = await broker_client(MqttSection(host="127.0.0.1", port=broker.port))
        async with client:
            assert (client.limits.most_unacknowledged, client.limits.largest_packet) == (3, None)
            link = a_link(broker, [])
            for number in range(20):
                link.publish(link.topics.event, b"%d" % number)
            assert len(link._sender.next_batch(client)) == 3


async def test_tells_retained_requests_whenever_they_come(broker: Broker) -> None:
    requests: list[Incoming] = []
    async with ground_station(broker) as ground:
        await ground.client.publish("panoexec/drone/request/start", b'{"transaction": "old"}', qos=1, retain=True)
        async with running(a_link(broker, requests)) as link:
            await eventually(lambda: requests)
            assert requests[0].retained
            await eventually(lambda: link.connected)
            await ground.client.publish("panoexec/drone/request/abort", b'{"transaction": "now"}', qos=1, retain=True)
            await eventually(lambda: len(requests) == 2)
            assert requests[1].retained
            await ground.client.publish("panoexec/drone/request/abort", b"", qos=1, retain=True)
            await ground.client.publish("panoexec/drone/request/get", b"{}", qos=1)
            await eventually(lambda: len(requests) == 3)
            assert requests[2].command == "get", "clearing a retained request is no request"


async def test_a_payload_too_large_comes_without_its_bytes(broker: Broker) -> None:
    requests: list[Incoming] = []
    async with ground_station(broker) as ground, running(a_link(broker, requests)) as link:
        await eventually(lambda: link.connected)
        await ground.client.publish("panoexec/drone/request/start", b"x" * 70_000, qos=1)
        await eventually(lambda: requests)
        assert (requests[0].payload, requests[0].size) == (b"", 70_000)


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
async def test_a_restarted_broker_gets_the_retained_state_and_no_event_is_lost(
    broker: Broker, protocol: Protocol
) -> None:
    requests: list[Incoming] = []
    async with running(a_link(broker, requests, protocol=protocol)) as link:
        link.publish(link.topics.state, b'{"seq": 1}', retain=True)
        async with ground_station(broker) as ground:
            await eventually(lambda: ground.payloads(link.topics.state))
        broker.stop(kill=True)
        await eventually(lambda: not link.connected)
        for number in range(50):
            link.publish(link.topics.event, json.dumps(number).encode())
            link.publish(link.topics.state, json.dumps({"seq": number}).encode(), retain=True)
        broker.start()
        async with ground_station(broker) as ground:
            # the events were queued here before; a subscriber that comes in time gets each of them, in order
            await eventually(lambda: link.connected)
            await eventually(lambda: len(link.outbox) == 0)
            await eventually(lambda: b'{"seq": 49}' in ground.payloads(link.topics.state))
            assert b'{"seq": 48}' not in ground.payloads(link.topics.state), "only the newest state is of interest"
            link.publish(link.topics.event, b"50")
            await eventually(lambda: b"50" in ground.payloads(link.topics.event))
            events = [int(payload) for payload in ground.payloads(link.topics.event)]
            assert events == list(range(events[0], 51))
    assert link.outbox.dropped == 0


async def test_a_broker_that_is_absent_or_refuses_is_tried_again_and_a_stop_ends_at_once(tmp_path: Path) -> None:
    broker = Broker(tmp_path, settings="allow_anonymous false")
    requests: list[Incoming] = []
    link = a_link(broker, requests)
    async with running(link):
        await eventually(lambda: "refused" in link.reason.lower())
        broker.start()
        try:
            await eventually(lambda: "not authorized" in link.reason.lower())
        finally:
            broker.stop()
        assert not link.connected


async def test_two_daemons_with_one_vehicle_id_are_told(broker: Broker) -> None:
    requests: list[Incoming] = []
    async with running(a_link(broker, requests)) as first:
        await eventually(lambda: first.connected)
        async with running(a_link(broker, requests)) as second:
            await eventually(lambda: second.connected)
            told = "check whether two daemons use the vehicle id 'drone'"
            await eventually(lambda: told in first.reason or told in second.reason)
    assert not requests


@pytest.mark.parametrize(("connections_before", "obeyed"), [(1, ["fresh"]), (0, [])])
async def test_requests_sent_in_a_radio_gap_come_unless_they_expired_or_the_process_is_new(
    broker: Broker, connections_before: int, obeyed: list[str]
) -> None:
    # the session as a lost connection leaves it behind at the broker
    lost = aiomqtt.Client(
        "127.0.0.1",
        broker.port,
        identifier="panoexec-panoexec:drone",
        protocol=aiomqtt.ProtocolVersion.V5,
        properties=_session(60),
    )
    async with lost:
        await lost.subscribe("panoexec/drone/request/#", qos=1)
    async with ground_station(broker) as ground:
        topic = "panoexec/drone/request/pause"
        expiring = request_properties(MessageExpiryInterval=1)
        await ground.client.publish(topic, b'{"transaction": "stale"}', qos=1, properties=expiring)
        await ground.client.publish(topic, b'{"transaction": "fresh"}', qos=1)
        await asyncio.sleep(2.1)  # the broker counts whole seconds
        requests: list[Incoming] = []
        link = a_link(broker, requests)
        link._times = connections_before
        async with running(link):
            await eventually(lambda: link.connected)
            await ground.client.publish("panoexec/drone/request/get", b'{"transaction": "last"}', qos=1)
            await eventually(lambda: requests and requests[-1].command == "get")
        assert [json.loads(request.payload)["transaction"] for request in requests] == [*obeyed, "last"]


def _session(seconds: int) -> Properties:
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = seconds
    return properties
