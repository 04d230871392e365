"""TLS with a real mosquitto: certificates both ways, and what is said when they do not fit."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from panoexec.doctor.broker import check_broker
from panoexec.doctor.findings import Findings
from panoexec.errors import LinkError, UsageError
from panoexec.inputs.config import Config
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.certificates import certificate_validity, explained
from panoexec.mqtt.ground_station import GroundStation
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.link import MqttLink, running
from panoexec.sim.ports import free_tcp_port
from tests.repository import ROOT
from tests.waiting import eventually
from tests.wire.broker import PATH, Broker, needs_mosquitto, running_broker
from tests.wire.certificates import Authority, Issued, needs_openssl

pytestmark = [needs_mosquitto, needs_openssl]
ACL = ROOT / "config" / "mosquitto.acl"


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    return Authority(tmp_path_factory.mktemp("ca"))


@pytest.fixture(scope="module")
def broker(authority: Authority, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    """A broker that lets nobody in without a certificate, and takes the common name for the user."""
    folder = tmp_path_factory.mktemp("broker")
    (folder / "acl").write_text(ACL.read_text())
    with running_broker(
        folder, listener=tls_of(authority, authority.issue("127.0.0.1")), settings=mutual(folder)
    ) as one:
        yield one


def tls_of(authority: Authority, broker: Issued) -> str:
    return f"cafile {authority.cert}\ncertfile {broker.cert}\nkeyfile {broker.key}"


def mutual(folder: Path) -> str:
    return f"require_certificate true\nuse_identity_as_username true\nallow_anonymous false\nacl_file {folder}/acl"


def section(broker: Broker, authority: Authority, mine: Issued | None = None, **more: Any) -> MqttSection:
    files = {} if mine is None else {"cert_file": mine.cert, "key_file": mine.key}
    return MqttSection.model_validate(
        {"host": "127.0.0.1", "port": broker.port, "ca_file": authority.cert} | files | more
    )


async def reason_of(settings: MqttSection, part: str) -> str:
    """What the daemon's link says of a connection that does not come about."""
    requests: list[Incoming] = []
    link = MqttLink(settings, vehicle="drone", on_request=requests.append, backoff_s=0.05)
    async with running(link):
        await eventually(lambda: part in link.reason, 60)
        assert not link.connected
        return link.reason


async def test_certificates_both_ways_let_in_and_give_the_rights_of_their_name(
    broker: Broker, authority: Authority
) -> None:
    requests: list[Incoming] = []
    drone, ground = authority.issue("drone"), authority.issue("ground")
    link = MqttLink(section(broker, authority, drone), vehicle="drone", on_request=requests.append)
    async with running(link), GroundStation(section(broker, authority, ground)) as station:
        await eventually(lambda: link.connected, 60)
        asking = asyncio.create_task(station.request("drone", "get", {}, timeout_s=30), name="ask")
        await eventually(lambda: requests, 60)
        transaction = requests[0].payload.split(b'"transaction": ')[1].split(b"}")[0]
        link.respond(requests[0], b'{"transaction": ' + transaction + b', "status": "ok"}')
        assert (await asking)["status"] == "ok"
    async with GroundStation(section(broker, authority, authority.issue("other"))) as station:
        with pytest.raises(LinkError, match="did not respond"):
            await station.request("drone", "abort", {}, timeout_s=1.0)
    assert [request.command for request in requests] == ["get"], "a certificate without rights gets nowhere"


async def test_without_a_certificate_of_ones_own_nobody_gets_in(broker: Broker, authority: Authority) -> None:
    reason = await reason_of(section(broker, authority), "certificate")
    assert "set mqtt.cert_file and key_file" in reason


async def test_a_broker_that_is_not_who_it_should_be(broker: Broker, authority: Authority, tmp_path: Path) -> None:
    drone = authority.issue("drone")
    stranger = Authority(tmp_path / "stranger")
    reason = await reason_of(section(broker, stranger, drone), "is not signed by")
    assert str(stranger.cert) in reason
    with running_broker(tmp_path, listener=tls_of(authority, authority.issue("elsewhere.example"))) as other:
        reason = await reason_of(section(other, authority, drone), "a name other than")
    assert "mqtt.host 127.0.0.1" in reason


async def test_an_expired_certificate_is_told_with_its_date(
    broker: Broker, authority: Authority, tmp_path: Path
) -> None:
    past = authority.issue("past", begin="20200101000000Z", end="20210203040506Z")
    mine = section(broker, authority, past)
    reason = await reason_of(mine, "expired on 2021-02-03 04:05 UTC")
    assert str(past.cert) in reason
    with pytest.raises(UsageError, match=r"cert_file .*past\.crt: expired on 2021-02-03"):
        async with GroundStation(mine):
            pass
    findings = Findings()
    await check_broker(Config.model_validate({"mqtt": mine.model_dump()}), findings)
    assert "expired on 2021" in next(f.found for f in findings.all if f.check == "cert_file")
    assert findings.exit_code == 3
    theirs = authority.issue("127.0.0.1", begin="20200101000000Z", end="20210203040506Z")
    with running_broker(tmp_path, listener=tls_of(authority, theirs)) as old:
        reason = await reason_of(section(old, authority), "has expired")
    assert "the broker's certificate has expired" in reason


async def test_a_port_without_tls(tmp_path: Path, authority: Authority) -> None:
    with running_broker(tmp_path) as plain:
        settings = section(plain, authority)
        requests: list[Incoming] = []
        link = MqttLink(settings, vehicle="drone", on_request=requests.append, backoff_s=0.05)
        async with running(link):
            await eventually(lambda: link.reason != "not connected yet", 60)
            assert not link.connected


def test_the_validity_of_a_certificate(authority: Authority, tmp_path: Path) -> None:
    far = certificate_validity(authority.issue("far", begin="20250102030405Z", end="20600102030405Z").cert)
    assert f"{far.begin:%Y-%m-%d %H:%M:%S}" == "2025-01-02 03:04:05"
    assert f"{far.end:%Y}" == "2060"
    assert far.problem(far.begin) == ""
    assert "not valid before 2025-01-02" in far.problem(far.begin.replace(year=2024))
    assert "set the clock of this computer, which says 1970-01-02" in far.problem(far.begin.replace(year=1970))
    assert "expired on 2060" in far.problem(far.end.replace(year=2061))
    for content in ("", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n", "\x80"):
        (tmp_path / "no.crt").write_text(content)
        with pytest.raises(UsageError, match=r"no\.crt: contains no certificate"):
            certificate_validity(tmp_path / "no.crt")
    with pytest.raises(UsageError, match="cannot be read"):
        certificate_validity(tmp_path / "none.crt")


def test_only_what_is_known_is_explained() -> None:
    settings = MqttSection(host="h", ca_file=Path("ca.crt"))
    text = "[SSL: CERTIFICATE_VERIFY_FAILED] certificate verify failed: unable to get local issuer certificate"
    assert explained(text, settings) == f"the broker's certificate is not signed by mqtt.ca_file ca.crt ({text})"
    refused = "[Errno 111] Connection refused"
    assert explained(refused, settings) == (
        f"nothing listens on h, port 1883: check that the broker runs and uses this port ({refused})"
    )
    assert explained("[Errno -2] Name or service not known", settings).startswith("the host name h is unknown")
    assert explained("Not authorized", settings) == "Not authorized"


async def test_the_shipped_configuration_of_the_broker_as_it_is(authority: Authority, tmp_path: Path) -> None:
    """Only its paths and ports are others: TLS outside, plain on the machine itself, nobody without a password."""
    certificate, tool = authority.issue("127.0.0.1"), shutil.which("mosquitto_passwd", path=PATH)
    assert tool is not None
    (tmp_path / "passwd").write_text("drone:secret-drone\nground:secret-ground\n")
    await asyncio.to_thread(subprocess.run, [tool, "-U", str(tmp_path / "passwd")], check=True)
    shutil.copy(ACL, tmp_path / "mosquitto.acl")
    outside, inside = free_tcp_port(), free_tcp_port()
    text = ACL.with_name("mosquitto.conf").read_text(encoding="utf-8")
    for shipped, here in {
        "/etc/mosquitto/certs/ca.crt": str(authority.cert),
        "/etc/mosquitto/certs/broker.crt": str(certificate.cert),
        "/etc/mosquitto/certs/broker.key": str(certificate.key),
        "/etc/mosquitto": str(tmp_path),
        "/var/lib/mosquitto/": f"{tmp_path}/",
        "listener 8883": f"listener {outside} 127.0.0.1",
        "listener 1883 127.0.0.1": f"listener {inside} 127.0.0.1",
    }.items():
        text = "\n".join(line if line.startswith("#") else line.replace(shipped, here) for line in text.splitlines())
    with running_broker(tmp_path, port=outside, whole=text):
        for port, ca in ((outside, authority.cert), (inside, None)):
            requests: list[Incoming] = []
            drone, ground = (known(tmp_path, user, port, ca) for user in ("drone", "ground"))
            link = MqttLink(drone, vehicle="drone", on_request=requests.append)
            async with running(link), GroundStation(ground) as station:
                await eventually(partial(getattr, link, "connected"), 60)
                with pytest.raises(LinkError, match="did not respond"):
                    await station.request("drone", "get", {}, timeout_s=1.0)
                assert [request.command for request in requests] == ["get"]
            with pytest.raises(LinkError, match=r"[Nn]ot authori[sz]ed"):
                async with GroundStation(MqttSection(host="127.0.0.1", port=port, ca_file=ca)):
                    pass


def known(folder: Path, user: str, port: int, ca: Path | None) -> MqttSection:
    """A user's settings."""
    password = folder / f"password-{user}"
    password.write_text(f"secret-{user}")
    password.chmod(0o600)
    return MqttSection(host="127.0.0.1", port=port, ca_file=ca, username=user, password_file=password)
