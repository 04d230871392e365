"""A pilot for simulated flights: takes a real ArduCopter's software up, holds it, brings it down.

Nobody flies a real drone with this: the mission needs a vehicle that hovers already.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import structlog
from mavsdk.plugins.action import Action

from panoexec.adapters.mavsdk_link import MavsdkLink
from panoexec.adapters.vendor import MAV_RESULTS
from panoexec.clock import Clock
from panoexec.devices import Vehicle
from panoexec.errors import DeviceError

DO_SET_MODE: Final = 176
NAV_TAKEOFF: Final = 22
_CUSTOM_MODE: Final = 1
_COPTER_GUIDED: Final = 4
_STEP_S: Final = 0.5
_HEIGHT_FRAC: Final = 0.97

_log = structlog.get_logger(__name__)


class MavsdkPilot:
    """Flies an ArduCopter in simulation."""

    def __init__(self, link: MavsdkLink, vehicle: Vehicle, *, clock: Clock) -> None:
        """Args: the link, entered; the vehicle on it, entered; the clock that timeouts run on."""
        self._link = link
        self._vehicle = vehicle
        self._clock = clock

    async def take_off(self, height_m: float = 30.0, *, timeout_s: float = 180.0) -> None:
        """Arm in GUIDED as soon as the vehicle lets itself be armed, climb, and return when it hovers there.

        Args:
            height_m: above the take-off point.
            timeout_s: for all of it; a simulated estimator needs some 40 s after boot before it can be armed.

        Raises:
            DeviceError: refused to the end, or not there in time.
        """
        action = self._link.plugin(Action)
        deadline_s = self._clock.monotonic() + timeout_s
        await self._wait(lambda: self._vehicle.status.position_ok, deadline_s, "waiting for a position")
        await self._must(DO_SET_MODE, [_CUSTOM_MODE, _COPTER_GUIDED], "changing to GUIDED")
        refusal = "it did not say why"
        while not self._vehicle.status.armed:
            if self._clock.monotonic() > deadline_s:
                raise DeviceError(f"arming: refused for {timeout_s:g} s; {refusal}")
            try:
                await self._link.vendor_call("arming", action.arm)
            except DeviceError as error:
                refusal = str(error)
            await self._clock.sleep(2 * _STEP_S)
        await self._must(NAV_TAKEOFF, [0, 0, 0, 0, 0, 0, height_m], "taking off")
        await self._wait(
            lambda: self._vehicle.status.relative_altitude_m >= _HEIGHT_FRAC * height_m, deadline_s, "climbing"
        )
        _log.info("hovering", height_m=self._vehicle.status.relative_altitude_m)

    async def go_to(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, heading_deg: float = float("nan")
    ) -> None:
        """Send it somewhere; returns when that was accepted, not when it is there.

        Args:
            latitude_deg: where.
            longitude_deg: where.
            altitude_m: above mean sea level.
            heading_deg: clockwise from north; NaN leaves it to the autopilot.

        Raises:
            DeviceError: refused or not answered.
        """
        action = self._link.plugin(Action)
        await self._link.vendor_call(
            "flying there", lambda: action.goto_location(latitude_deg, longitude_deg, altitude_m, heading_deg)
        )

    async def land(self, *, timeout_s: float = 120.0) -> None:
        """Land and return when the motors are off.

        Raises:
            DeviceError: refused, or not down in time.
        """
        action = self._link.plugin(Action)
        await self._link.vendor_call("landing", action.land)
        deadline_s = self._clock.monotonic() + timeout_s
        await self._wait(lambda: not self._vehicle.status.armed, deadline_s, "landing")

    async def _must(self, command: int, params: list[float], what: str) -> None:
        result = await self._link.command(command, params)
        if result != 0:
            raise DeviceError(f"{what}: {MAV_RESULTS.get(result, result)}")

    async def _wait(self, done: Callable[[], bool], deadline_s: float, what: str) -> None:
        while not done():
            if self._clock.monotonic() > deadline_s:
                raise DeviceError(f"{what}: not done in time")
            await self._clock.sleep(_STEP_S)
