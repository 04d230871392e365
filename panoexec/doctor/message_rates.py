"""Measured message rates, by sender."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """Messages received from one component.

    Attributes:
        component: MAVLink component id.
        hz: messages per second.
        gap_s: longest interval between two messages, including the one up to the end of the measurement.
    """

    component: int
    hz: float
    gap_s: float


class MessageRates:
    """Counts messages of one name from `start` on, in MAVSDK's callback thread."""

    def __init__(self, link: MavsdkLink, name: str) -> None:
        self.name = name
        self._link = link
        self._times: dict[int, list[float]] = {}
        self._begin_s = 0.0
        self._off: Callable[[], None] = lambda: None

    def start(self) -> None:
        """Start counting."""
        self._begin_s = self._link.clock.monotonic()
        self._off = self._link.on(self.name, self._arrived)

    def stop(self) -> list[Rate]:
        """Stop counting; return the rate of each sender, the fastest first. Seconds are those of the mission clock."""
        self._off()
        end_s = self._link.clock.monotonic()
        out = []
        for component, times in self._times.items():
            moments = [self._begin_s, *times, end_s]
            gap_s = max(after - before for before, after in pairwise(moments))
            out.append(Rate(component=component, hz=len(times) / (end_s - self._begin_s), gap_s=gap_s))
        return sorted(out, key=lambda rate: -rate.hz)

    def _arrived(self, message: MavMessage) -> None:
        self._times.setdefault(message.component_id, []).append(message.received_s)
