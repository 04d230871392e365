"""How long the rest of a mission will take, learned while flying."""

from __future__ import annotations

import math


class EtaEstimator:
    """Learns the seconds a shot costs while flying, and estimates the rest.

    The first guess comes from the plan; each accepted shot then pulls the estimate by `weight` (an exponentially
    weighted mean, so that a change of wind or light is followed within a few shots).
    """

    def __init__(self, *, expected_shot_s: float, weight: float = 0.1) -> None:
        self._shot_s = expected_shot_s
        self._weight = weight
        self._last_s = math.nan
        self._samples = 0

    @property
    def shot_s(self) -> float:
        """Seconds a shot costs now, retakes included."""
        return self._shot_s

    def restart(self, now_s: float) -> None:
        """Shooting begins, or goes on after a pause."""
        self._last_s = now_s

    def accepted(self, now_s: float) -> None:
        """A shot was accepted."""
        if not math.isnan(self._last_s):
            self._samples += 1
            weight = max(self._weight, 1 / (self._samples + 1))
            self._shot_s += weight * (now_s - self._last_s - self._shot_s)
        self._last_s = now_s

    def eta_s(self, shots_left: int) -> float:
        """Seconds until that many shots are taken."""
        return shots_left * self._shot_s
