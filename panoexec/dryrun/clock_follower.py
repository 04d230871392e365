"""Makes the mission's clock follow an autopilot that keeps its own time, and limits that autopilot's speed-up.

ArduPilot's SITL runs at its configured speed-up, or as fast as the computer permits, and cannot be paused. So the
mission's time is the autopilot's (SYSTEM_TIME, 2), which keeps timeouts consistent with simulated time; and where a
command takes too long in simulated seconds, the speed-up is reduced (`SIM_SPEEDUP`), and raised again later.

The autopilot tells its time 50 times a second. In between, the clock goes on at the rate of the last second, by no more
than to the next message: a vehicle is seen and triggered to some milliseconds, as on the clock of a real mission.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from time import monotonic
from typing import Final

import structlog

from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_health import Stream
from panoexec.clock import VehicleClock
from panoexec.dryrun.lockstep import MessageSource
from panoexec.errors import DeviceError

AUTOPILOT: Final = 1
TIME_STREAM: Final = Stream(message_id=2, name="SYSTEM_TIME", rate_hz=50.0, idle_rate_hz=50.0)
_REBOOT_S: Final = 1.0
_RATE_FROM_S: Final = 1.0
_BETWEEN_S: Final = 0.9 / TIME_STREAM.rate_hz
"""How far the clock goes on without a message: a silent autopilot has no time."""
_TICK_S: Final = 0.004
_LOOK_S: Final = 0.25
_SILENT_LOOKS: Final = 20

WORK_S: Final = 0.06
"""Permitted duration of real work (a command and its acknowledgement, a journal write) in simulated seconds. From the
photo command to the shutter 0.15 s are permitted, of which the camera needs a part."""
_MEMORY: Final = 0.3
_LEAST_CHANGE: Final = 1.15
_LONGEST_S: Final = 1.0
"""Longer work waits for a missing answer, and does not measure the computer's speed."""

_log = structlog.get_logger(__name__)


class SpeedupController:
    """Adapts the speed-up of a simulation to the duration of real work in simulated seconds."""

    def __init__(self, wanted: float) -> None:
        """Args: the requested speed-up, simulated seconds per second."""
        self.speed = self._wanted = wanted
        self._mean_s = math.nan

    def record(self, vehicle_s: float) -> bool:
        """Record the duration of some work in simulated seconds; return True if the speed-up should change."""
        cost_s = min(vehicle_s, _LONGEST_S)
        self._mean_s = cost_s if math.isnan(self._mean_s) else self._mean_s + _MEMORY * (cost_s - self._mean_s)
        # never slower than real time, the speed of a real vehicle
        best = min(self._wanted, max(min(1.0, self._wanted), self.speed * WORK_S / max(self._mean_s, 1e-3)))
        best = min(best, 1.5 * self.speed)
        if max(best, self.speed) < _LEAST_CHANGE * min(best, self.speed):
            return False
        self._mean_s *= best / self.speed
        self.speed = best
        return True


class ClockFollower:
    """Sets a mission's clock to the time of an autopilot."""

    def __init__(self, clock: VehicleClock) -> None:
        """Args: the clock; no other object may set it."""
        self._clock = clock
        self._controller: SpeedupController | None = None
        self._set_speed: Callable[[float], Awaitable[None]] | None = None
        self._setting: asyncio.Task[None] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._offset_s = 0.0
        self._newest_s = -math.inf
        self._told = 0
        self._began_s = math.nan
        self._heard: deque[tuple[float, float]] = deque()  # real time, vehicle time
        self._ticker: asyncio.TimerHandle | None = None

    @contextlib.contextmanager
    def following(self, link: MessageSource) -> Iterator[None]:
        """Follow the autopilot while the block runs, on the running event loop."""
        self._loop = asyncio.get_running_loop()
        self._clock.on_told, self._clock.on_work = self._wake, self._work_begins
        off = link.on(TIME_STREAM.name, self._hear)
        self._clock.between = self._between
        self._watch(self._loop.time(), 0, 0)
        self._tick()
        try:
            yield
        finally:
            off()
            self._clock.on_told = self._clock.on_work = lambda: None
            self._clock.between = None
            for timer in (self._timer, self._ticker):
                if timer is not None:
                    timer.cancel()
            if self._setting is not None:
                self._setting.cancel()

    def govern(self, wanted: float, set_speed: Callable[[float], Awaitable[None]]) -> None:
        """From now on reduce the speed-up where work takes too long in simulated seconds.

        Args:
            wanted: maximum speed-up, simulated seconds per second.
            set_speed: sets the speed-up of the autopilot; may raise DeviceError.
        """
        self._controller, self._set_speed = SpeedupController(wanted), set_speed

    # --- in MAVSDK's callback thread

    def _hear(self, message: MavMessage) -> None:
        if message.component_id != AUTOPILOT:
            return
        stamp_s = int(message.fields["time_boot_ms"]) / 1e3
        if stamp_s < self._newest_s - _REBOOT_S:
            self._offset_s, self._newest_s = self._clock.monotonic() - stamp_s, stamp_s
        self._newest_s = max(self._newest_s, stamp_s)
        self._told += 1
        now_s = stamp_s + self._offset_s
        self._heard.append((monotonic(), now_s))
        while self._heard[-1][0] - self._heard[0][0] > _RATE_FROM_S:
            self._heard.popleft()
        self._clock.tell(now_s)

    def _wake(self) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
                self._loop.call_soon_threadsafe(self._turn)

    def _between(self) -> float:
        """The time now, as far as it can be told; from any thread."""
        heard = tuple(self._heard)
        if len(heard) < 2:
            return -math.inf
        (first_s, began_s), (last_s, told_s) = heard[0], heard[-1]
        if last_s - first_s < _RATE_FROM_S / 2 or told_s <= began_s:
            return -math.inf
        rate = (told_s - began_s) / (last_s - first_s)
        return told_s + min(rate * (monotonic() - last_s), _BETWEEN_S)

    # --- on the event loop

    def _tick(self) -> None:
        """Wake those whose time comes between two messages."""
        assert self._loop is not None
        if self._clock.next_s < math.inf:
            self._clock.tell(self._between())
        self._ticker = self._loop.call_later(_TICK_S, self._tick)

    def _turn(self) -> None:
        self._clock.wake()
        if not self._clock.is_at_work and not math.isnan(self._began_s):
            cost_s, self._began_s = self._clock.monotonic() - self._began_s, math.nan
            if self._controller is not None and self._controller.record(cost_s) and self._setting is None:
                self._setting = asyncio.create_task(self._set(), name="set the speed-up")

    def _work_begins(self) -> None:
        self._began_s = self._clock.monotonic()

    async def _set(self) -> None:
        assert self._controller is not None
        assert self._set_speed is not None
        told = math.nan
        try:
            while told != self._controller.speed:  # it may change meanwhile
                told = self._controller.speed
                _log.debug("changing the speed-up of the simulation", speed=told)
                await self._set_speed(told)
        except DeviceError as error:
            _log.debug("changing the speed-up failed", error=str(error))
        finally:
            self._setting = None

    def _watch(self, since_s: float, told: int, looks: int) -> None:
        """Advance the time while the autopilot is silent, so that nobody waits forever for a lost one."""
        assert self._loop is not None
        now_s = self._loop.time()
        looks = looks + 1 if self._told == told else 0
        if looks >= _SILENT_LOOKS:
            self._clock.tell(self._clock.monotonic() + now_s - since_s)
            self._clock.wake()
        self._timer = self._loop.call_later(_LOOK_S, self._watch, now_s, self._told, looks)
