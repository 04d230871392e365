"""Whether the time that a photo itself tells (EXIF) fits its attempt. Pure logic.

A camera's clock may be hours off, without a time zone, in whole seconds, rounded or cut off. So only differences
count: the photos taken next to one another must agree on one offset between the camera's clock and the mission's. One
that does not agree with it is another one than its attempt took, or the camera's clock was stepped.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from panoexec.mission.log.photo_events import PhotoStored
from panoexec.mission.log.shot_record import AttemptRecord

NEIGHBOURS: Final = 8
"""How many photos taken next to a photo it is compared with."""
_FEWEST: Final = 3
"""So many of them must agree with each other, and this fraction of them."""
_MAJORITY: Final = 2 / 3
_SLACK_S: Final = 1.0
"""How far an exposure may be from the time that is recorded for it, and drift between the clocks."""
_UNKNOWN_S: Final = 10.0
"""How long before the verdict on its pose a photo was exposed at most, if nothing more is known."""


Key: TypeAlias = tuple[int, int, int]
"""Shot, attempt, photo."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedPhoto:
    """A photo with both times.

    Attributes:
        key: shot, attempt, photo.
        process: which process took it: the mission's clock begins anew with each.
        at_s: when it was taken, on the mission's clock.
        low_s, high_s: bounds of the camera's clock minus the mission's, by this photo.
    """

    key: Key
    process: int
    at_s: float
    low_s: float
    high_s: float

    @property
    def order(self) -> tuple[int, float]:
        """By process and time."""
        return self.process, self.at_s


def _timed(shot: int, attempt: AttemptRecord, stored: PhotoStored) -> TimedPhoto | None:
    """A photo whose file tells when it was taken; None if it does not, or nothing is known of its exposure."""
    exposed, taken_s, resolution_s = attempt.exposed, stored.taken_s, stored.taken_resolution_s
    if exposed is None or not (math.isfinite(taken_s) and math.isfinite(exposed.clock_s)):
        return None
    told = next((one for one in attempt.photos if one.number == stored.photo), None)
    ago_s = math.nan if told is None else exposed.time_utc_s - told.capture_time_utc_s
    is_dated = 0 <= ago_s <= _UNKNOWN_S
    at_s = exposed.clock_s - (ago_s if is_dated else 0.0)
    return TimedPhoto(
        key=(shot, attempt.number, stored.photo),
        process=attempt.process,
        at_s=at_s,
        # its time may be cut off or rounded
        low_s=taken_s - resolution_s / 2 - (at_s + _SLACK_S),
        high_s=taken_s + resolution_s - (at_s - (_SLACK_S if is_dated else _UNKNOWN_S)),
    )


class PhotoTimes:
    """The stored photos of one mission that tell when they were taken.

    Attributes:
        contradictions: by shot, attempt and photo: why its own time does not fit its attempt.
    """

    def __init__(self) -> None:
        self.contradictions: dict[Key, str] = {}
        self._photos: list[TimedPhoto] = []

    def judge(self, shot: int, attempt: AttemptRecord, stored: PhotoStored) -> str:
        """Why the time of a photo that is about to be stored does not fit its attempt; "" if nothing says so."""
        photo = _timed(shot, attempt, stored)
        return "" if photo is None else self._contradiction(photo)

    def note(self, shot: int, attempt: AttemptRecord, stored: PhotoStored) -> None:
        """Take a stored photo; judges those beside it again."""
        key = (shot, attempt.number, stored.photo)
        self._photos = [one for one in self._photos if one.key != key]
        self.contradictions.pop(key, None)
        photo = _timed(shot, attempt, stored)
        if photo is None:
            return
        place = bisect.bisect(self._photos, photo.order, key=lambda one: one.order)
        self._photos.insert(place, photo)
        for one in self._photos[max(0, place - NEIGHBOURS) : place + NEIGHBOURS + 1]:
            why = self._contradiction(one)
            if why:
                self.contradictions[one.key] = why
            else:
                self.contradictions.pop(one.key, None)

    def _contradiction(self, photo: TimedPhoto) -> str:
        near = self._beside(photo)
        count, low_s, high_s = _agreed(near)
        if count < _FEWEST or count < _MAJORITY * len(near):
            return ""
        if photo.high_s < low_s:
            off_s, way = low_s - photo.high_s, "before"
        elif photo.low_s > high_s:
            off_s, way = photo.low_s - high_s, "after"
        else:
            return ""
        told = f"its file tells that it was taken at least {off_s:.1f} s {way} its trigger"
        return f"{told}, by the camera's clock on which {count} photos beside it agree"

    def _beside(self, photo: TimedPhoto) -> list[TimedPhoto]:
        """The photos that were taken next to it, itself excluded."""
        place = bisect.bisect(self._photos, photo.order, key=lambda one: one.order)
        around = self._photos[max(0, place - NEIGHBOURS - 1) : place + NEIGHBOURS + 1]
        others = [one for one in around if one.process == photo.process and one.key != photo.key]
        return sorted(others, key=lambda one: abs(one.at_s - photo.at_s))[:NEIGHBOURS]


def _agreed(photos: Sequence[TimedPhoto]) -> tuple[int, float, float]:
    """How many agree on one offset, and the bounds of all offsets on which so many do."""
    edges = sorted({one.low_s for one in photos})
    best, low_s, high_s = 0, math.nan, math.nan
    for edge in edges:  # the number changes to more at lower bounds alone
        agreeing = [one for one in photos if one.low_s <= edge <= one.high_s]
        if len(agreeing) > best:
            best, low_s, high_s = len(agreeing), edge, min(one.high_s for one in agreeing)
        elif len(agreeing) == best:
            high_s = max(high_s, min(one.high_s for one in agreeing))
    return best, low_s, high_s
