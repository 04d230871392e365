"""The record of one shot: its attempts with their verdicts, photos and what those prove."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from panoexec.devices import EvidenceLevel
from panoexec.mission.log import events as ev
from panoexec.planning.model import Shot


class ShotStatus(StrEnum):
    """The state of a shot."""

    PENDING = "pending"
    """Not taken yet, or to be taken again."""
    ACTIVE = "active"
    """An attempt is in progress, before its photo."""
    EXPOSED = "exposed"
    """The photo was triggered; its evidence is awaited."""
    ACCEPTED = "accepted"
    DEFERRED = "deferred"
    """To be taken again after the others."""
    SKIPPED = "skipped"
    """Skipped by command."""
    MISSED = "missed"
    """All attempts used up."""


class Verdict(StrEnum):
    """The verdict on an attempt."""

    OPEN = "open"
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    INTERRUPTED = "interrupted"


@dataclass(slots=True, kw_only=True)
class AttemptRecord:
    """One attempt at a shot; updated by events."""

    number: int
    round: int
    pitch_deg: float
    yaw_deg: float
    started_utc_s: float
    seq: int = 0
    """Number of the event that began it: the order of attempts, whatever the clock says."""
    process: int = 0
    """How often the mission had been restarted: the mission's clock begins anew with each process."""
    verdict: Verdict = Verdict.OPEN
    by: str = ""
    code: str = ""
    reason: str = ""
    exposed: ev.ShotExposed | None = None
    photos: tuple[ev.Photo, ...] = ()
    stored: dict[int, ev.PhotoStored] = field(default_factory=dict)
    """The files in the mission directory, by number of the photo."""
    checked: ev.PhotoChecked | None = None
    """What the content of its photo proves; None if it was not examined."""

    @property
    def evidence(self) -> EvidenceLevel | None:
        """The weakest evidence among its photos; None without a photo."""
        return min((self.evidence_of(photo) for photo in self.photos), default=None)

    def evidence_of(self, photo: ev.Photo) -> EvidenceLevel:
        """The evidence of one of its photos: a stored file is the best there is."""
        return EvidenceLevel.FILE_SEEN if photo.number in self.stored else photo.evidence


@dataclass(slots=True, kw_only=True)
class ShotRecord:
    """One shot and all attempts at it."""

    shot: Shot
    status: ShotStatus = ShotStatus.PENDING
    reason: str = ""
    attempts: list[AttemptRecord] = field(default_factory=list)
    patch: bool = False
    between: tuple[int, int] | None = None
    """The two shots that a bridge shot is to tie; None for other shots."""

    @property
    def accepted(self) -> AttemptRecord | None:
        """The attempt that counts: the last accepted one."""
        return next((a for a in reversed(self.attempts) if a.verdict is Verdict.ACCEPTED), None)

    @property
    def tries(self) -> int:
        """Number of attempts, without those that a pause, a skip or an end broke off before their photo."""
        return sum(attempt.verdict is not Verdict.INTERRUPTED for attempt in self.attempts)

    @property
    def is_retaken(self) -> bool:
        """Whether the attempt that counts is not the first try."""
        counts = self.accepted
        return counts is not None and any(
            attempt.verdict is not Verdict.INTERRUPTED for attempt in self.attempts[: counts.number - 1]
        )

    @property
    def open_attempt(self) -> AttemptRecord | None:
        """The attempt without a verdict, if there is one."""
        return next((a for a in reversed(self.attempts) if a.verdict is Verdict.OPEN), None)
