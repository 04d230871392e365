"""Attempts that a crash left open: settled by what the camera remembers, or taken again.

How far an attempt came is in the journal. Without its `ShotExposed` nothing is known of the pose while the shutter was
open: the photo, if the camera has one, is filed and taken again. With it, pointing is judged already, and what is
missing is the proof of the photo. A photo is told by its time: the trigger's is in the journal, and cameras say when
they exposed. Where there is no time the count must tell: one image more than before the trigger, not two.
"""

from __future__ import annotations

import math
from typing import Final

from panoexec.devices import CaptureEvidence, EvidenceLevel, Recollection, RememberedPhoto
from panoexec.errors import DeviceError
from panoexec.mission import evidence
from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import AttemptRecord, Verdict
from panoexec.mission.overlap import overlaps_hold
from panoexec.mission.protocols import PhotoMemory
from panoexec.mission.waiting import until, within

RECALL_S: Final = 6.0
"""How long a camera may take to tell what it remembers."""
TRIES: Final = 2
AGAIN_AFTER_S: Final = 0.5
SLACK_S: Final = 0.25
"""How far wall clocks and stamps may be apart, before and after the time in which a photo must have been exposed."""
BEFORE: Final = "panoexec stopped before its photo"
UNKNOWN: Final = "panoexec stopped before its photo was proven"
UNJUDGED: Final = "panoexec stopped before the pointing of its photo was on record"


async def settle_open_attempts(flight: MissionContext) -> None:
    """Give every attempt that has no verdict one; photos whose file is still unknown get what the camera tells.

    When the process is to end again meanwhile, everything stays as it was for the next one.
    """
    shots = flight.record.shots
    if not any(record.open_attempt or _anonymous(attempt) for record in shots.values() for attempt in record.attempts):
        return
    _, recollection = await until(flight.control.stopping.wait(), _recall(flight), "what the camera remembers")
    if flight.control.stop is not None and flight.control.stop.kind == "interrupt":
        return
    photos = _Photos(flight, recollection or Recollection())
    for index, record in sorted(shots.items()):
        for attempt in record.attempts:
            if attempt.exposed is not None and attempt.verdict is not Verdict.OPEN and _anonymous(attempt):
                better = tuple(photos.identified(photo) for photo in attempt.photos)
                if better != attempt.photos:
                    flight.recorder.emit(ev.PhotoIdentified(shot=index, attempt=attempt.number, photos=better))
    # what was exposed has a time of its own, and comes before what may have been
    for exposed in (True, False):
        for index, record in sorted(shots.items()):
            unsettled = record.open_attempt
            if unsettled is not None and (unsettled.exposed is not None) is exposed:
                await _settle(flight, index, unsettled, photos)


def _anonymous(attempt: AttemptRecord) -> bool:
    return any(photo.image_index < 0 and not photo.file for photo in attempt.photos)


async def _recall(flight: MissionContext) -> Recollection:
    """What the camera remembers; nothing, if it has no memory or does not answer."""
    memory = flight.camera
    if not isinstance(memory, PhotoMemory):
        return Recollection()
    for left in reversed(range(TRIES)):
        try:
            return await within(flight.clock, RECALL_S, memory.recall(), "the camera's memory")
        except (DeviceError, TimeoutError):
            if left:
                await flight.clock.sleep(AGAIN_AFTER_S)
    return Recollection()


async def _settle(flight: MissionContext, index: int, attempt: AttemptRecord, remembered: _Photos) -> None:
    exposed, settings = attempt.exposed, flight.settings
    if exposed is None:
        photos = remembered.since(attempt.started_utc_s)
        if not photos and remembered.tells_times:
            flight.recorder.emit(ev.ShotInterrupted(shot=index, attempt=attempt.number, reason=BEFORE))
            return
        reason = UNJUDGED if photos else UNKNOWN
    else:
        photos = tuple(remembered.identified(photo) for photo in attempt.photos)
        if len(photos) == 1 and remembered.is_one_more_than(exposed.images_before):
            counted = CaptureEvidence(level=EvidenceLevel.COUNTED, received_s=math.nan)
            photos = (evidence.with_evidence(photos[0], counted),)
        proven = evidence.weakest(photos) >= settings.min_evidence
        by = ""
        if exposed.pointing_ok:
            by = "open_loop" if exposed.open_loop else "tolerance"
        elif exposed.may_overlap and proven and await overlaps_hold(flight, index, exposed.measured):
            by = "overlap"
        if by and len(photos) == settings.brackets and proven:
            flight.recorder.emit(ev.ShotAccepted(shot=index, attempt=attempt.number, photos=photos, by=by))
            flight.queue.drop(index)
            return
        reason = UNKNOWN if exposed.pointing_ok else exposed.reason
    flight.recorder.emit(
        ev.ShotRejected(shot=index, attempt=attempt.number, code="crash", reason=reason, photos=photos)
    )
    flight.recorder.emit(ev.ShotRetaken(shot=index, attempt=attempt.number + 1, reason=reason))


class _Photos:
    """The remembered photos that no attempt has claimed yet."""

    def __init__(self, flight: MissionContext, recollection: Recollection) -> None:
        attempts = [attempt for record in flight.record.shots.values() for attempt in record.attempts]
        known = {photo.image_index for attempt in attempts for photo in attempt.photos} - {-1}
        self._window_s = flight.settings.exposure_bound_s
        self._count = recollection.image_count
        self.tells_times = any(math.isfinite(photo.exposed_utc_s) for photo in recollection.photos)
        """Whether a photo that it does not tell of was not taken."""
        self._left = [photo for photo in recollection.photos if photo.evidence.image_index not in known]

    def is_one_more_than(self, images_before: int) -> bool:
        """Whether the camera counts exactly one image more than it did."""
        return images_before >= 0 and self._count == images_before + 1

    def identified(self, photo: ev.Photo) -> ev.Photo:
        """The photo of a trigger, with what the camera remembers of it; as it is, where that is nothing."""
        if photo.image_index >= 0 or photo.file:
            return photo
        triggered = photo.capture_time_utc_s
        fitting = [
            other
            for other in self._left
            if -SLACK_S <= other.exposed_utc_s - triggered <= self._window_s + SLACK_S  # NaN: never
        ]
        if not fitting:
            return photo
        found = min(fitting, key=lambda other: abs(other.exposed_utc_s - triggered))
        self._left.remove(found)
        return evidence.with_evidence(photo, found.evidence)

    def since(self, time_utc_s: float) -> tuple[ev.Photo, ...]:
        """Photos exposed after a moment: those of an attempt of which nothing else is known."""
        found = [other for other in self._left if other.exposed_utc_s >= time_utc_s - SLACK_S]
        self._left = [other for other in self._left if other not in found]
        return tuple(_filed(number, other) for number, other in enumerate(found, start=1))


def _filed(number: int, remembered: RememberedPhoto) -> ev.Photo:
    photo = ev.Photo(number=number, evidence=EvidenceLevel.COMMANDED, capture_time_utc_s=remembered.exposed_utc_s)
    return evidence.with_evidence(photo, remembered.evidence)
