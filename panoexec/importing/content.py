"""A pairing confirmed by content: where photos overlap, they must show the same thing where their attitudes say.

One photo that contradicts its neighbours may have a wrong attitude; several of them have been paired wrongly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from panoexec.angles import rotation_from_quaternion
from panoexec.formats.jpeg_header import read_jpeg_header
from panoexec.importing.card import CardPhoto
from panoexec.importing.pairing import Expected
from panoexec.mission.log.record import MissionRecord
from panoexec.planning.model import Plan

_LEAST: Final = 2
_SHARE: Final = 0.05
_NAMED: Final = 8


def contradictions(
    pairs: Sequence[tuple[Expected, CardPhoto]], *, record: MissionRecord, plan: Plan
) -> tuple[list[str], str]:
    """Examine the photos of accepted attempts with a measured attitude; blocks, some tenths of a second a photo.

    Args:
        pairs: of the mission.
        record: of the mission.
        plan: of the mission.

    Returns:
        What contradicts the pairing, a line each; and what is known of the content, in words.
    """
    from panoexec.pictures.examiner import Examiner  # noqa: PLC0415  (it imports Pillow)
    from panoexec.pictures.model import Content, PhotoToCheck  # noqa: PLC0415

    examiner = Examiner(plan.camera)
    examined = 0
    for item, photo in pairs:
        attempt = record.shots[item.shot].attempts[item.attempt - 1]
        measured = None if attempt.exposed is None else attempt.exposed.measured
        if not item.accepted or item.photo != 1 or measured is None or not _is_upright(photo, plan):
            continue
        rotation = rotation_from_quaternion(np.array(measured.q_wxyz, dtype=np.float64))
        examiner.add(PhotoToCheck(shot=item.shot, rotation=rotation, time_s=item.time_s), photo.path.read_bytes())
        examined += 1
    if not examined:
        return [], "content unchecked: no photo with a measured attitude whose pixels are stored upright"
    found = examiner.verdicts(final=True).photos
    against = [shot for shot, one in found.items() if one.verdict in {Content.CONTRADICTS, Content.UNTIED}]
    tied = [shot for shot, one in found.items() if one.verdict is Content.OK]
    told = f"content: {len(tied)} of {examined} photos are tied to their neighbours, {len(against)} contradict them"
    if len(against) >= _LEAST and len(against) > _SHARE * (len(against) + len(tied)):
        named = ", ".join(map(str, sorted(against)[:_NAMED])) + (", …" if len(against) > _NAMED else "")
        return [f"the content of {len(against)} photos contradicts the pairing (shots {named})"], told
    return [], told


def _is_upright(photo: CardPhoto, plan: Plan) -> bool:
    """Whether the pixels are stored as the profile says; others would have to be turned first."""
    try:
        header = read_jpeg_header(photo.path)
    except (OSError, ValueError):
        return False
    return header.orientation <= 1 and (header.height_px > header.width_px) == plan.camera.is_portrait
