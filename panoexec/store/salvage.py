"""The longest true part of a damaged journal, as a new journal; the damaged one is set aside, unchanged.

The true part are the events from the first on whose chain of seals holds. They are read through SQLite, and, where its
pages do not lead to them any more, from the pages of file and write-ahead log directly (`panoexec.store.page_scan`): a
seal proves an event, wherever it was found. What follows a gap is not used, although its own seals may hold, because
a mission cannot be folded over a gap.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import sqlite3
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from panoexec import __version__
from panoexec.errors import InputFileError, UsageError
from panoexec.mission.log.events import Event, ShotAccepted, event_from_json
from panoexec.store import journal_layout as layout
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import (
    DamagedJournalError,
    JournalFileError,
    JournalInUseError,
    load_journal,
    write_journal,
)
from panoexec.store.manifest import manifest_events, read_manifest
from panoexec.store.page_scan import Fragments, scan

_BESIDE: Final = ("", "-wal", "-shm")
_KNOWN: Final = frozenset({"plan", "settings", "extra", layout.WRITTEN_BY, layout.NUMBER})


@dataclass(frozen=True, slots=True, kw_only=True)
class Salvage:
    """What became of a mission.

    Attributes:
        events: events of the true part.
        lost_events: how many more there were; None if unknown.
        lost_head: constant data that are lost: without `plan` or `settings` the mission cannot be resumed.
        lost_shots: shots whose accepted photos only the manifest still knows.
        damage: what was found, "" for a whole journal.
        aside: the folder with the damaged files; None if nothing was changed.
        notes: what else is to be told.
    """

    events: int
    lost_events: int | None = 0
    lost_head: tuple[str, ...] = ()
    lost_shots: tuple[int, ...] = ()
    damage: str = ""
    aside: Path | None = None
    notes: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether nothing was lost."""
        return self.lost_events == 0 and not self.lost_head


@dataclass(frozen=True, slots=True)
class _Found:
    """What is left of a journal."""

    head: Mapping[str, str]
    rows: Sequence[layout.Row]
    lost_events: int | None
    lost_head: tuple[str, ...]
    notes: tuple[str, ...] = ()


def salvage_journal(directory: MissionDirectory) -> Salvage:
    """Recover the longest true part of a mission's journal; blocks.

    A whole journal stays as it is. A damaged one is moved into a folder `damaged-<n>` beside it, together with its
    write-ahead log and a copy of the manifest, and a new journal takes its place.

    Raises:
        JournalFileError: it is missing, in use, of a newer or of an unsealed layout, or nothing of it can be recovered;
            nothing was changed.
        UsageError: something cannot be written.
    """
    path = directory.journal
    if not path.is_file():
        raise JournalFileError(f"{path}: there is no journal")
    accepted, told = _told_by_manifest(directory)
    foreign = False
    try:
        contents = load_journal(path)
        if told > len(contents.events):
            damage = f"{path}: ends with event {len(contents.events)}, the manifest tells of event {told}"
        else:
            return Salvage(events=len(contents.events), notes=contents.notes)
    except JournalInUseError:
        raise
    except JournalFileError as error:  # a damaged header looks like that of another program, or of a newer version
        damage, foreign = str(error), not isinstance(error, DamagedJournalError)
    found = _what_is_left(directory, told)
    events, unknown = _understood(found.rows)
    own = found.head.get(layout.WRITTEN_BY) == __version__ or not foreign
    if not events or not own:
        raise JournalFileError(f"nothing can be recovered, nothing was changed: {damage}")
    rows = found.rows[: len(events)]
    aside = _set_aside(directory)
    try:
        write_journal(path, found.head, rows)
    except UsageError:
        _bring_back(directory, aside)
        raise
    kept = {event.shot for event in events if isinstance(event, ShotAccepted)}
    lost = found.lost_events
    return Salvage(
        events=len(rows),
        lost_events=None if lost is None else lost + len(found.rows) - len(rows),
        lost_head=found.lost_head,
        lost_shots=tuple(sorted(accepted - kept)),
        damage=damage,
        aside=aside,
        notes=(*found.notes, *unknown),
    )


def _told_by_manifest(directory: MissionDirectory) -> tuple[set[int], int]:
    """Shots with an accepted photo, and up to which event it tells, by a manifest that is not damaged."""
    try:
        document = read_manifest(directory.manifest)
        accepted = {int(shot["index"]) for shot in document["shots"] if shot.get("accepted_attempt") is not None}
    except (InputFileError, KeyError, TypeError, ValueError, AttributeError):
        return set(), 0
    return accepted, manifest_events(document) or 0


def _understood(rows: Sequence[layout.Row]) -> tuple[list[Event], tuple[str, ...]]:
    """Events that this version can read: those before the first that it cannot."""
    events: list[Event] = []
    for row in rows:
        try:
            events.append(event_from_json(json.loads(row.json)))
        except ValueError as error:
            return events, (f"event {row.seq} is not one that this version knows ({str(error)[:100]})",)
    return events, ()


def _what_is_left(directory: MissionDirectory, told: int) -> _Found:
    """Read what can be read from a copy, so that the damaged files are not changed."""
    with tempfile.TemporaryDirectory(prefix="panoexec-salvage-") as folder:
        copy = Path(folder) / directory.journal.name
        for suffix in _BESIDE[:2]:
            source = directory.journal.with_name(directory.journal.name + suffix)
            if source.exists():
                shutil.copyfile(source, copy.with_name(copy.name + suffix))
        fragments = scan(copy)
        with contextlib.suppress(sqlite3.Error, UnicodeDecodeError):
            fragments.merge(_through_sqlite(copy))
        if not fragments.rows:
            return _unsealed(copy)
    head, lost_head, start = _true_head(directory, fragments)
    rows = fragments.chain(start)
    written = max([told, *(_events_by(number, end, fragments) for number, end in fragments.tails)])
    lost = None if not fragments.tails and not told else max(0, written - len(rows))
    return _Found(head, rows, lost, lost_head)


def _events_by(number: int, end: bytes, fragments: Fragments) -> int:
    """How many events there were by a row of `tail`, of which number or seal may be damaged."""
    return next((row.seq for row in fragments.rows if row.seal == end), number)


def _unsealed(copy: Path) -> _Found:
    """What SQLite still reads of a journal of layout 1; it is sealed as it is found."""
    head: dict[str, str] = {}
    rows: list[layout.Row] = []
    with contextlib.closing(sqlite3.connect(copy)) as connection:
        with contextlib.suppress(sqlite3.Error, UnicodeDecodeError):
            head = layout.unsealed_head(connection)
        previous = layout.genesis(head.get(layout.MISSION_ID, ""))
        with contextlib.suppress(sqlite3.Error, UnicodeDecodeError):
            found = connection.execute("SELECT seq, type, time_utc_s, json FROM events ORDER BY seq")
            for seq, (number, kind, time_utc_s, text) in enumerate(found, start=1):
                if number != seq:
                    break
                previous = layout.event_seal(previous, seq, kind, time_utc_s, text)
                rows.append(layout.Row(seq, kind, time_utc_s, text, previous))
    if rows:
        head[layout.SEALED_LATER] = str(len(rows))
    lost_head = tuple(sorted({"plan", "settings"} - head.keys()))
    return _Found(head, rows, None, lost_head, ("written by an earlier version without seals: unchecked",))


def _through_sqlite(copy: Path) -> Fragments:
    found = Fragments()
    with contextlib.closing(sqlite3.connect(copy)) as connection:
        with contextlib.suppress(sqlite3.Error, UnicodeDecodeError):
            values, seals = layout.read_head(connection)
            found.head += [(key, value, seals[key]) for key, value in values.items()]
        with contextlib.suppress(sqlite3.Error, layout.BrokenSealError):
            number, end, _ = layout.read_tail(connection)
            found.tails.append((number, end))
        with contextlib.suppress(sqlite3.Error):
            for number, kind, time_utc_s, text, seal in connection.execute(
                "SELECT seq, CAST(type AS BLOB), time_utc_s, CAST(json AS BLOB), seal FROM events"
            ):
                found.add(number, kind, time_utc_s, text, seal)
    return found


def _true_head(directory: MissionDirectory, fragments: Fragments) -> tuple[dict[str, str], tuple[str, ...], bytes]:
    """The constant data whose seals hold, what is lost of them, and what the first event is chained to."""
    # the directory is named by the mission's id, which everything else is sealed with
    ids = [value for key, value, _ in fragments.head if key == layout.MISSION_ID] + [directory.mission_id]
    best: dict[str, str] = {}
    start = layout.genesis(directory.mission_id)
    for mission_id in ids:
        candidate = layout.genesis(mission_id)
        head = {key: value for key, value, seal in fragments.head if layout.head_seal(candidate, key, value) == seal}
        if len(head) > len(best):
            best, start = head, candidate
            best.setdefault(layout.MISSION_ID, mission_id)
    seals = {key: seal for key, _, seal in fragments.head}
    text = _plan_file(directory)
    if "plan" not in best and text is not None and seals.get("plan") == layout.head_seal(start, "plan", text):
        best["plan"] = text
    lost = tuple(sorted(_KNOWN - best.keys()))
    best.setdefault("extra", "{}")
    return best, lost, start


def _plan_file(directory: MissionDirectory) -> str | None:
    """The text that the journal has of the plan, made of the plan file."""
    try:
        document: Any = json.loads(directory.plan.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return json.dumps(document)


def _set_aside(directory: MissionDirectory) -> Path:
    number = 1
    while (aside := directory.path / f"damaged-{number}").exists():
        number += 1
    try:
        aside.mkdir()
        if directory.manifest.exists():
            shutil.copy2(directory.manifest, aside)
        for suffix in _BESIDE:
            path = directory.journal.with_name(directory.journal.name + suffix)
            if path.exists():
                path.rename(aside / path.name)
    except OSError as error:
        raise UsageError(f"{aside}: the damaged journal cannot be set aside ({error.strerror})") from error
    return aside


def _bring_back(directory: MissionDirectory, aside: Path) -> None:
    for suffix in _BESIDE:
        path = aside / (directory.journal.name + suffix)
        if path.exists():
            path.rename(directory.path / path.name)
