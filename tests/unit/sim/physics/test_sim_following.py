"""Time of an attached payload, and the effect of wind on it."""

from __future__ import annotations

import dataclasses
import statistics

import pytest

pytest.importorskip("pymavlink")

from panoexec.sim.config import AirframeConfig, GimbalConfig, SimConfig
from panoexec.sim.mavlink.wire import Message
from panoexec.sim.physics.following import AutopilotTime
from panoexec.sim.physics.world import SimClock, TruthLog
from panoexec.sim.simulation import Simulation


def test_time_follows_the_autopilots_stamps() -> None:
    time = AutopilotTime()
    assert time.at(12_000_000, 3.0) == 3.0
    assert time.at(12_020_000, 9.9) == pytest.approx(3.02)
    assert time.at(12_040_000, 0.0) == pytest.approx(3.04)


def test_32_bit_stamp_overflow() -> None:
    time = AutopilotTime()
    time.at(2**32 - 10_000, 100.0)
    assert time.at(10_000, 100.0) == pytest.approx(100.02)


def test_reboot_or_silence_resets_the_offset() -> None:
    time = AutopilotTime()
    time.at(500_000_000, 100.0)
    assert time.at(1_000_000, 107.0) == 107.0  # it restarted
    assert time.at(1_020_000, 107.0) == pytest.approx(107.02)
    time.forget()
    assert time.at(5_000_000, 120.0) == 120.0


class _Silence:
    """A link to nobody."""

    name = "nobody"

    def send(self, frame: bytes, message: Message) -> None:
        del frame, message


def shaking_deg(wind_m_s: float, gimbal: GimbalConfig | None = None) -> float:
    """Standard deviation of the camera's true pitch when only the payload is simulated."""
    config = SimConfig(
        attach_url="udpin:127.0.0.1:1",
        airframe=AirframeConfig(wind_m_s=wind_m_s),
        gimbal=gimbal or GimbalConfig(),
    )
    simulation = Simulation(config, clock=SimClock(), link=_Silence(), truth=TruthLog(None))
    simulation.start()
    pitches = []
    for step in range(1, 1001):
        simulation.advance(0.02 * step, budget_s=60.0)
        pitches.append(simulation.physics.truth_at(0.02 * step).pitch_deg)
    return statistics.pstdev(pitches)


def test_wind_shakes_an_attached_payload_as_configured() -> None:
    calm, windy = shaking_deg(0.0), shaking_deg(8.0)
    assert calm < 1e-6
    assert windy > 0.005
    assert shaking_deg(4.0) == pytest.approx(windy / 4, rel=0.1)  # with the square of the wind
    sheltered = dataclasses.replace(GimbalConfig(), gust_deg_s2=GimbalConfig().gust_deg_s2 / 2)
    assert shaking_deg(8.0, sheltered) == pytest.approx(windy / 2, rel=0.1)
