"""The vehicle's heading at the time of a gimbal's report, for gimbals that report it (`delta_yaw` of message 285).

A gimbal in the vehicle's frame reports its yaw relative to the heading, and a multirotor in wind yaws at 15° a second
and more (measured: ArduCopter SITL, 8 m/s). If the report is paired with the autopilot's ATTITUDE by arrival, a delay
of 50 ms between the two streams causes an error of 0.7°. The heading in the gimbal's report has the same time as its
angles, but may drift if it comes from the gimbal's gyroscopes. So this is a complementary filter: fast changes come
from the gimbal's heading, slow ones from the autopilot's.
"""

from __future__ import annotations

import math
from typing import Final

_SLOW_S: Final = 10.0
"""Time constant: slower differences between the two headings count as the gimbal's drift."""
_FRESH_S: Final = 1.0
"""Greatest age of the autopilot's heading."""
_SAME_MOMENT_S: Final = 0.03
"""Headings further apart in time are not compared; a turn would be taken for drift."""
_EARLY_S: Final = 0.1
"""An autopilot's heading up to this much later than the gimbal's report counts as simultaneous."""
_SURE_S: Final = 1.0
"""A difference that is told was averaged for so long."""
_JUMP_DEG: Final = 20.0
"""A larger change of the difference is neither jitter nor drift: the gimbal has reset its heading."""


class HeadingFilter:
    """Combines the two headings; fed from one thread, in the order of arrival."""

    def __init__(self) -> None:
        self._vehicle_deg = math.nan
        self._vehicle_s = -math.inf
        self._drift_deg = math.nan
        self._since_s = 0.0
        self._noted_s = 0.0

    @property
    def difference_deg(self) -> float:
        """The gimbal's heading minus the autopilot's, averaged; NaN before it was compared for `_SURE_S`."""
        return self._drift_deg if self._noted_s - self._since_s >= _SURE_S else math.nan

    def vehicle(self, heading_deg: float, received_s: float) -> None:
        """Take the autopilot's heading."""
        self._vehicle_deg, self._vehicle_s = heading_deg, received_s

    def gimbal(self, heading_deg: float, received_s: float) -> float:
        """The heading at the time of a gimbal's report.

        Args:
            heading_deg: as the gimbal reports it; NaN if it does not. Exactly 0 counts as not reported: it is the value
                of a field that older gimbals do not send.
            received_s: when the report arrived.

        Returns:
            Degrees; NaN if it is not reported, or cannot be compared with the autopilot's.
        """
        # the senders' clocks are known to some milliseconds, so the autopilot's heading may seem to be the later one
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
            # a plain mean at first, so that the first difference does not dominate for ten seconds
            memory_s = min(max(received_s - self._since_s, 0.02), _SLOW_S)
            step_s = min(received_s - self._noted_s, memory_s)
            self._drift_deg = _wrap(self._drift_deg + change * step_s / memory_s)
            self._noted_s = received_s
        return _wrap(heading_deg - self._drift_deg)


def _wrap(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0
