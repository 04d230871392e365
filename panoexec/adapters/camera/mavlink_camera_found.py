"""What discovery found of a camera behind MAVLink."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class MavlinkCameraFound:
    """What discovery found; implements `CameraFound`.

    Attributes:
        component: its MAVLink component; 1 to 6 are shutters of the autopilot.
        vendor, model: as reported, or "".
        image_width_px, image_height_px: 0 if not reported.
        focal_length_mm: NaN or 0 if not reported.
        feedback_pin: the autopilot reports the hot-shoe signal and not only the trigger.
        own_trigger: it is PX4's own trigger on an output pin, which is no MAVLink camera.
        why: why this camera was chosen.
    """

    component: int
    vendor: str = ""
    model: str = ""
    image_width_px: int = 0
    image_height_px: int = 0
    focal_length_mm: float = math.nan
    feedback_pin: bool = False
    own_trigger: bool = False
    why: str = ""

    @property
    def by_autopilot(self) -> bool:
        """Whether the autopilot triggers it."""
        return self.component <= 6

    @property
    def label(self) -> str:
        """See `CameraFound.label`."""
        name = f"{self.vendor} {self.model}".strip() or (
            ("PX4's camera trigger" if self.own_trigger else "a shutter of the autopilot")
            if self.by_autopilot
            else "unnamed"
        )
        return f"{name}, component {self.component}"

    @property
    def is_two_way(self) -> bool:
        """See `CameraFound.is_two_way`; of a shutter, the autopilot answers for it."""
        return True

    @property
    def may_tell_files(self) -> bool:
        """See `CameraFound.may_tell_files`."""
        return not self.by_autopilot
