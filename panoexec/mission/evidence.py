"""Evidence from the camera, and what a mission records of a photo."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from panoexec.devices import CaptureEvidence, EvidenceLevel, PendingCapture
from panoexec.errors import DeviceError
from panoexec.mission.log.events import Photo


def first_photos(trigger_utc_s: Sequence[float], captures: Sequence[PendingCapture]) -> tuple[Photo, ...]:
    """Photos of which only the trigger is known: sent, and acknowledged where the camera acknowledges triggers."""
    return tuple(
        Photo(
            number=number,
            evidence=EvidenceLevel.COMMANDED if math.isnan(capture.acknowledged_s) else EvidenceLevel.ACKNOWLEDGED,
            capture_time_utc_s=stamp,
        )
        for number, (stamp, capture) in enumerate(zip(trigger_utc_s, captures, strict=True), start=1)
    )


def with_evidence(photo: Photo, found: CaptureEvidence) -> Photo:
    """The photo with better evidence; fields that the evidence lacks are kept."""
    if found.level < photo.evidence:
        return photo
    return replace(
        photo,
        evidence=found.level,
        capture_time_utc_s=photo.capture_time_utc_s if math.isnan(found.time_utc_s) else found.time_utc_s,
        image_index=found.image_index if found.image_index >= 0 else photo.image_index,
        file=found.file_url or photo.file,
        latitude_deg=found.latitude_deg,
        longitude_deg=found.longitude_deg,
        altitude_m=found.altitude_m,
        duplicates=found.duplicates,
    )


async def gather(
    photos: Sequence[Photo], captures: Sequence[PendingCapture], *, at_least: EvidenceLevel, timeout_s: float
) -> tuple[Photo, ...]:
    """Await evidence of each photo, at most `timeout_s` from its trigger."""
    out = []
    for photo, capture in zip(photos, captures, strict=True):
        try:
            found = await capture.evidence(at_least, timeout_s)
        except DeviceError:
            out.append(photo)  # no more evidence will arrive; the verdict follows from the level reached
        else:
            out.append(with_evidence(photo, found))
    return tuple(out)


def weakest(photos: Sequence[Photo]) -> EvidenceLevel:
    """The lowest evidence level among the photos."""
    return min(photo.evidence for photo in photos)
