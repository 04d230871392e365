"""Send times of messages on the mission's clock: arrival times without the jitter of this computer and of the link.

A busy computer delivers messages in bursts. By arrival time, a burst looks like a gap in the stream followed by
simultaneous samples, and a pose is not verified during a gap. The sender's time stamps are regular and only need an
offset.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

_WINDOW_S: Final = 0.5
"""The message with the least delay in this window sets the offset. The window is short because the sender's clock may
run at another rate (a simulation that cannot keep up), which the offset must follow."""


_STEP_S: Final = 1.0
"""A stamp that is further from what the one before says is not of this moment."""
_RATE_FRAC: Final = 0.2
"""Clocks may run at rates that differ by so much (a simulation that cannot keep up)."""
_BIN_S: Final = 0.3
_DRIFT_FRAC: Final = 0.06
_STEP_RUN: Final = 3
"""So many messages in a row that agree with each other, but not with those before, show that the clock was set."""


class StampCheck:
    """Whether the time stamps of one stream belong to the moments of their arrival; fed in the order of arrival.

    One message whose stamp lies seconds in the future or in the past (forged, or kept somewhere) is no report of now.
    A clock that was set, as by a reboot, is believed after `_STEP_RUN` messages.
    """

    def __init__(self) -> None:
        self._good: tuple[float, float] | None = None
        self._odd: tuple[float, float] | None = None
        self._run = 0

    def fits(self, stamp_s: float, received_s: float) -> bool:
        """Take the next stamp; False if its message is to be dropped.

        Args:
            stamp_s: the sender's boot time; NaN or 0 if it does not stamp.
            received_s: when it arrived.
        """
        if math.isnan(stamp_s) or stamp_s == 0:
            return True
        now = (stamp_s, received_s)
        if self._good is None or _continues(self._good, now):
            self._good, self._odd, self._run = now, None, 0
            return True
        self._run = self._run + 1 if self._odd is not None and _continues(self._odd, now) else 1
        self._odd = now
        if self._run < _STEP_RUN:
            return False
        self._good, self._odd, self._run = now, None, 0
        return True


def _continues(before: tuple[float, float], now: tuple[float, float]) -> bool:
    elapsed_s = now[1] - before[1]
    return abs(now[0] - before[0] - elapsed_s) <= _STEP_S + _RATE_FRAC * abs(elapsed_s)


class Backlog:
    """By how much longer the messages of one stream are under way than they were, as their time stamps tell.

    A stream that is held up goes on where it stopped: its stamps run on, each message a fixed time late. No single
    message shows that, and it does not pass by itself. A clock of another rate lags by at most `_DRIFT_FRAC`; a
    simulation that cannot keep up looks like a backlog. Fed in the order of arrival.
    """

    def __init__(self) -> None:
        self.late_s = 0.0
        """Seconds; 0 if the stream never was earlier than now."""
        self._began_s = self._least_s = math.nan
        self._before: tuple[float, float] | None = None
        self._newest_stamp_s = -math.inf

    def note(self, stamp_s: float, received_s: float) -> None:
        """Take the next message.

        Args:
            stamp_s: the sender's boot time; NaN or 0 if it does not stamp.
            received_s: when it arrived.
        """
        if math.isnan(stamp_s) or stamp_s == 0:
            return
        if stamp_s < self._newest_stamp_s - _STEP_S:  # the sender's clock was set back: nothing held these up
            self._before, self._began_s = None, math.nan
        self._newest_stamp_s = stamp_s
        delay_s = received_s - stamp_s
        if math.isnan(self._began_s):
            self._began_s, self._least_s = received_s, delay_s
        self._least_s = min(self._least_s, delay_s)  # the fastest of some: the others met this computer's jitter
        if received_s - self._began_s < _BIN_S:
            return
        if self._before is not None:
            grown_s = self._least_s - self._before[1]
            drift_s = _DRIFT_FRAC * (received_s - self._before[0])
            self.late_s = max(0.0, self.late_s + math.copysign(max(0.0, abs(grown_s) - drift_s), grown_s))
        self._before = received_s, self._least_s
        self._began_s, self._least_s = received_s, delay_s


class StampDejitter:
    """Converts the time stamps of one stream to the mission's clock; fed in the order of arrival, from one thread.

    The result is never later than the arrival, at most as late after the sending as the fastest message of the window,
    and never earlier than the result of an earlier message.
    """

    def __init__(self) -> None:
        # (arrival, offset) with offsets that rise: the first is the least of the window
        self._offsets: deque[tuple[float, float]] = deque()
        self._newest_stamp_s = -math.inf
        self._newest_s = -math.inf

    def sent_s(self, stamp_s: float, received_s: float) -> float:
        """When a message was sent, seconds of the mission's clock.

        Args:
            stamp_s: the sender's boot time; NaN if unknown.
            received_s: when it arrived.

        Returns:
            The arrival time if the stamp is unusable: missing, not increasing, or reset by a reboot.
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
