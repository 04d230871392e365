"""Journals as another version would have written them: sealed, but with other content."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

from panoexec.store import journal_layout as layout
from panoexec.store.journal import write_journal


def rewrite(
    path: Path,
    *,
    head: Mapping[str, str] | None = None,
    texts: Mapping[int, str] | None = None,
    keep: Callable[[int], bool] = lambda seq: True,
) -> None:
    """Write a closed journal anew, with true seals over what is given.

    Args:
        path: the journal.
        head: values that replace those of these keys.
        texts: JSON texts that replace those of these events.
        keep: which events stay.
    """
    with closing(sqlite3.connect(path)) as found:
        values = layout.read_head(found)[0] | dict(head or {})
        old = found.execute("SELECT seq, type, time_utc_s, json FROM events ORDER BY seq").fetchall()
    rows, previous = [], layout.genesis(values[layout.MISSION_ID])
    for seq, kind, time_utc_s, text in old:
        if keep(seq):
            new = (texts or {}).get(seq, text)
            previous = layout.event_seal(previous, seq, kind, time_utc_s, new)
            rows.append(layout.Row(seq, kind, time_utc_s, new, previous))
    path.unlink()
    write_journal(path, values, rows)
    with closing(sqlite3.connect(path)) as new:  # as one that was opened
        new.execute("PRAGMA journal_mode = WAL")


def unseal(path: Path) -> None:
    """Turn a closed journal into one of layout 1."""
    with closing(sqlite3.connect(path)) as found:
        head = layout.read_head(found)[0]
        events = found.execute("SELECT seq, type, time_utc_s, json FROM events ORDER BY seq").fetchall()
    path.unlink()
    with closing(sqlite3.connect(path)) as old:
        old.executescript(
            f"PRAGMA application_id = {layout.APPLICATION_ID}; PRAGMA user_version = 1;"
            "CREATE TABLE head (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;"
            "CREATE TABLE events (seq INTEGER PRIMARY KEY, type TEXT NOT NULL, time_utc_s REAL NOT NULL,"
            " json TEXT NOT NULL) STRICT;"
        )
        with old:
            old.executemany("INSERT INTO head VALUES (?, ?)", list(head.items()))
            old.executemany("INSERT INTO events VALUES (?, ?, ?, ?)", events)


def documents(path: Path) -> list[dict[str, object]]:
    """The events of a journal as they stand in it."""
    with closing(sqlite3.connect(path)) as found:
        return [json.loads(text) for (text,) in found.execute("SELECT json FROM events ORDER BY seq")]
