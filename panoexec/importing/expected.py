"""The photos that the attempts of a mission took, with their times, as its journal tells."""

from __future__ import annotations

import math

from panoexec.importing.pairing import Expected
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import AttemptRecord, Verdict

_PLAUSIBLE_S = 10.0
"""A capture time that is further from the verdict on the exposure is of a clock that is not this computer's."""


def expected_photos(record: MissionRecord, *, mission: str = "") -> list[Expected]:
    """The photos that were triggered, in the order of their times.

    Args:
        record: of the mission.
        mission: its id; "" for the mission that is imported.
    """
    attempts = [(index, attempt) for index, shot in record.shots.items() for attempt in shot.attempts]
    own_clock = all(_is_of_own_clock(attempt) for _, attempt in attempts)
    found = [
        Expected(
            mission=mission,
            shot=index,
            attempt=attempt.number,
            photo=photo.number,
            time_s=photo.capture_time_utc_s if own_clock else attempt.exposed.time_utc_s,
            accepted=attempt.verdict is Verdict.ACCEPTED,
        )
        for index, attempt in attempts
        if attempt.exposed is not None
        for photo in attempt.photos
    ]
    return sorted(found, key=lambda one: one.time_s)


def _is_of_own_clock(attempt: AttemptRecord) -> bool:
    """Whether the capture times are of this computer's clock, or of one that agrees with it."""
    if attempt.exposed is None:
        return True
    off = [attempt.exposed.time_utc_s - photo.capture_time_utc_s for photo in attempt.photos]
    return all(math.isfinite(value) and abs(value) < _PLAUSIBLE_S for value in off)
