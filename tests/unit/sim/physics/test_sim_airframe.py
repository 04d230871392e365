"""The physics of the vehicle."""

from __future__ import annotations

import dataclasses
import math
import statistics

import pytest

from panoexec.sim.config import AirframeConfig
from panoexec.sim.physics.airframe import Airframe, LandedState

STEP_S = 0.02
CALM = AirframeConfig(wind_m_s=0.0, wind_from_deg=270.0, heading_deg=0.0)


def fly(airframe: Airframe, seconds: float) -> None:
    for _ in range(round(seconds / STEP_S)):
        airframe.step(STEP_S)


def test_it_leans_into_the_wind_with_its_square() -> None:
    """14° in 8 m/s was measured; wind from the west on a vehicle that looks north makes it lean left."""
    airframe = Airframe(dataclasses.replace(CALM, wind_m_s=8.0, sway_deg=0.0, heading_sway_deg=0.0), seed=1)
    fly(airframe, 1.0)
    state = airframe.state()
    assert [state.roll_deg, state.pitch_deg] == pytest.approx([-14.0, 0.0], abs=1e-6)
    airframe.wind_m_s = 4.0
    fly(airframe, 6.0)
    assert airframe.state().roll_deg == pytest.approx(-3.5, abs=0.01)


def test_wind_from_ahead_lowers_the_nose() -> None:
    config = dataclasses.replace(CALM, wind_m_s=8.0, wind_from_deg=0.0, sway_deg=0.0, heading_sway_deg=0.0)
    state = Airframe(config, seed=1).state()
    assert [state.roll_deg, state.pitch_deg] == pytest.approx([0.0, -14.0], abs=1e-6)


def test_rates_are_the_derivatives_of_the_angles() -> None:
    airframe = Airframe(CALM, seed=1)
    fly(airframe, 3.0)
    for _ in range(50):
        before = airframe.state()
        airframe.step(1e-3)
        after = airframe.state()
        for axis in ("roll", "pitch", "yaw"):
            change = getattr(after, f"{axis}_deg") - getattr(before, f"{axis}_deg")
            assert change / 1e-3 == pytest.approx(getattr(before, f"{axis}_rate_deg_s"), abs=0.02)


def test_it_holds_the_gps_position_and_drifts_with_the_gps_error() -> None:
    airframe = Airframe(CALM, seed=2)
    reported, true = [], []
    for _ in range(2000):
        fly(airframe, 0.5)
        reported.append((airframe.position().latitude_deg - CALM.latitude_deg) * 111_320)
        true.append(airframe.state().north_m)
    assert statistics.pstdev(reported) == pytest.approx(CALM.hold_m, rel=0.2)
    assert max(map(abs, reported)) < 0.5
    assert 0.3 < statistics.pstdev(true) < 1.0
    assert max(map(abs, true)) < 3.0
    height = airframe.position().relative_altitude_m
    assert height == pytest.approx(CALM.height_m, abs=0.5)
    assert airframe.position().altitude_m == pytest.approx(CALM.home_altitude_m + height)


def test_the_battery_drains_in_the_air_to_nothing() -> None:
    airframe = Airframe(dataclasses.replace(CALM, battery_frac=1.0, battery_minutes=1.0), seed=1)
    fly(airframe, 30.0)
    assert airframe.battery_frac == pytest.approx(0.5, abs=0.001)
    assert airframe.voltage_v == pytest.approx(4 * 3.75, abs=0.01)
    fly(airframe, 60.0)
    assert airframe.battery_frac == 0.0


def test_it_arms_takes_off_hovers_lands_and_disarms() -> None:
    airframe = Airframe(dataclasses.replace(CALM, in_air=False), seed=1)
    assert (airframe.landed_state, airframe.armed) == (LandedState.ON_GROUND, False)
    assert not airframe.take_off(30.0)
    assert airframe.arm(True)
    assert airframe.take_off(30.0)
    fly(airframe, 3.0)
    assert airframe.landed_state.name == "TAKEOFF"
    assert not airframe.arm(False)
    fly(airframe, 12.0)
    assert airframe.landed_state.name == "IN_AIR"
    assert airframe.position().relative_altitude_m == pytest.approx(30.0, abs=0.5)
    airframe.land()
    fly(airframe, 3.0)
    assert airframe.landed_state.name == "LANDING"
    fly(airframe, 40.0)
    assert (airframe.landed_state, airframe.armed) == (LandedState.ON_GROUND, False)
    assert airframe.state().yaw_rate_deg_s == 0.0


def test_a_seed_gives_the_same_flight() -> None:
    def track(seed: int) -> list[float]:
        airframe = Airframe(CALM, seed=seed)
        fly(airframe, 5.0)
        state, position = airframe.state(), airframe.position()
        return [state.roll_deg, state.yaw_deg, position.latitude_deg, position.velocity_m_s[0]]

    assert track(1) == track(1)
    assert track(1) != track(2)
    assert all(map(math.isfinite, track(1)))
