"""Drops unneeded datagrams of an idle daemon in the kernel, with a socket filter.

A gimbal that is its own component reports 50 times a second, asked or not. Each report that reaches MAVSDK is parsed
and put into JSON there, whoever listens: 0.15 ms, together more than all else that a daemon does while it waits. Asking
the gimbal for less would take the reports from everybody else on the vehicle too. So the socket that MAVSDK listens on
gets a classic BPF filter (socket(7), SO_ATTACH_FILTER), which others do not notice, and loses it again.

Measured (`python -m tests.bench savings`): a waiting daemon takes 0.53 to 0.69 % of a core with the filter and 0.99 to
1.15 % without it, a ratio of 1.7 to 1.9. The budget is 1 % (docs/mission.md).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import stat
import struct
import sys
from pathlib import Path
from typing import Final

from panoexec.adapters.link.connection_url import ConnectionUrl

_SO_ATTACH_FILTER: Final = 26
_SO_DETACH_FILTER: Final = 27
_UDP_HEADER: Final = 8
_MAGIC: Final = 0xFD
_FRAME: Final = 12
"""A MAVLink 2 frame without payload and signature: ten bytes of header, two of checksum."""

# linux/bpf_common.h: load a byte, half a word, the length; add, copy to X, jump if not less, if equal, if X; return
_LDB, _LDH, _LEN, _ADD, _TAX, _JGE, _JEQ, _JEQ_X, _RET = 0x30, 0x28, 0x80, 0x04, 0x07, 0x35, 0x15, 0x1D, 0x06


def filter_program(message_id: int) -> bytes:
    """A filter that drops datagrams that consist of one unsigned MAVLink 2 frame of this message.

    The filter of a UDP socket gets the UDP header first.
    """
    low, middle, high = message_id.to_bytes(3, "little")
    at = _UDP_HEADER
    keep = 14
    program = [
        (_LEN, 0, 0, 0),  # a load beyond the end would drop the datagram
        (_JGE, 0, keep - 2, _FRAME + _UDP_HEADER),
        (_LDB, 0, 0, at),
        (_JEQ, 0, keep - 4, _MAGIC),
        (_LDH, 0, 0, at + 7),
        (_JEQ, 0, keep - 6, low << 8 | middle),
        (_LDB, 0, 0, at + 9),
        (_JEQ, 0, keep - 8, high),
        (_LDB, 0, 0, at + 1),
        (_ADD, 0, 0, _FRAME + _UDP_HEADER),
        (_TAX, 0, 0, 0),
        (_LEN, 0, 0, 0),
        (_JEQ_X, 0, 1, 0),
        (_RET, 0, 0, 0),
        (_RET, 0, 0, 0xFFFFFFFF),
    ]
    return b"".join(struct.pack("HBBI", *instruction) for instruction in program)


class DatagramFilter:
    """Filters one message on this process's socket that listens on a URL's port; does nothing for other URLs.

    Args:
        url: where MAVSDK listens.
        message_id: the message to drop.
    """

    def __init__(self, url: ConnectionUrl, message_id: int) -> None:
        self._port = url.port if url.kind == "udpin" and sys.platform == "linux" else None
        self._program = filter_program(message_id)
        self._found: tuple[int, int] | None = None

    def mute(self) -> None:
        """Attach the filter."""
        code = ctypes.create_string_buffer(self._program)
        program = struct.pack("HP", len(self._program) // 8, ctypes.addressof(code))
        self._set(_SO_ATTACH_FILTER, program)

    def unmute(self) -> None:
        """Detach the filter."""
        self._set(_SO_DETACH_FILTER, struct.pack("i", 0))

    def _set(self, option: int, value: bytes) -> None:
        """Set the option on MAVSDK's socket, if there is one at present."""
        if self._port is None:
            return
        if self._found is None or not _is(self._found):
            self._found = _listening_on(self._port)
        if self._found is None:
            return
        descriptor, inode = self._found
        with contextlib.suppress(OSError):  # closed meanwhile, or no filter to detach
            copy = os.dup(descriptor)
            try:
                if os.fstat(copy).st_ino == inode:
                    _setsockopt(copy, option, value)
            finally:
                os.close(copy)


def _setsockopt(descriptor: int, option: int, value: bytes) -> None:
    same = socket.socket(fileno=descriptor)
    try:
        same.setsockopt(socket.SOL_SOCKET, option, value)
    finally:
        same.detach()


def _is(found: tuple[int, int]) -> bool:
    try:
        return os.fstat(found[0]).st_ino == found[1]
    except OSError:
        return False


def _listening_on(port: int) -> tuple[int, int] | None:
    """Descriptor and inode of this process's UDP socket with that local port."""
    for entry in Path("/proc/self/fd").iterdir():
        descriptor = int(entry.name)
        with contextlib.suppress(OSError):
            status = os.fstat(descriptor)
            if not stat.S_ISSOCK(status.st_mode):
                continue
            same = socket.socket(fileno=os.dup(descriptor))
            with same:
                internet = same.family in (socket.AF_INET, socket.AF_INET6) and same.type == socket.SOCK_DGRAM
                if internet and same.getsockname()[1] == port:
                    return descriptor, status.st_ino
    return None
