"""Order of the shots: retakes at once, then after the other shots, until the attempts are used up. Pure logic."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum


class Decision(StrEnum):
    """What happens to a shot after a rejected attempt."""

    AT_ONCE = "at_once"
    LATER = "later"
    GIVE_UP = "give_up"


@dataclass(frozen=True, slots=True)
class Task:
    """The shot to take now, and its round (0 = the first pass)."""

    shot: int
    round: int


class ShotQueue:
    """The queue of shots; holds each shot at most once.

    Args:
        shots: indices in shooting order.
        attempts: attempts at a shot within a round before it is deferred.
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
        """Remove and return the next shot; None if the queue is empty."""
        if not self._now:
            self._now, self._later = self._later, deque()
        if not self._now:
            return None
        shot = self._now.popleft()
        return Task(shot, self._round_of.get(shot, 0))

    def coming(self) -> Iterator[int]:
        """The next shots of this round, in order."""
        yield from self._now

    def put_back(self, shot: int) -> None:
        """Put an interrupted shot first; the attempt does not count."""
        self.drop(shot)
        self._now.appendleft(shot)

    def restore(self, shot: int) -> None:
        """Put a shot first with all its attempts: those that it had say nothing about it."""
        self.put_back(shot)
        self._tried.pop(shot, None)
        self._round_of.pop(shot, None)

    def rejected(self, shot: int) -> Decision:
        """Count a failed attempt and decide when the shot is taken again, if at all."""
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
        """The round of the shot's next attempt."""
        return self._round_of.get(shot, 0)

    def drop(self, shot: int) -> None:
        """Remove a shot, if it is queued."""
        for line in (self._now, self._later):
            if shot in line:
                line.remove(shot)

    def add(self, shot: int) -> None:
        """Append a shot to this round with all its attempts (a repeat, a patch)."""
        self.drop(shot)
        self._tried.pop(shot, None)
        self._round_of.pop(shot, None)
        self._now.append(shot)

    def clear(self) -> None:
        """Remove all shots."""
        self._now.clear()
        self._later.clear()

    def __contains__(self, shot: int) -> bool:
        return shot in self._now or shot in self._later

    def __len__(self) -> int:
        return len(self._now) + len(self._later)
