"""Rows of a journal, read from the pages of its files without SQLite, whose pointers may be damaged.

Every page of the file and of its write-ahead log is taken for a leaf of a table, and every cell in it for a row; what
is none is passed over. Rows of old states of a page are found too: seals tell what is true, not the place where it was
found. Layout: https://www.sqlite.org/fileformat2.html, sections 1.6, 2.1 and 4.1.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeAlias

from panoexec.store import journal_layout as layout

PAGE: Final = 4096
"""Bytes of a page of every journal."""
_LOG_HEADER: Final = 32
_FRAME_HEADER: Final = 24
_LARGEST: Final = 16 * 2**20
_ZEROS: Final = 4

Value: TypeAlias = bytes | int | float | None
_WHOLE: Final = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
"""Bytes of an integer by its serial type."""


@dataclass(slots=True)
class Fragments:
    """Rows of a journal, whether their seals hold or not.

    Attributes:
        head: key, value and seal.
        rows: events.
        tails: number of events and seal of the last one.
    """

    head: list[tuple[str, str, bytes]] = field(default_factory=list)
    rows: list[layout.Row] = field(default_factory=list)
    tails: list[tuple[int, bytes]] = field(default_factory=list)

    def merge(self, other: Fragments) -> None:
        """Add what was found in another way."""
        self.head += other.head
        self.rows += other.rows
        self.tails += other.tails

    def add(self, seq: Value, kind: Value, time_utc_s: Value, text: Value, seal: Value) -> None:
        """Add an event unless it cannot be one."""
        match seq, kind, time_utc_s, text, seal:
            case int(), bytes(), int() | float(), bytes(), bytes():
                with contextlib.suppress(UnicodeDecodeError):
                    self.rows.append(layout.Row(seq, kind.decode(), float(time_utc_s), text.decode(), seal))

    def chain(self, start: bytes) -> list[layout.Row]:
        """The events from the first on whose seals hold."""
        by_number: dict[int, list[layout.Row]] = {}
        for row in self.rows:
            by_number.setdefault(row.seq, []).append(row)
        found: list[layout.Row] = []
        previous = start
        while True:
            seq = len(found) + 1
            true = next(
                (
                    row
                    for row in by_number.get(seq, ())
                    if row.seal == layout.event_seal(previous, seq, row.type, row.time_utc_s, row.json)
                ),
                None,
            )
            if true is None:
                return found
            found.append(true)
            previous = true.seal


def scan(path: Path) -> Fragments:
    """All rows in the pages of a journal and of its write-ahead log.

    Raises:
        OSError: a file cannot be read.
    """
    found = Fragments()
    data = path.read_bytes()
    beside = path.with_name(path.name + "-wal")
    log = beside.read_bytes() if beside.exists() else b""
    pages = {number: data[at : at + PAGE] for number, at in enumerate(range(0, len(data), PAGE), start=1)}
    leaves = list(pages.values())
    for at in range(_LOG_HEADER, len(log) - _FRAME_HEADER, _FRAME_HEADER + PAGE):
        page = log[at + _FRAME_HEADER : at + _FRAME_HEADER + PAGE]
        leaves.append(page)
        pages[int.from_bytes(log[at : at + 4])] = page
    for leaf in leaves:
        for rowid, values in _cells(leaf, pages):
            _sort_in(found, rowid, values)
    return found


def _sort_in(found: Fragments, rowid: int, values: list[Value]) -> None:
    match values:
        case [None, kind, time_utc_s, text, seal]:
            found.add(rowid, kind, time_utc_s, text, seal)
        case [bytes() as key, bytes() as value, bytes() as seal]:
            with contextlib.suppress(UnicodeDecodeError):
                found.head.append((key.decode(), value.decode(), seal))
        case [None, int() as number, bytes() as end, bytes()] if rowid == 1:
            found.tails.append((number, end))


def _cells(page: bytes, pages: dict[int, bytes]) -> Iterator[tuple[int, list[Value]]]:
    """Row id and values of each cell of a leaf."""
    if len(page) < PAGE:
        return
    start = 100 if page[:15] == b"SQLite format 3" else 0
    # a damaged kind of page, number of cells or pointer must not hide cells: what follows the pointers are zeros
    zeros = 0
    for at in range(start + 8, PAGE - 1, 2):
        pointer = int.from_bytes(page[at : at + 2])
        zeros = zeros + 1 if pointer == 0 else 0
        if zeros > _ZEROS:
            return
        if not at + 2 < pointer < PAGE - 4:
            continue
        try:
            yield _cell(page, pointer, pages)
        except (IndexError, ValueError, struct.error):
            continue


def _cell(page: bytes, at: int, pages: dict[int, bytes]) -> tuple[int, list[Value]]:
    size, at = _varint(page, at)
    rowid, at = _varint(page, at)
    if not 2 <= size <= _LARGEST:
        raise ValueError(size)
    return rowid, _record(_payload(page, at, size, pages))


def _payload(page: bytes, at: int, size: int, pages: dict[int, bytes]) -> bytes:
    """The payload of a cell, with its overflow pages."""
    most = PAGE - 35
    if size <= most:
        return page[at : at + size]
    least = (PAGE - 12) * 32 // 255 - 23
    local = least + (size - least) % (PAGE - 4)
    local = local if local <= most else least
    parts, left = [page[at : at + local]], size - local
    following = int.from_bytes(page[at + local : at + local + 4])
    while left > 0 and following in pages:
        overflow = pages[following]
        parts.append(overflow[4 : 4 + left])
        left -= len(parts[-1])
        following = int.from_bytes(overflow[:4])
        if not parts[-1]:
            break
    return b"".join(parts)


def _record(payload: bytes) -> list[Value]:
    """The values of a record."""
    length, at = _varint(payload, 0)
    if not 0 < length <= len(payload) or length > PAGE:
        raise ValueError(length)
    kinds, body = [], length
    while at < length:
        kind, at = _varint(payload, at)
        kinds.append(kind)
    values: list[Value] = []
    for kind in kinds:
        size = _WHOLE.get(kind, 0) if kind < 12 else (kind - 12) // 2
        size = 8 if kind == 7 else size
        data = payload[body : body + size]
        if len(data) != size:
            raise ValueError(size)
        body += size
        values.append(_value(kind, data))
    return values


def _value(kind: int, data: bytes) -> Value:
    if kind >= 12:
        return data
    if kind in _WHOLE:
        return int.from_bytes(data, signed=True)
    if kind == 7:
        return float(struct.unpack(">d", data)[0])
    return {8: 0, 9: 1}.get(kind)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for count in range(9):
        byte = data[at + count]
        if count == 8:
            return (value << 8) | byte, at + 9
        value = (value << 7) | (byte & 0x7F)
        if not byte & 0x80:
            return value, at + count + 1
    raise ValueError("not a varint")
