"""Validity of certificates, and explanations for errors of the connection and its TLS handshake."""

from __future__ import annotations

import binascii
import re
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from panoexec.errors import UsageError
from panoexec.inputs.service_sections import MqttSection

_PEM: Final = re.compile(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", re.DOTALL)
_SEQUENCE: Final = 0x30
_VERSION: Final = 0xA0
_UTC_TIME: Final = 0x17
_GENERALIZED_TIME: Final = 0x18

_MEANINGS: Final[tuple[tuple[str, str], ...]] = (
    (
        "certificate has expired",
        "the broker's certificate has expired: renew it, or set the clock of this computer, which says {clock}",
    ),
    (
        "certificate is not yet valid",
        "the broker's certificate is not valid yet: set the clock of this computer, which says {clock}",
    ),
    ("unable to get local issuer", "the broker's certificate is not signed by mqtt.ca_file {ca}"),
    ("self-signed certificate", "the broker's certificate is not signed by mqtt.ca_file {ca}"),
    ("self signed certificate", "the broker's certificate is not signed by mqtt.ca_file {ca}"),
    ("signature failure", "the broker's certificate is not signed by mqtt.ca_file {ca}"),
    (
        "connection refused",
        "nothing listens on {host}, port {port}: check that the broker runs and uses this port",
    ),
    ("no route to host", "{host} cannot be reached: check that it is on and that this computer is on its network"),
    ("network is unreachable", "{host} cannot be reached: check that this computer is on a network"),
    ("name or service not known", "the host name {host} is unknown: check its spelling and the DNS"),
    ("no address associated", "the host name {host} is unknown: check its spelling and the DNS"),
    (
        "failure in name resolution",
        "the host name {host} cannot be resolved: no network or no DNS; or give its address",
    ),
    ("timed out", "{host}, port {port} does not respond: check the address of the broker and firewalls"),
    ("mismatch", "the broker's certificate is for a name other than mqtt.host {host}"),
    ("wrong_version_number", "mqtt.port {port} does not use TLS: remove ca_file, or use the broker's TLS port"),
    ("packet_length_too_long", "mqtt.port {port} does not use TLS: remove ca_file, or use the broker's TLS port"),
    ("alert_certificate_expired", "the broker reports that the client certificate mqtt.cert_file {cert} has expired"),
    ("alert certificate expired", "the broker reports that the client certificate mqtt.cert_file {cert} has expired"),
    ("alert_unknown_ca", "the broker does not know the CA of the client certificate mqtt.cert_file {cert}"),
    ("alert unknown ca", "the broker does not know the CA of the client certificate mqtt.cert_file {cert}"),
    ("certificate_required", "the broker requires a client certificate: set mqtt.cert_file and key_file"),
    ("certificate required", "the broker requires a client certificate: set mqtt.cert_file and key_file"),
)


_CHECK_TLS: Final = "if its port needs TLS, set ca_file; otherwise its log tells more"
_REFUSALS: Final[tuple[tuple[str, str, str], ...]] = (
    (
        "unsupported protocol version",
        'the broker does not speak MQTT 5: set [mqtt] protocol = "3.1.1"',
        'the broker does not speak MQTT 3.1.1: set [mqtt] protocol = "5"',
    ),
    (
        "closed the connection at connect",
        f'if the broker does not speak MQTT 5, set [mqtt] protocol = "3.1.1"; {_CHECK_TLS}',
        _CHECK_TLS,
    ),
    (
        "client identifier not valid",
        "the broker rejects the client id",
        "the broker rejects the client id, or keepalive_s = {keepalive}: try a smaller one",
    ),
)
"""Parts of errors, and what they mean with MQTT 5 and with MQTT 3.1.1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Validity:
    """The validity period of a certificate."""

    begin: datetime
    end: datetime

    def problem(self, now: datetime) -> str:
        """Why the certificate is not valid at that time; "" if it is valid."""
        if now > self.end:
            return f"expired on {self.end:%Y-%m-%d %H:%M} UTC: renew it"
        if now < self.begin:
            return f"is not valid before {_shown(self.begin)}: set the clock of this computer, which says {_shown(now)}"
        return ""


def certificate_validity(path: Path) -> Validity:
    """The validity of the first certificate in a PEM file.

    Raises:
        UsageError: the file cannot be read or contains no certificate.
    """
    try:
        return _validity(_first_certificate(path.read_text(encoding="ascii")))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, IndexError, binascii.Error) as error:
        raise UsageError(f"{path}: contains no certificate ({error})") from error


def check_dates(settings: MqttSection) -> None:
    """Check the validity of the client certificate, because brokers rarely say why they reject it.

    Raises:
        UsageError: the certificate is not valid now; the text names file and date.
    """
    if settings.cert_file is not None:
        problem = certificate_validity(settings.cert_file).problem(datetime.now(UTC))
        if problem:
            raise UsageError(f"mqtt.cert_file {settings.cert_file}: {problem}")


def explained(text: str, settings: MqttSection) -> str:
    """The error text of a failed connection, preceded by an explanation if one is known."""
    low = text.lower()
    for part, meaning in _MEANINGS:
        if part in low:
            where = {"host": settings.host, "port": settings.port, "ca": settings.ca_file, "cert": settings.cert_file}
            where["clock"] = _shown(datetime.now(UTC))
            return f"{meaning.format(**where)} ({text})"
    five = settings.protocol == "5"
    for part, for_five, for_older in _REFUSALS:
        if part in low:
            return f"{text}: {(for_five if five else for_older).format(keepalive=settings.keepalive_s)}"
    return text


def _shown(moment: datetime) -> str:
    return f"{moment:%Y-%m-%d %H:%M} UTC"


def _first_certificate(pem: str) -> bytes:
    found = _PEM.search(pem)
    if found is None:
        raise ValueError("no PEM block found")
    return ssl.PEM_cert_to_DER_cert(found.group())


def _validity(der: bytes) -> Validity:
    """Parse X.509: Certificate { TBSCertificate { [0] version, serial, algorithm, issuer, Validity { …, … } } }."""
    whole, _ = _element(der, _SEQUENCE)
    rest, _ = _element(whole, _SEQUENCE)
    if rest[0] == _VERSION:
        _, rest = _element(rest)
    for _ in range(3):
        _, rest = _element(rest)
    dates, _ = _element(rest, _SEQUENCE)
    begin, after = _element(dates)
    end, _ = _element(after)
    return Validity(begin=_time(dates[0], begin), end=_time(after[0], end))


def _element(data: bytes, kind: int | None = None) -> tuple[bytes, bytes]:
    """The content of the first DER element, and the data after it."""
    if kind is not None and data[0] != kind:
        raise ValueError(f"found element {data[0]:#x} instead of {kind:#x}")
    length, start = data[1], 2
    if length & 0x80:
        start += length & 0x7F
        length = int.from_bytes(data[2:start], "big")
    if len(data) < start + length:
        raise ValueError("the data is truncated")
    return data[start : start + length], data[start + length :]


def _time(kind: int, text: bytes) -> datetime:
    if kind not in (_UTC_TIME, _GENERALIZED_TIME):
        raise ValueError(f"found element {kind:#x} instead of a time")
    digits = text.decode("ascii")
    if kind == _UTC_TIME:  # two digits of the year: 1950 to 2049
        digits = ("19" if digits[:2] >= "50" else "20") + digits
    return datetime.strptime(digits, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC)
