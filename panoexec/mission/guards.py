"""Guards: small objects that look at the situation while a mission flies and say why it must hold.

Each has a code (stable, for programs) and a reason (for a pilot). `automatic` findings let the mission go on by itself
when they are gone; the others wait for `resume`. `release` gives the gimbal back at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from panoexec.devices import VehicleStatus
from panoexec.mission.preflight import LEISURELY_S, cannot_turn
from panoexec.mission.settings import GuardSettings, MissionSettings

EARTH_RADIUS_M = 6_371_000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """What guards look at.

    Attributes:
        now_s: on the mission's clock.
        vehicle: its newest status.
        sample_age_s: age of the newest attitude sample; infinity before the first.
        in_control: whether the gimbal's manager names us.
        expects_control: whether it should.
        unclaimed: whether the manager says that nobody has the gimbal.
        origin: latitude, longitude, altitude where the mission began; NaN where unknown.
        storage_free_images: how many more photos fit.
        holding: codes of the findings that hold the mission now.
        turn_modes: flight modes in which the vehicle can be turned; None while it need not be.
    """

    now_s: float
    vehicle: VehicleStatus
    sample_age_s: float
    in_control: bool
    expects_control: bool
    origin: tuple[float, float, float]
    storage_free_images: float
    unclaimed: bool = False
    holding: frozenset[str] = frozenset()
    turn_modes: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Why a mission must hold."""

    code: str
    reason: str
    automatic: bool
    release: bool = False


class Guard(Protocol):
    """Looks at one danger."""

    def check(self, situation: Situation) -> Finding | None:
        """The finding, or None while all is well. Must be quick and must not wait."""
        ...


@dataclass(frozen=True, slots=True)
class LinkGuard:
    """The vehicle is gone."""

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        if situation.vehicle.connected:
            return None
        return Finding(code="link", reason="no heartbeat from the autopilot; waiting for the link", automatic=True)


@dataclass(frozen=True, slots=True)
class AttitudeGuard:
    """The attitude stream is silent, so that nothing can be proven.

    While the gimbal is not held its reports are asked for less often, and `LEISURELY_S` is the least patience.
    """

    silence_s: float

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        silence_s = self.silence_s if situation.expects_control else max(self.silence_s, LEISURELY_S)
        if situation.sample_age_s <= silence_s:
            return None
        age = situation.sample_age_s
        for_how_long = f"for {age:.1f} s" if math.isfinite(age) else "yet"
        return Finding(
            code="attitude",
            reason=f"the gimbal has reported no attitude {for_how_long}; waiting for it",
            automatic=True,
        )


@dataclass(frozen=True, slots=True)
class ControlGuard:
    """Somebody else has the gimbal.

    Who gives it back leaves it to nobody: so that the mission may go on, it need not be ours again already.
    """

    reclaim: bool

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        if situation.in_control or not situation.expects_control or not situation.vehicle.connected:
            return None
        if situation.unclaimed and not self.reclaim and "gimbal_control" in situation.holding:
            return None
        what = "asking for it back" if self.reclaim else "give it back and resume"
        reason = f"the gimbal is not ours any more (another station has it, or its manager restarted); {what}"
        return Finding(code="gimbal_control", reason=reason, automatic=self.reclaim)


@dataclass(frozen=True, slots=True)
class ModeGuard:
    """The pilot flies: hands off."""

    allowed: tuple[str, ...]

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        mode = situation.vehicle.mode
        if not self.allowed or not mode or mode in self.allowed or not situation.vehicle.connected:
            return None
        return Finding(
            code="pilot",
            reason=f"the pilot has taken over (mode {mode}; allowed: {', '.join(self.allowed)}); gimbal released",
            automatic=False,
            release=True,
        )


@dataclass(frozen=True, slots=True)
class TurnGuard:
    """The vehicle must be turned for the shots to come, and its flight mode does not let it."""

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        mode, modes = situation.vehicle.mode, situation.turn_modes
        if modes is None or not mode or mode in modes or not situation.vehicle.connected:
            return None
        return Finding(
            code="turning", reason=f"the vehicle pans the camera: {cannot_turn(mode, modes)}", automatic=True
        )


@dataclass(frozen=True, slots=True)
class LandedGuard:
    """The vehicle is on the ground."""

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        if situation.vehicle.in_air or not situation.vehicle.connected:
            return None
        return Finding(
            code="landed", reason="the vehicle is not in the air; gimbal released", automatic=False, release=True
        )


@dataclass(frozen=True, slots=True)
class BatteryGuard:
    """The battery is needed for the way home."""

    floor_frac: float

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        if not situation.vehicle.battery_frac < self.floor_frac:  # NaN: the vehicle does not say
            return None
        have, floor = 100 * situation.vehicle.battery_frac, 100 * self.floor_frac
        reason = f"battery at {have:.0f} %, floor {floor:.0f} %: land, swap the battery and resume"
        return Finding(code="battery", reason=reason, automatic=False, release=True)


@dataclass(frozen=True, slots=True)
class PositionGuard:
    """The vehicle has drifted off: parallax."""

    drift_m: float
    back_frac: float

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        moved = distance_m(situation.origin, situation.vehicle)
        limit = self.drift_m * (self.back_frac if "position" in situation.holding else 1.0)
        if not moved > limit:  # NaN: unknown
            return None
        reason = (
            f"{moved:.1f} m away from where the mission began (at most {self.drift_m:g} m); waiting for it to be back"
        )
        return Finding(code="position", reason=reason, automatic=True)


@dataclass(frozen=True, slots=True)
class StorageGuard:
    """The camera is full."""

    needed: int

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        if situation.storage_free_images >= self.needed:
            return None
        return Finding(code="storage", reason="the camera's storage is full; make room", automatic=True)


def flight_guards(settings: MissionSettings) -> tuple[Guard, ...]:
    """The guards that watch a flight with these settings."""
    guard: GuardSettings = settings.guards
    guards: list[Guard] = [LinkGuard(), ControlGuard(guard.reclaim == "ask"), StorageGuard(settings.brackets)]
    if settings.feedback != "none":
        guards.append(AttitudeGuard(guard.attitude_silence_s))
    if guard.allowed_modes:
        guards.append(ModeGuard(guard.allowed_modes))
    if settings.gimbal.turning is not None:
        guards.append(TurnGuard())
    if guard.position_hold:
        guards.append(LandedGuard())
    if guard.battery_floor_frac > 0:
        guards.append(BatteryGuard(guard.battery_floor_frac))
    if math.isfinite(guard.position_drift_m):
        guards.append(PositionGuard(guard.position_drift_m, guard.position_back_frac))
    return tuple(guards)


def distance_m(origin: tuple[float, float, float], vehicle: VehicleStatus) -> float:
    """Distance of the vehicle from a place (latitude, longitude, altitude), metres; NaN if either is unknown.

    The larger of the way along the ground and half the way in height, whose error is about twice as large. Flat earth,
    good to a part in a thousand for the few metres that matter; the height counts if both are known.
    """
    latitude, longitude, altitude = origin
    north = math.radians(vehicle.latitude_deg - latitude) * EARTH_RADIUS_M
    east = math.radians(vehicle.longitude_deg - longitude) * EARTH_RADIUS_M * math.cos(math.radians(latitude))
    up = vehicle.altitude_m - altitude
    along = math.hypot(north, east)
    return along if math.isnan(along) or math.isnan(up) else max(along, abs(up) / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold:
    """A finding (or a command) that holds the mission, and since when its cause is gone.

    Attributes:
        finding: why.
        gone_since_s: NaN while the cause persists.
    """

    finding: Finding
    gone_since_s: float = math.nan


def reasons(holds: Mapping[str, Hold]) -> str:
    """All that holds a mission, in one line."""
    return "; ".join(hold.finding.reason for hold in holds.values())
