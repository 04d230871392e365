"""Which shot comes next: retakes at once, then later after the others, until the attempts are used up. Pure logic."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum


class Decision(StrEnum):
    """What becomes of a shot whose attempt was rejected."""

    AT_ONCE = "at_once"
    LATER = "later"
    GIVE_UP = "give_up"


@dataclass(frozen=True, slots=True)
class Task:
    """A shot to try now, in this round over the shots (0 = the first)."""

    shot: int
    round: int


class ShotQueue:
    """Hands out shots; each is in it once at most.

    Args:
        attempts: tries of a shot within a round before it is put off.
        rounds: passes over the shots, the first included.
    """

    def __init__(self, shots: Iterable[int], *, attempts: int, rounds: int) -> None:
        self._now: deque[int] = deque(shots)
        self._later: deque[int] = deque()
        self._attempts = attempts
        self._rounds = rounds
        self._tried: dict[int, int] = {}
        self._round_of: dict[int, int] = {}

    def take(self) -> Task | None:
        """The next shot; None when nothing is left but what is out for its evidence."""
        if not self._now:
            self._now, self._later = self._later, deque()
        if not self._now:
            return None
        shot = self._now.popleft()
        return Task(shot, self._round_of.get(shot, 0))

    def coming(self) -> Iterator[int]:
        """The shots after the one that is out, in the order in which they come if all goes well."""
        yield from self._now

    def put_back(self, shot: int) -> None:
        """It was interrupted: first again, and nothing counted."""
        self.drop(shot)
        self._now.appendleft(shot)

    def rejected(self, shot: int) -> Decision:
        """It failed once more: again at once, after the others, or never."""
        self.drop(shot)
        tried = self._tried.get(shot, 0) + 1
        self._tried[shot] = tried
        if tried < self._attempts:
            self._now.appendleft(shot)
            return Decision.AT_ONCE
        if self._round_of.get(shot, 0) + 1 < self._rounds:
            self._tried[shot] = 0
            self._round_of[shot] = self._round_of.get(shot, 0) + 1
            self._later.append(shot)
            return Decision.LATER
        return Decision.GIVE_UP

    def round_of(self, shot: int) -> int:
        """The round in which the shot comes next."""
        return self._round_of.get(shot, 0)

    def drop(self, shot: int) -> None:
        """It is not wanted any more (skipped)."""
        for line in (self._now, self._later):
            if shot in line:
                line.remove(shot)

    def add(self, shot: int) -> None:
        """Take it (again) after the others of this round, with all its attempts (a repeat, a patch)."""
        self.drop(shot)
        self._tried.pop(shot, None)
        self._round_of.pop(shot, None)
        self._now.append(shot)

    def clear(self) -> None:
        """Nothing more is wanted."""
        self._now.clear()
        self._later.clear()

    def __contains__(self, shot: int) -> bool:
        return shot in self._now or shot in self._later

    def __len__(self) -> int:
        return len(self._now) + len(self._later)
