"""The mark of each shot (its state as maps show it), and a one-line text of all marks for remote views."""

from __future__ import annotations

from panoexec.mission.log import events as ev
from panoexec.mission.log.mark_text import ShotMark, in_runs
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import ShotRecord, ShotStatus


def mark_of(record: ShotRecord, *, current: bool, ended: bool = False) -> ShotMark:
    """The mark of a shot.

    Args:
        record: of the shot.
        current: whether it is the mission's current shot.
        ended: whether the mission is over, so that nothing is to be taken any more.
    """
    if current and record.status in {ShotStatus.ACTIVE, ShotStatus.EXPOSED}:
        return ShotMark.CURRENT
    if record.accepted is not None:
        return ShotMark.RETAKEN if record.is_retaken else ShotMark.DONE
    if ended or record.status in {ShotStatus.MISSED, ShotStatus.SKIPPED}:
        return ShotMark.MISSING
    return ShotMark.AGAIN if any(attempt.code for attempt in record.attempts) else ShotMark.TO_DO


def marks_text(record: MissionRecord) -> str:
    """The marks of all shots by index, run-length encoded: `d12 r1 c1 t42`."""
    return in_runs(
        mark_of(shot, current=index == record.current, ended=record.ended)
        for index, shot in sorted(record.shots.items())
    )


class ShotMarks:
    """The text of the running mission, updated incrementally by its events (a mission may have thousands of shots)."""

    def __init__(self) -> None:
        self._record: MissionRecord | None = None
        self._places: dict[int, int] = {}
        self._letters: list[ShotMark] = []
        self._touched: set[int] = set()
        self._current: int | None = None
        self._text = ""
        self._ended = False

    def note(self, event: ev.Event) -> None:
        """Take a published event."""
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
        elif record.ended and not self._ended:
            self._touched = set(record.shots)
        elif not self._touched and record.current == self._current:
            return self._text
        self._ended = record.ended
        self._touched |= {index for index in (self._current, record.current) if index in self._places}
        for index in self._touched & self._places.keys():
            mark = mark_of(record.shots[index], current=index == record.current, ended=record.ended)
            self._letters[self._places[index]] = mark
        self._touched.clear()
        self._current = record.current
        self._text = in_runs(self._letters)
        return self._text
