"""What a simulated photo was taken with, and how a camera meters that is not set by hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

_BRIGHT_EV: Final = 2.0
"""How much brighter the sky is than the ground, to a camera that meters each photo by itself."""
_GROUND_S: Final = 0.004


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What a photo was taken with, for its EXIF.

    Attributes:
        exposure_s: shutter time.
        f_number: aperture.
        iso: sensitivity.
        manual_white_balance: not chosen by the camera.
    """

    exposure_s: float
    f_number: float = 5.6
    iso: int = 100
    manual_white_balance: bool = False


def metered(settings: Settings, pitch_deg: float) -> Settings:
    """The settings with the shutter time that a camera chooses which looks at that elevation."""
    brightness_ev = _BRIGHT_EV * min(1.0, max(0.0, pitch_deg / 30 + 0.5))
    return replace(settings, exposure_s=round(_GROUND_S * 2**-brightness_ev, 6))
