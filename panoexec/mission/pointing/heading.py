"""Turns the vehicle where its gimbal cannot pan far enough, and corrects the autopilot's steady heading error.

An autopilot holds its heading setpoint within a degree or two: wind disturbs it, and ArduCopter's SITL has an offset
of 0.9° in calm air. With a pan axis this does not matter, because the gimbal holds its own yaw. A two-axis gimbal
follows the vehicle's heading: there the yaw error that the gate measures, averaged while the heading is steady, is
subtracted from the next setpoint and from those that follow (`trim_deg`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence

from panoexec.angles import wrap_180
from panoexec.clock import Clock
from panoexec.devices import Vehicle
from panoexec.errors import DeviceError
from panoexec.planning.model import GimbalLimits, Turning, TurnLimits
from panoexec.planning.order.duration import turn_times_s
from panoexec.planning.order.vehicle_yaw import NO_TURN_DEG, PanReach, heading_for

AVERAGED_S = 1.5
"""Averaging time of the yaw error, so that corrections do not follow oscillations in gusts (ArduCopter's SITL: mostly
at 0.3 Hz)."""
GAIN = 0.8
"""Fraction of the averaged error that is subtracted from the next setpoint."""
RESPONSE_S = 1.2
"""Settling time of the heading after a corrected setpoint."""
CORRECTION_THRESHOLD_FRAC = 0.5
"""Smallest steady error that is corrected, as a fraction of the yaw tolerance."""
MAX_TRIM_DEG = 10.0
"""Largest trim; a larger error has another cause."""
HELD_WITHIN_DEG = 5.0
"""The heading counts as held within this angle of its setpoint."""


class HeadingController:
    """Turns one vehicle for one mission; headings and yaws are degrees from true north.

    Attributes:
        trim_deg: added to a heading setpoint to cancel the steady error.
        turns: number of commanded turns to another heading.
        last_turn_s: expected duration of the last turn, seconds.
        turn_ends_at_s: expected end of the last turn below a gimbal with a pan axis. During a fast turn a delay of
            30 ms is a degree, so the gimbal's reported yaw is then too inaccurate.
    """

    def __init__(self, *, vehicle: Vehicle, clock: Clock, turning: Turning, tolerance_yaw_deg: float) -> None:
        self._vehicle = vehicle
        self._clock = clock
        self._turning = turning
        self._correction_threshold_deg = CORRECTION_THRESHOLD_FRAC * tolerance_yaw_deg
        self._wanted_deg = math.nan
        self._errors: deque[tuple[float, float]] = deque()
        self._steady_from_s = math.inf
        self._needed = False
        self.trim_deg = 0.0
        self.turns = 0
        self.last_turn_s = 0.0
        self.turn_ends_at_s = -math.inf

    @property
    def modes(self) -> tuple[str, ...] | None:
        """Flight modes in which the vehicle can be turned; None while the remaining shots need no turn."""
        return self._vehicle.turn_modes if self._needed else None

    @property
    def turning(self) -> Turning:
        """How the vehicle is expected to turn."""
        return self._turning

    def limit(self, limits: TurnLimits) -> None:
        """Expect turns no faster than the autopilot makes them."""
        self._turning = self._turning.within(limits)

    def needs(self, yaws_deg: Iterable[float], limits: GimbalLimits) -> bool:
        """Whether the vehicle must turn for any of these yaws."""
        heading, reach = self._held_heading_deg(), PanReach.of(limits)
        self._needed = any(not reach.has(yaw, heading) for yaw in yaws_deg)
        return self._needed

    def _held_heading_deg(self) -> float:
        """The heading setpoint if it is held, else the measured heading."""
        measured = self._vehicle.status.heading_deg
        held = abs(float(wrap_180(measured - self._wanted_deg))) <= HELD_WITHIN_DEG
        return self._wanted_deg if held else measured

    async def begin(self, yaws_deg: Sequence[float], limits: GimbalLimits) -> float:
        """Turn the vehicle for the next shot if needed; returns when the autopilot accepted the command.

        Args:
            yaws_deg: yaws of the remaining shots, the next one first.
            limits: of the gimbal.

        Returns:
            Expected duration of the turn, seconds; 0 without one.

        Raises:
            DeviceError: the vehicle refuses, or its heading is unknown.
        """
        held_deg, two_axes = self._held_heading_deg(), not limits.pans
        if math.isnan(held_deg):
            raise DeviceError("the vehicle's heading is unknown, but it must turn")
        wanted = heading_for(yaws_deg, held_deg, PanReach.of(limits))
        self._needed = two_axes or self.needs(yaws_deg, limits)
        turn_deg = abs(float(wrap_180(wanted - held_deg)))
        if two_axes:
            self._learn()
        elif turn_deg <= NO_TURN_DEG:
            return 0.0
        self._wanted_deg = wanted
        if turn_deg > NO_TURN_DEG:
            self.turns += 1
        expected_s = self.last_turn_s = float(turn_times_s(self._turning, turn_deg))
        await self._command(expected_s)
        if not two_axes:
            self.turn_ends_at_s = self._steady_from_s
        return expected_s

    def note(self, time_s: float, yaw_error_deg: float) -> None:
        """Take the camera's yaw error of a sample that arrived at `time_s`."""
        if not math.isfinite(yaw_error_deg):
            return
        self._errors.append((time_s, yaw_error_deg))
        while self._errors[0][0] < time_s - AVERAGED_S:
            self._errors.popleft()

    def is_off(self, now_s: float) -> bool:
        """Whether the heading is steady, but with an error that needs a correction."""
        if now_s < self._steady_from_s + AVERAGED_S:
            return False
        return abs(self._steady_error_deg()) > self._correction_threshold_deg

    async def correct(self) -> None:
        """Send the heading setpoint again, corrected by the remaining error."""
        self._learn()
        try:
            await self._command(RESPONSE_S)
        except DeviceError:  # retried later, until the attempt times out
            self._steady_from_s = self._clock.monotonic() + RESPONSE_S

    def _steady_error_deg(self) -> float:
        """Mean error since the heading is steady; 0 with too few samples."""
        errors = [error for time_s, error in self._errors if time_s >= self._steady_from_s]
        span_s = self._errors[-1][0] - self._steady_from_s if errors else 0.0
        return sum(errors) / len(errors) if span_s >= AVERAGED_S / 2 else 0.0

    def _learn(self) -> None:
        error = self._steady_error_deg()
        if abs(error) <= HELD_WITHIN_DEG:
            self.trim_deg = min(max(self.trim_deg - GAIN * error, -MAX_TRIM_DEG), MAX_TRIM_DEG)

    async def _command(self, steady_after_s: float) -> None:
        self._errors.clear()
        self._steady_from_s = math.inf
        heading = float((self._wanted_deg + self.trim_deg) % 360.0)
        await self._vehicle.turn(heading, self._turning.rate_deg_s)
        self._steady_from_s = self._clock.monotonic() + steady_after_s
