"""Attempts that a crash left open: settled by what the camera remembers, or taken again."""

from __future__ import annotations

from panoexec import events as ev
from panoexec.devices import CaptureEvidence
from panoexec.errors import DeviceError
from panoexec.mission import evidence
from panoexec.mission.flight import Flight
from panoexec.mission.protocols import PhotoMemory
from panoexec.mission.record import ShotRecord


async def settle_open_attempts(flight: Flight) -> None:
    """Give every attempt that has no verdict one.

    A photo whose pointing was proven before the crash counts when the camera remembers a photo newer than the last one
    that is accounted for. An attempt that had not come that far is rejected: whether its photo exists or not, nothing
    is known of its pose.
    """
    for index, record in sorted(flight.record.shots.items()):
        attempt = record.open_attempt
        if attempt is None:
            continue
        found = await _remembered(flight, record)
        if found is not None:
            photos = (evidence.with_evidence(attempt.photos[0], found),)
            by = "open_loop" if attempt.exposed is not None and attempt.exposed.open_loop else "tolerance"
            flight.recorder.emit(ev.ShotAccepted(shot=index, attempt=attempt.number, photos=photos, by=by))
            flight.queue.drop(index)
            continue
        reason = "panoexec stopped before its photo was proven"
        flight.recorder.emit(
            ev.ShotRejected(shot=index, attempt=attempt.number, code="crash", reason=reason, photos=attempt.photos)
        )
        flight.recorder.emit(ev.ShotRetaken(shot=index, attempt=attempt.number + 1, reason=reason))


async def _remembered(flight: Flight, record: ShotRecord) -> CaptureEvidence | None:
    attempt = record.open_attempt
    memory = flight.camera
    if attempt is None or attempt.exposed is None or not attempt.exposed.pointing_ok:
        return None
    if len(attempt.photos) != 1 or flight.settings.brackets != 1 or not isinstance(memory, PhotoMemory):
        return None
    known = [photo.image_index for r in flight.record.shots.values() for a in r.attempts for photo in a.photos]
    try:
        found = await memory.taken_after(max(known, default=-1))
    except DeviceError:
        return None
    return found if found is not None and found.level >= flight.settings.min_evidence else None
