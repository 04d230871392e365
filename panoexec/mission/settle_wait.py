"""The wait for one pose to settle, until its trigger may be sent."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from panoexec.clock import Clock
from panoexec.devices import AttitudeFeed
from panoexec.mission.pointing.heading import HeadingController
from panoexec.mission.pointing.poses import PoseReader
from panoexec.mission.pointing.tolerance_gate import SettleTracker

LAST_SLEEP_S = 0.05
"""The last part of a wait for the settle time, slept without reading samples; earlier ones are judged before it."""
_LEAST_SLEEP_S = 0.05


@dataclass(kw_only=True)
class SettleWait:
    """Feeds a tracker with the readings since a command; the timeout moves when the trigger is held for other reasons.

    Attributes:
        poses: the readings.
        feed: the gimbal's reports.
        clock: of the mission.
        tracker: judges the readings.
        next_trigger_s: returns when the camera may be triggered next.
        heading_controller: turns the vehicle where the gimbal cannot pan far enough.
        vehicle_pans: the vehicle's heading sets the camera's yaw.
        commanded_s: when the pose was commanded.
        bound_s: the settle timeout.
        on_settled: called once, when the pose is settled for the first time; False: nothing may be triggered. There is
            done what takes time, so that the trigger follows the last look at the pose at once.
    """

    poses: PoseReader
    feed: AttitudeFeed
    clock: Clock
    tracker: SettleTracker
    next_trigger_s: Callable[[], float]
    heading_controller: HeadingController | None
    vehicle_pans: bool
    commanded_s: float
    bound_s: float
    on_settled: Callable[[], bool] = lambda: True
    _deadline_s: float = field(init=False)
    _newest_s: float = field(init=False)
    _trigger_held: bool = field(default=False, init=False)
    _awaits_calm: bool = field(default=False, init=False)
    was_settled: bool = field(default=False, init=False)
    """Whether `on_settled` was called."""

    def __post_init__(self) -> None:
        """Nothing was read yet."""
        self._deadline_s = self.commanded_s + self.bound_s
        self._newest_s = self.commanded_s

    async def settled(self, clear: Callable[[], asyncio.Event | None]) -> float:
        """Feed the tracker until the trigger may be sent; returns when its last condition was met.

        The pose cannot be settled before the settle time has passed since the newest sample out of tolerance. Until
        then samples are collected and judged in one batch: waking up for each sample would dominate the CPU time of
        the slew.

        Args:
            clear: returns None if nothing else blocks the trigger, else an event to await before it is called again.
        """
        tracker, free_s = self.tracker, self.commanded_s
        controller = self._corrector
        turn_ends_at_s = -math.inf if self.heading_controller is None else self.heading_controller.turn_ends_at_s
        while True:
            await asyncio.sleep(0)  # let other tasks run even if samples arrive faster than they are read
            self.read()
            now_s = self.clock.monotonic()
            if controller is not None and math.isnan(tracker.inside_since_s) and controller.is_off(now_s):
                await controller.correct()
            if not tracker.is_settled(now_s):
                self._awaits_calm = False
                await self._samples(now_s)
                continue
            if not self.was_settled:
                self.was_settled = True
                if not self.on_settled():
                    return tracker.settled_at_s
                continue
            blocker, left_s = clear(), max(self.next_trigger_s(), turn_ends_at_s) - self.clock.monotonic()
            if blocker is None and left_s <= 0:
                self._awaits_calm = not tracker.is_calm(now_s)
                if not self._awaits_calm:
                    return max(tracker.settled_at_s, free_s)
                await self.feed.newer_than(self._newest_s)
                continue
            self._trigger_held = True
            if blocker is not None:
                await blocker.wait()
                free_s = self.clock.monotonic()
            else:
                await self._sleep_most_of(left_s)
                free_s = self.next_trigger_s()
            self._trigger_held = False
            self._deadline_s = max(self._deadline_s, free_s + self.bound_s)

    async def timed_out(self) -> None:
        """Return at the settle timeout; it does not apply while the pose is settled and the trigger is held."""
        while True:
            await self.clock.sleep(max(self._deadline_s - self.clock.monotonic(), _LEAST_SLEEP_S))
            now_s = self.clock.monotonic()
            ready = self.tracker.is_settled(now_s) and not self._awaits_calm
            if now_s >= self._deadline_s and not self._trigger_held and not ready:
                return

    def read(self) -> None:
        """Feed the tracker with the new samples."""
        readings = self.poses.since(self._newest_s)
        if not readings:
            return
        self._newest_s = readings[-1].time_s
        controller = self._corrector
        if controller is None:
            self.tracker.add(*readings)
            return
        for reading in readings:
            self.tracker.add(reading)
            if self.tracker.error is not None:
                controller.note(reading.time_s, float(self.tracker.error.yaw_deg))

    @property
    def _corrector(self) -> HeadingController | None:
        """What corrects the heading by the camera's yaw error."""
        return self.heading_controller if self.vehicle_pans else None

    async def _samples(self, now_s: float) -> None:
        """Return at the earliest time at which the pose can be settled, or with the next sample if that is near."""
        settled_at_s = self.tracker.settled_at_s
        if math.isnan(settled_at_s):
            settled_at_s = self._newest_s + self.tracker.needed_s
        left_s = settled_at_s - now_s
        if left_s > 0 and (self._corrector is None or left_s < LAST_SLEEP_S):
            await self._sleep_most_of(left_s)
        else:
            await self.feed.newer_than(self._newest_s)

    async def _sleep_most_of(self, left_s: float) -> None:
        """Sleep until `LAST_SLEEP_S` before the end, or to the end, so that collected samples are judged in time."""
        await self.clock.sleep(left_s - LAST_SLEEP_S if left_s > LAST_SLEEP_S else left_s)
