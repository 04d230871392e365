"""A vehicle that obeys the protocol of `panoexec.devices` and can misbehave in every way that hardware does."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from panoexec.angles import wrap_180
from panoexec.clock import Clock
from panoexec.devices import (
    Severity,
    VehicleStatus,
)
from panoexec.errors import DeviceError
from tests.unit.fakes.gimbal import eased


@dataclass
class FakeVehicle:
    """A vehicle that hovers; its heartbeats come each full second."""

    _status: VehicleStatus = field(
        default_factory=lambda: VehicleStatus(
            connected=True,
            armed=True,
            in_air=True,
            mode="OFFBOARD",
            heading_deg=30.0,
            latitude_deg=47.0,
            longitude_deg=8.0,
            altitude_m=500.0,
            relative_altitude_m=30.0,
            battery_frac=0.9,
            position_ok=True,
        )
    )
    said: list[tuple[Severity, str]] = field(default_factory=list)
    deaf: bool = False
    silent: bool = False
    """No more heartbeats."""
    clock: Clock | None = None
    turn_modes: tuple[str, ...] = ("OFFBOARD",)
    offset_deg: Callable[[float], float] = lambda _: 0.0
    """How far the nose stands beside the heading that it was told, at a time."""
    refusals: int = 0
    turn_rate_deg_s: float = 45.0
    turn_acceleration_deg_s2: float = 90.0
    # what happened
    turns: list[tuple[float, float]] = field(default_factory=list)
    _from_deg: float = math.nan
    _to_deg: float = math.nan
    _since: float = -math.inf

    @property
    def status(self) -> VehicleStatus:
        if self.clock is not None and not self.silent:
            self._status = replace(self._status, heartbeats=math.floor(self.clock.monotonic()))
        return self._status

    def heading(self, at_s: float) -> float:
        """Where the nose points at a time, not wrapped."""
        if math.isnan(self._to_deg):
            return self.status.heading_deg
        steady = eased(
            self._from_deg, self._to_deg, at_s - self._since, self.turn_rate_deg_s, self.turn_acceleration_deg_s2
        )
        return steady + self.offset_deg(at_s)

    async def turn(self, heading_deg: float, rate_deg_s: float) -> None:
        assert self.clock is not None
        await self.clock.sleep(0.004)
        if self.refusals > 0:
            self.refusals -= 1
            raise DeviceError("the vehicle refused to turn")
        now = self.clock.monotonic()
        self.turns.append((now, heading_deg))
        if self.status.mode in self.turn_modes:
            here = self.heading(now) - (0.0 if math.isnan(self._to_deg) else self.offset_deg(now))
            self._from_deg, self._to_deg = here, here + float(wrap_180(heading_deg - here))
            self._since = now

    async def tell(self) -> None:
        """Keep the status' heading up to date, ten times a second."""
        assert self.clock is not None
        while True:
            self.change(heading_deg=self.heading(self.clock.monotonic()) % 360.0)
            await self.clock.sleep(0.1)

    async def say(self, text: str, severity: Severity = Severity.NOTICE) -> None:
        if self.deaf:
            await asyncio.Event().wait()
        self.said.append((severity, text))

    def change(self, **changes: object) -> None:
        self._status = replace(self._status, **changes)  # type: ignore[arg-type]
