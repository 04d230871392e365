"""A pilot for simulated flights: arms an ArduCopter or PX4 in SITL, takes off, lands.

It is not used on real vehicles: a mission starts with a vehicle that hovers already.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import structlog
from mavsdk.plugins.action import Action

from panoexec.adapters.link.mavsdk_errors import MAV_RESULTS
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.clock import Clock
from panoexec.devices import Vehicle, VehicleStatus
from panoexec.errors import DeviceError

DO_SET_MODE: Final = 176
NAV_TAKEOFF: Final = 22
_CUSTOM_MODE: Final = 1
_REAL32: Final = 9
_COPTER_GUIDED: Final = 4
_STEP_S: Final = 0.5
_HEIGHT_FRAC: Final = 0.97
_GPS_RAW_INT: Final = 24
_FIX_3D: Final = 3
_STILL_M: Final = 0.5
_STILL_S: Final = 4.0
_STILL_PATIENCE_S: Final = 40.0
_STILL_REAL_S: Final = 10.0
_EARTH_M: Final = 6_371_000.0
_LEAST_REAL_S: Final = 60.0
"""Minimum of all timeouts in real time: a simulation may not reach its requested speed-up."""
_REFUSALS: Final = ("Arm: ", "PreArm: ", "Arming denied", "Preflight Fail")
"""How ArduPilot and PX4 begin the STATUSTEXT that says why the vehicle cannot be armed."""
_MULTIROTORS: Final = frozenset({2, 3, 4, 13, 14, 15, 29})
"""MAV_TYPE: quadrotor, coaxial, helicopter, hexa-, octo-, tri- and dodecarotor."""

_log = structlog.get_logger(__name__)


class MavsdkPilot:
    """Flies a multirotor in simulation."""

    def __init__(self, link: MavsdkLink, vehicle: Vehicle, *, clock: Clock, px4: bool = False) -> None:
        """Args: the link and the vehicle, both entered; the clock of the timeouts; whether PX4 flies it."""
        self._link = link
        self._vehicle = vehicle
        self._clock = clock
        self._px4 = px4

    async def take_off(self, height_m: float = 30.0, *, timeout_s: float = 180.0) -> None:
        """Arm as soon as the autopilot permits, climb, and return when the vehicle hovers.

        ArduCopter climbs and hovers in GUIDED; PX4 goes from its take-off mode to HOLD by itself.

        Args:
            height_m: above the take-off point.
            timeout_s: for each stage (GPS, estimator and arming, climb); a simulated estimator needs some 40 s.

        Raises:
            DeviceError: denied until the timeout, or not reached in time; includes the autopilot's STATUSTEXT.
        """
        kind, _ = self._link.components.get(AUTOPILOT, (-1, 0.0))
        if kind not in _MULTIROTORS:
            raise DeviceError(f"the vehicle is not a multirotor (MAV_TYPE {kind}); a panorama needs one that hovers")
        with self._listening() as said:
            await self._wait_gps(timeout_s)
            if self._px4:
                await self._climb_px4(height_m, timeout_s, said)
            else:
                await self._must(DO_SET_MODE, [_CUSTOM_MODE, _COPTER_GUIDED], "changing to GUIDED")
                await self._arm(timeout_s, said)
                await self._must(NAV_TAKEOFF, [0, 0, 0, 0, 0, 0, height_m], "taking off")
            enough_m = _HEIGHT_FRAC * height_m
            await self._wait(lambda: self._vehicle.status.relative_altitude_m >= enough_m, timeout_s, "climbing")
            if self._px4:
                await self._wait(lambda: self._vehicle.status.mode == "HOLD", timeout_s, "changing to HOLD")
            await self._wait_still()
        _log.info("hovering", height_m=self._vehicle.status.relative_altitude_m)

    async def _climb_px4(self, height_m: float, timeout_s: float, said: list[str]) -> None:
        action = self._link.requests.plugin(Action)
        await self._link.requests.mavsdk_call(
            "setting the take-off height", lambda: action.set_takeoff_altitude(height_m)
        )
        await self._arm(timeout_s, said)
        await self._link.requests.mavsdk_call("taking off", action.takeoff)

    async def go_to(
        self, latitude_deg: float, longitude_deg: float, altitude_m: float, heading_deg: float = float("nan")
    ) -> None:
        """Fly to a position; returns when the command was accepted, not on arrival.

        Args:
            latitude_deg: of the destination.
            longitude_deg: of the destination.
            altitude_m: above mean sea level.
            heading_deg: clockwise from north; NaN leaves it to the autopilot.

        Raises:
            DeviceError: denied or not acknowledged.
        """
        action = self._link.requests.plugin(Action)
        await self._link.requests.mavsdk_call(
            "flying there", lambda: action.goto_location(latitude_deg, longitude_deg, altitude_m, heading_deg)
        )

    async def land(self, *, timeout_s: float = 120.0) -> None:
        """Land and return when the motors are off.

        Raises:
            DeviceError: denied, or not landed in time.
        """
        action = self._link.requests.plugin(Action)
        await self._link.requests.mavsdk_call("landing", action.land)
        await self._wait(lambda: not self._vehicle.status.armed, timeout_s, "landing")

    async def set_speed(self, speed: float) -> None:
        """Set the speed-up of ArduPilot's SITL (PARAM_SET of SIM_SPEEDUP); the result is not verified.

        Args:
            speed: simulated seconds per second.

        Raises:
            DeviceError: not sent.
        """
        fields = {
            "target_system": self._link.vehicle_system_id or 1,
            "target_component": AUTOPILOT,
            "param_id": "SIM_SPEEDUP",
            "param_value": speed,
            "param_type": _REAL32,
        }
        await self._link.requests.send("changing the speed", "PARAM_SET", fields)

    async def _must(self, command: int, params: list[float], what: str) -> None:
        result = await self._link.requests.command(command, params)
        if result != 0:
            raise DeviceError(f"{what}: {MAV_RESULTS.get(result, result)}")

    @contextmanager
    def _listening(self) -> Iterator[list[str]]:
        """The autopilot's latest reasons for refusing to arm (STATUSTEXT, 253), the newest last."""
        said: list[str] = []

        def hear(message: MavMessage) -> None:
            text = str(message.fields.get("text", "")).strip()
            if message.component_id == AUTOPILOT and text.startswith(_REFUSALS):
                said[:] = [*(known for known in said if known != text), text][-3:]

        off = self._link.on("STATUSTEXT", hear)
        try:
            yield said
        finally:
            off()

    async def _wait_gps(self, timeout_s: float) -> None:
        timeout = _Timeout(self._clock, timeout_s)
        fix = 0
        while fix < _FIX_3D:
            if timeout.expired:
                raise DeviceError(f"no GPS fix within {timeout_s:g} s (fix type {fix}, 3 is required)")
            try:
                fix = int((await self._link.requests.message(_GPS_RAW_INT, "GPS_RAW_INT")).fields["fix_type"])
            except DeviceError as error:
                _log.debug("no GPS status yet", error=str(error))
            await self._clock.sleep(_STEP_S)

    async def _arm(self, timeout_s: float, said: list[str]) -> None:
        timeout = _Timeout(self._clock, timeout_s)
        action = self._link.requests.plugin(Action)
        refusal = ""
        while not self._vehicle.status.armed:
            if timeout.expired:
                why = "; ".join(said) or refusal or "no reason given"
                raise DeviceError(f"the autopilot could not be armed within {timeout_s:g} s: {why}")
            try:
                await self._link.requests.mavsdk_call("arming", action.arm)
            except DeviceError as error:
                refusal = str(error)
            await self._clock.sleep(2 * _STEP_S)

    async def _wait_still(self) -> None:
        """Return when the vehicle holds its position; wind displaces it during the climb.

        If it never does in strong wind, the mission's guards decide, so the timeout is short.
        """
        timeout = _Timeout(self._clock, _STILL_PATIENCE_S, least_real_s=_STILL_REAL_S)
        track: deque[VehicleStatus] = deque(maxlen=round(_STILL_S / _STEP_S) + 1)
        while not timeout.expired:
            track.append(self._vehicle.status)
            if len(track) == track.maxlen and all(_apart_m(track[-1], past) < _STILL_M for past in track):
                return
            await self._clock.sleep(_STEP_S)

    async def _wait(self, done: Callable[[], bool], timeout_s: float, what: str) -> None:
        timeout = _Timeout(self._clock, timeout_s)
        while not done():
            if timeout.expired:
                raise DeviceError(f"{what}: not completed within {timeout_s:g} s")
            await self._clock.sleep(_STEP_S)


def _apart_m(a: VehicleStatus, b: VehicleStatus) -> float:
    north = math.radians(a.latitude_deg - b.latitude_deg) * _EARTH_M
    east = math.radians(a.longitude_deg - b.longitude_deg) * _EARTH_M * math.cos(math.radians(a.latitude_deg))
    return math.hypot(north, east, a.relative_altitude_m - b.relative_altitude_m)


class _Timeout:
    """A timeout on the mission clock with a minimum in real time."""

    def __init__(self, clock: Clock, timeout_s: float, *, least_real_s: float | None = None) -> None:
        self._clock = clock
        self._end_s = clock.monotonic() + timeout_s
        self._end_real_s = time.monotonic() + min(timeout_s, _LEAST_REAL_S if least_real_s is None else least_real_s)

    @property
    def expired(self) -> bool:
        """Whether the timeout has expired."""
        return self._clock.monotonic() > self._end_s and time.monotonic() > self._end_real_s
