"""The vehicle: its status, turns, and messages to its pilot."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from types import TracebackType
from typing import Final, Self

from panoexec.adapters.flight_modes import flight_mode, own_name
from panoexec.adapters.link.mavsdk_errors import MAV_RESULTS
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_health import EKF_STATUS_REPORT, ESTIMATOR_STATUS
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.adapters.position_health import PositionHealth
from panoexec.adapters.turn_limits import read_turn_limits
from panoexec.devices import Severity, VehicleStatus
from panoexec.errors import DeviceError
from panoexec.planning.model import TurnLimits

CONDITION_YAW: Final = 115
DO_REPOSITION: Final = 192
_KEEP_SPEED: Final = -1.0
_CHANGE_MODE: Final = 1.0
"""MAV_DO_REPOSITION_FLAGS: the vehicle goes over to Hold, if it is not in it."""
_SAFETY_ARMED: Final = 128
_GPS: Final = 0x20
_IN_AIR: Final = frozenset({2, 3, 4})
"""MAV_LANDED_STATE: in air, taking off, landing."""

_SENSORS: Final = {1: "gyroscopes", 2: "accelerometers", 4: "compass", 8: "barometer", 0x200000: "attitude estimator"}
"""MAV_SYS_STATUS_SENSOR bits of attitude, heading and height; the position is checked separately."""
_POSITION_STALE_S: Final = 5.0
_BATTERY_STALE_S: Final = 30.0
"""A charge that SYS_STATUS has not told again for so long is unknown. Slow links tell it every few seconds."""
_UNKNOWN_HEADING: Final = 65535


class MavsdkVehicle:
    """Implements `Vehicle`; an async context manager on an open link.

    Reads MAVLink messages of the autopilot directly: what MAVSDK says of autopilot and flight mode depends on the
    heartbeats of all components, and on which of them came last.
    """

    def __init__(self, link: MavsdkLink) -> None:
        """Create it; entering the context subscribes to messages."""
        self._link = link
        self._off: list[Callable[[], None]] = []
        self._armed = False
        self._in_air = False
        self._mode = ""
        self._own_mode = ""
        self._heartbeats = 0
        self._battery_frac = math.nan
        self._battery_s = -math.inf
        self._position = (math.nan,) * 5
        self._position_s = -math.inf
        self._gps_ok = False
        self._health = PositionHealth()
        self._unhealthy: tuple[str, ...] = ()
        self._hold_position: tuple[float, float, float] | None = None
        self._turn_limits: tuple[tuple[str | None, int], TurnLimits] | None = None

    @property
    def status(self) -> VehicleStatus:
        """See `Vehicle.status`."""
        latitude_deg, longitude_deg, altitude_m, relative_altitude_m, heading_deg = self._position
        now = time.monotonic()
        fresh = now - self._position_s < _POSITION_STALE_S
        trusted = self._gps_ok if self._health.estimator_ok is None else self._health.estimator_ok
        heartbeats = self._heartbeats  # before the mode, which may be newer then, but not older
        return VehicleStatus(
            connected=self._link.connected,
            armed=self._armed,
            in_air=self._in_air,
            mode=self._mode,
            own_mode=self._own_mode,
            heading_deg=heading_deg,
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_m=altitude_m,
            relative_altitude_m=relative_altitude_m,
            battery_frac=self._battery_frac if now - self._battery_s < _BATTERY_STALE_S else math.nan,
            position_ok=trusted and fresh,
            position_doubts=self._health.doubts,
            boot_count=self._link.boot_count,
            heartbeats=heartbeats,
            unhealthy=self._unhealthy,
        )

    @property
    def turn_modes(self) -> tuple[str, ...]:
        """See `Vehicle.turn_modes`: ArduPilot's GUIDED (MAVSDK calls it OFFBOARD), PX4's Hold; none of others."""
        return {"ardupilot": ("OFFBOARD",), "px4": ("HOLD",)}.get(self._link.autopilot or "", ())

    async def turn(self, heading_deg: float, rate_deg_s: float) -> None:
        """See `Vehicle.turn`.

        ArduPilot: MAV_CMD_CONDITION_YAW (115), which it accepts in every mode and executes in GUIDED. PX4 has no such
        command: it gets MAV_CMD_DO_REPOSITION (192) to its hold position, and turns at its own rate.
        """
        what = f"turning the vehicle to {heading_deg:.1f}°"
        autopilot = self._link.autopilot
        if autopilot == "ardupilot":
            result = await self._link.requests.command(CONDITION_YAW, [heading_deg % 360.0, rate_deg_s])
        elif autopilot == "px4":
            result = await self._reposition(what, heading_deg)
        else:
            raise DeviceError(f"{what}: the autopilot is neither ArduPilot nor PX4 (or was not found)")
        if result != 0:
            raise DeviceError(f"{what}: {MAV_RESULTS.get(result, result)}")

    async def _reposition(self, what: str, heading_deg: float) -> int:
        """Hold the position with the nose at a heading; the position is that of the first turn in this mode."""
        if self._hold_position is None:
            status = self.status
            self._hold_position = (status.latitude_deg, status.longitude_deg, status.altitude_m)
        latitude_deg, longitude_deg, altitude_m = self._hold_position
        if not all(math.isfinite(value) for value in self._hold_position):
            self._hold_position = None
            raise DeviceError(f"{what}: its position is unknown")
        heading = math.radians((heading_deg + 180.0) % 360.0 - 180.0)
        return await self._link.requests.command_at(
            DO_REPOSITION,
            [_KEEP_SPEED, _CHANGE_MODE, 0.0, heading],
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_m=altitude_m,
        )

    async def turn_limits(self) -> TurnLimits:
        """See `LimitsTurns.turn_limits`; read again after a reboot of the autopilot."""
        key = (self._link.autopilot, self._link.boot_count)
        if self._turn_limits is None or self._turn_limits[0] != key:
            self._turn_limits = key, await read_turn_limits(self._link.requests, self._link.autopilot)
        return self._turn_limits[1]

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
        identity, fields = self._link.identity, message.fields
        autopilot = identity.autopilot
        if message.component_id != AUTOPILOT or autopilot is None or not identity.is_own(fields):
            return
        base_mode = int(fields["base_mode"])
        self._armed = bool(base_mode & _SAFETY_ARMED)
        mode = flight_mode(autopilot, identity.kind, base_mode, int(fields["custom_mode"]))
        if mode is not None and mode != self._mode:
            self._hold_position = None  # the vehicle may have been flown elsewhere
            self._mode = mode
        if mode is not None:
            self._own_mode = own_name(autopilot, identity.kind, int(fields["custom_mode"]), mode)
        self._heartbeats += 1

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
        self._battery_s = time.monotonic()
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

    # --- on the loop

    def _came_back(self) -> None:
        """Reset the status that may have changed with a reboot."""
        self._health.forget()
        self._gps_ok = False
        self._unhealthy = ()
        self._position_s = -math.inf
