"""The vehicle's heading at the moment of a gimbal's report, for gimbals that tell it (`delta_yaw` of message 285).

A gimbal in the vehicle's frame reports its yaw relative to the nose, and the nose of a multirotor in wind turns at
15° a second and more (measured: ArduCopter SITL, 8 m/s). Paired with the autopilot's ATTITUDE by arrival, a delay of
50 ms between the two streams is then 0.7° of error. What the gimbal says of the heading belongs to the same moment as
its angles; but its heading may drift, if it rests on its own gyroscopes. So: the gimbal's word for what is fast, the
autopilot's for what is slow.
"""

from __future__ import annotations

import math
from typing import Final

_SLOW_S: Final = 10.0
"""Differences between the two headings that last longer are the gimbal's drift."""
_FRESH_S: Final = 1.0
"""An autopilot's heading older than this is none."""
_SAME_MOMENT_S: Final = 0.03
"""Headings further apart in time tell nothing of the difference; a nose that turns would be taken for drift."""
_EARLY_S: Final = 0.1
"""One from so far ahead of a gimbal's report counts as one of its moment."""
_JUMP_DEG: Final = 20.0
"""A difference that changes by more than jitter and drift can (the gimbal has set its heading anew)."""


class HeadingFilter:
    """Blends the two; fed from one thread, in the order of arrival."""

    def __init__(self) -> None:
        self._vehicle_deg = math.nan
        self._vehicle_s = -math.inf
        self._drift_deg = math.nan
        self._since_s = 0.0
        self._noted_s = 0.0

    def vehicle(self, heading_deg: float, received_s: float) -> None:
        """Take the autopilot's heading."""
        self._vehicle_deg, self._vehicle_s = heading_deg, received_s

    def gimbal(self, heading_deg: float, received_s: float) -> float:
        """The heading at the moment of a gimbal's report.

        Args:
            heading_deg: as the gimbal tells it; NaN if it does not. Exactly 0 counts as not told: that is what the
                field holds that an older gimbal does not send.
            received_s: when the report arrived.

        Returns:
            Degrees; NaN if it is not told, or cannot be checked against the autopilot's.
        """
        # the clocks of two senders are known to some milliseconds: the autopilot's word may seem to be the later one
        fresh = -_EARLY_S <= received_s - self._vehicle_s <= _FRESH_S
        if heading_deg == 0 or not math.isfinite(heading_deg) or not fresh or math.isnan(self._vehicle_deg):
            self._drift_deg = math.nan
            return math.nan
        if received_s - self._vehicle_s > _SAME_MOMENT_S and math.isfinite(self._drift_deg):
            return _wrap(heading_deg - self._drift_deg)
        difference = _wrap(heading_deg - self._vehicle_deg)
        change = _wrap(difference - self._drift_deg) if math.isfinite(self._drift_deg) else math.inf
        if abs(change) > _JUMP_DEG:
            self._drift_deg, self._since_s, self._noted_s = difference, received_s, received_s
        else:
            # a plain mean at first, so that the first difference does not weigh for ten seconds
            memory_s = min(max(received_s - self._since_s, 0.02), _SLOW_S)
            step_s = min(received_s - self._noted_s, memory_s)
            self._drift_deg = _wrap(self._drift_deg + change * step_s / memory_s)
            self._noted_s = received_s
        return _wrap(heading_deg - self._drift_deg)


def _wrap(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0
