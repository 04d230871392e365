"""When a message was sent, on the mission's clock: arrival times without the jitter of this computer and of the link.

A busy computer delivers messages in bursts. Judged by arrival, a burst looks like a silence of the sender followed by
samples of one moment, and a silence is no proof of a pose. The sender's own stamps are even; they only need an offset.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

_WINDOW_S: Final = 0.5
"""The fastest message of so long a time tells the offset. Short, because the sender's clock may run at another speed
than ours (a simulation that cannot keep up): then the offset must follow."""


class StampDejitter:
    """Turns the stamps of one stream into the mission's clock; fed in the order of arrival, from one thread.

    The result is never later than the arrival, never earlier than the sending less the shortest delay of half a second,
    and never before the result of an earlier message.
    """

    def __init__(self) -> None:
        # (arrival, offset) with offsets that rise: the first is the least of the window
        self._offsets: deque[tuple[float, float]] = deque()
        self._newest_stamp_s = -math.inf
        self._newest_s = -math.inf

    def sent_s(self, stamp_s: float, received_s: float) -> float:
        """When a message was sent, seconds of the mission's clock.

        Args:
            stamp_s: the sender's boot time in it; NaN if it has none.
            received_s: when it arrived.

        Returns:
            The arrival itself where stamps tell nothing: none, standing still, or begun anew (a reboot).
        """
        if not stamp_s > self._newest_stamp_s:
            if stamp_s < self._newest_stamp_s:
                self._offsets.clear()
                self._newest_stamp_s = stamp_s
            self._newest_s = max(self._newest_s, received_s)
            return received_s
        self._newest_stamp_s = stamp_s
        offset = received_s - stamp_s
        while self._offsets and self._offsets[-1][1] >= offset:
            self._offsets.pop()
        self._offsets.append((received_s, offset))
        while self._offsets[0][0] < received_s - _WINDOW_S:
            self._offsets.popleft()
        self._newest_s = max(self._newest_s, min(stamp_s + self._offsets[0][1], received_s))
        return self._newest_s
