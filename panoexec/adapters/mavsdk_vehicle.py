"""The vehicle: its status, turns, and messages to its pilot."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from types import TracebackType
from typing import Final, Self

from mavsdk.plugins.action import Action
from mavsdk.plugins.telemetry import FlightMode, Telemetry

from panoexec.adapters.link.mavsdk_errors import MAV_RESULTS
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_health import EKF_STATUS_REPORT, ESTIMATOR_STATUS
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.adapters.position_health import PositionHealth
from panoexec.devices import Severity, VehicleStatus
from panoexec.errors import DeviceError

CONDITION_YAW: Final = 115
_SAFETY_ARMED: Final = 128
_GPS: Final = 0x20
_IN_AIR: Final = frozenset({2, 3, 4})
"""MAV_LANDED_STATE: in air, taking off, landing."""

_SENSORS: Final = {1: "gyroscopes", 2: "accelerometers", 4: "compass", 8: "barometer", 0x200000: "attitude estimator"}
"""MAV_SYS_STATUS_SENSOR bits of attitude, heading and height; the position is checked separately."""
_POSITION_STALE_S: Final = 5.0
_UNKNOWN_HEADING: Final = 65535


class MavsdkVehicle:
    """Implements `Vehicle`; an async context manager on an open link.

    Reads MAVLink messages directly, except for the flight mode, which MAVSDK names for each kind of autopilot.
    """

    def __init__(self, link: MavsdkLink) -> None:
        """Create it; entering the context subscribes to messages."""
        self._link = link
        self._off: list[Callable[[], None]] = []
        self._armed = False
        self._in_air = False
        self._mode = ""
        self._battery_frac = math.nan
        self._position = (math.nan,) * 5
        self._position_s = -math.inf
        self._gps_ok = False
        self._health = PositionHealth()
        self._unhealthy: tuple[str, ...] = ()
        self._hold_position: tuple[float, float, float] | None = None

    @property
    def status(self) -> VehicleStatus:
        """See `Vehicle.status`."""
        latitude_deg, longitude_deg, altitude_m, relative_altitude_m, heading_deg = self._position
        fresh = time.monotonic() - self._position_s < _POSITION_STALE_S
        trusted = self._gps_ok if self._health.estimator_ok is None else self._health.estimator_ok
        return VehicleStatus(
            connected=self._link.connected,
            armed=self._armed,
            in_air=self._in_air,
            mode=self._mode,
            heading_deg=heading_deg,
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_m=altitude_m,
            relative_altitude_m=relative_altitude_m,
            battery_frac=self._battery_frac,
            position_ok=trusted and fresh,
            position_doubts=self._health.doubts,
            boot_count=self._link.boot_count,
            unhealthy=self._unhealthy,
        )

    @property
    def turn_modes(self) -> tuple[str, ...]:
        """See `Vehicle.turn_modes`: ArduPilot's GUIDED (MAVSDK calls it OFFBOARD), PX4's Hold."""
        return ("OFFBOARD",) if self._link.is_ardupilot else ("HOLD",)

    async def turn(self, heading_deg: float, rate_deg_s: float) -> None:
        """See `Vehicle.turn`.

        ArduPilot: MAV_CMD_CONDITION_YAW (115), which it accepts in every mode and executes in GUIDED. PX4 has no such
        command: it gets MAV_CMD_DO_REPOSITION (192) to its hold position, and turns at its own rate.
        """
        if self._link.is_ardupilot:
            result = await self._link.requests.command(CONDITION_YAW, [heading_deg % 360.0, rate_deg_s])
            if result != 0:
                raise DeviceError(f"turning the vehicle to {heading_deg:.1f}°: {MAV_RESULTS.get(result, result)}")
            return
        if self._hold_position is None:
            status = self.status
            self._hold_position = (status.latitude_deg, status.longitude_deg, status.altitude_m)
        position = self._hold_position
        if not all(math.isfinite(value) for value in position):
            self._hold_position = None
            raise DeviceError(f"turning the vehicle to {heading_deg:.1f}°: its position is unknown")
        action = self._link.requests.plugin(Action)
        await self._link.requests.mavsdk_call(
            f"turning the vehicle to {heading_deg:.1f}°", lambda: action.goto_location(*position, heading_deg)
        )

    async def say(self, text: str, severity: Severity = Severity.NOTICE) -> None:
        """See `Vehicle.say`."""
        await self._link.requests.say(text, severity)

    async def __aenter__(self) -> Self:
        """Subscribe to messages."""
        on = self._link.on
        self._off = [
            on("HEARTBEAT", self._heartbeat),
            on("GLOBAL_POSITION_INT", self._global_position),
            on("SYS_STATUS", self._sys_status),
            on("EXTENDED_SYS_STATE", self._extended_sys_state),
            on("GPS_RAW_INT", self._receiver),
            on("EKF_STATUS_REPORT", partial(self._estimator, EKF_STATUS_REPORT)),
            on("ESTIMATOR_STATUS", partial(self._estimator, ESTIMATOR_STATUS)),
            self._link.when_attached(self._attach),
            self._link.when_back(self._came_back),
        ]
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Unsubscribe."""
        for off in self._off:
            off()

    # --- in MAVSDK's thread; each assignment is atomic, so the event loop reads the old or the new value

    def _heartbeat(self, message: MavMessage) -> None:
        if message.component_id == AUTOPILOT:
            self._armed = bool(int(message.fields["base_mode"]) & _SAFETY_ARMED)

    def _global_position(self, message: MavMessage) -> None:
        if message.component_id != AUTOPILOT:
            return
        fields = message.fields
        heading = int(fields["hdg"])
        known = fields["lat"] != 0 or fields["lon"] != 0
        self._position = (
            fields["lat"] / 1e7 if known else math.nan,
            fields["lon"] / 1e7 if known else math.nan,
            fields["alt"] / 1e3 if known else math.nan,
            fields["relative_alt"] / 1e3,
            math.nan if heading == _UNKNOWN_HEADING else heading / 100.0 % 360.0,
        )
        self._position_s = time.monotonic()

    def _sys_status(self, message: MavMessage) -> None:
        if message.component_id != AUTOPILOT:
            return
        fields = message.fields
        remaining = int(fields["battery_remaining"])
        self._battery_frac = remaining / 100.0 if remaining >= 0 else math.nan
        present, enabled, health = (
            int(fields[f"onboard_control_sensors_{kind}"]) for kind in ("present", "enabled", "health")
        )
        self._gps_ok = bool(present & enabled & health & _GPS)
        self._unhealthy = tuple(name for bit, name in _SENSORS.items() if present & enabled & ~health & bit)

    def _extended_sys_state(self, message: MavMessage) -> None:
        if message.component_id == AUTOPILOT:
            self._in_air = int(message.fields["landed_state"]) in _IN_AIR

    def _receiver(self, message: MavMessage) -> None:
        if message.component_id == AUTOPILOT:
            self._health.receiver(message.fields)

    def _estimator(self, message_id: int, message: MavMessage) -> None:
        if message.component_id == AUTOPILOT:
            self._health.estimator(int(message.fields["flags"]), message_id=message_id)

    def _flight_mode(self, mode: FlightMode, _user_data: object) -> None:
        if mode.name != self._mode:
            self._hold_position = None  # the vehicle may have been flown elsewhere
        self._mode = mode.name

    # --- on the loop

    def _attach(self) -> None:
        plugin = self._link.requests.plugin(Telemetry)
        handle = plugin.subscribe_flight_mode(self._flight_mode)
        self._off.append(partial(plugin.unsubscribe_flight_mode, handle))

    def _came_back(self) -> None:
        """Reset the status that may have changed with a reboot."""
        self._health.forget()
        self._gps_ok = False
        self._unhealthy = ()
        self._position_s = -math.inf
