"""The camera's clock: its time since boot related to the mission's clock, with the rate estimated.

A camera stamps a photo with its own time since boot (`time_boot_ms` of CAMERA_IMAGE_CAPTURED, 263). Its clock may run
slow or fast by per cents (PX4's SITL clock lagged 2 %) and may be stepped. Messages that are stamped when they are sent
(262, 259, 261) relate the two clocks: each arrives a short transport delay after its stamp. One that was certainly
stamped after a request was sent (`camera_round_trips`) has a delay that is not longer than the round trip.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Sequence
from statistics import median
from typing import Final

RATE_BOUND: Final = 0.06
"""How far the rate may be from 1 while too little is known to estimate it."""
DELAY_S: Final = 0.05
"""Transport delay of an ordinary message: the part of a date that no estimate removes."""

_KEPT: Final = 24
_WINDOW_S: Final = 120.0
_SHORTEST_SPAN_S: Final = 2.0
_APART_TRIPS_S: Final = 0.5
_DRIFT: Final = 2e-4
"""What the rate itself may change."""
LATE_S: Final = 0.25
"""A message that is later than predicted by more than this was held up, or the camera's clock was stepped back. A
smaller step back looks like a delay until the messages from before it have left the window."""
APART_S: Final = 0.5
"""Two late messages tell of a step if so much time lies between them; closer ones may have waited in one queue."""
_HELD_UP_S: Final = 1.0
"""While a message is suspected that is late by no more than this, dates are widened by it; beyond, they wait."""
_AGREE_S: Final = 0.1
_RESOLUTIONS_MS: Final = (1000, 100)
"""Stamps that have all been multiples of one of these are coarse."""
_LATEST_REPORT_S: Final = 10.0
"""How long a report may be under way."""
_TRIPS: Final = 9
ENOUGH_TRIPS: Final = 5
"""Round trips before they are believed: one of so many may be false."""
_FALSE_OF: Final = 5
"""One of so many round trips may be false: what they prove is what all the others allow."""
_TIGHT_S: Final = 0.06
"""Bounds that are wider than this tell no more than a date."""


class CameraClock:
    """Dates stamps of a camera on the mission's clock.

    Args:
        pairs: stamps and arrivals that relate the clocks.
        rate: mission seconds per camera second.
        rate_error: how far the rate may be wrong.
    """

    def __init__(
        self, pairs: Iterable[tuple[float, float]] = (), *, rate: float = 1.0, rate_error: float = RATE_BOUND
    ) -> None:
        self._pairs: deque[tuple[float, float]] = deque(pairs, maxlen=_KEPT)
        self._suspect: tuple[float, float] | None = None
        self._rate, self._rate_error = rate, rate_error
        self._trips: deque[tuple[float, float, float]] = deque(maxlen=_TRIPS)  # stamp, asked, received
        self._before: CameraClock | None = None  # the relation before the last step
        self._found_s = math.inf
        self.in_doubt_since_s = math.inf
        """The last message before the last step: dates of reports that arrived after it and before the step was found
        may be wrong."""
        self._step_ms = 0
        self.steps = 0
        """How often the camera's clock was found stepped, or the camera rebooted."""
        self.step_s = 0.0
        """By how much it was stepped the last time, seconds; negative: back."""

    @property
    def rate(self) -> float:
        """Mission seconds per camera second, as estimated; 1 before there is an estimate."""
        return self._rate

    @property
    def related(self) -> bool:
        """Whether stamps can be dated."""
        return bool(self._pairs)

    @property
    def suspicious(self) -> bool:
        """Whether the clock may have been stepped back so far that nothing can be dated; the next message tells."""
        return self._late_s > _HELD_UP_S

    @property
    def _late_s(self) -> float:
        """By how much the suspected message is late: how far the clock was stepped back if it was; 0 without one."""
        if self._suspect is None or not self._pairs:
            return 0.0
        return max(0.0, self._suspect[1] - self._predict(self._suspect[0])[0])

    @property
    def trips(self) -> int:
        """How many round trips are known."""
        return len(self._trips)

    def note_trip(self, stamp_s: float, asked_s: float, received_s: float) -> None:
        """Take a message, noted already, that was certainly stamped after a request was sent.

        Args:
            stamp_s: the camera's time since boot, seconds.
            asked_s: when the request was sent, on the mission's clock.
            received_s: when the message arrived.
        """
        if math.isfinite(stamp_s) and asked_s <= received_s:
            self._trips.append((stamp_s, asked_s, received_s))

    def note(self, stamp_s: float, received_s: float) -> None:
        """Take a message that was stamped when it was sent.

        Args:
            stamp_s: the camera's time since boot, seconds.
            received_s: when it arrived, on the mission's clock.
        """
        if not (math.isfinite(stamp_s) and math.isfinite(received_s)):
            return
        self._learn_resolution(stamp_s)
        if self._pairs:
            predicted_s, error_s = self._predict(stamp_s)
            error_s += self.resolution_s
            if received_s < predicted_s - error_s - DELAY_S:  # arrived before it was sent: stepped forward
                self._restart([], received_s, predicted_s - received_s)
            elif received_s > predicted_s + error_s + LATE_S:
                self._suspected(stamp_s, received_s)
                return
        self._suspect = None
        self._add(stamp_s, received_s)

    def date(self, stamp_s: float, received_s: float) -> tuple[float, float]:
        """When a stamped exposure began, and how far that may be wrong; NaN if the clocks are not related yet.

        Args:
            stamp_s: of the exposure, the camera's time since boot, seconds.
            received_s: when the report arrived.

        Returns:
            (time, error), seconds on the mission's clock. The time may lie after `received_s`: then the camera's clock
            was stepped, and the date is not to be believed. NaN, too, for a stamp that may be from before a step and
            from after it.
        """
        if not self._pairs or math.isnan(stamp_s):
            return math.nan, math.nan
        predicted_s, error_s = self._predict(stamp_s)
        error_s += self.resolution_s  # of this stamp, or of the one that relates the clocks
        if 0 < predicted_s - received_s <= error_s + DELAY_S:
            predicted_s = received_s
        error_s += DELAY_S
        late_s = min(self._late_s, received_s - predicted_s)
        if late_s > 0:  # stepped back, or only held up: the date covers both, as far as it lies before the arrival
            predicted_s, error_s = predicted_s + late_s / 2, error_s + late_s / 2
        if self._before is None or received_s > self._found_s + _WINDOW_S:
            return predicted_s, error_s
        old_s, old_error_s = self._before.date(stamp_s, received_s)
        may_be_old = received_s - _LATEST_REPORT_S - old_error_s <= old_s <= self._found_s + old_error_s
        may_be_new = self.in_doubt_since_s - error_s <= predicted_s <= received_s + error_s
        if may_be_old == may_be_new:
            return math.nan, math.nan
        return (predicted_s, error_s) if may_be_new else (old_s, old_error_s)

    def bounds(self, stamp_s: float, received_s: float) -> tuple[float, float]:
        """Between which times a stamp was made, as round trips prove it.

        Each round trip bounds the relation of the clocks, and so do all of them together. A fifth of them may be false
        (datagrams that overtook each other, a step of the camera's clock), each of which falsifies every bound that it
        is part of: the bounds are those of all the ways to leave out so many, as far as the others agree. The newest
        must agree with them: where it does not, the camera's clock may have been stepped since the others.

        Args:
            stamp_s: the camera's time since boot, seconds.
            received_s: when the message with it arrived.

        Returns:
            (earliest, latest) on the mission's clock; NaN if that is not known within 0.06 s, or while a step of the
            camera's clock is suspected or was found within two minutes.
        """
        unknown = (math.nan, math.nan)
        if not self._pairs or not math.isfinite(stamp_s) or self.trips < ENOUGH_TRIPS or self.resolution_s:
            return unknown
        stepped = self._before is not None and received_s <= self._found_s + _WINDOW_S
        if stepped or self._suspect is not None:
            return unknown
        step_s = max(1, self._step_ms) / 1000.0  # what the camera counts in: a stamp is of any time within it
        told = []
        for kept in itertools.combinations(self._trips, self.trips - self.trips // _FALSE_OF):
            rates = _rate_bounds(kept, step_s)
            possible = [_carried(trip, stamp_s, rates, step_s) for trip in (*kept, self._trips[-1])]
            low, high = max(low for low, _ in possible[:-1]), min(high for _, high in possible[:-1])
            if rates[0] <= rates[1] and low <= high:
                if possible[-1][0] > high or possible[-1][1] < low:
                    return unknown
                told.append((low, high))
        earliest_s, latest_s = (
            min((low for low, _ in told), default=math.inf),
            max((high for _, high in told), default=0),
        )
        if earliest_s > received_s or latest_s - earliest_s > _TIGHT_S:
            return unknown
        return earliest_s, min(latest_s, received_s)

    @property
    def resolution_s(self) -> float:
        """What all stamps are multiples of, seconds; 0 if they are fine enough."""
        if self._step_ms == 0:
            return 0.0
        return next((step_ms / 1000.0 for step_ms in _RESOLUTIONS_MS if self._step_ms % step_ms == 0), 0.0)

    def _learn_resolution(self, stamp_s: float) -> None:
        self._step_ms = math.gcd(self._step_ms, round(stamp_s * 1000.0))

    def _predict(self, stamp_s: float) -> tuple[float, float]:
        """When a message with that stamp would arrive without any delay, by the fastest of those known."""
        best = (math.inf, math.inf)
        for known_stamp_s, known_received_s in self._pairs:
            apart_s = stamp_s - known_stamp_s
            error_s = self._rate_error * abs(apart_s)
            best = min(best, (known_received_s + self._rate * apart_s + error_s, error_s))
        return best[0] - best[1], best[1]

    def _suspected(self, stamp_s: float, received_s: float) -> None:
        """Two late messages in a row that agree with each other are a step; a single one was held up.

        Messages that waited in one queue agree too, and arrive together, so the two must be apart.
        """
        first = self._suspect
        if first is not None and 0 <= received_s - first[1] < APART_S and abs(stamp_s - first[0]) < APART_S:
            return
        self._suspect = (stamp_s, received_s)
        if first is None:
            return
        apart_s = (received_s - first[1]) - self._rate * (stamp_s - first[0])
        if abs(apart_s) <= _AGREE_S + self._rate_error * abs(stamp_s - first[0]):
            self._restart([first, (stamp_s, received_s)], first[1], -self._late_s)

    def _restart(self, pairs: list[tuple[float, float]], found_s: float, step_s: float) -> None:
        """Begin anew after a step: offsets from before say nothing; the rate stays as estimated."""
        self.steps += 1
        self.step_s = step_s
        self.in_doubt_since_s = self._pairs[-1][1]
        self._before = CameraClock(self._pairs, rate=self._rate, rate_error=self._rate_error)
        self._suspect = None
        self._pairs.clear()
        self._pairs.extend(pairs)
        self._trips.clear()
        self._found_s = found_s
        self._rate_error = max(self._rate_error, 0.005)

    def _add(self, stamp_s: float, received_s: float) -> None:
        self._pairs.append((stamp_s, received_s))
        while self._pairs and received_s - self._pairs[0][1] > _WINDOW_S:
            self._pairs.popleft()
        pairs = list(self._pairs)
        span_s = pairs[-1][0] - pairs[0][0]
        if span_s < _SHORTEST_SPAN_S:
            return
        slopes = [
            (later[1] - earlier[1]) / (later[0] - earlier[0])
            for number, earlier in enumerate(pairs)
            for later in pairs[number + 1 :]
            if later[0] - earlier[0] >= span_s / 2
        ]
        if slopes:
            self._rate = median(slopes)
            self._rate_error = min(RATE_BOUND, (DELAY_S + self.resolution_s) / span_s + _DRIFT)


def _rate_bounds(trips: Sequence[tuple[float, float, float]], step_s: float) -> tuple[float, float]:
    """Bounds of the rate, as round trips leave it open; they contradict each other if the first one is larger."""
    slowest, fastest = 1.0 - RATE_BOUND, 1.0 + RATE_BOUND
    for (early_s, asked_s, received_s), (late_s, asked_again_s, received_again_s) in itertools.combinations(trips, 2):
        apart_s = late_s - early_s
        if apart_s >= _APART_TRIPS_S:
            slowest = max(slowest, (asked_again_s - received_s) / (apart_s + step_s) - _DRIFT)
            fastest = min(fastest, (received_again_s - asked_s) / (apart_s - step_s) + _DRIFT)
    return slowest, fastest


def _carried(
    trip: tuple[float, float, float], stamp_s: float, rates: tuple[float, float], step_s: float
) -> tuple[float, float]:
    """Between which times a stamp was made, by one round trip, the bounds of the rate, and the step of the stamps."""
    known_s, asked_s, received_s = trip
    passed_s = [rate * (stamp_s - known_s + rounded_s) for rate in rates for rounded_s in (-step_s, step_s)]
    return asked_s + min(passed_s), received_s + max(passed_s)
