"""Estimate of a mission's remaining time, updated while it runs."""

from __future__ import annotations

import math


class EtaEstimator:
    """Measures the seconds per shot and estimates the remaining time.

    The initial value comes from the plan; each accepted shot updates an exponentially weighted mean with `weight`, so
    that the estimate follows a change of wind within a few shots.
    """

    def __init__(self, *, expected_shot_s: float, weight: float = 0.1) -> None:
        self._shot_s = expected_shot_s
        self._weight = weight
        self._last_s = math.nan
        self._samples = 0

    @property
    def shot_s(self) -> float:
        """Estimated seconds per shot, including retakes."""
        return self._shot_s

    def restart(self, now_s: float) -> None:
        """Shooting begins or continues after a pause; the time before does not count."""
        self._last_s = now_s

    def accepted(self, now_s: float) -> None:
        """A shot was accepted."""
        if not math.isnan(self._last_s):
            self._samples += 1
            weight = max(self._weight, 1 / (self._samples + 1))
            self._shot_s += weight * (now_s - self._last_s - self._shot_s)
        self._last_s = now_s

    def eta_s(self, shots_left: int) -> float:
        """Estimated seconds for that many shots."""
        return shots_left * self._shot_s
