"""How the stored pixels of photos are turned, judged over all photos of a mission.

All photos of a mission come from one camera in one mount, so the upright image has the profile's format. Files whose
pixels have the other format are turned by a quarter, whatever they say; of others a quarter is not believed. Which
quarter, or which way up, EXIF says; where the camera looks steeply down its sense of gravity says nothing about the
turn, and the other photos are believed instead.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from panoexec.exports.model import ExportShot
from panoexec.optics import Camera

UPRIGHT: Final = (1, 3)
QUARTERS: Final = (6, 8)
STEEP_DEG: Final = -60.0
"""Below this elevation one photo's orientation is not believed against the others'."""


def with_believed_orientation(shots: Sequence[ExportShot], camera: Camera) -> tuple[ExportShot, ...]:
    """The shots with the orientation that is believed, in EXIF's numbers; unchanged where no file was seen.

    Args:
        shots: with the size and orientation of their files.
        camera: in its mounting orientation.
    """
    usual = {turned: _usual(shots, camera, turned=turned) for turned in (False, True)}
    return tuple(
        replace(shot, orientation=_believed(shot, usual[is_turned(shot, camera)], is_turned(shot, camera)))
        if shot.width_px
        else shot
        for shot in shots
    )


def is_turned(shot: ExportShot, camera: Camera) -> bool:
    """Whether the stored pixels have the other format than the upright image."""
    return shot.width_px != shot.height_px and (shot.height_px > shot.width_px) != camera.is_portrait


def _usual(shots: Sequence[ExportShot], camera: Camera, *, turned: bool) -> int:
    """The orientation of most files, by those that are not steep if there are any."""
    possible = QUARTERS if turned else UPRIGHT
    flags = [shot for shot in shots if shot.width_px and is_turned(shot, camera) == turned]
    flags = [shot for shot in flags if shot.orientation in possible]
    level = [shot for shot in flags if shot.target_pitch_deg >= STEEP_DEG]
    counted = Counter(shot.orientation for shot in level or flags)
    return counted.most_common(1)[0][0] if counted else possible[0]


def _believed(shot: ExportShot, usual: int, turned: bool) -> int:
    possible = QUARTERS if turned else UPRIGHT
    is_steep = shot.target_pitch_deg < STEEP_DEG
    return shot.orientation if shot.orientation in possible and not is_steep else usual
