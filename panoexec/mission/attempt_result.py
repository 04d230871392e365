"""How an attempt went: not settled, settled, or exposed with a verdict on the pose."""

from __future__ import annotations

from dataclasses import dataclass, field

from panoexec.devices import PendingCapture
from panoexec.mission.pointing.tolerance_gate import WindowVerdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """By how much a pose missed its target, about the gimbal's axes, signed."""

    pitch_deg: float
    roll_deg: float
    yaw_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NotSettled:
    """The attempt ends before its photo.

    Attributes:
        code: as of a rejected attempt.
        reason: for the pilot.
        offset: the pointing error at the end; None if it is unknown.
    """

    code: str
    reason: str
    offset: Offset | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Settled:
    """The pose is settled: trigger now.

    Attributes:
        commanded_s: when the pointing command was sent.
        settled_s: when the last condition for the trigger was met.
    """

    commanded_s: float
    settled_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """Photos taken, attitudes judged.

    Attributes:
        captures: one per photo; evidence is awaited on it.
        verdict: on the attitudes from the first trigger, or when it was carried out, to the end of the last exposure.
        trigger_utc_s: wall time of each trigger.
        trigger_delay_s: from settled to the first trigger on the wire.
        start_s, end_s: from when and until when the attitudes were judged.
        failure: why not all photos were taken, "" if they were.
        images_before: how many images the camera counted before; -1 where that was not known.
        broken_off: a pause or an end was requested between two photos of a bracket.
        by_opening: the verdict is on when the shutter was open, by the camera's stamp.
        held: other intervals in which the pose was held, as the dates of the photos asked; a later look finds the same
            dates, and the samples of then are not kept for ever.
    """

    captures: tuple[PendingCapture, ...]
    verdict: WindowVerdict
    trigger_utc_s: tuple[float, ...]
    trigger_delay_s: float
    start_s: float
    end_s: float
    failure: str = ""
    images_before: int = -1
    broken_off: bool = False
    held: set[tuple[float, float]] = field(default_factory=set)
    by_opening: bool = False
