"""The shipped ACL under a real mosquitto: who may do what, and who gets nowhere."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import aiomqtt
import pytest

from panoexec.doctor.broker import check_broker
from panoexec.doctor.findings import Findings
from panoexec.errors import LinkError
from panoexec.inputs.config import Config
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.credentials import credential_problems
from panoexec.mqtt.ground_station import GroundStation
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink, running
from panoexec.mqtt.probe import probe_broker
from tests.repository import ROOT
from tests.waiting import eventually
from tests.wire.broker import PATH, Broker, needs_mosquitto, running_broker

pytestmark = needs_mosquitto
ACL = ROOT / "config" / "mosquitto.acl"
USERS = ("drone", "other", "ground", "viewer")


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    passwords = tmp_path / "passwd"
    passwords.write_text("".join(f"{user}:secret-{user}\n" for user in USERS))
    tool = shutil.which("mosquitto_passwd", path=PATH)
    assert tool is not None
    subprocess.run([tool, "-U", str(passwords)], check=True)
    rights = shutil.copy(ACL, tmp_path / "acl")
    settings = f"allow_anonymous false\npassword_file {passwords}\nacl_file {rights}"
    with running_broker(tmp_path, settings=settings) as one:
        yield one


def credentials(tmp_path: Path, broker: Broker, user: str) -> MqttSection:
    file = tmp_path / f"password-{user}"
    file.write_text(f"secret-{user}\n")
    file.chmod(0o600)
    return MqttSection(host="127.0.0.1", port=broker.port, username=user, password_file=file)


@asynccontextmanager
async def listening(broker: Broker, user: str, seen: list[tuple[str, bytes]]) -> Any:
    async with aiomqtt.Client("127.0.0.1", broker.port, username=user, password=f"secret-{user}") as client:
        await client.subscribe("panoexec/#", qos=1)

        async def listen() -> None:
            async for message in client.messages:
                seen.append((str(message.topic), bytes(message.payload)))  # noqa: PERF401  (seen while it goes on)

        task = asyncio.create_task(listen(), name=f"{user} listens")
        try:
            yield client
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


async def test_everybody_may_do_what_they_must_and_nothing_else(tmp_path: Path, broker: Broker) -> None:
    requests: list[Incoming] = []
    link = MqttLink(credentials(tmp_path, broker, "drone"), vehicle="drone", on_request=requests.append)
    heard: dict[str, list[tuple[str, bytes]]] = {user: [] for user in USERS}
    async with (
        listening(broker, "ground", heard["ground"]) as ground,
        listening(broker, "viewer", heard["viewer"]) as viewer,
        listening(broker, "other", heard["other"]) as other,
        running(link),
    ):
        await eventually(lambda: link.connected)
        for client in (viewer, other):
            await client.publish("panoexec/drone/request/abort", b"stranger", qos=1)
            await client.publish("panoexec/drone/state", b"stranger", qos=1)
            await client.publish("panoexec/drone/response/get", b"stranger", qos=1)
        for topic in ("status", "state", "plan", "event", "response/get"):
            await ground.publish(f"panoexec/drone/{topic}", b"stranger", qos=1)
        await ground.publish("panoexec/drone/request/get", b"ours", qos=1)
        await eventually(lambda: requests)
        link.publish(link.topics.event, b"event")
        link.respond(requests[0], b"answer")
        await eventually(lambda: ("panoexec/drone/response/get", b"answer") in heard["ground"])
        await eventually(lambda: ("panoexec/drone/event", b"event") in heard["viewer"])
    assert [request.payload for request in requests] == [b"ours"]
    assert all(payload != b"stranger" for messages in heard.values() for _, payload in messages)
    assert heard["other"] == []


async def test_a_wrong_password_is_told(tmp_path: Path, broker: Broker) -> None:
    section = credentials(tmp_path, broker, "drone")
    assert section.password_file is not None
    section.password_file.write_text("wrong")
    with pytest.raises(LinkError, match=r"[Nn]ot authori[sz]ed"):
        async with GroundStation(section.model_copy(update={"protocol": "5"})):
            pass


async def test_the_ground_station_says_when_nobody_answers(tmp_path: Path, broker: Broker) -> None:
    async with GroundStation(credentials(tmp_path, broker, "ground")) as ground:
        with pytest.raises(LinkError, match=r"drone did not respond to get within 0\.3 s"):
            await ground.request("drone", "get", {}, timeout_s=0.3)


def test_a_password_that_everybody_can_read_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("secret")
    file.chmod(0o644)
    section = MqttSection(host="h", username="u", password_file=file, ca_file=tmp_path / "none.crt")
    problems = credential_problems(section)
    assert len(problems) == 2
    assert "readable by everybody on this computer (mode 644)" in problems[0]
    assert "ca_file" in problems[1]
    with suppress(OSError):
        file.unlink()


@pytest.mark.parametrize(("user", "allowed"), [("drone", True), ("other", False)])
async def test_the_doctor_sees_who_may_answer_for_a_vehicle(
    tmp_path: Path, broker: Broker, user: str, allowed: bool
) -> None:
    report = await probe_broker(credentials(tmp_path, broker, user), vehicle="drone")
    assert set(report.may_write.values()) == {allowed}
    old = credentials(tmp_path, broker, user).model_copy(update={"protocol": "3.1.1"})
    assert set((await probe_broker(old, vehicle="drone")).may_write.values()) == {None}
    findings = Findings()
    section = credentials(tmp_path, broker, user).model_dump()
    await check_broker(Config.model_validate({"vehicle": {"id": "drone"}, "mqtt": section}), findings)
    (answers,) = [f for f in findings.all if f.check == "answers"]
    assert answers.verdict == ("ok" if allowed else "missing")
    assert findings.exit_code == (0 if allowed else 3)


async def test_the_doctor_is_told_by_a_broker_that_lets_nobody_in(tmp_path: Path, broker: Broker) -> None:
    section = MqttSection(host="127.0.0.1", port=broker.port).model_dump()
    findings = Findings()
    await check_broker(Config.model_validate({"mqtt": section}), findings)
    (connection,) = [f for f in findings.all if f.check == "connection"]
    assert connection.verdict == "missing"
    assert "not authori" in connection.found.lower()
