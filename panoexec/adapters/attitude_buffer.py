"""The stream of attitudes between the vendor's thread that delivers it and the event loop that reads it.

The vendor's thread only appends to an inbox and wakes the loop when somebody waits there: a wake-up of the loop costs
more than all the rest of a sample, and at 50 Hz gimbal plus 50 Hz airframe it would be paid a hundred times a second
(measured: 1.6 % of a core). Everything else happens on the loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

from panoexec.adapters.attitude_messages import interpolate
from panoexec.devices import AttitudeSample, VehicleAttitude

KEEP_S: Final = 60.0
"""How long samples are kept, on the mission's clock (`AttitudeFeed.since`)."""

PAIR_S: Final = 0.1
"""Furthest in time that an airframe's attitude may be from the sample that it is paired with."""

SOURCE_SILENT_S: Final = 1.0
"""After this silence of the chosen source another one is taken."""

INBOX_MOST: Final = 20_000
"""Samples that wait to be read; 60 s at 300 Hz. The oldest go when nobody reads."""


class AttitudeBuffer:
    """Implements `AttitudeFeed`. `put_*` are for the vendor's thread, all else for the event loop.

    An ArduPilot that drives a MAVLink gimbal sends a second, relabelled copy of the gimbal's own reports (always
    "vehicle frame", rates and failures dropped); so reports of the gimbal itself are preferred to the autopilot's.
    """

    def __init__(self, *, autopilot_component: int = 1) -> None:
        self._autopilot_component = autopilot_component
        self._loop: asyncio.AbstractEventLoop | None = None
        self._inbox: deque[AttitudeSample] = deque(maxlen=INBOX_MOST)
        self._samples: deque[AttitudeSample] = deque()
        self._vehicle_inbox: deque[VehicleAttitude] = deque(maxlen=INBOX_MOST)
        self._vehicle: deque[VehicleAttitude] = deque()
        self._source: int | None = None
        self._source_s = -math.inf
        self._waiters: list[asyncio.Future[None]] = []
        self._wake_pending = False

    @property
    def source_component(self) -> int | None:
        """Component that the samples come from, None before the first."""
        return self._source

    def put_sample(self, sample: AttitudeSample, component: int) -> None:
        """Take a report of the gimbal; in the vendor's thread."""
        if not self._from_chosen_source(component, sample.received_s):
            return
        self._inbox.append(sample)
        # A waiter registers before it looks into the inbox, and we look for waiters after filling it: one of both sees
        if self._waiters and not self._wake_pending and self._loop is not None:
            self._wake_pending = True
            with contextlib.suppress(RuntimeError):  # the loop was closed: nobody waits any more
                self._loop.call_soon_threadsafe(self._wake)

    def put_vehicle(self, attitude: VehicleAttitude) -> None:
        """Take a report of the airframe; in the vendor's thread."""
        self._vehicle_inbox.append(attitude)

    def rebooted(self) -> None:
        """Forget the airframe's attitudes, whose time stamps mean nothing after a reboot."""
        self._vehicle_inbox.clear()
        self._vehicle.clear()

    @property
    def latest(self) -> AttitudeSample | None:
        """See `AttitudeFeed.latest`."""
        _take_in(self._inbox, self._samples)
        return self._samples[-1] if self._samples else None

    def since(self, received_s: float) -> Sequence[AttitudeSample]:
        """See `AttitudeFeed.since`."""
        _take_in(self._inbox, self._samples)
        out: list[AttitudeSample] = []
        for sample in reversed(self._samples):
            if sample.received_s <= received_s:
                break
            out.append(sample)
        out.reverse()
        return out

    async def newer_than(self, received_s: float) -> AttitudeSample:
        """See `AttitudeFeed.newer_than`."""
        self._loop = asyncio.get_running_loop()
        while True:
            waiter = self._loop.create_future()
            self._waiters.append(waiter)
            try:
                found = self.since(received_s)
                if found:
                    return found[0]
                await waiter
            finally:
                self._waiters.remove(waiter)

    def vehicle_attitude_at(self, sample: AttitudeSample) -> VehicleAttitude | None:
        """See `AttitudeFeed.vehicle_attitude_at`; between two reports it is interpolated, after the last continued.

        Paired by the senders' boot time when the autopilot stamped both, else by arrival (a gimbal has its own clock).
        """
        _take_in(self._vehicle_inbox, self._vehicle)
        if self._source == self._autopilot_component and math.isfinite(sample.vehicle_s):
            return _nearest(self._vehicle, sample.vehicle_s, lambda attitude: attitude.vehicle_s)
        return _nearest(self._vehicle, sample.received_s, lambda attitude: attitude.received_s)

    def _from_chosen_source(self, component: int, now_s: float) -> bool:
        if component != self._source:
            better = self._source is None or (
                self._source == self._autopilot_component and component != self._autopilot_component
            )
            if not better and now_s - self._source_s <= SOURCE_SILENT_S:
                return False
            self._source = component
        self._source_s = now_s
        return True

    def _wake(self) -> None:
        self._wake_pending = False
        for waiter in self._waiters:
            if not waiter.done():
                waiter.set_result(None)


_Stamped = TypeVar("_Stamped", AttitudeSample, VehicleAttitude)


def _take_in(inbox: deque[_Stamped], kept: deque[_Stamped]) -> None:
    while inbox:
        kept.append(inbox.popleft())
    while kept and kept[0].received_s < kept[-1].received_s - KEEP_S:
        kept.popleft()


def _nearest(
    attitudes: deque[VehicleAttitude], time_s: float, stamp: Callable[[VehicleAttitude], float]
) -> VehicleAttitude | None:
    """The attitude at `time_s`: interpolated between its neighbours, continued from the two before, or the nearest.

    Continued by no more than the time between those two, so that errors grow no more than threefold; None if none is
    near enough. By bisection: while a backlog is worked off, the wanted one is far from the newest, and a search from
    there would make the backlog grow.
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
