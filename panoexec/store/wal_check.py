"""Integrity check of SQLite's write-ahead log (journal.sqlite-wal) that a killed process left.

SQLite reads the log up to the first frame with a wrong checksum and silently discards the rest. That is correct for a
transaction that a power cut interrupted, because it was not reported as committed. But a log that is damaged before its
end contains later transactions that were committed; without them a half-finished mission would look like a new one.
Layout: https://www.sqlite.org/fileformat2.html, section 4.1 and 4.2.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

_HEADER: Final = 32
_FRAME: Final = 24
_MAGIC: Final = (0x377F0682, 0x377F0683)


def lost_tail(log: Path) -> str:
    """The damage in a write-ahead log that hides later committed transactions; "" if there is none.

    Raises:
        OSError: the log cannot be read.
    """
    data = log.read_bytes() if log.exists() else b""
    if len(data) < _HEADER + _FRAME:
        return ""
    magic, _, page_size = struct.unpack_from(">3I", data)
    order = ">" if magic & 1 else "<"
    sums = _checksum(data[: _HEADER - 8], (0, 0), order)
    good = magic in _MAGIC and sums == struct.unpack_from(">2I", data, _HEADER - 8)
    if not good:
        page_size = 4096  # of every panoexec journal
    salts = data[16:24] if good else data[_HEADER + 8 : _HEADER + 16]
    broken = 0 if good else 1  # number of the first frame that SQLite would not read
    commits_lost = 0
    for number, at in enumerate(range(_HEADER, len(data) - _FRAME - page_size + 1, _FRAME + page_size), start=1):
        page = data[at + _FRAME : at + _FRAME + page_size]
        if not broken:
            if data[at + 8 : at + 16] != salts:  # a frame of an earlier log in the same file
                broken = number
                continue
            sums = _checksum(page, _checksum(data[at : at + 8], sums, order), order)
            if sums != struct.unpack_from(">2I", data, at + 16):
                broken = number
        if broken and data[at + 8 : at + 16] == salts:
            commits_lost += data[at + 4 : at + 8] != b"\0\0\0\0"
    # the last transaction may be incomplete; each earlier one was on disk before the next one began
    if commits_lost < 2:
        return ""
    where = f"frame {broken}" if good else "the header"
    return f"{where} of {log.name}, with {commits_lost} transactions after it"


def _checksum(data: bytes, sums: tuple[int, int], order: str) -> tuple[int, int]:
    """SQLite's checksum over pairs of words, continued from `sums`."""
    first, second = sums
    words = iter(struct.unpack(f"{order}{len(data) // 4}I", data))
    for one, other in zip(words, words, strict=True):
        first = (first + one + second) & 0xFFFFFFFF
        second = (second + other + first) & 0xFFFFFFFF
    return first, second
