"""What the reports of a gimbal are good for, from constructed reports."""

from __future__ import annotations

import math
import random

import pytest

from panoexec.devices import AttitudeSample, YawFrame
from panoexec.doctor.gimbal_quality import measured
from panoexec.inputs.vehicle_sections import PointingSection
from panoexec.sim.physics.gimbal import Angles, quaternion


def reports(
    *, hz: float = 50.0, renewed_hz: float = 50.0, noise_deg: float = 0.017, step_deg: float = 0.0, seconds: float = 4.0
) -> list[AttitudeSample]:
    noise, out, known_at = random.Random(1), [], -1
    known = Angles(0.0, 0.0, 0.0)
    for tick in range(round(seconds * hz)):
        time_s = tick / hz
        if math.floor(time_s * renewed_hz + 1e-9) != known_at:
            known_at = math.floor(time_s * renewed_hz + 1e-9)
            angles = [20 * math.sin(time_s), 0.0, -25.0]
            shaken = [angle + noise.gauss(0, noise_deg) for angle in angles]
            known = Angles(*(round(a / step_deg) * step_deg if step_deg else a for a in shaken))
        sample = AttitudeSample(
            received_s=time_s,
            vehicle_s=time_s,
            q_wxyz=quaternion(known),
            yaw_frame=YawFrame.VEHICLE,
            rate_deg_s=math.nan,
        )
        out.append(sample)
    return out


def test_a_good_gimbal_needs_no_setting() -> None:
    quality = measured(reports())
    assert quality is not None
    assert quality.text() == "50 Hz, noise 0.017°" or quality.text().startswith("50 Hz, noise 0.01")
    assert quality.settings(PointingSection()) == []


def test_steps_that_are_renewed_ten_times_a_second_are_recognised() -> None:
    quality = measured(reports(renewed_hz=10.0, step_deg=0.1, noise_deg=0.05))
    assert quality is not None
    assert quality.repeats
    assert quality.fresh_hz == pytest.approx(10, abs=1)
    assert quality.step_deg == pytest.approx(0.1, abs=0.005)
    assert "but they repeat: renewed at about 10 Hz, steps of 0.1°" in quality.text()
    wanted = quality.settings(PointingSection())
    assert "tolerance_pitch_deg = 0.3" in wanted
    assert "settle_s = 0.4" in wanted


def test_a_slow_gimbal_needs_longer_gaps() -> None:
    quality = measured(reports(hz=5.0, renewed_hz=5.0))
    assert quality is not None
    assert quality.settings(PointingSection()) == ["max_gap_s = 0.5", "settle_s = 0.8"]
    assert measured(reports(hz=10.0, renewed_hz=10.0)).settings(PointingSection(settle_s=0.4)) == []  # type: ignore[union-attr]


def test_equal_reports_say_nothing_of_rate_and_steps() -> None:
    still = [sample for sample in reports() for _ in range(2)][:1] * 50
    still = [AttitudeSample(n / 50, n / 50, still[0].q_wxyz, YawFrame.EARTH, math.nan) for n in range(50)]
    quality = measured(still)
    assert quality is not None
    assert "they repeat: all are equal" in quality.text()
    assert quality.step_deg == 0


def test_too_few_reports_have_no_quality() -> None:
    assert measured(reports()[:5]) is None
    nan = math.nan
    assert measured([AttitudeSample(n / 50, nan, (nan,) * 4, YawFrame.EARTH, nan) for n in range(99)]) is None
