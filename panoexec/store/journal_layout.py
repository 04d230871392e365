"""The tables of a journal, and how they are sealed and read.

Layout, version 2: `application_id` identifies a panoexec journal, `user_version` is the version of the layout.

* `head` (key, value, seal): constant data. The seal of a row covers key and value.
* `events` (seq, type, time_utc_s, json, seal): the seal of an event covers the event and the seal of the one before,
  so that a changed, missing, exchanged or inserted event is noticed at that event.
* `tail` (id, events, seal, head): one row: number and seal of the last event, and a seal over all rows of `head`; it is
  changed in the transaction of the events, and shows that the last events are missing.

All seals depend on the mission's id. Version 1 had no seals: it can be read, but its content is unchecked. When such a
journal is opened to continue its mission it is sealed as it is found, and `head` says up to which event.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from panoexec.durable.seals import seal
from panoexec.mission.log.events import Event, event_from_json

APPLICATION_ID: Final = 0x50414E4F
"""`PANO`."""
SCHEMA_VERSION: Final = 2
UNSEALED_VERSION: Final = 1
WRITTEN_BY: Final = "panoexec"
"""Key in `head` of the panoexec version that started the mission."""
MISSION_ID: Final = "mission_id"
"""Key in `head` of the mission's id."""
NUMBER: Final = "number"
"""Key in `head` of the mission's number in its storage; higher is later, whatever the clock said."""
SEALED_LATER: Final = "sealed_later"
"""Key in `head` of the number of events that an earlier version wrote without seals."""

SCHEMA: Final = """
CREATE TABLE head (key TEXT PRIMARY KEY, value TEXT NOT NULL, seal BLOB NOT NULL) STRICT;
CREATE TABLE events (
    seq INTEGER PRIMARY KEY, type TEXT NOT NULL, time_utc_s REAL NOT NULL, json TEXT NOT NULL, seal BLOB NOT NULL
) STRICT;
CREATE TABLE tail (
    id INTEGER PRIMARY KEY CHECK (id = 1), events INTEGER NOT NULL, seal BLOB NOT NULL, head BLOB NOT NULL
) STRICT;
"""


class BrokenSealError(ValueError):
    """Stored data differ from what was written."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of `events` as it is stored."""

    seq: int
    type: str
    time_utc_s: float
    json: str
    seal: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalContents:
    """A whole journal.

    Attributes:
        head: constant data.
        events: in order.
        end: the seal of the last event, or that of the mission's id without events.
        notes: what a reader should be told: content is unchecked, the last write was interrupted.
    """

    head: Mapping[str, str]
    events: Sequence[Event]
    end: bytes
    notes: tuple[str, ...] = ()


def genesis(mission_id: str) -> bytes:
    """What the first event is chained to, and what every row of `head` is sealed with."""
    return seal("panoexec.journal", mission_id)


def head_seal(start: bytes, key: str, value: str) -> bytes:
    """The seal of a row of `head`; `start` is the genesis."""
    return seal(start, key, value)


def whole_head_seal(start: bytes, seals: Mapping[str, bytes]) -> bytes:
    """The seal over all rows of `head`, given the seal of each key."""
    return seal(start, *(seals[key] for key in sorted(seals)))


def sealed(event: Event, previous: bytes) -> Row:
    """An event as it is stored after the one with the seal `previous`."""
    text = json.dumps(event.to_json(), separators=(",", ":"))
    time_utc_s = float(event.time_utc_s)
    return Row(event.seq, event.type, time_utc_s, text, event_seal(previous, event.seq, event.type, time_utc_s, text))


def event_seal(previous: bytes, seq: int, kind: str, time_utc_s: float, text: str) -> bytes:
    """The seal of an event after the one with the seal `previous`."""
    return seal(previous, seq, kind, time_utc_s, text)


def fill(connection: sqlite3.Connection, head: Mapping[str, str], rows: Sequence[Row] = ()) -> None:
    """Write the tables of a new journal into an empty database, in one transaction."""
    start = genesis(head.get(MISSION_ID, ""))
    seals = {key: head_seal(start, key, value) for key, value in head.items()}
    end = rows[-1].seal if rows else start
    connection.executescript(f"BEGIN; {SCHEMA} COMMIT;")
    with connection:
        connection.executemany("INSERT INTO head VALUES (?, ?, ?)", [(k, v, seals[k]) for k, v in head.items()])
        insert(connection, rows)
        connection.execute("INSERT INTO tail VALUES (1, ?, ?, ?)", (len(rows), end, whole_head_seal(start, seals)))


def insert(connection: sqlite3.Connection, rows: Sequence[Row]) -> None:
    """Insert events, without the tail."""
    connection.executemany(
        "INSERT INTO events VALUES (?, ?, ?, ?, ?)", [(r.seq, r.type, r.time_utc_s, r.json, r.seal) for r in rows]
    )


def append(connection: sqlite3.Connection, rows: Sequence[Row]) -> None:
    """Insert events and update the tail, in one transaction."""
    if not rows:
        return
    with connection:
        insert(connection, rows)
        connection.execute("UPDATE tail SET events = ?, seal = ?", (rows[-1].seq, rows[-1].seal))


def is_sealed(connection: sqlite3.Connection) -> bool:
    """Whether the journal has seals.

    Raises:
        BrokenSealError: version and tables contradict each other.
        sqlite3.Error: the schema cannot be read.
    """
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    columns = {str(row[1]) for row in connection.execute("PRAGMA table_info(events)")}
    old = columns == {"seq", "type", "time_utc_s", "json"}
    if version == SCHEMA_VERSION and not old:
        return True
    if version == UNSEALED_VERSION and old:
        return False
    raise BrokenSealError(f"layout {version} with other tables than those of this layout")


def read_head(connection: sqlite3.Connection) -> tuple[dict[str, str], dict[str, bytes]]:
    """Values and seals of `head`, unchecked; texts that are none raise `UnicodeDecodeError`."""
    rows = connection.execute("SELECT CAST(key AS BLOB), CAST(value AS BLOB), seal FROM head").fetchall()
    return (
        {key.decode(): value.decode() for key, value, _ in rows},
        {key.decode(): found for key, _, found in rows},
    )


def checked_head(connection: sqlite3.Connection) -> dict[str, str]:
    """The constant data.

    Raises:
        BrokenSealError: it was changed since it was written.
    """
    values, seals = read_head(connection)
    start = genesis(values.get(MISSION_ID, ""))
    wrong = [key for key, value in values.items() if seals[key] != head_seal(start, key, value)]
    if wrong:
        raise BrokenSealError(f"{' and '.join(wrong) if len(wrong) < 3 else 'the head'} was changed")
    if whole_head_seal(start, seals) != read_tail(connection)[2]:
        raise BrokenSealError("a part of the head is missing")
    return values


def read_tail(connection: sqlite3.Connection) -> tuple[int, bytes, bytes]:
    """Number of events, seal of the last one, seal of the head."""
    rows = connection.execute("SELECT events, seal, head FROM tail").fetchall()
    if len(rows) != 1:
        raise BrokenSealError("the number of events is missing")
    return rows[0]  # type: ignore[no-any-return]


def chained(connection: sqlite3.Connection, start: bytes) -> Iterator[Row]:
    """The events in order, as long as the chain holds.

    Raises:
        BrokenSealError: at the first event that is missing or was changed.
    """
    previous = start
    # blobs: a text that is none must be an error of this event, not of the cursor
    found = connection.execute(
        "SELECT seq, CAST(type AS BLOB), time_utc_s, CAST(json AS BLOB), seal FROM events ORDER BY seq"
    )
    for seq, (number, kind, time_utc_s, text, stored) in enumerate(found, start=1):
        if number != seq:
            raise BrokenSealError(f"event {seq} is missing")
        try:
            row = Row(number, kind.decode(), time_utc_s, text.decode(), stored)
            good = event_seal(previous, row.seq, row.type, row.time_utc_s, row.json) == stored
        except (UnicodeDecodeError, AttributeError, TypeError):
            good = False
        if not good:
            raise BrokenSealError(f"event {seq} was changed")
        yield row
        previous = stored


def checked_rows(connection: sqlite3.Connection, start: bytes) -> list[Row]:
    """All events.

    Raises:
        BrokenSealError: an event is missing or was changed.
    """
    rows = list(chained(connection, start))
    number, end, _ = read_tail(connection)
    if number != len(rows) or end != (rows[-1].seal if rows else start):
        raise BrokenSealError(f"{number} events were written, {len(rows)} are there")
    return rows


def unsealed_head(connection: sqlite3.Connection) -> dict[str, str]:
    """The constant data of a journal without seals."""
    return dict(connection.execute("SELECT key, value FROM head").fetchall())


def unsealed_texts(connection: sqlite3.Connection) -> list[str]:
    """The events of a journal without seals, as JSON texts."""
    return [text for (text,) in connection.execute("SELECT json FROM events ORDER BY seq")]


def parsed(texts: Sequence[str]) -> list[Event]:
    """Events from their JSON texts.

    Raises:
        BrokenSealError: an event is missing.
        UnknownEventError: an event of a type that this version does not know.
        ValueError: invalid content.
    """
    events = [event_from_json(json.loads(text)) for text in texts]
    wrong = next((i for i, event in enumerate(events, start=1) if event.seq != i), None)
    if wrong is not None:
        raise BrokenSealError(f"event {wrong} is missing")
    return events


def seal_as_found(connection: sqlite3.Connection) -> None:
    """Seal a journal of layout 1, in one transaction."""
    head, texts = unsealed_head(connection), unsealed_texts(connection)
    head[SEALED_LATER] = str(len(texts))
    start = previous = genesis(head.get(MISSION_ID, ""))
    rows = []
    # the texts stay as they are: a later version may have written fields that this one does not know
    for number, kind, time_utc_s, text in connection.execute(
        "SELECT seq, type, time_utc_s, json FROM events ORDER BY seq"
    ).fetchall():
        previous = event_seal(previous, number, kind, time_utc_s, text)
        rows.append(Row(number, kind, time_utc_s, text, previous))
    seals = {key: head_seal(start, key, value) for key, value in head.items()}
    connection.execute("BEGIN IMMEDIATE")
    try:
        for statement in ("DROP TABLE head", "DROP TABLE events", *filter(str.strip, SCHEMA.split(";"))):
            connection.execute(statement)
        connection.executemany("INSERT INTO head VALUES (?, ?, ?)", [(k, v, seals[k]) for k, v in head.items()])
        insert(connection, rows)
        connection.execute("INSERT INTO tail VALUES (1, ?, ?, ?)", (len(rows), previous, whole_head_seal(start, seals)))
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        connection.execute("COMMIT")
    except BaseException:
        connection.rollback()
        raise
