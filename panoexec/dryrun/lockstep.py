"""Keeps a simulated vehicle and the mission on it at one time, however busy the computer is.

The vehicle tells its time in the stream of its messages; the mission's clock (`VehicleClock`) shows that time and no
other. The vehicle in turn is only allowed to live a little further than what arrived here, and not beyond the next
moment that somebody on the clock waits for: so a command goes out at the simulated moment at which the mission decided
on it. While something takes real time (a command that is to be answered, the journal's disk), simulated time goes on
as fast as real time at most, in steps each of which must arrive here first: on a computer that is ten times slower, it
passes ten times slower too.
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
"""Lets simulated time go on: until when, and how fast (`SimulatorProcess.allow`)."""

AHEAD_S: Final = 0.02
"""How far the vehicle may be ahead of what arrived here; as long as from one attitude to the next."""
STEP_S: Final = 0.005
"""Likewise while something takes real time."""
BEGIN_EVERY_S: Final = 10.0
"""Missions begin at multiples of this: then the same gusts blow in them, however long it took to connect."""
_BEGIN_SPEED: Final = 10.0
_BEGIN_AHEAD_S: Final = 0.2
"""Nobody does anything yet; but MAVSDK keeps 100 messages at most."""
_TURNS: Final = 6
"""Turns of the event loop in which whoever was woken may go to work, before time goes on."""
_LOOK_S: Final = 0.25
_SILENT_LOOKS: Final = 20
"""So many looks at a vehicle that says nothing, and time goes on by itself: nobody may wait for a dead one."""


class Hears(Protocol):
    """What a `MavsdkLink` is here."""

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        """See `MavsdkLink.on`."""
        ...


class Lockstep:
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
        self._speed, self._ahead_s = 1.0, AHEAD_S
        self._loop: asyncio.AbstractEventLoop | None = None
        self._turning = False
        self._told = 0
        self._last = (0.0, 1.0)
        self._timer: asyncio.TimerHandle | None = None

    @contextlib.contextmanager
    def keeping(self, link: Hears) -> Iterator[None]:
        """Keep time while the block runs, on the running event loop; in real time until `begin`."""
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
        """Return at the next moment at which missions begin; from then on time goes as fast as it was asked to."""
        self._speed, self._ahead_s = max(_BEGIN_SPEED, self._speedup), _BEGIN_AHEAD_S
        now_s = self._clock.monotonic()
        await self._clock.sleep(BEGIN_EVERY_S * (math.floor(now_s / BEGIN_EVERY_S) + 1) - now_s)
        self._speed, self._ahead_s = self._speedup, AHEAD_S

    # --- in the vendor's thread

    def _hear(self, message: MavMessage) -> None:
        fields = message.fields
        if message.component_id == TIME_COMPONENT and str(fields["name"]).rstrip("\0") == TIME_NAME:
            self._told += 1
            self._clock.tell(time_from_fields(int(fields["time_boot_ms"]), int(fields["value"])))

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
            until_s, speed = max(now_s, min(now_s + self._ahead_s, clock.next_s)), self._speed
        clock.look_at_s = min(until_s, now_s + self._ahead_s / 2) - RESOLUTION_S
        self._let(until_s, speed)
        if clock.monotonic() >= clock.look_at_s:  # it was told in between
            self._look()

    def _let(self, until_s: float, speed: float) -> None:
        if (until_s, speed) != self._last:
            self._last = until_s, speed
            self._clock.allowed_s = max(self._clock.allowed_s, until_s)
            self._allow(until_s, speed)

    def _watch(self, since_s: float, told: int, looks: int) -> None:
        """See that time goes on where nothing is heard, and look again after a while.

        Before the first word, when nobody can hear it yet, the vehicle goes on in real time. Later a word may have been
        lost: a little more is allowed then. One that stays silent is dead, and time goes on without it.

        Args:
            since_s: the last look, in the loop's time.
            told: how often the time had been told by then.
            looks: for how many looks it has been silent.
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
