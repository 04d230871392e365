"""Each guard by itself: when it speaks, what it says, what follows."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from panoexec.devices import VehicleStatus
from panoexec.mission.guards import (
    AttitudeGuard,
    BatteryGuard,
    ControlGuard,
    FixGuard,
    GimbalControl,
    Guard,
    LandedGuard,
    LinkGuard,
    ModeGuard,
    ParallaxGuard,
    PositionGuard,
    Situation,
    StorageGuard,
    distance_m,
    flight_guards,
    parallax_guard,
)
from panoexec.mission.settings import GuardSettings
from tests.unit.fakes.world import a_plan, some_settings

NAN = float("nan")
METRE = 1 / 111_194.9
WELL = Situation(
    now_s=100.0,
    vehicle=VehicleStatus(
        connected=True,
        in_air=True,
        mode="HOLD",
        latitude_deg=47.0,
        longitude_deg=8.0,
        altitude_m=500.0,
        battery_frac=0.8,
    ),
    sample_age_s=0.02,
    control=GimbalControl.OURS,
    expects_control=True,
    origin=(47.0, 8.0, 500.0),
    storage_free_images=100.0,
)
TAKEN = replace(WELL, holding=frozenset({"gimbal_control"}))
C = GimbalControl
MODES = ModeGuard(("HOLD", "OFFBOARD"))


def _vehicle(**changes: object) -> Situation:
    return replace(WELL, vehicle=replace(WELL.vehicle, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("guard", "situation", "code", "text", "automatic", "release"),
    [
        (LinkGuard(), _vehicle(connected=False), "link", "no heartbeat", True, False),
        (AttitudeGuard(1.0), replace(WELL, sample_age_s=1.2), "attitude", "for 1.2 s", True, False),
        (AttitudeGuard(1.0), replace(WELL, sample_age_s=math.inf), "attitude", "no attitude yet", True, False),
        (ControlGuard(True), replace(WELL, control=C.ANOTHERS), "gimbal_control", "requesting it back", True, False),
        (ControlGuard(False), replace(WELL, control=C.ANOTHERS), "gimbal_control", "and resume", False, False),
        (ControlGuard(False), replace(WELL, control=C.UNKNOWN), "gimbal_unknown", "asking its manager", True, False),
        (ControlGuard(False), replace(WELL, control=C.NOBODYS), "gimbal_lost", "acquiring it again", True, False),
        (ControlGuard(False), replace(TAKEN, control=C.UNKNOWN), "gimbal_control", "and resume", False, False),
        (ControlGuard(True), replace(TAKEN, control=C.NOBODYS), "gimbal_lost", "acquiring it again", True, False),
        (MODES, _vehicle(mode="STABILIZED"), "pilot", "mode STABILIZED; allowed: HOLD, OFFBOARD", False, True),
        (LandedGuard(), _vehicle(in_air=False), "landed", "not in the air", False, True),
        (BatteryGuard(0.25), _vehicle(battery_frac=0.2), "battery", "battery at 20 %, floor 25 %", False, True),
        (FixGuard(), _vehicle(position_doubts=("no 3D fix", "x")), "fix", "not reliable: no 3D fix, x", True, False),
        (StorageGuard(1), replace(WELL, storage_free_images=0.0), "storage", "storage is full", True, False),
    ],
)
def test_what_is_wrong_is_said(
    guard: Guard, situation: Situation, code: str, text: str, automatic: bool, release: bool
) -> None:
    assert guard.check(WELL) is None
    finding = guard.check(situation)
    assert finding is not None
    assert (finding.code, finding.automatic, finding.release) == (code, automatic, release)
    assert text in finding.reason


@pytest.mark.parametrize(
    ("guard", "situation"),
    [
        (ControlGuard(True), replace(WELL, control=C.ANOTHERS, expects_control=False)),
        (ControlGuard(True), replace(_vehicle(connected=False), control=C.UNKNOWN)),
        (ControlGuard(False), replace(TAKEN, control=C.NOBODYS)),
        (MODES, _vehicle(mode="")),
        (MODES, _vehicle(mode="STABILIZED", connected=False)),
        (LandedGuard(), _vehicle(in_air=False, connected=False)),
        (BatteryGuard(0.25), _vehicle(battery_frac=NAN)),
        (FixGuard(), _vehicle(position_doubts=("no 3D fix",), connected=False)),
        (FixGuard(), replace(_vehicle(position_doubts=("no 3D fix",)), origin=(NAN, NAN, NAN))),
        (PositionGuard(3.0, 0.7), _vehicle(latitude_deg=NAN)),
        (PositionGuard(3.0, 0.7), replace(WELL, origin=(NAN, NAN, NAN))),
        (StorageGuard(3), replace(WELL, storage_free_images=math.inf)),
    ],
)
def test_what_is_unknown_is_no_finding(guard: Guard, situation: Situation) -> None:
    assert guard.check(situation) is None


def test_position_has_hysteresis() -> None:
    guard = PositionGuard(3.0, 0.7)
    away = _vehicle(latitude_deg=47.0 + 2.5 * METRE)
    assert guard.check(away) is None
    assert guard.check(replace(away, holding=frozenset({"position"}))) is not None
    assert guard.check(_vehicle(latitude_deg=47.0 + 3.1 * METRE)) is not None


def test_the_drift_that_a_seam_allows_grows_with_the_height() -> None:
    guard = ParallaxGuard(limit_px=200.0, focal_px=4000.0, steepness=0.5, back_frac=0.7)
    away = {"latitude_deg": 47.0 + 1.8 * METRE}
    # 200 px · height / (2 · 4000 px · 0.5): 1.5 m at 30 m, 3 m at 60 m
    assert guard.check(_vehicle(**away, relative_altitude_m=60.0)) is None
    found = guard.check(_vehicle(**away, relative_altitude_m=30.0))
    assert found is not None
    assert (found.code, found.automatic, found.release) == ("parallax", True, False)
    assert "1.80 m" in found.reason
    assert "at most 1.50 m" in found.reason
    near = _vehicle(latitude_deg=47.0 + 1.2 * METRE, relative_altitude_m=30.0)
    assert guard.check(near) is None
    assert guard.check(replace(near, holding=frozenset({"parallax"}))) is not None
    assert guard.check(_vehicle(**away)) is None, "the height is unknown"
    assert guard.check(_vehicle(**away, relative_altitude_m=-1.0)) is None
    sky = ParallaxGuard(limit_px=200.0, focal_px=4000.0, steepness=-0.1, back_frac=0.7)
    assert sky.check(_vehicle(**away, relative_altitude_m=30.0)) is None


def test_the_guard_of_the_seam_follows_the_plan() -> None:
    plan = a_plan()
    assert parallax_guard(some_settings(), plan) == ()
    (guard,) = parallax_guard(some_settings(guards=GuardSettings(parallax_px=50.0)), plan)
    assert isinstance(guard, ParallaxGuard)
    assert guard.steepness == pytest.approx(math.sin(math.radians(40)))
    assert guard.focal_px == pytest.approx(plan.camera.focal_length_px)


@pytest.mark.parametrize(
    ("changes", "metres"),
    [
        ({"latitude_deg": 47.0 + 3 * METRE}, 3.0),
        ({"longitude_deg": 8.0 + 4 * METRE / math.cos(math.radians(47.0))}, 4.0),
        ({"altitude_m": 505.0}, 2.5),
        ({"altitude_m": NAN, "latitude_deg": 47.0 + METRE}, 1.0),
    ],
)
def test_distances(changes: dict[str, float], metres: float) -> None:
    assert distance_m(WELL.origin, _vehicle(**changes).vehicle) == pytest.approx(metres, rel=1e-3)


def test_settings_choose_the_guards() -> None:
    kinds = {type(guard) for guard in flight_guards(some_settings())}
    assert kinds == {
        LinkGuard,
        ControlGuard,
        StorageGuard,
        AttitudeGuard,
        ModeGuard,
        LandedGuard,
        BatteryGuard,
        FixGuard,
        PositionGuard,
    }
    off = GuardSettings(battery_floor_frac=0.0, position_drift_m=math.inf, allowed_modes=(), position_hold=False)
    kinds = {type(guard) for guard in flight_guards(some_settings(guards=off, feedback="none"))}
    assert kinds == {LinkGuard, ControlGuard, StorageGuard}
