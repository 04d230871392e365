"""Opens MAVSDK connections, with a reason if that fails. Blocking: call it in a worker thread."""

from __future__ import annotations

import errno
import os
import socket
from pathlib import Path
from typing import Any

from mavsdk import Mavsdk, MavsdkError

from panoexec.adapters.link.connection_url import ConnectionUrl
from panoexec.errors import LinkError

_STOP_THE_DAEMON = "if the daemon uses it: systemctl stop panoexec, run panoexec doctor, systemctl start panoexec"


def open_connection(mavsdk: Mavsdk, url: ConnectionUrl) -> Any:
    """Add a connection and return its handle.

    Raises:
        LinkError: the message names the port or device and the reason.
    """
    target = url
    if url.listens:
        target = listening(url)
    elif url.kind == "serial":
        _check_device(Path(url.path))
    try:
        return mavsdk.add_any_connection_with_handle(target.mavsdk)
    except MavsdkError as error:
        raise LinkError(f"cannot open {url}: {_reason(str(error))}") from error


def close_connection(mavsdk: Mavsdk, handle: Any) -> None:
    """Remove a connection."""
    mavsdk.remove_connection(handle)


def listening(url: ConnectionUrl) -> ConnectionUrl:
    """The URL with a resolved interface, after a check that the port is free.

    MAVSDK sets SO_REUSEADDR, with which Linux lets two programs bind one UDP port and delivers the packets to the later
    one: a second daemon would silently take over the first one's packets. A bind without the option fails instead.

    Raises:
        LinkError: it is in use, or there is no such interface.
    """
    udp = url.kind == "udpin"
    protocol = "UDP" if udp else "TCP"
    try:
        host = socket.gethostbyname(url.host)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if udp else socket.SOCK_STREAM) as probe:
            if not udp:  # connections that just ended do not count as in use
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, url.port))
    except socket.gaierror as error:
        raise LinkError(f"cannot open {url}: host {url.host!r} cannot be resolved ({error.strerror})") from error
    except OSError as error:
        reason = {
            errno.EADDRINUSE: f"{protocol} port {url.port} is in use by another program; stop it or use another port",
            errno.EADDRNOTAVAIL: f"{url.host} is not an address of this machine; 0.0.0.0 listens on all interfaces",
            errno.EACCES: f"{protocol} port {url.port} needs privileges; use one above 1023",
        }.get(error.errno or 0, error.strerror or str(error))
        advice = _STOP_THE_DAEMON if error.errno == errno.EADDRINUSE else ""
        raise LinkError(f"cannot open {url}: {reason}", advice=advice) from error
    return ConnectionUrl(kind=url.kind, host=host, port=url.port)


def _check_device(path: Path) -> None:
    if not path.exists():
        raise LinkError(f"cannot open {path}: no such device; is it plugged in?")
    if not os.access(path, os.R_OK | os.W_OK):
        raise LinkError(f"cannot open {path}: no permission; add this user to the group {path.group()}")


def _reason(text: str) -> str:
    name = text.rpartition(": ")[2]
    return {
        "BIND_ERROR": "the port is in use by another program",
        "SOCKET_CONNECTION_ERROR": "the connection was refused",
        "CONNECTION_ERROR": "the device does not answer as a serial port",
        "DESTINATION_IP_UNKNOWN": "the host cannot be resolved",
        "BAUDRATE_UNKNOWN": "the baud rate is not supported",
        "CONNECTION_URL_INVALID": "MAVSDK does not accept this URL",
    }.get(name, name.lower().replace("_", " "))
