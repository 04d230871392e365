"""Turning the vehicle where its gimbal cannot pan far enough, and correcting what the autopilot leaves of the heading.

An autopilot holds the heading that it was told within a degree or two: wind leans against the airframe, and
ArduCopter's SITL stands 0.9° beside its target in calm air. Under a gimbal that pans this does not matter, as it holds
its own yaw. A camera on two axes looks where the nose does: there the error that the gate measures, averaged while the
nose stands, is taken off the next command, and stays off those that follow (`trim_deg`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence

from panoexec.angles import wrap_180
from panoexec.clock import Clock
from panoexec.devices import Vehicle
from panoexec.errors import DeviceError
from panoexec.planning.model import GimbalLimits, Turning
from panoexec.planning.order.duration import turn_times_s
from panoexec.planning.order.vehicle_yaw import NO_TURN_DEG, PanReach, heading_for

AVERAGED_S = 1.5
"""The heading's error is averaged over so long: a correction must not chase the swaying of the nose in gusts, of which
ArduCopter's SITL has most at a third of a hertz."""
GAIN = 0.8
"""Of the averaged error, so much is taken off the next command."""
RESPONSE_S = 1.2
"""Before that, a corrected command has no steady effect."""
WORTH_FRAC = 0.5
"""Of the tolerance: a smaller steady error is left alone."""
TRIM_MOST_DEG = 10.0
"""More is no steady error of a heading, but something else that is wrong."""
HELD_DEG = 5.0
"""While the nose is this near to where it was told to be, it stands there."""


class HeadingController:
    """Turns one vehicle for one mission; headings and yaws are degrees from true north.

    Attributes:
        trim_deg: what is added to a heading so that the camera comes to look there.
        turns: how often the vehicle was told to turn to another heading.
        rests_at_s: when the last turn under a gimbal that pans will be over. While the nose turns, so fast that a delay
            of 30 ms is a degree, the gimbal's word for the yaw that it holds is not to be trusted to a tenth of that.
    """

    def __init__(self, *, vehicle: Vehicle, clock: Clock, turning: Turning, tolerance_yaw_deg: float) -> None:
        self._vehicle = vehicle
        self._clock = clock
        self._turning = turning
        self._worth_deg = WORTH_FRAC * tolerance_yaw_deg
        self._wanted_deg = math.nan
        self._errors: deque[tuple[float, float]] = deque()
        self._steady_from_s = math.inf
        self._needed = False
        self.trim_deg = 0.0
        self.turns = 0
        self.rests_at_s = -math.inf

    @property
    def modes(self) -> tuple[str, ...] | None:
        """Flight modes in which the vehicle can be turned; None while the shots to come do not ask for it."""
        return self._vehicle.turn_modes if self._needed else None

    def needs(self, yaws_deg: Iterable[float], limits: GimbalLimits) -> bool:
        """Whether the vehicle must turn for any of these yaws."""
        heading, reach = self._standing_deg(), PanReach.of(limits)
        self._needed = any(not reach.has(yaw, heading) for yaw in yaws_deg)
        return self._needed

    def _standing_deg(self) -> float:
        """Where the nose is held: what it was told, unless it is somewhere else."""
        measured = self._vehicle.status.heading_deg
        held = abs(float(wrap_180(measured - self._wanted_deg))) <= HELD_DEG
        return self._wanted_deg if held else measured

    async def begin(self, yaws_deg: Sequence[float], limits: GimbalLimits) -> float:
        """Have the nose turned for the next shot, if it must; returns when that is accepted.

        Args:
            yaws_deg: of the shots to come, the next one first.
            limits: of the gimbal.

        Returns:
            Seconds that the turn is expected to take; 0 without one.

        Raises:
            DeviceError: the vehicle refuses, or does not say where its nose points.
        """
        standing, two_axes = self._standing_deg(), not limits.pans
        if math.isnan(standing):
            raise DeviceError("the vehicle does not say where its nose points, and must be turned")
        wanted = heading_for(yaws_deg, standing, PanReach.of(limits))
        self._needed = two_axes or self.needs(yaws_deg, limits)
        turn_deg = abs(float(wrap_180(wanted - standing)))
        if two_axes:
            self._learn()
        elif turn_deg <= NO_TURN_DEG:
            return 0.0
        self._wanted_deg = wanted
        if turn_deg > NO_TURN_DEG:
            self.turns += 1
        expected_s = float(turn_times_s(self._turning, turn_deg))
        await self._command(expected_s)
        if not two_axes:
            self.rests_at_s = self._steady_from_s
        return expected_s

    def note(self, time_s: float, yaw_error_deg: float) -> None:
        """Take the camera's yaw error, as measured by a sample that arrived at `time_s`."""
        if not math.isfinite(yaw_error_deg):
            return
        self._errors.append((time_s, yaw_error_deg))
        while self._errors[0][0] < time_s - AVERAGED_S:
            self._errors.popleft()

    def is_off(self, now_s: float) -> bool:
        """Whether the nose has stood for a while, but beside the heading."""
        if now_s < self._steady_from_s + AVERAGED_S:
            return False
        return abs(self._steady_error_deg()) > self._worth_deg

    async def correct(self) -> None:
        """Command the heading anew, less the error that remains."""
        self._learn()
        try:
            await self._command(RESPONSE_S)
        except DeviceError:  # the next time, or the attempt's time-out, tells
            self._steady_from_s = self._clock.monotonic() + RESPONSE_S

    def _steady_error_deg(self) -> float:
        """Mean error since the nose stands; 0 where there are too few samples."""
        errors = [error for time_s, error in self._errors if time_s >= self._steady_from_s]
        span_s = self._errors[-1][0] - self._steady_from_s if errors else 0.0
        return sum(errors) / len(errors) if span_s >= AVERAGED_S / 2 else 0.0

    def _learn(self) -> None:
        error = self._steady_error_deg()
        if abs(error) <= HELD_DEG:
            self.trim_deg = min(max(self.trim_deg - GAIN * error, -TRIM_MOST_DEG), TRIM_MOST_DEG)

    async def _command(self, steady_after_s: float) -> None:
        self._errors.clear()
        self._steady_from_s = math.inf
        heading = float((self._wanted_deg + self.trim_deg) % 360.0)
        await self._vehicle.turn(heading, self._turning.rate_deg_s)
        self._steady_from_s = self._clock.monotonic() + steady_after_s
