"""Requests the message streams that a link needs, at the current rates."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias

from panoexec.adapters.link.message_hub import MavMessage, MessageHub
from panoexec.adapters.link.roster import AUTOPILOT
from panoexec.adapters.link.stream_health import RebootDetector, Stream, StreamHealth
from panoexec.clock import Clock
from panoexec.errors import DeviceError

__all__ = ["AUTOPILOT", "SET_MESSAGE_INTERVAL", "StreamKeeper", "StreamReport"]

SET_MESSAGE_INTERVAL: Final = 511

_MEASURE_S: Final = 2.0
_OF_ANY_COMPONENT: Final = frozenset({281, 285})
"""Streams that a gimbal, or a manager beside the autopilot, sends itself."""

Command: TypeAlias = Callable[[int, Sequence[float]], Awaitable[int]]


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamReport:
    """The status of one stream.

    Attributes:
        stream: the stream.
        wanted_hz: requested rate.
        measured_hz: received rate over the last seconds of the mission's clock.
        refused: the autopilot refused the request.
        age_s: real seconds since the last message; infinity before the first.
    """

    stream: Stream
    wanted_hz: float
    measured_hz: float
    refused: bool
    age_s: float


class StreamKeeper:
    """Requests streams, again if they stop; detects reboots by their time stamps."""

    def __init__(
        self,
        streams: Sequence[Stream],
        *,
        hub: MessageHub,
        clock: Clock,
        command: Command,
        rebooted: Callable[[], None],
    ) -> None:
        """Create it; nothing is sent before `ask`.

        Args:
            streams: the required streams.
            hub: source of the messages.
            clock: of the mission.
            command: sends a command to the autopilot, returns its MAV_RESULT, raises DeviceError.
            rebooted: called in MAVSDK's thread after a reboot.
        """
        self.autopilot: int | None = None
        """MAV_AUTOPILOT of the vehicle, by its heartbeat; None before the first."""
        self.active = False
        """Whether to request the rates of a running mission."""
        self.throttled: dict[int, float] = {}
        """Lower rates, Hz, by message id, that temporarily replace those of the streams."""
        self.boots = RebootDetector()
        self._watches = [StreamHealth(stream) for stream in streams]
        self._measured = {stream.name: (0, clock.monotonic(), 0.0) for stream in streams}
        self._clock = clock
        self._command = command
        self._rebooted = rebooted
        self._asking = asyncio.Lock()
        for watch in self._watches:
            hub.on(watch.stream.name, partial(self._arrived, watch))

    def forget(self) -> None:
        """The autopilot may have lost the intervals: request all streams at once."""
        for watch in self._watches:
            watch.forget()

    async def ask(self) -> None:
        """Request the streams that are due. Does not raise if the autopilot refuses or does not answer."""
        async with self._asking:
            for watch in self._watches:
                wanted, now = self._wanted_hz(watch), time.monotonic()
                watch.settle(wanted, now)
                if not self._has(watch.stream) or not watch.due(wanted, now):
                    continue
                try:
                    result = await self._command(SET_MESSAGE_INTERVAL, [watch.stream.message_id, 1e6 / wanted])
                except DeviceError:
                    watch.asked(wanted, time.monotonic(), granted=None)
                    return  # further requests would not be answered either
                granted = {0: True, 1: None}.get(result, False)  # 1: temporarily rejected
                watch.asked(wanted, time.monotonic(), granted=granted)

    def measure(self) -> None:
        """Update the measured rates; call it a few times a second."""
        now = self._clock.monotonic()
        for watch in self._watches:
            count, since_s, _ = self._measured[watch.stream.name]
            if now - since_s >= _MEASURE_S:
                rate = (watch.count - count) / (now - since_s)
                self._measured[watch.stream.name] = (watch.count, now, rate)

    def reports(self) -> list[StreamReport]:
        """The status of all streams."""
        now = time.monotonic()
        return [
            StreamReport(
                stream=watch.stream,
                wanted_hz=self._wanted_hz(watch),
                measured_hz=self._measured[watch.stream.name][2],
                refused=watch.refused,
                age_s=now - watch.last_s,
            )
            for watch in self._watches
            if self._has(watch.stream)
        ]

    def _has(self, stream: Stream) -> bool:
        """Whether the autopilot is one that has the message."""
        return stream.autopilot in (None, self.autopilot)

    def _wanted_hz(self, watch: StreamHealth) -> float:
        stream = watch.stream
        wanted = stream.rate_hz if self.active else stream.idle_rate_hz
        return min(wanted, self.throttled.get(stream.message_id, wanted))

    def _arrived(self, watch: StreamHealth, message: MavMessage) -> None:
        if message.component_id != AUTOPILOT and watch.stream.message_id not in _OF_ANY_COMPONENT:
            return  # the autopilot was asked: what somebody else sends does not answer for it
        watch.note(message.heard_s)
        # a gimbal that is its own component stamps with its own boot time; 0 is a sender that does not stamp
        boot_ms = message.fields.get("time_boot_ms") if message.component_id == AUTOPILOT else None
        if not boot_ms:
            return
        if self.boots.note(boot_ms / 1000.0, message.heard_s, message.received_s, stream=message.name):
            self._rebooted()
