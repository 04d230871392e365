"""systemd's journal by its native protocol: a sentence in MESSAGE, what belongs to it in fields of its own.

The protocol: one datagram to `/run/systemd/journal/socket` per entry, `NAME=value` a line; a value with line breaks as
its name, a line break, its length (64 bit, little-endian) and the value
(systemd.io/JOURNAL_NATIVE_PROTOCOL). `systemctl status` shows the sentences, `journalctl -o verbose` the fields.
"""

from __future__ import annotations

import os
import re
import socket
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Final, TextIO

SOCKET = "/run/systemd/journal/socket"
_MOST_BYTES: Final = 48 * 1024
"""Of one value: the kernel takes datagrams of 200 kB at least, and longer values are of no use to readers."""
_PRIORITIES: Final[Mapping[str, int]] = {"critical": 2, "error": 3, "warning": 4, "info": 6, "debug": 7}
_REASONS: Final = ("error", "reason", "text", "problem", "trouble", "note")
"""What follows the event in the sentence, after a colon."""
_HIDDEN: Final = frozenset({"event", "level", "logger", "timestamp", "exception"})
_TOLD: Final = frozenset({"level", "timestamp"})
"""What the journal knows by itself, or by PRIORITY."""


def is_journal(stream: TextIO) -> bool:
    """Whether a stream goes to the journal, as the standard error of a unit does ($JOURNAL_STREAM, systemd.exec(5))."""
    try:
        there = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{there.st_dev}:{there.st_ino}" and Path(SOCKET).is_socket()


def sentence(entry: Mapping[str, object]) -> str:
    """An entry in words: `request failed: no mission is under way (command pause, code refused)`."""
    reason = next((name for name in _REASONS if entry.get(name)), "")
    why = str(entry[reason]) if reason else str(entry.get("exception", "")).strip().rpartition("\n")[2]
    text = str(entry.get("event", "")).replace("_", " ") + (f": {why}" if why else "")
    beside = [
        f"{name.replace('_', ' ')} {_short(value)}"
        for name, value in entry.items()
        if name not in _HIDDEN and name != reason and value is not None and value != ""
    ]
    return f"{text} ({', '.join(beside)})" if beside else text


class Journal:
    """Sends entries to the journal.

    Args:
        path: of the journal's socket.
    """

    def __init__(self, path: str = "") -> None:
        self._path = path or SOCKET
        self._socket: socket.socket | None = None

    def send(self, entry: Mapping[str, object]) -> bool:
        """Send an entry of structlog; False if the journal does not take it at once. Never waits, never raises."""
        fields: dict[str, object] = {
            "MESSAGE": sentence(entry),
            "PRIORITY": _PRIORITIES.get(str(entry.get("level")), 6),
            "SYSLOG_IDENTIFIER": "panoexec",
        }
        # journald keeps names like UNIT and MESSAGE_ID for itself
        fields |= {f"PANO_{name}": value for name, value in entry.items() if name not in _TOLD}
        datagram = b"".join(_field(name, value) for name, value in fields.items() if value is not None and value != "")
        try:
            if self._socket is None:
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
                self._socket.setblocking(False)
            self._socket.sendto(datagram, self._path)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the socket; the next entry opens it again."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _field(name: str, value: object) -> bytes:
    """One field; a name has at most 64 of A to Z, 0 to 9 and _."""
    key = re.sub(r"[^A-Z0-9_]", "_", name.upper())[:64]
    data = str(value).encode(errors="replace")[:_MOST_BYTES]
    if b"\n" in data:
        return key.encode() + b"\n" + struct.pack("<Q", len(data)) + data + b"\n"
    return key.encode() + b"=" + data + b"\n"


def _short(value: object) -> str:
    text = {True: "yes", False: "no"}[value] if isinstance(value, bool) else " ".join(str(value).split())
    return text if len(text) <= 80 else text[:79] + "…"
