"""Guards: conditions that are checked while a mission runs and that pause it.

Each finding has a code (stable, for programs) and a reason (for a pilot). After an `automatic` finding the mission
continues by itself when the cause is gone; after the others it waits for `resume`. `release` releases the gimbal at
once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from panoexec.devices import Gimbal, VehicleStatus
from panoexec.mission.preflight import IDLE_SILENCE_S, cannot_turn
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.planning.model import Plan

EARTH_RADIUS_M = 6_371_000.0


class GimbalControl(StrEnum):
    """Who has primary control of the gimbal, by its manager's last status."""

    OURS = "ours"
    ANOTHERS = "another's"
    NOBODYS = "nobody's"
    UNKNOWN = "unknown"
    """No status since the link was opened, came back, or the autopilot rebooted."""

    @classmethod
    def of(cls, gimbal: Gimbal) -> GimbalControl:
        """The control state of a gimbal."""
        if gimbal.in_control:
            return cls.OURS
        holder = gimbal.controlled_by
        return cls.UNKNOWN if holder is None else cls.NOBODYS if holder == (0, 0) else cls.ANOTHERS


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """The inputs of the guards.

    Attributes:
        now_s: on the mission's clock.
        vehicle: its newest status.
        sample_age_s: age of the newest attitude sample; infinity before the first.
        control: who has primary control of the gimbal.
        expects_control: whether the mission has acquired the gimbal.
        origin: latitude, longitude, altitude where the mission began; NaN where unknown.
        storage_free_images: how many more photos the camera's storage holds.
        holding: codes of the active holds.
        turn_modes: flight modes in which the vehicle can be turned; None while it need not be.
    """

    now_s: float
    vehicle: VehicleStatus
    sample_age_s: float
    control: GimbalControl
    expects_control: bool
    origin: tuple[float, float, float]
    storage_free_images: float
    holding: frozenset[str] = frozenset()
    turn_modes: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Why a mission must pause.

    Attributes:
        code: for programs.
        reason: for the pilot.
        automatic: the mission continues by itself when the cause is gone.
        release: the gimbal must be released at once.
        retry: only another attempt shows whether the cause is gone, so `resume` is always possible.
    """

    code: str
    reason: str
    automatic: bool
    release: bool = False
    retry: bool = False


class Guard(Protocol):
    """Checks one condition."""

    def check(self, situation: Situation) -> Finding | None:
        """The finding, or None if the condition is met. Must return quickly and must not block."""
        ...


@dataclass(frozen=True, slots=True)
class LinkGuard:
    """The heartbeat of the autopilot is missing."""

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        if situation.vehicle.connected:
            return None
        return Finding(code="link", reason="no heartbeat from the autopilot; waiting for the link", automatic=True)


@dataclass(frozen=True, slots=True)
class AttitudeGuard:
    """The attitude stream is silent, so no pose can be verified.

    While the gimbal is not held its attitude is requested at a lower rate; the limit is then at least `IDLE_SILENCE_S`.
    """

    silence_s: float

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        silence_s = self.silence_s if situation.expects_control else max(self.silence_s, IDLE_SILENCE_S)
        if situation.sample_age_s <= silence_s:
            return None
        age = situation.sample_age_s
        for_how_long = f"for {age:.1f} s" if math.isfinite(age) else "yet"
        return Finding(
            code="attitude",
            reason=f"the gimbal has sent no attitude {for_how_long}; waiting for it",
            automatic=True,
        )


@dataclass(frozen=True, slots=True)
class ControlGuard:
    """The mission does not have control of the gimbal that it had acquired.

    * Unknown (no status since a link gap or a reboot): holds until the manager has answered.
    * Nobody's (a reboot of the manager, an expiry): the mission acquires the gimbal again.
    * Another station's: `reclaim` decides between a request and the operator. A station that releases the gimbal leaves
      it without primary control, so this hold ends when the gimbal is nobody's.
    """

    reclaim: bool

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        control, was_taken = situation.control, "gimbal_control" in situation.holding
        if control is GimbalControl.OURS or not situation.expects_control or not situation.vehicle.connected:
            return None
        if control is GimbalControl.ANOTHERS or (control is GimbalControl.UNKNOWN and was_taken):
            what = "requesting it back" if self.reclaim else "release it there and resume"
            reason = f"another station took control of the gimbal; {what}"
            return Finding(code="gimbal_control", reason=reason, automatic=self.reclaim)
        if control is GimbalControl.UNKNOWN:
            reason = "control of the gimbal is unknown; asking its manager"
            return Finding(code="gimbal_unknown", reason=reason, automatic=True)
        if was_taken and not self.reclaim:
            return None
        reason = "control of the gimbal was lost (its manager restarted, or the control expired); acquiring it again"
        return Finding(code="gimbal_lost", reason=reason, automatic=True)


@dataclass(frozen=True, slots=True)
class ModeGuard:
    """The flight mode is not allowed: the pilot has taken over."""

    allowed: tuple[str, ...]

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        mode = situation.vehicle.mode
        if not self.allowed or not mode or mode in self.allowed or not situation.vehicle.connected:
            return None
        shown, allowed = situation.vehicle.mode_text, ", ".join(self.allowed)
        return Finding(
            code="pilot",
            reason=f"the pilot has taken over (mode {shown}; allowed: {allowed}); gimbal released",
            automatic=False,
            release=True,
        )


@dataclass(frozen=True, slots=True)
class TurnGuard:
    """The remaining shots require the vehicle to turn, and the flight mode does not allow it."""

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        mode, modes = situation.vehicle.mode, situation.turn_modes
        if modes is None or not mode or mode in modes or not situation.vehicle.connected:
            return None
        return Finding(
            code="turning",
            reason=f"the vehicle must turn for the next shots: {cannot_turn(situation.vehicle.mode_text, modes)}",
            automatic=True,
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
    """The battery is below the floor."""

    floor_frac: float

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        if not situation.vehicle.battery_frac < self.floor_frac:  # NaN: not reported
            return None
        have, floor = 100 * situation.vehicle.battery_frac, 100 * self.floor_frac
        reason = f"battery at {have:.0f} %, floor {floor:.0f} %: land, swap the battery and resume"
        return Finding(code="battery", reason=reason, automatic=False, release=True)


@dataclass(frozen=True, slots=True)
class PositionGuard:
    """The vehicle has drifted from the mission's origin, which causes parallax."""

    drift_m: float
    back_frac: float

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        moved = distance_m(situation.origin, situation.vehicle)
        limit = self.drift_m * (self.back_frac if "position" in situation.holding else 1.0)
        if not moved > limit:  # NaN: unknown
            return None
        reason = f"{moved:.1f} m from where the mission began (at most {self.drift_m:g} m); waiting for its return"
        return Finding(code="position", reason=reason, automatic=True)


@dataclass(frozen=True, slots=True)
class ParallaxGuard:
    """The drift uses up the limit of the seam error: two photos at half of it each are just within it.

    Attributes:
        limit_px: `GuardSettings.parallax_px`.
        focal_px: focal length of the camera, pixels.
        steepness: sine of the steepest angle below the horizon at which the panorama shows ground.
        back_frac: share of the limit within which a hold ends.
    """

    limit_px: float
    focal_px: float
    steepness: float
    back_frac: float

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        moved, height = distance_m(situation.origin, situation.vehicle), situation.vehicle.relative_altitude_m
        if not height > 0 or not self.steepness > 0:
            return None
        limit_m = self.limit_px * height / (2 * self.focal_px * self.steepness)
        if not moved > limit_m * (self.back_frac if "parallax" in situation.holding else 1.0):
            return None
        reason = (
            f"{moved:.2f} m from where the mission began: at most {limit_m:.2f} m keep seams on ground {height:.0f} m"
            f" below within {self.limit_px:g} px; waiting for its return"
        )
        return Finding(code="parallax", reason=reason, automatic=True)


def parallax_guard(settings: MissionSettings, plan: Plan) -> tuple[Guard, ...]:
    """The guard of the seam error, if the settings have a limit for it."""
    guard = settings.guards
    if not guard.parallax_px > 0:
        return ()
    lowest_deg = plan.constraints.band.elevation_min_deg
    return (
        ParallaxGuard(
            limit_px=guard.parallax_px,
            focal_px=plan.camera.focal_length_px,
            steepness=-math.sin(math.radians(lowest_deg)),
            back_frac=guard.position_back_frac,
        ),
    )


@dataclass(frozen=True, slots=True)
class FixGuard:
    """GNSS or the estimator lost the position: the vehicle drifts, and its failsafe follows seconds later.

    Only where the mission had a position: a vehicle on a bench or indoors may never have one.
    """

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        doubts = situation.vehicle.position_doubts
        if not doubts or not situation.vehicle.connected or math.isnan(situation.origin[0]):
            return None
        reason = f"the position is not reliable: {', '.join(doubts)}; waiting for it"
        return Finding(code="fix", reason=reason, automatic=True)


@dataclass(frozen=True, slots=True)
class StorageGuard:
    """The camera's storage is full."""

    needed: int

    def check(self, situation: Situation) -> Finding | None:
        """See `Guard.check`."""
        if situation.storage_free_images >= self.needed:
            return None
        return Finding(code="storage", reason="the camera's storage is full; free some space", automatic=True)


def flight_guards(settings: MissionSettings) -> tuple[Guard, ...]:
    """The guards that these settings enable."""
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
        guards += [FixGuard(), PositionGuard(guard.position_drift_m, guard.position_back_frac)]
    return tuple(guards)


def distance_m(origin: tuple[float, float, float], vehicle: VehicleStatus) -> float:
    """Distance of the vehicle from a position (latitude, longitude, altitude), metres; NaN if either is unknown.

    The larger of the horizontal distance and half the vertical distance, whose GNSS error is about twice as large.
    Computed on a flat earth, accurate to 0.1 % over a few metres; the altitude counts only if both are known.
    """
    latitude, longitude, altitude = origin
    north = math.radians(vehicle.latitude_deg - latitude) * EARTH_RADIUS_M
    east = math.radians(vehicle.longitude_deg - longitude) * EARTH_RADIUS_M * math.cos(math.radians(latitude))
    up = vehicle.altitude_m - altitude
    along = math.hypot(north, east)
    return along if math.isnan(along) or math.isnan(up) else max(along, abs(up) / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold:
    """A finding (or a command) that holds the mission.

    Attributes:
        finding: why.
        gone_since_s: since when its cause is absent; NaN while it persists.
    """

    finding: Finding
    gone_since_s: float = math.nan


def reasons(holds: Mapping[str, Hold]) -> str:
    """The reasons of all holds, in one line."""
    return "; ".join(hold.finding.reason for hold in holds.values())
