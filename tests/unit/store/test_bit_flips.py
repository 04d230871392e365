"""One flipped bit anywhere in a journal: the same events are read, or the damage is told.

`PANOEXEC_FLIPS` sets how many bits are flipped in all (default 240), half of them in a journal that was closed, half in
one that a killed process left.
"""

from __future__ import annotations

import asyncio
import os
import random
import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest

from panoexec.mission.log.events import Event
from panoexec.store.journal import JournalFileError, SqliteJournal, load_journal, read_journal
from tests.repository import ROOT

FLIPS = int(os.environ.get("PANOEXEC_FLIPS", "240"))
RECORDED = ROOT / "tests" / "data" / "recorded" / "journal.sqlite"


@pytest.fixture(scope="module", name="mission")
def a_mission(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Sequence[Event]]:
    """The recorded mission with seals: as it was closed, and as a killed process leaves it; and its events.

    The log of the killed one was merged once, so that it begins anew in front of frames of the time before.
    """
    folder = tmp_path_factory.mktemp("flips")
    (folder / "recorded").mkdir()
    shutil.copy(RECORDED, folder / "recorded")
    head, events = read_journal(folder / "recorded" / "journal.sqlite")
    closed, killed = folder / "closed", folder / "killed"

    async def write() -> None:
        closed.mkdir()
        async with await SqliteJournal.create(closed / "journal.sqlite", head) as journal:
            for event in events[:60]:
                await journal.append([event])
            journal._connection.execute("PRAGMA wal_checkpoint(PASSIVE)")
            for event in events[60:]:
                await journal.append([event])
            shutil.copytree(closed, killed)

    asyncio.run(write())
    assert (killed / "journal.sqlite-wal").stat().st_size > 100_000
    assert load_journal(killed / "journal.sqlite").events == events
    assert load_journal(killed / "journal.sqlite").notes == ()
    return closed, killed, events


def _outcome(folder: Path, events: Sequence[Event]) -> str:
    try:
        contents = load_journal(folder / "journal.sqlite")
    except JournalFileError:
        return "refused"
    if contents.events == events:
        return "same"
    # only the last write can be missing, and that is told
    lost_last = list(contents.events) == list(events)[:-1]
    return "told" if lost_last and contents.notes else "silent"


@pytest.mark.parametrize("name", ["journal.sqlite", "journal.sqlite-wal"])
def test_a_flipped_bit_is_harmless_or_told(
    mission: tuple[Path, Path, Sequence[Event]], tmp_path: Path, name: str
) -> None:
    closed, killed, events = mission
    source = killed if name.endswith("-wal") else closed
    whole = (source / name).read_bytes()
    rng = random.Random(name)
    folder = shutil.copytree(source, tmp_path / "mission")
    outcomes: Counter[str] = Counter()
    for _ in range(FLIPS // 2):
        at, bit = rng.randrange(len(whole)), rng.randrange(8)
        data = bytearray(whole)
        data[at] ^= 1 << bit
        (folder / name).write_bytes(data)
        outcome = _outcome(folder, events)
        outcomes[outcome] += 1
        assert outcome != "silent", f"bit {bit} of byte {at} of {name}"
    print(name, dict(outcomes))
    assert outcomes["refused"] > FLIPS // 10


def test_every_bit_of_the_first_page_and_of_the_last_transaction(
    mission: tuple[Path, Path, Sequence[Event]], tmp_path: Path
) -> None:
    """Where damage has the most effect: SQLite's header and schema, and what SQLite discards as never written."""
    closed, killed, events = mission
    rng = random.Random(1)
    cases = [(closed, "journal.sqlite", at) for at in [*range(112), *rng.sample(range(112, 4096), 40)]]
    log = (killed / "journal.sqlite-wal").read_bytes()
    frame = 24 + 4096
    live = 2 * (len(events) - 60)  # at least two pages a transaction
    cases += [(killed, "journal.sqlite-wal", at) for at in [*range(32), *rng.sample(range(len(log)), 20)]]
    cases += [(killed, "journal.sqlite-wal", 32 + frame * n + at) for n in (0, live - 1, live) for at in range(24)]
    folders = {source: shutil.copytree(source, tmp_path / source.name) for source in (closed, killed)}
    for source, name, at in cases:
        whole = (source / name).read_bytes()
        data = bytearray(whole)
        data[at] ^= 1 << rng.randrange(8)
        (folders[source] / name).write_bytes(data)
        assert _outcome(folders[source], events) != "silent", (name, at)
        (folders[source] / name).write_bytes(whole)
