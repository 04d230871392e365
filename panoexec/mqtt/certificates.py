"""When certificates are valid, and what the errors of a connection and its TLS handshake mean to whoever set it up."""

from __future__ import annotations

import binascii
import re
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from panoexec.errors import UsageError
from panoexec.inputs.config import MqttSection

_PEM: Final = re.compile(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", re.DOTALL)
_SEQUENCE: Final = 0x30
_VERSION: Final = 0xA0
_UTC_TIME: Final = 0x17
_GENERALIZED_TIME: Final = 0x18

_MEANINGS: Final[tuple[tuple[str, str], ...]] = (
    (
        "certificate has expired",
        "the broker's certificate has expired: renew it there, and look at this machine's clock",
    ),
    ("certificate is not yet valid", "the broker's certificate is not valid yet: look at this machine's clock"),
    ("unable to get local issuer", "the broker's certificate is not signed by mqtt.ca_file {ca}"),
    ("self-signed certificate", "the broker's certificate is not signed by mqtt.ca_file {ca}"),
    ("self signed certificate", "the broker's certificate is not signed by mqtt.ca_file {ca}"),
    ("signature failure", "the broker's certificate is not signed by mqtt.ca_file {ca}"),
    (
        "connection refused",
        "nothing listens on {host}, port {port}: does the broker run, is that its port?",
    ),
    ("no route to host", "{host} cannot be reached: is it on, is this machine on its network?"),
    ("network is unreachable", "{host} cannot be reached: is this machine on a network?"),
    ("name or service not known", "{host} is a name that nobody knows: look at its spelling and at the DNS"),
    ("no address associated", "{host} is a name that nobody knows: look at its spelling and at the DNS"),
    (
        "failure in name resolution",
        "the name {host} cannot be looked up: no network or no DNS; or give its address",
    ),
    ("timed out", "{host}, port {port} does not answer: is that the broker, does a firewall drop us?"),
    ("mismatch", "the broker's certificate is for another name than mqtt.host {host}"),
    ("wrong_version_number", "there is no TLS on mqtt.port {port}: leave out ca_file, or take the broker's TLS port"),
    ("packet_length_too_long", "there is no TLS on mqtt.port {port}: leave out ca_file, or take the broker's TLS port"),
    ("alert_certificate_expired", "the broker says that our certificate mqtt.cert_file {cert} has expired"),
    ("alert certificate expired", "the broker says that our certificate mqtt.cert_file {cert} has expired"),
    ("alert_unknown_ca", "the broker does not know the signer of our certificate mqtt.cert_file {cert}"),
    ("alert unknown ca", "the broker does not know the signer of our certificate mqtt.cert_file {cert}"),
    ("certificate_required", "the broker asks for a client certificate: give mqtt.cert_file and key_file"),
    ("certificate required", "the broker asks for a client certificate: give mqtt.cert_file and key_file"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Validity:
    """From when and until when a certificate is valid."""

    begin: datetime
    end: datetime

    def problem(self, now: datetime) -> str:
        """What is wrong with it at that moment; "" if nothing is."""
        if now > self.end:
            return f"expired on {self.end:%Y-%m-%d %H:%M} UTC: renew it"
        if now < self.begin:
            return f"is not valid before {self.begin:%Y-%m-%d %H:%M} UTC: is this machine's clock right?"
        return ""


def certificate_validity(path: Path) -> Validity:
    """The validity of the first certificate in a PEM file.

    Raises:
        UsageError: it cannot be read, or holds no certificate.
    """
    try:
        return _validity(_first_certificate(path.read_text(encoding="ascii")))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, IndexError, binascii.Error) as error:
        raise UsageError(f"{path}: holds no certificate ({error})") from error


def check_dates(settings: MqttSection) -> None:
    """Refuse a client certificate whose time is over: a broker that refuses it seldom says why.

    Raises:
        UsageError: naming file and date.
    """
    if settings.cert_file is not None:
        problem = certificate_validity(settings.cert_file).problem(datetime.now(UTC))
        if problem:
            raise UsageError(f"mqtt.cert_file {settings.cert_file}: {problem}")


def explained(text: str, settings: MqttSection) -> str:
    """The text of a failed connection, preceded by its meaning if that is known."""
    low = text.lower()
    for part, meaning in _MEANINGS:
        if part in low:
            where = {"host": settings.host, "port": settings.port, "ca": settings.ca_file, "cert": settings.cert_file}
            return f"{meaning.format(**where)} ({text})"
    return text


def _first_certificate(pem: str) -> bytes:
    found = _PEM.search(pem)
    if found is None:
        raise ValueError("there is none in it")
    return ssl.PEM_cert_to_DER_cert(found.group())


def _validity(der: bytes) -> Validity:
    """Of X.509: Certificate { TBSCertificate { [0] version, serial, algorithm, issuer, Validity { …, … } } }."""
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
    """The content of the first DER element, and what comes after it."""
    if kind is not None and data[0] != kind:
        raise ValueError(f"found element {data[0]:#x} instead of {kind:#x}")
    length, start = data[1], 2
    if length & 0x80:
        start += length & 0x7F
        length = int.from_bytes(data[2:start], "big")
    if len(data) < start + length:
        raise ValueError("it is cut off")
    return data[start : start + length], data[start + length :]


def _time(kind: int, text: bytes) -> datetime:
    if kind not in (_UTC_TIME, _GENERALIZED_TIME):
        raise ValueError(f"found element {kind:#x} instead of a time")
    digits = text.decode("ascii")
    if kind == _UTC_TIME:  # two digits of the year: 1950 to 2049
        digits = ("19" if digits[:2] >= "50" else "20") + digits
    return datetime.strptime(digits, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC)
