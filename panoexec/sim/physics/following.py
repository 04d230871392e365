"""The time of a real autopilot, which an attached payload must follow."""

from __future__ import annotations

from typing import Final

AHEAD_S: Final = 0.03
"""How far the payload advances beyond the autopilot's last message: one and a half of its intervals."""
SILENT_S: Final = 1.0
"""Seconds of real time without a message after which the payload uses its own clock again."""

TIME_RESOLUTION_S: Final = 0.05
"""Time resolution: payload and mission each get a stamp every 20 ms and extrapolate in between, so that two seconds of
one may be 1.96 s of the other."""

_WRAP_US: Final = 1 << 32
_MOST_S: Final = 60.0


class AutopilotTime:
    """Converts the time stamps of AUTOPILOT_STATE_FOR_GIMBAL_DEVICE (286) into simulated time.

    ArduPilot counts microseconds since boot in 32 bits, which overflow after 71.6 minutes; and it may reboot.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._now_s = 0.0

    def at(self, boot_us: int, now_s: float) -> float:
        """The simulated time of a stamp.

        Args:
            boot_us: the stamp.
            now_s: simulated time of arrival: the result for the first stamp, after a reboot or after a long silence.
        """
        passed_s = _MOST_S if self._last_us is None else (boot_us - self._last_us) % _WRAP_US * 1e-6
        self._last_us = boot_us
        self._now_s = now_s if passed_s >= _MOST_S else self._now_s + passed_s
        return self._now_s

    def forget(self) -> None:
        """Reset after a silence: the next stamp sets a new offset."""
        self._last_us = None
