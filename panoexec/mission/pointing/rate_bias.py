"""The bias of a gimbal's gyroscopes: what its angular rates tell beside the motion that its angles show.

A rate of 0.3°/s that is none would make every pose look as if it were about to leave its tolerance. Where a pose is
held, the mean of the rates over 0.2 s less the slope of the angles in that time is their bias and noise; the median of
many such times is the bias.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Final, TypeAlias

import numpy as np

from panoexec.mission.pointing.unseen_motion import slope

Triple: TypeAlias = tuple[float, float, float]
"""Of pitch, roll and yaw."""

_SPAN_S: Final = 0.2
_LEAST_READINGS: Final = 5
_LEAST_TIMES: Final = 3
_REMEMBERED: Final = 25
_SLACK_S: Final = 1e-6


class RateBias:
    """Learns the bias of the rates of one gimbal; outlives its poses."""

    def __init__(self) -> None:
        self._held: list[tuple[float, Triple, Triple]] = []
        self._found: deque[Triple] = deque(maxlen=_REMEMBERED)

    @property
    def rates_deg_s(self) -> Triple:
        """The bias about pitch, roll and yaw; 0 until it is known, and of a rate that is not told."""
        return self._median(0), self._median(1), self._median(2)

    def _median(self, axis: int) -> float:
        told = [one[axis] for one in self._found if math.isfinite(one[axis])]
        return median(told) if len(told) >= _LEAST_TIMES else 0.0

    def note(self, time_s: float, errors_deg: Triple, rates_deg_s: Triple) -> None:
        """Take the errors and rates of a reading of a pose that is held."""
        self._held.append((time_s, errors_deg, rates_deg_s))
        if time_s - self._held[0][0] < _SPAN_S - _SLACK_S:
            return
        if len(self._held) >= _LEAST_READINGS:
            times, errors, rates = (np.array(part) for part in zip(*self._held, strict=True))
            pitch, roll, yaw = (float(rates[:, k].mean()) - slope(times, errors[:, k]) for k in range(3))
            self._found.append((pitch, roll, yaw))
        self._held.clear()

    def interrupt(self) -> None:
        """The pose is not held, or a reading is unusable."""
        self._held.clear()
