"""Buffer of the gimbal's attitude samples and of the airframe's attitudes."""

from __future__ import annotations

import asyncio
import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

from panoexec.adapters.gimbal.attitude_messages import interpolate
from panoexec.devices import AttitudeSample, VehicleAttitude

KEEP_S: Final = 60.0
"""How long samples are kept, on the mission's clock (`AttitudeFeed.since`)."""

PAIR_S: Final = 0.1
"""Greatest time difference between a sample and the airframe's attitude that it is paired with."""

SOURCE_SILENT_S: Final = 1.0
"""After this silence of the selected source another one is selected, unless it is pinned."""


class AttitudeBuffer:
    """Implements `AttitudeFeed`; for the event loop.

    An ArduPilot that drives a MAVLink gimbal sends a second, modified copy of the gimbal's reports (always in the
    vehicle frame, without rates and failure flags), so reports of the gimbal itself are preferred.
    """

    def __init__(self, *, autopilot_component: int = 1, ingest: Callable[[], None] = lambda: None) -> None:
        """Describe it.

        Args:
            autopilot_component: MAVLink's number of it.
            ingest: puts in the reports that have arrived.
        """
        self._autopilot_component = autopilot_component
        self._ingest = ingest
        self._samples: deque[AttitudeSample] = deque()
        self._vehicle: deque[VehicleAttitude] = deque()
        self._source: int | None = None
        self._source_s = -math.inf
        self._pinned: int | None = None
        self._waiters: list[asyncio.Future[None]] = []
        self.late_s = 0.0
        """See `AttitudeFeed.late_s`."""

    @property
    def source_component(self) -> int | None:
        """Component that the samples come from, None before the first."""
        return self._source

    @property
    def pinned(self) -> int | None:
        """The only component whose samples count; None as long as it may change."""
        return self._pinned

    def pin(self, component: int) -> None:
        """Let only the samples of that component count from now on, and forget those of others."""
        if component != self._source:
            self._samples.clear()
        self._pinned = self._source = component

    @property
    def is_awaited(self) -> bool:
        """Whether a task waits for the next sample; may be called in any thread."""
        return bool(self._waiters)

    def put_sample(self, sample: AttitudeSample, component: int) -> bool:
        """Add a report of the gimbal; False if another source is selected."""
        if not self.takes(component, sample.received_s):
            return False
        self._source, self._source_s = component, sample.received_s
        _keep(self._samples, sample)
        for waiter in self._waiters:
            if not waiter.done():
                waiter.set_result(None)
        return True

    def put_vehicle(self, attitude: VehicleAttitude) -> None:
        """Add an attitude of the airframe."""
        _keep(self._vehicle, attitude)

    def rebooted(self) -> None:
        """Forget the airframe's attitudes, whose time stamps mean nothing after a reboot."""
        self._ingest()
        self._vehicle.clear()

    def ingest(self) -> None:
        """See `AttitudeFeed.ingest`."""
        self._ingest()

    @property
    def latest(self) -> AttitudeSample | None:
        """See `AttitudeFeed.latest`."""
        return self._samples[-1] if self._samples else None

    def since(self, received_s: float) -> Sequence[AttitudeSample]:
        """See `AttitudeFeed.since`."""
        out: list[AttitudeSample] = []
        for sample in reversed(self._samples):
            if sample.received_s <= received_s:
                break
            out.append(sample)
        out.reverse()
        return out

    async def newer_than(self, received_s: float) -> AttitudeSample:
        """See `AttitudeFeed.newer_than`."""
        loop = asyncio.get_running_loop()
        while True:
            waiter = loop.create_future()
            self._waiters.append(waiter)
            try:
                self.ingest()  # after it was said that somebody waits: what comes from now on wakes the waiter
                found = self.since(received_s)
                if found:
                    return found[0]
                await waiter
            finally:
                self._waiters.remove(waiter)

    def vehicle_attitude_at(self, sample: AttitudeSample) -> VehicleAttitude | None:
        """See `AttitudeFeed.vehicle_attitude_at`; interpolated between two reports, extrapolated after the last.

        Paired by boot time if the autopilot stamped both, else by arrival (a gimbal has a clock of its own).
        """
        if self._source == self._autopilot_component and math.isfinite(sample.vehicle_s):
            return _nearest(self._vehicle, sample.vehicle_s, lambda attitude: attitude.vehicle_s)
        return _nearest(self._vehicle, sample.received_s, lambda attitude: attitude.received_s)

    def takes(self, component: int, now_s: float) -> bool:
        """Whether a sample of that component would be taken now."""
        if component == self._source or self._pinned is not None:
            return component == self._source
        better = self._source is None or self._source == self._autopilot_component
        return better or now_s - self._source_s > SOURCE_SILENT_S


_Stamped = TypeVar("_Stamped", AttitudeSample, VehicleAttitude)


def _keep(kept: deque[_Stamped], newest: _Stamped) -> None:
    kept.append(newest)
    while kept[0].received_s < newest.received_s - KEEP_S:
        kept.popleft()


def _nearest(
    attitudes: deque[VehicleAttitude], time_s: float, stamp: Callable[[VehicleAttitude], float]
) -> VehicleAttitude | None:
    """The attitude at `time_s`: interpolated between its neighbours, extrapolated from the two before, or the nearest.

    Extrapolated by at most the time between those two, so that errors grow at most threefold; None if none is within
    `PAIR_S`. Searched by bisection: while a backlog is processed, the result is far from the newest one.
    """
    after = bisect_right(attitudes, time_s, key=stamp)
    earlier = attitudes[after - 1] if after > 0 else None
    later = attitudes[after] if after < len(attitudes) else None
    if earlier is not None and time_s - stamp(earlier) > PAIR_S:
        earlier = None
    if later is not None and stamp(later) - time_s > PAIR_S:
        later = None
    if earlier is not None and later is not None:
        return interpolate(earlier, later, (time_s - stamp(earlier)) / (stamp(later) - stamp(earlier)))
    if earlier is not None and after > 1:
        previous = attitudes[after - 2]
        since_s, step_s = time_s - stamp(earlier), stamp(earlier) - stamp(previous)
        if since_s <= step_s <= PAIR_S:
            return interpolate(previous, earlier, 1.0 + since_s / step_s if step_s > 0 else 1.0)
    return earlier or later
