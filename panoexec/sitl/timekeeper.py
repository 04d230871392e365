"""Keeps a simulated vehicle and the mission on it at one time, however busy the computer is.

The vehicle tells its time in the stream of its messages; the mission's clock (`VehicleClock`) shows that time and no
other. The vehicle in turn is only allowed to live a little further than what arrived here, and not beyond the next moment
that somebody on the clock waits for: so a command goes out at the simulated moment at which the mission decided on it.
While something takes real time (a command that is to be answered, the journal's disk), simulated time goes on at
real time's speed at most, in steps that are each acknowledged: on a computer that is ten times slower, it passes ten
times slower too.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable
from typing import Final

from panoexec.adapters.mavsdk_link import MavsdkLink
from panoexec.adapters.message_hub import MavMessage
from panoexec.clock import RESOLUTION_S, VehicleClock
from panoexec.sim.pacing import TIME_COMPONENT, TIME_MESSAGE, TIME_NAME, told_time_s

Allow = Callable[[float, float], None]
"""Lets simulated time go on: until when, and how fast (`SimulatorProcess.allow`)."""

AHEAD_S: Final = 0.02
"""How far the vehicle may be ahead of what arrived here; as long as from one attitude to the next."""
STEP_S: Final = 0.005
"""Likewise while something takes real time."""
BEGIN_EVERY_S: Final = 10.0
"""Missions begin at multiples of this: then the same gusts blow in the same mission, however long it took to connect."""
_BEGIN_SPEED: Final = 10.0
_TURNS: Final = 6
"""Turns of the event loop in which whoever was woken may go to work, before time goes on."""
_LOOK_S: Final = 0.25
_SILENT_LOOKS: Final = 20
"""So many looks at a vehicle that says nothing, and time goes on by itself: nobody may wait for a dead one."""


class Timekeeper:
    """Tells the clock what the vehicle's time is, and the vehicle how far it may go."""

    def __init__(self, clock: VehicleClock, allow: Allow, *, speedup: float) -> None:
        """Describe it.

        Args:
            clock: of the mission; nobody else tells it the time.
            allow: lets the vehicle go on.
            speedup: simulated seconds a second at most, once the mission has begun.
        """
        self._clock = clock
        self._allow = allow
        self._speedup = speedup
        self._speed = 1.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._turning = False
        self._told = 0
        self._last = (0.0, 1.0)

    @contextlib.asynccontextmanager
    async def keeping(self, link: MavsdkLink) -> AsyncIterator[None]:
        """Keep time while the block runs, in real time until `begin`."""
        self._loop = asyncio.get_running_loop()
        self._clock.on_told, self._clock.on_work = self._look, self._go_on
        self._clock.look_at_s = 0.0
        off = link.on(TIME_MESSAGE, self._hear)
        async with asyncio.TaskGroup() as group:
            watch = group.create_task(self._watch(), name="simulated time")
            try:
                yield
            finally:
                watch.cancel()
                off()

    async def begin(self) -> None:
        """Return at the next moment at which missions begin; from then on time goes as fast as it was asked to."""
        self._speed = max(_BEGIN_SPEED, self._speedup)
        now_s = self._clock.monotonic()
        await self._clock.sleep(BEGIN_EVERY_S * math.ceil(now_s / BEGIN_EVERY_S) - now_s)
        self._speed = self._speedup

    # --- in the vendor's thread

    def _hear(self, message: MavMessage) -> None:
        fields = message.fields
        if message.component_id == TIME_COMPONENT and str(fields["name"]).rstrip("\0") == TIME_NAME:
            self._told += 1
            self._clock.tell(told_time_s(int(fields["time_boot_ms"]), int(fields["value"])))

    def _look(self) -> None:
        """Somebody is to be woken, or the vehicle to be let go on; from any thread."""
        if not self._turning and self._loop is not None:
            self._turning = True
            with contextlib.suppress(RuntimeError):  # the loop was closed: nobody waits any more
                self._loop.call_soon_threadsafe(self._turn, _TURNS)

    # --- on the loop

    def _turn(self, left: int) -> None:
        assert self._loop is not None
        self._clock.wake()
        if left:
            self._loop.call_soon(self._turn, left - 1)
            return
        self._turning = False
        self._go_on()

    def _go_on(self) -> None:
        """Let the vehicle go on from what arrived of it."""
        clock = self._clock
        now_s = clock.monotonic()
        if clock.is_at_work:
            until_s, speed = now_s + STEP_S, min(1.0, self._speed)
        else:
            until_s, speed = max(now_s, min(now_s + AHEAD_S, clock.next_s)), self._speed
        clock.look_at_s = min(until_s, now_s + AHEAD_S / 2) - RESOLUTION_S
        self._let(until_s, speed)

    def _let(self, until_s: float, speed: float) -> None:
        if (until_s, speed) != self._last:
            self._last = until_s, speed
            self._clock.allowed_s = max(self._clock.allowed_s, until_s)
            self._allow(until_s, speed)

    async def _watch(self) -> None:
        """Let the vehicle go on in real time until it is heard, and time itself when it is heard no more."""
        assert self._loop is not None
        looks, told = 0, self._told
        while True:
            began_s = self._loop.time()
            await asyncio.sleep(_LOOK_S if told else STEP_S)
            if self._told != told:
                looks, told = 0, self._told
                continue
            looks += 1
            passed_s = self._loop.time() - began_s
            if not told:
                self._let(self._last[0] + passed_s, 1.0)
            elif looks >= _SILENT_LOOKS:
                self._clock.tell(self._clock.monotonic() + passed_s)
                self._clock.wake()
