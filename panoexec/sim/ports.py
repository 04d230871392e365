"""Ports for programs that are started in a moment, below those that the kernel hands out by itself.

A port that is free now may be taken before its program binds it: every socket that connects or sends without a port of
its own gets one from `ip_local_port_range`. A client that tries again and again to reach a port of that range at which
nobody listens may even be connected to itself. The kernel never hands out the ports below.
"""

from __future__ import annotations

import errno
import random
import socket
from pathlib import Path
from typing import Final

_LEAST: Final = 20_000
"""Below are the usual ports of autopilots, ground stations and brokers."""
_RANGE: Final = Path("/proc/sys/net/ipv4/ip_local_port_range")
_USUAL_FIRST: Final = 32_768
_FEWEST: Final = 1000
_HOST: Final = "127.0.0.1"

_random = random.SystemRandom()
_given: set[tuple[socket.SocketKind, int]] = set()


def free_udp_ports(count: int) -> list[int]:
    """Different UDP ports that are currently unused; this process gets none of them twice."""
    return [_free(socket.SOCK_DGRAM) for _ in range(count)]


def free_udp_port() -> int:
    """One of them."""
    return _free(socket.SOCK_DGRAM)


def free_tcp_port() -> int:
    """The same for TCP."""
    return _free(socket.SOCK_STREAM)


def _free(kind: socket.SocketKind) -> int:
    first = _first_of_the_kernel()
    while True:
        # a kernel that hands out nearly all ports chooses itself
        wanted = _random.randrange(_LEAST, first) if first - _LEAST >= _FEWEST else 0
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind((_HOST, wanted))
            except OSError as error:
                if error.errno == errno.EADDRINUSE:
                    continue
                raise
            port = int(probe.getsockname()[1])
            if (kind, port) not in _given:
                _given.add((kind, port))
                return port


def _first_of_the_kernel() -> int:
    """The first port that the kernel hands out by itself."""
    try:
        return int(_RANGE.read_text(encoding="ascii").split()[0])
    except (OSError, ValueError, IndexError):
        return _USUAL_FIRST
