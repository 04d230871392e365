"""Integrity check of SQLite's write-ahead log (`…-wal`) that a killed process left.

SQLite reads the log up to the first frame with a wrong checksum and silently discards the rest. That is correct for a
transaction that a power cut interrupted, because it was not reported as committed. But a log that is damaged before its
end contains later transactions that were committed; without them a half-finished mission would look like a new one.
Of the last transaction nobody can say whether a write was interrupted or a written one was damaged later: that is told.
Layout: https://www.sqlite.org/fileformat2.html, section 4.1 and 4.2.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_HEADER: Final = 32
_FRAME: Final = 24
_MAGIC: Final = (0x377F0682, 0x377F0683)
_SECTOR: Final = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class LogState:
    """The damage in a write-ahead log.

    Attributes:
        lost: damage that hides later committed transactions; "" if there is none.
        torn: the last transaction is incomplete, interrupted or damaged later; "" if it is complete.
    """

    lost: str = ""
    torn: str = ""


def examine_log(log: Path) -> LogState:
    """Examine a write-ahead log; a missing or empty one is whole.

    Raises:
        OSError: the log cannot be read.
    """
    data = log.read_bytes() if log.exists() else b""
    if len(data) < _HEADER + _FRAME:
        return LogState()
    magic, _, page_size = struct.unpack_from(">3I", data)
    order = ">" if magic & 1 else "<"
    sums = _checksum(data[: _HEADER - 8], (0, 0), order)
    good = magic in _MAGIC and sums == struct.unpack_from(">2I", data, _HEADER - 8)
    if not good:
        page_size = _SECTOR  # of every panoexec file
    salts = data[16:24] if good else data[_HEADER + 8 : _HEADER + 16]
    broken = 0 if good else 1  # number of the first frame that SQLite would not read
    commits_lost = damaged = 0
    for number, at in enumerate(range(_HEADER, len(data) - _FRAME, _FRAME + page_size), start=1):
        page = data[at + _FRAME : at + _FRAME + page_size]
        ours = data[at + 8 : at + 16] == salts
        # a frame of an earlier log in the same file differs in both salts; a damaged one of this log in one at most
        kin = data[at + 8 : at + 12] == salts[:4] or data[at + 12 : at + 16] == salts[4:]
        whole = len(page) == page_size
        if not broken:
            if not ours or not whole:
                broken, damaged = number, damaged + kin
                continue
            sums = _checksum(page, _checksum(data[at : at + 8], sums, order), order)
            if sums != struct.unpack_from(">2I", data, at + 16):
                broken = number
        if broken and kin:
            damaged += 1
            commits_lost += ours and whole and data[at + 4 : at + 8] != b"\0\0\0\0"
    where = f"frame {broken}" if good else "the header"
    # the last transaction may be incomplete; each earlier one was on disk before the next one began
    if commits_lost >= 2:
        return LogState(lost=f"{where} of {log.name}, with {commits_lost} transactions after it")
    if damaged:
        return LogState(torn=f"{where} of {log.name}: the last write was interrupted, or was damaged since")
    return LogState()


def _checksum(data: bytes, sums: tuple[int, int], order: str) -> tuple[int, int]:
    """SQLite's checksum over pairs of words, continued from `sums`."""
    first, second = sums
    words = iter(struct.unpack(f"{order}{len(data) // 4}I", data))
    for one, other in zip(words, words, strict=True):
        first = (first + one + second) & 0xFFFFFFFF
        second = (second + other + first) & 0xFFFFFFFF
    return first, second
