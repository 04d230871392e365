"""Brokers that do not offer everything: the daemon works with them, says so, and the doctor says the same."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Literal

import aiomqtt
import pytest
import structlog

from panoexec.doctor.broker import check_broker
from panoexec.doctor.findings import Finding, Findings
from panoexec.errors import LinkError
from panoexec.inputs.config import Config
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.client_id import another_client_id, client_id
from panoexec.mqtt.ground_station import GroundStation
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink, running
from panoexec.mqtt.topics import Topics
from panoexec.mqtt.twin import TwinWatch
from tests.waiting import eventually
from tests.wire.broker import Broker, needs_mosquitto, running_broker
from tests.wire.broker_proxy import CONNECT, announcing, broker_proxy, is_retained_publish
from tests.wire.test_mqtt_link import Ground, ground_station

pytestmark = needs_mosquitto
Protocol = Literal["5", "3.1.1"]
RETAIN, QOS = "does not keep retained messages", "no QoS above 0"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with running_broker(tmp_path) as one:
        yield one


def a_link(port: int, requests: list[Incoming], **settings: Any) -> MqttLink:
    section = MqttSection.model_validate({"host": "127.0.0.1", "port": port} | settings)
    return MqttLink(section, vehicle="drone", on_request=requests.append, backoff_s=0.05, boot_id="mine")


async def doctors_findings(port: int, **settings: Any) -> list[Finding]:
    findings = Findings()
    section = {"host": "127.0.0.1", "port": port} | settings
    await check_broker(Config.model_validate({"vehicle": {"id": "drone"}, "mqtt": section}), findings)
    return [one for one in findings.all if one.area == "broker"]


def told(logs: list[Any], event: str) -> str:
    return "\n".join(str(entry) for entry in logs if entry["event"] == event)


@asynccontextmanager
async def plain_ground(port: int, *topics: str) -> AsyncIterator[Ground]:
    """A ground station on any broker, with QoS 0, that subscribes to everything or to these topics."""
    async with aiomqtt.Client("127.0.0.1", port, protocol=aiomqtt.ProtocolVersion.V311) as client:
        ground = Ground(client)
        for topic in topics or ("panoexec/#",):
            await client.subscribe(topic, qos=0)

        task = asyncio.create_task(ground.listen(), name="ground station")
        try:
            yield ground
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
@pytest.mark.parametrize(
    ("listener", "lines", "said"),
    [
        ("", "retain_available false", [RETAIN]),
        ("max_qos 0", "", [QOS]),
        ("max_qos 0", "retain_available false", [RETAIN, QOS]),
        ("max_qos 1", "", []),
        ("", "max_keepalive 10\nmax_packet_size 20000", []),
    ],
)
async def test_a_poor_broker_carries_requests_answers_and_state(
    tmp_path: Path, protocol: Protocol, listener: str, lines: str, said: list[str]
) -> None:
    requests: list[Incoming] = []
    settings = {"protocol": protocol, "keepalive_s": 20 if protocol == "5" else 10}
    with (
        running_broker(tmp_path, listener=listener, settings=f"allow_anonymous true\n{lines}") as broker,
        structlog.testing.capture_logs() as logs,
    ):
        link = a_link(broker.port, requests, **settings)
        async with plain_ground(broker.port) as ground:
            async with running(link):
                await eventually(lambda: b"online" in ground.payloads("panoexec/drone/status"))
                link.publish(link.topics.state, b"state", retain=True)
                link.publish(link.topics.event, b"event")
                await ground.client.publish("panoexec/drone/request/get", b"{}")
                await eventually(lambda: requests)
                link.respond(requests[0], b"answer")
                await eventually(lambda: ground.payloads("panoexec/drone/response/get") == [b"answer"])
                await eventually(lambda: ground.payloads("panoexec/drone/state") == [b"state"])
                assert ground.payloads("panoexec/drone/event") == [b"event"]
                findings = await doctors_findings(broker.port, **settings)
            await eventually(lambda: ground.payloads("panoexec/drone/status")[-1] == b"offline")
        log = broker.log.read_text()
    limitations = told(logs, "broker with limitations")
    warned = " ".join(one.found for one in findings if one.check == "limitations")
    assert "connection" not in {one.check for one in findings if one.verdict == "missing"}
    for text in (RETAIN, QOS):
        assert (text in limitations, text in warned) == (text in said, text in said)
    assert "disconnected, not authorised" not in log
    assert log.count("already connected") == 0, "the doctor does not take the daemon's client id"


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
async def test_a_broker_that_closes_the_connection_at_retained_messages_gets_none(
    broker: Broker, protocol: Protocol
) -> None:
    async with broker_proxy(broker.port, closes_at=is_retained_publish) as proxy, ground_station(broker) as ground:
        link = a_link(proxy.port, [], protocol=protocol)
        link.publish(link.topics.state, b"state", retain=True)
        async with running(link):
            await eventually(lambda: ground.payloads("panoexec/drone/state") == [b"state"])
            assert b"online" in ground.payloads("panoexec/drone/status")
        limitations = [
            one.found for one in await doctors_findings(proxy.port, protocol=protocol) if "limit" in one.check
        ]
    assert RETAIN in "".join(limitations)


async def test_a_connection_that_was_closed_by_chance_teaches_nothing(broker: Broker) -> None:
    closed: list[int] = []

    def the_first(first: int, _content: bytes) -> bool:
        if first >> 4 == CONNECT and not closed:
            closed.append(first)
            return True
        return False

    async with broker_proxy(broker.port, closes_at=the_first) as proxy, ground_station(broker) as ground:
        async with running(a_link(proxy.port, [], protocol="3.1.1")) as link:
            await eventually(lambda: link.connected)
        async with ground_station(broker) as late:
            await eventually(lambda: late.payloads("panoexec/drone/status"))
            assert late.seen[0][1:] == (b"offline", True), "it is retained"
    assert ground.payloads("panoexec/drone/status")[0] == b"online"


async def test_without_wildcards_each_command_is_subscribed_to(broker: Broker) -> None:
    requests: list[Incoming] = []
    no_wildcards = announcing(b"\x28\x00")
    async with (
        broker_proxy(broker.port, edit=no_wildcards) as proxy,
        ground_station(broker) as ground,
        running(a_link(proxy.port, requests)) as link,
    ):
        await eventually(lambda: link.connected)
        for command in ("abort", "get", "start"):
            await ground.client.publish(f"panoexec/drone/request/{command}", b"{}", qos=1)
        await eventually(lambda: len(requests) == 3)
    assert "request/#" not in broker.log.read_text().replace("panoexec/# ", "")


async def test_without_retained_messages_the_status_is_repeated_and_get_brings_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.mqtt.sender.REPEAT_S", 0.2)
    monkeypatch.setattr("panoexec.mqtt.sender.PULSE_S", 0.1)
    with running_broker(tmp_path, settings="allow_anonymous true\nretain_available false") as broker:
        async with ground_station(broker) as ground, running(a_link(broker.port, [])) as link:
            await eventually(lambda: ground.payloads("panoexec/drone/status").count(b"online") > 2)
            monkeypatch.setattr("panoexec.mqtt.sender.REPEAT_S", 1000.0)
            await eventually(lambda: len(link.outbox) == 0)
            heard = ground.payloads("panoexec/drone/status").count(b"online")
            link.announce()
            await eventually(lambda: ground.payloads("panoexec/drone/status").count(b"online") > heard)
            assert set(ground.payloads("panoexec/drone/status")) == {b"online"}


async def test_watch_asks_for_what_such_a_broker_does_not_keep(tmp_path: Path) -> None:
    requests: list[Incoming] = []
    with running_broker(tmp_path, settings="allow_anonymous true\nretain_available false") as broker:
        link = a_link(broker.port, requests)
        async with running(link), GroundStation(MqttSection(host="127.0.0.1", port=broker.port)) as ground:
            await eventually(lambda: link.connected)
            messages = ground.listen("drone")
            first = asyncio.create_task(anext(messages), name="first message")
            await eventually(lambda: requests)
            assert requests[0].command == "get"
            link.publish(link.topics.state, b'{"seq": 1}', retain=True)
            assert (await first).document == {"seq": 1}
            await messages.aclose()


async def test_an_answer_that_is_too_large_for_the_broker_says_at_least_what_became_of_the_request(
    tmp_path: Path,
) -> None:
    request = Incoming(command="start", payload=b"", size=0, correlation=b"c")
    with running_broker(tmp_path, settings="allow_anonymous true\nmax_packet_size 1000") as broker:
        async with ground_station(broker) as ground, running(a_link(broker.port, [])) as link:
            await eventually(lambda: link.connected)
            answer = {"transaction": "a", "status": "ok", "error": None, "data": {"notes": 2000 * "x"}}
            link.respond(request, json.dumps(answer).encode())
            await eventually(lambda: ground.payloads("panoexec/drone/response/start"))
            (short,) = ground.payloads("panoexec/drone/response/start")
    assert json.loads(short) == answer | {"data": None}


@pytest.mark.parametrize(
    "answer",
    [
        pytest.param(b"\x20\x03\x00\x84\x00", id="reason 0x84"),
        pytest.param(b"\x20\x02\x00\x01", id="return code 1"),
        pytest.param(b"", id="closed"),
    ],
)
async def test_a_broker_without_mqtt_5_is_named_with_the_key_to_set(broker: Broker, answer: bytes) -> None:
    hint = '[mqtt] protocol = "3.1.1"'
    async with broker_proxy(broker.port, answers_connect=answer) as proxy:
        link = a_link(proxy.port, [])
        async with running(link):
            await eventually(lambda: hint in link.reason)
        (connection,) = [one for one in await doctors_findings(proxy.port) if one.check == "connection"]
        assert connection.verdict == "missing"
        assert hint in connection.found
        with pytest.raises(LinkError, match=r"3\.1\.1"):
            async with GroundStation(MqttSection(host="127.0.0.1", port=proxy.port)):
                pass


def test_each_vehicle_below_each_prefix_has_a_client_id_of_its_own() -> None:
    ids = {client_id(Topics(prefix, vehicle)) for prefix, vehicle in (("a/b", "c"), ("a", "b-c"), ("a-b", "c"))}
    assert len(ids) == 3
    assert another_client_id(Topics("a", "b")) != another_client_id(Topics("a", "b"))


def a_state(boot_id: str) -> bytes:
    return json.dumps({"boot_id": boot_id}).encode()


async def stolen(port: int, identifier: str, protocol: Protocol, *, clean: bool = True) -> None:
    """Another client with that client id."""
    version = aiomqtt.ProtocolVersion.V5 if protocol == "5" else aiomqtt.ProtocolVersion.V311
    how: dict[str, Any] = {"clean_start": clean} if protocol == "5" else {"clean_session": clean}
    async with aiomqtt.Client("127.0.0.1", port, identifier=identifier, protocol=version, **how):
        pass


@pytest.mark.parametrize(("protocol", "clean"), [("5", True), ("5", False), ("3.1.1", True), ("3.1.1", False)])
async def test_a_client_that_takes_the_daemons_client_id_does_so_twice_at_most(
    broker: Broker, protocol: Protocol, clean: bool
) -> None:
    thefts_felt = 2  # this broker does not say why it closes; one closing may also be its restart
    requests: list[Incoming] = []
    name = client_id(Topics("panoexec", "drone"))
    async with ground_station(broker) as ground:
        with structlog.testing.capture_logs() as logs:
            async with running(a_link(broker.port, requests, protocol=protocol)) as link:
                for theft in range(8):
                    times = min(theft, thefts_felt) + 1
                    await eventually(lambda n=times: link.connected and link._connections == n)  # type: ignore[misc]
                    await stolen(broker.port, name, protocol, clean=clean)
                await eventually(lambda: link.connected)
                assert link._connections == thefts_felt + 1
                assert not link.twin
                await ground.client.publish("panoexec/drone/request/get", b"{}", qos=1)
                await eventually(lambda: requests)
    assert name in told(logs, "another client uses this client id: connecting with another one")


async def test_a_broker_that_is_restarted_is_no_thief(tmp_path: Path) -> None:
    """It comes back at once and has forgotten the session."""
    with running_broker(tmp_path) as broker, structlog.testing.capture_logs() as logs:
        async with running(a_link(broker.port, [])) as link:
            await eventually(lambda: link.connected)
            name = link._identifier
            broker.stop()
            broker.start()
            await eventually(lambda: link._connections == 2)
            assert link._identifier == name
    assert not [entry for entry in logs if "another client" in entry["event"]]


async def test_of_two_daemons_with_one_vehicle_id_only_one_may_begin_a_mission(broker: Broker) -> None:
    requests: list[Incoming] = []
    async with running(a_link(broker.port, requests)) as first:
        await eventually(lambda: first.connected)
        section = MqttSection(host="127.0.0.1", port=broker.port)
        second = MqttLink(section, vehicle="drone", on_request=requests.append, backoff_s=0.05, boot_id="other")
        async with running(second):
            name = client_id(first.topics)
            await eventually(lambda: {first._identifier == name, second._identifier == name} == {True, False})
            await eventually(lambda: first.connected and second.connected)
            for link, boot_id in ((first, "mine"), (second, "other")):
                link.publish(link.topics.state, a_state(boot_id), retain=True)
            await eventually(lambda: first.twin or second.twin)
            assert first.twin is (first._identifier != name), "the one that moved knows of the other one"
            assert second.twin is (second._identifier != name)


async def test_where_a_daemon_could_not_see_another_one_it_keeps_its_client_id(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.mqtt.twin.BLIND_S", 0.2)
    monkeypatch.setattr("panoexec.mqtt.sender.PULSE_S", 0.05)
    rights = tmp_path / "acl"
    rights.write_text("topic read panoexec/drone/request/#\ntopic write panoexec/drone/#\n")
    with running_broker(tmp_path, settings=f"allow_anonymous true\nacl_file {rights}") as broker:
        async with running(a_link(broker.port, [])) as link:
            await eventually(lambda: link.connected)
            name = client_id(link.topics)
            with structlog.testing.capture_logs() as logs:
                await stolen(broker.port, name, "5")
                await eventually(lambda: link._connections >= 2)
                await stolen(broker.port, name, "5")
                # mosquitto accepts any subscription, and checks the right to read when it delivers
                await eventually(lambda: link._identifier != name)
                await eventually(lambda: "would not be seen" in told(logs, "broker connection failed, retrying"))
                await eventually(lambda: link.connected)
            for _ in range(3):
                connections = link._connections
                await stolen(broker.port, name, "5")
                await eventually(lambda n=connections: link._connections > n)  # type: ignore[misc]
            assert link._identifier == name


async def test_the_doctor_asks_for_each_right_and_publishes_nothing_on_the_daemons_topics(tmp_path: Path) -> None:
    rights = tmp_path / "acl"
    names = ("status", "plan", "event", "response/#")
    lines = ["topic read panoexec/#", *(f"topic write panoexec/drone/{name}" for name in names)]
    rights.write_text("\n".join(lines) + "\n")
    with running_broker(tmp_path, settings=f"allow_anonymous true\nacl_file {rights}") as broker:
        async with ground_station(broker) as ground:
            async with running(a_link(broker.port, [])) as link:
                await eventually(lambda: ground.payloads("panoexec/drone/status") == [b"online"])
                verdicts = {one.check: one.verdict for one in await doctors_findings(broker.port)}
                link.publish(link.topics.event, b"afterwards")
                await eventually(lambda: ground.payloads(link.topics.event))
                assert link._connections == 1
            await eventually(lambda: ground.payloads("panoexec/drone/status") == [b"online", b"offline"])
        heard = {topic for topic, _, _ in ground.seen}
        async with ground_station(broker) as late:
            await eventually(lambda: late.payloads("panoexec/drone/status"))
            assert [topic for topic, _, _ in late.seen] == ["panoexec/drone/status"], "the doctor leaves nothing behind"
    assert (verdicts["state"], verdicts["status"], verdicts["event"]) == ("missing", "ok", "ok")
    assert heard == {"panoexec/drone/status", "panoexec/drone/event", "panoexec/drone/response/probe"}
    assert ground.payloads(link.topics.event) == [b"afterwards"]


@pytest.mark.parametrize("payload", [b"", b"no json", b"[]", b'{"boot_id": 7}', a_state("mine")])
def test_what_is_no_foreign_state_is_no_other_daemon(payload: bytes) -> None:
    twins = TwinWatch("mine")
    assert not twins.hear(payload, retained=False)
    assert not twins.hear(a_state("other"), retained=True), "an earlier process left it"
    assert not twins.present
    assert twins.hear(a_state("other"), retained=False)
    assert twins.present


def test_who_hears_not_even_itself_would_hear_no_other_daemon() -> None:
    now = [0.0]
    twins = TwinWatch("mine", clock=lambda: now[0])
    twins.watch()
    now[0] = 41.0
    assert twins.blind
    twins.hear(a_state("mine"), retained=False)
    assert not twins.blind
