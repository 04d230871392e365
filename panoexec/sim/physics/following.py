"""The time of an autopilot, for a payload that is joined to it and must not live faster or slower than that."""

from __future__ import annotations

from typing import Final

AHEAD_S: Final = 0.03
"""How far beyond the autopilot's last word the payload goes by itself: one and a half intervals of that message."""
SILENT_S: Final = 1.0
"""Real seconds without a word after which the payload goes by its own clock again."""

GRAIN_S: Final = 0.05
"""How well moments can be told apart: payload and mission each have a stamp every 20 ms and go on by themselves between
them, so that two seconds of the one may be 1.96 s of the other."""

_WRAP_US: Final = 1 << 32
_MOST_S: Final = 60.0


class AutopilotTime:
    """Turns the time stamps of AUTOPILOT_STATE_FOR_GIMBAL_DEVICE (286) into simulated time.

    ArduPilot counts microseconds since boot in 32 bits, which overflow after 71.6 minutes; and it may restart.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._now_s = 0.0

    def at(self, boot_us: int, now_s: float) -> float:
        """The simulated time of a stamp.

        Args:
            boot_us: the stamp.
            now_s: simulated time when it arrived: what it means the first time, after a restart or a long silence.
        """
        passed_s = _MOST_S if self._last_us is None else (boot_us - self._last_us) % _WRAP_US * 1e-6
        self._last_us = boot_us
        self._now_s = now_s if passed_s >= _MOST_S else self._now_s + passed_s
        return self._now_s

    def forget(self) -> None:
        """It was silent: its next word says nothing of the time between."""
        self._last_us = None
