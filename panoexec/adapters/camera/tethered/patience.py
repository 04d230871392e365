"""How long a tethered camera may take."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """How long things may take before something is done about it, seconds.

    Attributes:
        open_s: opening the camera and listing its card.
        call_s: a trigger, until the process is killed.
        list_s: a listing, until the process is killed.
        back_s: how long a trigger waits for a camera that is being opened anew.
        late_s: how long after a trigger, or after the camera answers again, its photo may still come.
        missing_s: how long after a trigger the camera is not disturbed by a listing: it opens the camera anew.
        look_s: between two looks for a photo that is missing.
    """

    open_s: float = 25.0
    call_s: float = 4.0
    list_s: float = 15.0
    back_s: float = 8.0
    late_s: float = 10.0
    missing_s: float = 3.0
    look_s: float = 0.25
