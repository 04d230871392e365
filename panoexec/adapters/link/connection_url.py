"""Connection strings in MAVSDK's form; MAVProxy's forms are converted, others are rejected with a reason."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from panoexec.errors import UsageError

Kind: TypeAlias = Literal["udpin", "udpout", "tcpin", "tcpout", "serial"]

DEFAULT_BAUD: Final = 115_200
"""MAVProxy's default for a device without a rate."""

ACCEPTED: Final = (
    "udpin://0.0.0.0:14540, udpout://HOST:PORT, tcpin://0.0.0.0:PORT, tcpout://HOST:PORT, "
    "serial:///dev/serial/by-id/DEVICE:BAUD, or MAVProxy's udp:HOST:PORT, tcp:HOST:PORT, /dev/DEVICE,BAUD"
)

_NETWORK: Final[dict[str, Kind]] = {"udpin": "udpin", "udpout": "udpout", "tcpin": "tcpin", "tcpout": "tcpout"}
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,252}[A-Za-z0-9])?")


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionUrl:
    """The address of an autopilot.

    Attributes:
        kind: what is opened; `…in` listens, `…out` connects.
        host: interface to listen on, or host to connect to; "" for serial.
        port: 1 to 65535; 0 for serial.
        path: the serial device; "" for the others.
        baud: bits a second; 0 for the others.
        flow_control: RTS/CTS on the serial line.
    """

    kind: Kind
    host: str = ""
    port: int = 0
    path: str = ""
    baud: int = 0
    flow_control: bool = False

    @property
    def listens(self) -> bool:
        """Whether a local port is bound."""
        return self.kind in ("udpin", "tcpin")

    @property
    def mavsdk(self) -> str:
        """The URL in MAVSDK's form."""
        if self.kind == "serial":
            scheme = "serial_flowcontrol" if self.flow_control else "serial"
            return f"{scheme}://{self.path}:{self.baud}"
        return f"{self.kind}://{self.host}:{self.port}"

    def __str__(self) -> str:
        return self.mavsdk


def parse_connection(text: str) -> ConnectionUrl:
    """Parse a connection string.

    Args:
        text: MAVSDK's form (`udpin://0.0.0.0:14540`), its older `udp://` and `tcp://`, or MAVProxy's
            (`udp:127.0.0.1:14550` listens, `udpout:`, `tcp:` connects, `tcpin:`, `/dev/ttyACM0,57600`).

    Raises:
        UsageError: the message names the string, the error and the accepted forms.
    """
    stripped = text.strip()
    try:
        if stripped.startswith("/"):
            return _mavproxy_device(stripped)
        scheme, separator, rest = stripped.partition("://")
        if separator:
            return _mavsdk_form(scheme.lower(), rest)
        scheme, separator, rest = stripped.partition(":")
        return _mavproxy_form(scheme.lower(), rest if separator else "")
    except ValueError as error:
        raise UsageError(f"connection {text!r}: {error}; accepted forms: {ACCEPTED}") from error


def _mavsdk_form(scheme: str, rest: str) -> ConnectionUrl:
    if scheme in ("serial", "serial_flowcontrol"):
        path, separator, baud = rest.rpartition(":")
        if not separator:
            raise ValueError("the baud rate is missing")
        return _serial(path, baud, flow_control=scheme == "serial_flowcontrol")
    if scheme not in (*_NETWORK, "udp", "tcp"):
        raise ValueError(f"unknown protocol {scheme!r}")
    host, port = _host_and_port(rest)
    if scheme in ("udp", "tcp"):  # MAVSDK's older form: without a host, or with 0.0.0.0, it listens
        kind: Kind = ("udpin" if scheme == "udp" else "tcpin") if host in ("", "0.0.0.0") else _outgoing(scheme)  # noqa: S104
        return _network(kind, host or "0.0.0.0", port)  # noqa: S104
    return _network(_NETWORK[scheme], host, port)


def _mavproxy_form(scheme: str, rest: str) -> ConnectionUrl:
    kinds: dict[str, Kind] = _NETWORK | {"udp": "udpin", "tcp": "tcpout"}
    if scheme not in kinds:
        raise ValueError(f"unknown protocol {scheme!r}")
    host, port = _host_and_port(rest)
    return _network(kinds[scheme], host, port)


def _mavproxy_device(text: str) -> ConnectionUrl:
    path, separator, baud = text.rpartition(",")
    return _serial(path, baud) if separator else _serial(text, str(DEFAULT_BAUD))


def _outgoing(scheme: str) -> Kind:
    return "udpout" if scheme == "udp" else "tcpout"


def _network(kind: Kind, host: str, port: int) -> ConnectionUrl:
    if not host:
        raise ValueError("the host is missing (0.0.0.0 listens on all interfaces)")
    if not _HOST.fullmatch(host):
        raise ValueError(f"{host!r} is not a host")
    if host == "0.0.0.0" and kind in ("udpout", "tcpout"):  # noqa: S104
        raise ValueError("0.0.0.0 is an address to listen on, not to connect to")
    return ConnectionUrl(kind=kind, host=host, port=port)


def _serial(path: str, baud: str, *, flow_control: bool = False) -> ConnectionUrl:
    if not path.startswith("/") or path.endswith("/"):
        raise ValueError(f"{path!r} is not the path of a serial device")
    if not (baud.isascii() and baud.isdigit() and 1200 <= int(baud) <= 4_000_000):
        raise ValueError(f"baud rate {baud!r} is not a number from 1200 to 4000000")
    return ConnectionUrl(kind="serial", path=path, baud=int(baud), flow_control=flow_control)


def _host_and_port(rest: str) -> tuple[str, int]:
    host, separator, port = rest.rpartition(":")
    if not separator:
        raise ValueError("the port is missing")
    if not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
        raise ValueError(f"port {port!r} is not a number from 1 to 65535")
    return host, int(port)
