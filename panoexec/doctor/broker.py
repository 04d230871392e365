"""Checks of the MQTT broker: credentials, connection, and access rights of the vehicle."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Final

from panoexec.doctor.findings import Findings
from panoexec.errors import PanoexecError
from panoexec.inputs.config import Config
from panoexec.mqtt.certificates import certificate_validity
from panoexec.mqtt.credentials import credential_problems
from panoexec.mqtt.probe import BrokerReport, probe_broker

_SOON: Final = timedelta(days=30)
_SMALL_PACKET: Final = 64 * 1024
"""A plan of some 500 shots."""
_LOCAL: Final = frozenset({"localhost", "127.0.0.1", "::1"})


async def check_broker(config: Config, findings: Findings) -> None:
    """Check credentials, certificates, connection and access rights."""
    section = config.mqtt
    if section.host is None:
        findings.note("broker", "address", "none", advice="[mqtt] host; without it the daemon receives no requests")
        return
    problems = credential_problems(section)
    for problem in problems:
        findings.missing("broker", "credentials", problem, advice="check the files named in [mqtt]")
    _examine_certificates(config, findings)
    if section.ca_file is None and section.host not in _LOCAL:
        findings.warning(
            "broker",
            "encryption",
            f"no encryption to {section.host}",
            needed="TLS on a network: anyone who listens could command the vehicle",
            advice="[mqtt] ca_file and port 8883; config/mosquitto.conf",
        )
    if problems:
        return
    try:
        report = await probe_broker(section, vehicle=config.vehicle.id)
    except PanoexecError as error:
        findings.missing(
            "broker",
            "connection",
            str(error),
            advice="check [mqtt] host, port, username, password_file; is the broker running?",
        )
        return
    findings.ok(
        "broker",
        "connection",
        f"{section.host}:{section.port}, MQTT {section.protocol}, {1000 * report.connect_s:.0f} ms to connect, "
        f"{1000 * report.round_trip_s:.1f} ms round trip",
    )
    for text in report.limitations:
        findings.warning("broker", "limitations", text, needed="retained messages and QoS 1")
    most = report.largest_packet
    if most is not None and most < _SMALL_PACKET:
        findings.warning(
            "broker",
            "packet size",
            f"at most {most} bytes",
            needed="room for a plan; a larger plan or state is not published",
            advice="mosquitto: max_packet_size",
        )
    _judge_rights(findings, report, base=f"{section.prefix}/{config.vehicle.id}")


def _judge_rights(findings: Findings, report: BrokerReport, *, base: str) -> None:
    acl = "the broker's ACL: config/mosquitto.acl; the user name must be the vehicle's id"
    findings.judge(
        "broker",
        "requests",
        report.may_read,
        f"subscribing to {base}/request/#: {_allowed(report.may_read)}",
        advice=acl,
    )
    unknown = [name for name, may in report.may_write.items() if may is None]
    if unknown:
        text = f"the broker does not tell whether publishing is permitted below {base}: {', '.join(unknown)}"
        findings.note("broker", "answers" if "response" in unknown else "publishing", text)
    for name, may in report.may_write.items():
        if name == "state/delta" and may is False:
            text = f"publishing to {base}/{name}: refused; on a slow link whole states take its place"
            findings.note("broker", name, text, advice=acl)
        elif may is not None:
            topic = f"{base}/{name}/…" if name == "response" else f"{base}/{name}"
            check = "answers" if name == "response" else name
            findings.judge("broker", check, may, f"publishing to {topic}: {_allowed(may)}", advice=acl)
    if not report.sees_twin:
        findings.note(
            "broker",
            "own state",
            f"subscribing to {base}/state: refused; another daemon with this vehicle's id would not be noticed",
            advice=acl,
        )


def _allowed(value: bool) -> str:
    return "allowed" if value else "refused"


def _examine_certificates(config: Config, findings: Findings) -> None:
    now = datetime.now(UTC)
    for key in ("ca_file", "cert_file"):
        path = getattr(config.mqtt, key)
        if path is None:
            continue
        try:
            validity = certificate_validity(path)
        except PanoexecError:
            continue  # reported with the credentials
        found = f"{path}: valid until {validity.end:%Y-%m-%d}"
        if problem := validity.problem(now):
            findings.missing("broker", key, f"{path}: {problem}", advice=f"[mqtt] {key}")
        elif validity.end - now < _SOON:
            findings.warning("broker", key, found, needed="more than 30 days", advice="renew it")
        else:
            findings.ok("broker", key, found)
