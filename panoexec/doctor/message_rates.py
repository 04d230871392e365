"""How often messages really arrive, by sender."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """What one component sent.

    Attributes:
        component: its MAVLink component.
        hz: messages a second.
        gap_s: longest time between two of them, the time to the end of the measurement included.
    """

    component: int
    hz: float
    gap_s: float


class MessageRates:
    """Counts messages of one name from `start` on; counting happens in the vendor's thread."""

    def __init__(self, link: MavsdkLink, name: str) -> None:
        self.name = name
        self._link = link
        self._times: dict[int, list[float]] = {}
        self._begin_s = 0.0
        self._off: Callable[[], None] = lambda: None

    def start(self) -> None:
        """Begin to count."""
        self._begin_s = self._link.clock.monotonic()
        self._off = self._link.on(self.name, self._arrived)

    def stop(self) -> list[Rate]:
        """End; what each component sent, the fastest first. Seconds of the mission's clock."""
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
