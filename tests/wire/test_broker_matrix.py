"""The link and the doctor with several brokers. Opt-in: PANOEXEC_BROKERS=1; a broker that is not installed is skipped.

mosquitto from Debian, NATS by `go install github.com/nats-io/nats-server/v2@latest` (PANOEXEC_NATS_SERVER names the
program), RabbitMQ from Debian (`rabbitmq-server`).
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import aiomqtt
import pytest

from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.ground_station import GroundStation
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink, running
from tests.waiting import eventually
from tests.wire.broker import MOSQUITTO, running_broker
from tests.wire.broker_proxy import broker_proxy
from tests.wire.other_brokers import NATS, RABBIT, nats_cluster, rabbitmq
from tests.wire.test_broker_limits import doctors_findings, plain_ground

pytestmark = pytest.mark.skipif(
    not os.environ.get("PANOEXEC_BROKERS"), reason="starts other brokers: set PANOEXEC_BROKERS=1"
)
Protocol = Literal["5", "3.1.1"]
EVENTS = 100
TOPICS = [f"panoexec/drone/{name}" for name in ("status", "state", "plan", "event", "response/get")]
"""RabbitMQ delivers retained messages to subscriptions without wildcards only."""


@contextmanager
def broker_of(name: str, folder: Path) -> Iterator[int]:
    """The MQTT port of a broker while the block runs."""
    if {"mosquitto": MOSQUITTO, "nats": NATS, "rabbitmq": RABBIT}[name] is None:
        pytest.skip(f"{name} is not installed")
    if name == "mosquitto":
        with running_broker(folder) as broker:
            yield broker.port
    elif name == "nats":
        with nats_cluster(folder) as nodes:
            yield nodes[0][0]
    else:
        with rabbitmq(folder) as port:
            yield port


def a_link(port: int, requests: list[Incoming], protocol: Protocol) -> MqttLink:
    section = MqttSection(host="127.0.0.1", port=port, protocol=protocol)
    return MqttLink(section, vehicle="drone", on_request=requests.append, backoff_s=0.2, boot_id="mine")


@pytest.mark.parametrize(
    ("name", "protocol"), [("mosquitto", "5"), ("mosquitto", "3.1.1"), ("nats", "3.1.1"), ("rabbitmq", "3.1.1")]
)
async def test_requests_answers_events_and_retained_messages(tmp_path: Path, name: str, protocol: Protocol) -> None:
    requests: list[Incoming] = []
    with broker_of(name, tmp_path) as port:
        link = a_link(port, requests, protocol)
        async with running(link):
            await eventually(lambda: link.connected, 60)
            link.publish(link.topics.state, b'{"seq": 1}', retain=True)
            link.publish(link.topics.plan, b"p" * 20_000, retain=True)
            await eventually(lambda: len(link.outbox) == 0)
            async with plain_ground(port, *TOPICS) as ground:
                await eventually(lambda: ground.payloads(link.topics.plan) == [b"p" * 20_000])
                assert ground.payloads(link.topics.status) == [b"online"]
                assert ground.payloads(link.topics.state) == [b'{"seq": 1}']
                for number in range(EVENTS):
                    link.publish(link.topics.event, b"%d" % number)
                await eventually(lambda: len(ground.payloads(link.topics.event)) == EVENTS)
                assert ground.payloads(link.topics.event) == [b"%d" % number for number in range(EVENTS)]
                await ground.client.publish("panoexec/drone/request/get", b'{"transaction": 1}', qos=1)
                await eventually(lambda: requests)
                link.respond(requests[0], b"answer")
                await eventually(lambda: ground.payloads("panoexec/drone/response/get") == [b"answer"])
            findings = await doctors_findings(port, protocol=protocol)
            assert link.connected
        async with plain_ground(port, *TOPICS) as ground:
            await eventually(lambda: ground.payloads(link.topics.status) == [b"offline"])
    assert [one for one in findings if one.verdict == "missing"] == []


@pytest.mark.parametrize("name", ["nats", "rabbitmq"])
async def test_a_broker_that_speaks_only_mqtt_3_is_named_with_the_key(tmp_path: Path, name: str) -> None:
    with broker_of(name, tmp_path) as port:
        link = a_link(port, [], "5")
        async with running(link):
            await eventually(lambda: link.connected or '[mqtt] protocol = "3.1.1"' in link.reason, 60)
        if link.reason:
            (connection,) = [one for one in await doctors_findings(port) if one.check == "connection"]
            assert '[mqtt] protocol = "3.1.1"' in connection.found


async def test_a_cluster_that_loses_a_node_loses_no_event(tmp_path: Path) -> None:
    if NATS is None:
        pytest.skip("nats-server is not installed")
    with nats_cluster(tmp_path) as nodes:
        (first, _), (second, _), (_, _) = nodes
        async with broker_proxy(first) as proxy:  # as a load balancer before the cluster
            link = a_link(proxy.port, [], "3.1.1")
            heard: list[int] = []
            async with running(link):
                await eventually(lambda: link.connected, 60)
                async with aiomqtt.Client("127.0.0.1", second, identifier="gcs", clean_session=False) as ground:
                    await ground.subscribe(link.topics.event, qos=1)
                    messages = ground.messages
                    for number in range(EVENTS):
                        link.publish(link.topics.event, b"%d" % number)
                        if number == EVENTS // 2:
                            proxy.target = second
                            nodes[0][1].kill()
                    while len(set(heard)) < EVENTS:
                        heard.append(int(bytes((await anext(messages)).payload)))
                await eventually(lambda: link.connected, 60)
                assert proxy.connections > 1, "the link was lost with the node"
    assert list(dict.fromkeys(heard)) == list(range(EVENTS))


@pytest.mark.parametrize("name", ["nats", "rabbitmq"])
async def test_the_ground_station_gets_its_answer(tmp_path: Path, name: str) -> None:
    requests: list[Incoming] = []
    with broker_of(name, tmp_path) as port:
        link = a_link(port, requests, "3.1.1")
        async with running(link):
            await eventually(lambda: link.connected, 60)
            async with GroundStation(MqttSection(host="127.0.0.1", port=port, protocol="3.1.1")) as station:
                asking = asyncio.create_task(
                    station.request("drone", "get", {"transaction": "t"}, timeout_s=20), name="ground station"
                )
                await eventually(lambda: requests)
                link.respond(requests[0], b'{"transaction": "t", "status": "ok"}')
                assert (await asking)["status"] == "ok"
