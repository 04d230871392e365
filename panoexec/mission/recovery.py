"""Recovery after a crash: open attempts get a verdict from the camera's own records, or are taken again.

The journal shows how far an attempt came. Without its `ShotExposed` the pose during the exposure is unknown: a photo
that the camera reports is recorded, and the shot is taken again. With it, pointing is judged already and only the
evidence of the photo is missing. Photos are matched by time: the journal has the trigger time, and cameras report the
exposure time. Without a time the image count decides: exactly one more than before the trigger.

The pose was judged for as long as the shutter was expected to need. That is known of the photos before it; the first
one of a process counts only if its time tells that it was no later.
"""

from __future__ import annotations

import math
from typing import Final

from panoexec.devices import CaptureEvidence, EvidenceLevel, RecalledPhoto, RecalledPhotos
from panoexec.errors import DeviceError
from panoexec.mission import evidence
from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.log.shot_record import AttemptRecord, Verdict
from panoexec.mission.measured_certificate import overlaps_hold
from panoexec.mission.protocols import PhotoRecall
from panoexec.mission.waiting import until, within

RECALL_S: Final = 6.0
"""Timeout for the camera's list of its latest photos."""
TRIES: Final = 2
AGAIN_AFTER_S: Final = 0.5
SLACK_S: Final = 0.25
"""Tolerance between wall clock and exposure times, before and after the possible exposure window."""
DATED_S: Final = 0.05
"""How far the time of a photo may be off where it decides whether its pose was judged."""
BEFORE: Final = "panoexec stopped before the photo was taken"
UNKNOWN: Final = "panoexec stopped before there was evidence of the photo"
UNREPORTED: Final = "the camera reported other photos, but not this one"
UNJUDGED: Final = "panoexec stopped before the pointing during the exposure was recorded"


async def settle_open_attempts(context: MissionContext) -> None:
    """Settle every open attempt; photos without a file name get it from the camera if it reports one.

    If the mission is interrupted meanwhile, all attempts stay open for the next process.
    """
    shots = context.record.shots
    if not any(record.open_attempt or _anonymous(attempt) for record in shots.values() for attempt in record.attempts):
        return
    _, recollection = await until(context.requests.stopping.wait(), _recall(context), "recall photos")
    if context.requests.stop is not None and context.requests.stop.kind == "interrupt":
        return
    photos = _Photos(context, recollection or RecalledPhotos())
    for index, record in sorted(shots.items()):
        for attempt in record.attempts:
            if attempt.exposed is not None and attempt.verdict is not Verdict.OPEN and _anonymous(attempt):
                better = tuple(photos.identified(photo) for photo in attempt.photos)
                if better != attempt.photos:
                    context.recorder.emit(ev.PhotoIdentified(shot=index, attempt=attempt.number, photos=better))
    _revoke_unreported(context)
    # attempts with a known exposure claim their photos first
    for exposed in (True, False):
        for index, record in sorted(shots.items()):
            unsettled = record.open_attempt
            if unsettled is not None and (unsettled.exposed is not None) is exposed:
                await _settle(context, index, unsettled, photos)


def _revoke_unreported(context: MissionContext) -> None:
    """Revoke photos that an earlier process accepted by a count alone before the camera reported its first one."""
    for index, record in sorted(context.record.shots.items()):
        for attempt in record.attempts:
            level = evidence.weakest(attempt.photos) if attempt.photos else EvidenceLevel.COMMANDED
            if attempt.verdict is Verdict.ACCEPTED and level < context.record.reported_level:
                revoked = ev.ShotRevoked(shot=index, attempt=attempt.number, code="evidence", reason=UNREPORTED)
                context.recorder.emit(revoked)
                if record.accepted is None and record.open_attempt is None and index not in context.queue:
                    context.queue.add(index)


def _anonymous(attempt: AttemptRecord) -> bool:
    return any(photo.image_index < 0 and not photo.file for photo in attempt.photos)


async def _recall(context: MissionContext) -> RecalledPhotos:
    """The camera's latest photos; empty if it cannot report them or does not answer."""
    memory = context.camera
    if not isinstance(memory, PhotoRecall):
        return RecalledPhotos()
    for left in reversed(range(TRIES)):
        try:
            return await within(context.clock, RECALL_S, memory.recall(), "recall photos")
        except (DeviceError, TimeoutError):
            if left:
                await context.clock.sleep(AGAIN_AFTER_S)
    return RecalledPhotos()


async def _settle(context: MissionContext, index: int, attempt: AttemptRecord, recalled: _Photos) -> None:
    exposed, settings = attempt.exposed, context.settings
    if exposed is None:
        photos = recalled.since(attempt.started_utc_s)
        if not photos and recalled.has_times:
            context.recorder.emit(ev.ShotInterrupted(shot=index, attempt=attempt.number, reason=BEFORE))
            return
        reason = UNJUDGED if photos else UNKNOWN
    else:
        lag_known = _is_lag_known(context, attempt)
        latest_s = math.inf if lag_known else settings.latency_s + DATED_S
        photos = tuple(recalled.identified(photo, latest_s=latest_s) for photo in attempt.photos)
        if len(photos) == 1 and lag_known and recalled.is_one_more_than(exposed.images_before):
            counted = CaptureEvidence(level=EvidenceLevel.COUNTED, received_s=math.nan)
            photos = (evidence.with_evidence(photos[0], counted),)
        proven = evidence.weakest(photos) >= max(settings.min_evidence, context.record.reported_level)
        by = ""
        if exposed.pointing_ok:
            by = "open_loop" if exposed.open_loop else "tolerance"
        elif exposed.may_overlap and proven and await overlaps_hold(context, index, exposed.measured):
            by = "overlap"
        if by and len(photos) == settings.brackets and proven:
            context.recorder.emit(ev.ShotAccepted(shot=index, attempt=attempt.number, photos=photos, by=by))
            context.queue.drop(index)
            return
        reason = UNKNOWN if exposed.pointing_ok else exposed.reason
    context.recorder.emit(
        ev.ShotRejected(shot=index, attempt=attempt.number, code="crash", reason=reason, photos=photos)
    )
    context.recorder.emit(ev.ShotRetaken(shot=index, attempt=attempt.number + 1, reason=reason))


def _is_lag_known(context: MissionContext, attempt: AttemptRecord) -> bool:
    """Whether an earlier photo of the same process had shown how late the camera's shutter is."""
    attempts = (one for record in context.record.shots.values() for one in record.attempts)
    return any(
        one.process == attempt.process and one.seq < attempt.seq and one.verdict is Verdict.ACCEPTED for one in attempts
    )


class _Photos:
    """The photos reported by the camera that no attempt has claimed yet."""

    def __init__(self, context: MissionContext, recollection: RecalledPhotos) -> None:
        attempts = [attempt for record in context.record.shots.values() for attempt in record.attempts]
        known = {photo.image_index for attempt in attempts for photo in attempt.photos} - {-1}
        self._window_s = context.settings.exposure_bound_s
        self._count = recollection.image_count
        self.has_times = any(math.isfinite(photo.exposed_utc_s) for photo in recollection.photos)
        """Whether exposure times are reported, so that a photo that is not listed was not taken."""
        self._left = [photo for photo in recollection.photos if photo.evidence.image_index not in known]

    def is_one_more_than(self, images_before: int) -> bool:
        """Whether the camera's image count is exactly one more than before."""
        return images_before >= 0 and self._count == images_before + 1

    def identified(self, photo: ev.Photo, *, latest_s: float = math.inf) -> ev.Photo:
        """The photo of a trigger with the evidence of the matching reported photo; unchanged if none matches.

        Args:
            photo: of the trigger.
            latest_s: a photo that was exposed later after the trigger does not match.
        """
        if photo.image_index >= 0 or photo.file:
            return photo
        triggered = photo.capture_time_utc_s
        fitting = [
            other
            for other in self._left
            if -SLACK_S <= other.exposed_utc_s - triggered <= min(latest_s, self._window_s + SLACK_S)  # NaN: no match
        ]
        if not fitting:
            return photo
        found = min(fitting, key=lambda other: abs(other.exposed_utc_s - triggered))
        self._left.remove(found)
        return evidence.with_evidence(photo, found.evidence)

    def since(self, time_utc_s: float) -> tuple[ev.Photo, ...]:
        """Claim the photos exposed after a time: those of an attempt without a recorded exposure."""
        found = [other for other in self._left if other.exposed_utc_s >= time_utc_s - SLACK_S]
        self._left = [other for other in self._left if other not in found]
        return tuple(_filed(number, other) for number, other in enumerate(found, start=1))


def _filed(number: int, recalled: RecalledPhoto) -> ev.Photo:
    photo = ev.Photo(number=number, evidence=EvidenceLevel.COMMANDED, capture_time_utc_s=recalled.exposed_utc_s)
    return evidence.with_evidence(photo, recalled.evidence)
