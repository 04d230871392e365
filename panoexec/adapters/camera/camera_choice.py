"""Which of several cameras takes the photos, and why. Pure logic; daemon and `doctor` choose by it alike.

Every component that says that it is a camera (MAV_TYPE_CAMERA) is asked what it can do: CAMERA_INFORMATION (259) has
flags (CAMERA_CAP_FLAGS). A streamer of video is such a component as well, often the first one, and takes no photos.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

CAPTURES_VIDEO: Final = 1
CAPTURES_IMAGES: Final = 2
HAS_MODES: Final = 4
STREAMS_VIDEO: Final = 256
LAST_OF_AUTOPILOT: Final = 6
"""Camera ids up to this are shutters of the autopilot."""
_ABILITIES: Final = ((CAPTURES_IMAGES, "photos"), (CAPTURES_VIDEO, "video"), (STREAMS_VIDEO, "video stream"))


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCandidate:
    """What a component tells of itself.

    Attributes:
        component: its MAVLink component; 1 to 6 are shutters of the autopilot.
        vendor, model: as told, or "".
        image_width_px, image_height_px: 0 if not told.
        focal_length_mm: of its lens; NaN or 0 if not told.
        flags: CAMERA_CAP_FLAGS.
    """

    component: int
    vendor: str = ""
    model: str = ""
    image_width_px: int = 0
    image_height_px: int = 0
    focal_length_mm: float = math.nan
    flags: int = 0

    @property
    def by_autopilot(self) -> bool:
        """Whether it is a shutter of the autopilot."""
        return self.component <= LAST_OF_AUTOPILOT

    @property
    def takes_photos(self) -> bool:
        """Whether it says so; of a shutter the autopilot may say nothing at all (ArduPilot up to 4.5)."""
        return bool(self.flags & CAPTURES_IMAGES) or (self.by_autopilot and not self.flags)

    @property
    def abilities(self) -> str:
        """What it can do, for people."""
        if self.by_autopilot and not self.flags:
            return "photos"
        return ", ".join(text for flag, text in _ABILITIES if self.flags & flag) or "nothing that it tells"

    @property
    def label(self) -> str:
        """Which camera it is, for people."""
        unnamed = "a shutter of the autopilot" if self.by_autopilot else "unnamed"
        return f"{f'{self.vendor} {self.model}'.strip() or unnamed}, component {self.component}"

    @property
    def summary(self) -> str:
        """Which camera it is and what it can do."""
        return f"{self.label}: {self.abilities}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The chosen camera and the reason for the choice."""

    camera: CameraCandidate
    reason: str


def choose(
    candidates: Iterable[CameraCandidate], *, component: int = 0, image_px: tuple[int, int] | None = None
) -> Choice | None:
    """The camera to use; None if there is none yet.

    The configured component first; else of the cameras with a component of their own that take photos the one with the
    image size of the profile, else the lowest component; else a shutter of the autopilot.

    Args:
        candidates: all that told what they are.
        component: `[camera] component`, 0 for any.
        image_px: image size of the profile, in any order.
    """
    known = sorted(candidates, key=lambda one: one.component)
    if component:
        return next((_configured(one) for one in known if one.component == component and _may_be_configured(one)), None)
    own = [one for one in known if one.takes_photos and not one.by_autopilot]
    shutters = [one for one in known if one.takes_photos and one.by_autopilot]
    if len(own) == 1:
        return Choice(camera=own[0], reason="the only camera that takes photos")
    if own:
        sized = [one for one in own if image_px and {one.image_width_px, one.image_height_px} == set(image_px)]
        if len(sized) == 1:
            return Choice(camera=sized[0], reason="the only camera with the image size of the profile")
        return Choice(camera=own[0], reason="the lowest component of those that take photos")
    return Choice(camera=shutters[0], reason="no other camera takes photos") if shutters else None


def _may_be_configured(one: CameraCandidate) -> bool:
    """A camera that tells nothing of itself may be one; one that tells what it can do is believed."""
    return one.takes_photos or not one.flags


def _configured(one: CameraCandidate) -> Choice:
    return Choice(camera=one, reason="[camera] component")


def why_none(candidates: Sequence[CameraCandidate], *, component: int) -> str:
    """Why none of those that told what they are can be used; "" if nothing speaks against them."""
    others = [one for one in candidates if one.takes_photos and one.component != component]
    if component:
        wrong = [one for one in candidates if one.component == component and not _may_be_configured(one)]
        if wrong:
            text = f"component {component} is configured, but takes no photos ({wrong[0].summary})"
            return text + (f"; {others[0].label} does" if others else "")
        return ""
    mute = [one for one in candidates if not one.takes_photos]
    return "; ".join(f"component {one.component} takes no photos ({one.summary})" for one in mute)
