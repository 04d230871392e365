"""Which program of this computer uses the port or the device of a connection. Linux (/proc); reads, opens nothing."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
from pathlib import Path
from typing import Final

from panoexec.adapters.link.connection_url import ConnectionUrl
from panoexec.errors import LinkError

_PROC: Final = Path("/proc")


def occupant(url: ConnectionUrl, proc: Path = _PROC) -> str:
    """Who uses what the connection would open, other than this process; "" if nobody does, as far as can be seen.

    Args:
        url: a port to listen on, or a serial device; a connection to somewhere else occupies nothing.
        proc: where the kernel tells of processes.

    Returns:
        `UDP port 14540 is in use by process 812 (panoexec)`; without the process if that belongs to somebody else.
    """
    if url.listens:
        protocol = "UDP" if url.kind == "udpin" else "TCP"
        if not _is_bound(url):
            return ""
        return f"{protocol} port {url.port} is in use by {_process(_socket_inodes(url, proc), proc)}"
    if url.kind == "serial":
        device = os.path.realpath(url.path)
        holder = _process({device}, proc)
        return f"{url.path} is in use by {holder}" if holder != _UNKNOWN else ""
    return ""


_UNKNOWN: Final = "another program"


def _is_bound(url: ConnectionUrl) -> bool:
    udp = url.kind == "udpin"
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if udp else socket.SOCK_STREAM) as probe:
            if not udp:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((socket.gethostbyname(url.host), url.port))
    except socket.gaierror as error:
        raise LinkError(f"cannot open {url}: host {url.host!r} cannot be resolved ({error.strerror})") from error
    except OSError as error:
        return error.errno == errno.EADDRINUSE
    return False


def _socket_inodes(url: ConnectionUrl, proc: Path) -> set[str]:
    """What /proc/PID/fd calls the sockets that are bound to the port: `socket:[12345]`."""
    found: set[str] = set()
    for table in ("udp", "udp6") if url.kind == "udpin" else ("tcp", "tcp6"):
        with contextlib.suppress(OSError):
            for line in (proc / "net" / table).read_text().splitlines()[1:]:
                columns = line.split()
                if int(columns[1].rpartition(":")[2], 16) == url.port:
                    found.add(f"socket:[{columns[9]}]")
    return found


def _process(targets: set[str], proc: Path) -> str:
    """The process that has one of these open."""
    for folder in proc.glob("[0-9]*"):
        if folder.name == str(os.getpid()):
            continue
        with contextlib.suppress(OSError):
            for entry in (folder / "fd").iterdir():
                with contextlib.suppress(OSError):
                    if str(entry.readlink()) in targets:
                        return f"process {folder.name} ({(folder / 'comm').read_text().strip()})"
    return _UNKNOWN
