"""Where each shot of a mission stands, as pictures of it show it, and in a line of text for those who look on."""

from __future__ import annotations

import re
from collections.abc import Iterable
from enum import StrEnum
from itertools import groupby
from typing import Final

from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord, ShotRecord, ShotStatus


class ShotMark(StrEnum):
    """Where a shot stands; the letter is that of the text."""

    TO_DO = "t"
    CURRENT = "c"
    """It is being taken."""
    DONE = "d"
    """Its first photo counts."""
    RETAKEN = "r"
    """A later photo counts."""
    AGAIN = "a"
    """Tried, and to be taken again."""
    MISSING = "m"
    """Given up or left out."""


_RUN: Final = re.compile(r"([tcdram])([1-9][0-9]{0,6})")


def mark_of(record: ShotRecord, *, current: bool) -> ShotMark:
    """Where a shot stands.

    Args:
        record: of the shot.
        current: it is the mission's current one.
    """
    if current and record.status in {ShotStatus.ACTIVE, ShotStatus.EXPOSED}:
        return ShotMark.CURRENT
    if record.accepted is not None:
        return ShotMark.RETAKEN if record.accepted.number > 1 else ShotMark.DONE
    if record.status in {ShotStatus.MISSED, ShotStatus.SKIPPED}:
        return ShotMark.MISSING
    return ShotMark.AGAIN if any(attempt.code for attempt in record.attempts) else ShotMark.TO_DO


def marks_text(record: MissionRecord) -> str:
    """All shots in the order of their indices, equal neighbours together: `d12 r1 c1 t42`."""
    return _in_runs(mark_of(shot, current=index == record.current) for index, shot in sorted(record.shots.items()))


def _in_runs(letters: Iterable[ShotMark]) -> str:
    return " ".join(f"{letter.value}{sum(1 for _ in run)}" for letter, run in groupby(letters))


class ShotMarks:
    """The text of the mission that flies, kept up to date by its events: a large one has thousands of shots."""

    def __init__(self) -> None:
        self._record: MissionRecord | None = None
        self._places: dict[int, int] = {}
        self._letters: list[ShotMark] = []
        self._touched: set[int] = set()
        self._current: int | None = None
        self._text = ""

    def note(self, event: ev.Event) -> None:
        """Take an event that was announced."""
        if isinstance(event, ev.ShotEvent):
            self._touched.add(event.shot)

    def text(self, record: MissionRecord | None) -> str:
        """As `marks_text`; "" without a mission."""
        if record is None:
            return ""
        if record is not self._record or len(record.shots) != len(self._letters):
            self._record = record
            self._places = {index: place for place, index in enumerate(sorted(record.shots))}
            self._letters = [ShotMark.TO_DO] * len(record.shots)
            self._touched = set(record.shots)
        elif not self._touched and record.current == self._current:
            return self._text
        self._touched |= {index for index in (self._current, record.current) if index in self._places}
        for index in self._touched & self._places.keys():
            standing = mark_of(record.shots[index], current=index == record.current)
            self._letters[self._places[index]] = standing
        self._touched.clear()
        self._current = record.current
        self._text = _in_runs(self._letters)
        return self._text


def marks_from_text(text: str, *, count: int) -> list[ShotMark]:
    """What `marks_text` told of so many shots; empty if it is not that."""
    runs = [_RUN.fullmatch(part) for part in text.split(" ")]
    if any(run is None for run in runs) or sum(int(run[2]) for run in runs if run) != count:
        return []
    return [ShotMark(run[1]) for run in runs if run for _ in range(int(run[2]))]
