"""Round trips to a camera: which of its messages were certainly stamped after a request of ours was sent.

A camera's capture status (CAMERA_CAPTURE_STATUS, 262) that arrives after its request is not therefore an answer to it:
many cameras send it by themselves just after a photo, some ten times a second, and MAVSDK requests it too. Nothing in
the message tells. The acknowledgement of the request does: the camera had the request when it acknowledged it, so what
it sends *after the acknowledgement* was stamped after the request was sent, whoever asked for it. A link delivers in
order what one component sends; where datagrams overtake each other, the message with the latest stamp of those that
arrive shortly after the acknowledgement is the one that counts, as it is not earlier than the answer.

Which acknowledgement is ours is not told either, as all requests are the same command. MAVSDK has one of them under way
at a time, and returns when it is acknowledged: the last acknowledgement that has arrived some time after that is ours,
or a later one. On a link that is so slow that MAVSDK repeats its requests, they are acknowledged twice, which may be
taken for ours: what is found there does not count.

Some cameras answer before they acknowledge. Their answer proves nothing, but a second request, sent as soon as the
first is acknowledged, is answered after that, and so certainly after the first was sent. It is taken for stamped after
the second was sent only if answer, acknowledgement, answer, acknowledgement is all that arrived, this time and the
times before: else a message that the camera sends by itself may have taken the place of an answer that was lost.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

from panoexec.clock import Clock

_ACCEPTED: Final = 0
_OVERTAKES_S: Final = 0.05
"""How long after an acknowledgement, or a message, one that was sent before it may arrive."""
_LATEST_S: Final = 0.25
"""How long after its acknowledgement an answer is waited for."""
_REPEATED_S: Final = 0.4
"""A request that is acknowledged later may have been repeated (MAVSDK does after 0.5 s)."""
_REMEMBERED: Final = 9
"""So many round trips in a row must have been without anything unasked, or lost."""
_SLOW_S: Final = 10.0
"""For so long after that nothing counts: requests of MAVSDK's own may have been repeated, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundTrip:
    """A message that was stamped after a request was sent, and before it arrived.

    Attributes:
        stamp_s: the camera's time since boot.
        asked_s: when the request was sent, on the mission's clock.
        received_s: when the message arrived.
    """

    stamp_s: float
    asked_s: float
    received_s: float


_Heard: TypeAlias = list[tuple[float | None, float]]
"""What arrived since a request, in order: stamp and time of arrival; acknowledgements have no stamp."""


def _last_acknowledgement(heard: _Heard) -> int:
    """Index of the last acknowledgement; -1 without one."""
    return max((number for number, (stamp_s, _) in enumerate(heard) if stamp_s is None), default=-1)


def _latest_after(heard: _Heard, acknowledged: int) -> tuple[float, float] | None:
    """Stamp and arrival of the message with the latest stamp of those after an acknowledgement."""
    return max(((stamp_s, at_s) for stamp_s, at_s in heard[acknowledged + 1 :] if stamp_s is not None), default=None)


class RoundTrips:
    """Makes round trips; one at a time. For the event loop.

    Args:
        clock: of the mission.
        request: requests the capture status, and returns the MAV_RESULT when it is acknowledged.
    """

    def __init__(self, clock: Clock, request: Callable[[], Awaitable[int]]) -> None:
        self._clock = clock
        self._request = request
        self._heard: _Heard | None = None
        self._answers_first = False
        self._slow_until_s = -math.inf
        self._disturbed: deque[bool] = deque(maxlen=_REMEMBERED)

    def acknowledged(self, received_s: float) -> None:
        """Take an acknowledgement of a request for a message, of anybody's; in order of arrival with `stamped`."""
        if self._heard is not None:
            self._heard.append((None, received_s))

    def stamped(self, stamp_s: float, received_s: float) -> None:
        """Take a capture status."""
        if self._heard is not None:
            self._heard.append((stamp_s, received_s))

    async def make(self) -> RoundTrip | None:
        """Make one round trip; None if nothing that arrived proves one, or the camera refuses.

        Raises:
            DeviceError: the request was not acknowledged.
        """
        if self._heard is not None:
            return None
        self._heard = []
        try:
            if not self._answers_first:
                trip = await self._once(self._heard)
                if trip is not None or not self._answers_first:
                    return trip
                self._heard = []
            return await self._twice(self._heard)
        finally:
            self._heard = None

    async def _once(self, heard: _Heard) -> RoundTrip | None:
        """A camera that acknowledges, then answers; finds out if it does not."""
        asked_s = self._clock.monotonic()
        if not await self._is_acknowledged():
            return None
        until_s = self._clock.monotonic() + _LATEST_S
        while True:
            await self._clock.sleep(_OVERTAKES_S)
            now_s = self._clock.monotonic()
            last = _last_acknowledgement(heard)
            latest = None if last < 0 else _latest_after(heard, last)
            if latest is not None and now_s - latest[1] >= _OVERTAKES_S / 2:
                return RoundTrip(stamp_s=latest[0], asked_s=asked_s, received_s=latest[1])
            if last >= 0 and latest is None and any(stamp_s is not None for stamp_s, _ in heard):
                self._answers_first = True
                return None
            if now_s >= until_s:
                return None

    async def _twice(self, heard: _Heard) -> RoundTrip | None:
        """A camera that answers, then acknowledges: what follows the first acknowledgement counts."""
        asked_s = self._clock.monotonic()
        if not await self._is_acknowledged():
            return None
        again_s = self._clock.monotonic()
        if not await self._is_acknowledged():
            return None
        await self._clock.sleep(_OVERTAKES_S)
        acknowledged = [number for number, (stamp_s, _) in enumerate(heard) if stamp_s is None]
        if len(acknowledged) != 2:  # others were acknowledged too: which one is that of the first request?
            self._disturbed.append(True)
            return None
        self._disturbed.append([stamp_s is None for stamp_s, _ in heard] != [False, True, False, True])
        latest = _latest_after(heard, acknowledged[0])
        self._answers_first = latest is not None and _latest_after(heard, acknowledged[1]) is None
        if latest is None:
            return None
        is_known = len(self._disturbed) == _REMEMBERED and not any(self._disturbed)
        asked_s = again_s if is_known else asked_s
        return RoundTrip(stamp_s=latest[0], asked_s=asked_s, received_s=latest[1])

    async def _is_acknowledged(self) -> bool:
        """Send a request; returns whether it was accepted, on a link on which none is repeated."""
        asked_s = self._clock.monotonic()
        result = await self._request()
        now_s = self._clock.monotonic()
        if now_s - asked_s >= _REPEATED_S:
            self._slow_until_s = now_s + _SLOW_S
        return result == _ACCEPTED and now_s >= self._slow_until_s
