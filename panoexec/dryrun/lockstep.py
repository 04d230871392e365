"""Runs a simulated vehicle and its mission in lockstep, independent of the load of the computer.

The vehicle sends its time in the stream of its messages, and the mission's clock (`VehicleClock`) shows exactly that
time. The vehicle in turn may advance only slightly beyond the messages received here, and not beyond the next wake-up
on the mission's clock: so a command is sent at the simulated time at which the mission decided on it. While something
takes real time (an unacknowledged command, a write to the journal), simulated time advances at most as fast as real
time, in steps that must each arrive here first: on a computer that is ten times slower, time passes ten times slower.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Final, Protocol

from panoexec.adapters.link.message_hub import Handler, MavMessage
from panoexec.clock import RESOLUTION_S, VehicleClock
from panoexec.sim.pacing import TIME_COMPONENT, TIME_MESSAGE, TIME_NAME, time_from_fields

Allow = Callable[[float, float], None]
"""Sets the limits of simulated time: the end, and the speed (`SimulatorProcess.allow`)."""

AHEAD_S: Final = 0.02
"""How far the vehicle may be ahead of the messages received here: the interval of two attitudes."""
STEP_S: Final = 0.005
"""The same while something takes real time."""
BEGIN_EVERY_S: Final = 10.0
"""Missions begin at multiples of this time, so that gusts are reproducible whatever the time to connect."""
_BEGIN_SPEED: Final = 10.0
_BEGIN_AHEAD_S: Final = 0.2
"""A larger step is possible as nobody acts yet; but MAVSDK buffers at most 100 messages."""
_TURNS: Final = 6
"""Iterations of the event loop in which woken tasks may start work before time advances."""
_LOOK_S: Final = 0.25
_SILENT_LOOKS: Final = 20
"""Number of checks without a message after which time advances by itself, so that nobody waits for a lost vehicle."""


class MessageSource(Protocol):
    """The part of `MavsdkLink` that is used here."""

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        """See `MavsdkLink.on`."""
        ...


class Lockstep:
    """Sets the mission's clock to the vehicle's time, and the limits of the vehicle's time."""

    def __init__(self, clock: VehicleClock, allow: Allow, *, speedup: float) -> None:
        """Create it.

        Args:
            clock: the mission's clock; no other object may set it.
            allow: sets the limits of the vehicle's time.
            speedup: maximum simulated seconds per second once the mission has begun.
        """
        self._clock = clock
        self._allow = allow
        self._speedup = speedup
        # nothing is commanded at an exact time yet; with small steps a vehicle on a starved computer beats less than
        # once in the 3 real seconds after which MAVSDK considers it lost, so that it would never be found
        self._speed, self._ahead_s = 1.0, _BEGIN_AHEAD_S
        self._begun = False
        self._loop: asyncio.AbstractEventLoop | None = None
        self._turning = False
        self._told = 0
        self._last = (0.0, 1.0)
        self._timer: asyncio.TimerHandle | None = None

    @contextlib.contextmanager
    def keeping(self, link: MessageSource) -> Iterator[None]:
        """Keep lockstep while the block runs, on the running event loop; in real time until `begin`."""
        self._loop = asyncio.get_running_loop()
        self._clock.on_told, self._clock.on_work = self._look, self._go_on
        self._clock.look_at_s = 0.0
        off = link.on(TIME_MESSAGE, self._hear)
        self._watch(self._loop.time(), 0, 0)
        try:
            yield
        finally:
            off()
            if self._timer is not None:
                self._timer.cancel()

    async def begin(self) -> None:
        """Return at the next start time of missions; from then on the requested speed-up applies."""
        self._speed, self._ahead_s = max(_BEGIN_SPEED, self._speedup), _BEGIN_AHEAD_S
        now_s = self._clock.monotonic()
        await self._clock.sleep(BEGIN_EVERY_S * (math.floor(now_s / BEGIN_EVERY_S) + 1) - now_s)
        self._speed, self._ahead_s, self._begun = self._speedup, AHEAD_S, True

    # --- in MAVSDK's callback thread

    def _hear(self, message: MavMessage) -> None:
        fields = message.fields
        if message.component_id == TIME_COMPONENT and str(fields["name"]).rstrip("\0") == TIME_NAME:
            self._told += 1
            self._clock.tell(time_from_fields(int(fields["time_boot_ms"]), int(fields["value"])))

    def _look(self) -> None:
        """Schedule waking of sleepers and advancing of the vehicle; from any thread."""
        if not self._turning and self._loop is not None:
            self._turning = True
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
                self._loop.call_soon_threadsafe(self._turn, _TURNS)

    # --- on the event loop

    def _turn(self, left: int) -> None:
        assert self._loop is not None
        self._clock.wake()
        if left:
            self._loop.call_soon(self._turn, left - 1)
            return
        self._turning = False
        self._go_on()

    def _go_on(self) -> None:
        """Let the vehicle advance beyond the time received from it."""
        clock = self._clock
        now_s = clock.monotonic()
        if clock.is_at_work and self._begun:
            until_s, speed = now_s + STEP_S, min(1.0, self._speed)
        else:
            until_s, speed = max(now_s, min(now_s + self._ahead_s, clock.next_s)), self._speed
        clock.look_at_s = min(until_s, now_s + self._ahead_s / 2) - RESOLUTION_S
        self._let(until_s, speed)
        if clock.monotonic() >= clock.look_at_s:  # a new time arrived meanwhile
            self._look()

    def _let(self, until_s: float, speed: float) -> None:
        if (until_s, speed) != self._last:
            self._last = until_s, speed
            self._clock.allowed_s = max(self._clock.allowed_s, until_s)
            self._allow(until_s, speed)

    def _watch(self, since_s: float, told: int, looks: int) -> None:
        """Check periodically that time advances.

        Before the first message, when nothing is received yet, the vehicle advances in real time. Later a message may
        have been lost: then a small step is allowed. A vehicle that stays silent is lost, and time advances without it.

        Args:
            since_s: time of the last check, in the event loop's time.
            told: number of times received up to the last check.
            looks: number of checks without a message.
        """
        assert self._loop is not None
        now_s = self._loop.time()
        if not self._told:
            self._let(self._last[0] + now_s - since_s, 1.0)
        elif self._told != told:
            looks = 0
        else:
            looks += 1
            self._let(self._last[0] + STEP_S, self._last[1])
            if looks >= _SILENT_LOOKS:
                self._clock.tell(self._clock.monotonic() + now_s - since_s)
        after_s = _LOOK_S if self._told else STEP_S
        self._timer = self._loop.call_later(after_s, self._watch, now_s, self._told, looks)
