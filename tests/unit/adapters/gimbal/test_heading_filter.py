import math

import pytest

from panoexec.adapters.gimbal.heading_filter import HeadingFilter

RATE_HZ = 50.0


def swinging(t_s: float) -> float:
    """A nose that swings by ±8° with 1.2 s, so at up to 42° a second, about a heading beyond ±180°."""
    return 178.0 + 8.0 * math.sin(2 * math.pi * t_s / 1.2)


def wrapped(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0


def errors(delay_s: float, drift_deg_s: float = 0.0, offset_deg: float = 0.0, seconds: float = 60.0) -> list[float]:
    """Errors of the blend when the autopilot's heading is always `delay_s` late and the gimbal's drifts."""
    blend = HeadingFilter()
    out = []
    for step in range(int(seconds * RATE_HZ)):
        now = step / RATE_HZ
        blend.vehicle(wrapped(swinging(now - delay_s)), now)
        told = wrapped(swinging(now) + offset_deg + drift_deg_s * now)
        out.append(wrapped(blend.gimbal(told, now) - swinging(now)))
    return out


def test_a_late_autopilot_does_not_spoil_the_heading() -> None:
    late = max(abs(wrapped(swinging(t / 50) - swinging(t / 50 - 0.1))) for t in range(60))
    assert late > 4.0  # what pairing by arrival would be off by
    assert max(map(abs, errors(delay_s=0.1)[500:])) < 0.2


def test_a_drifting_gimbal_does_not_carry_the_heading_away() -> None:
    assert max(map(abs, errors(delay_s=0.02, drift_deg_s=0.01, offset_deg=-7.0)[1500:])) < 0.2


def test_a_gimbal_that_sets_its_heading_anew_is_followed_at_once() -> None:
    blend = HeadingFilter()
    for step in range(200):
        blend.vehicle(100.0, step / RATE_HZ)
        told = 130.0 if step < 100 else 99.0
        assert blend.gimbal(told, step / RATE_HZ) == pytest.approx(100.0)


@pytest.mark.parametrize("told", [0.0, math.nan])
def test_what_is_not_told_is_not_used(told: float) -> None:
    blend = HeadingFilter()
    blend.vehicle(10.0, 0.0)
    assert math.isnan(blend.gimbal(told, 0.1))


def test_without_a_fresh_heading_of_the_autopilot_there_is_none() -> None:
    blend = HeadingFilter()
    assert math.isnan(blend.gimbal(10.0, 0.0))
    blend.vehicle(10.0, 1.0)
    assert blend.gimbal(10.0, 1.5) == pytest.approx(10.0)
    assert math.isnan(blend.gimbal(10.0, 2.5))
    blend.vehicle(math.nan, 3.0)
    assert math.isnan(blend.gimbal(10.0, 3.0))


@pytest.mark.parametrize("rate_hz", [50.0, 10.0, 7.0])
def test_an_autopilot_that_tells_its_heading_seldom_is_compared_only_at_its_moments(rate_hz: float) -> None:
    """A nose that turns on and on, 15° a second: a heading 100 ms old would be taken for 1.5° of drift."""
    blend = HeadingFilter()
    told_s, worst = -1.0, 0.0
    for step in range(int(40 * RATE_HZ)):
        now = step / RATE_HZ
        heading = wrapped(15.0 * now)
        if now - told_s >= 1 / rate_hz - 1e-9:
            told_s = now
            blend.vehicle(heading, now)
        out = blend.gimbal(wrapped(heading + 3.0 + 0.01 * now), now)
        if step > 1000:
            worst = max(worst, abs(wrapped(out - heading)))
    assert worst < 0.25


@pytest.mark.parametrize(("early_s", "known"), [(0.0, True), (0.05, True), (0.5, False)])
def test_an_autopilots_word_that_seems_a_little_later_counts(early_s: float, known: bool) -> None:
    """The two senders' clocks are known to some milliseconds only."""
    blend = HeadingFilter()
    blend.vehicle(30.0, 10.0 + early_s)
    assert math.isfinite(blend.gimbal(31.0, 10.0)) is known
