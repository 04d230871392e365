"""What is told of a heading that is not held: how far it sways, how fast it moves, and when that is enough to pause."""

from __future__ import annotations

import math

import pytest

from panoexec.angles import rotation
from panoexec.mission.pointing.nose_hold import NoseHold, NoseMotion, motion_of
from panoexec.mission.pointing.poses import Reading

SWAY = NoseMotion(sway_deg=2.4, speed_deg_s=1.0)
SHAKE = NoseMotion(sway_deg=1.2, speed_deg_s=15.0)


def readings(*, amplitude_deg: float, hz: float, seconds: float = 8.0, about_deg: float = 179.0) -> list[Reading]:
    return [
        Reading(0.02 * i, rotation(about_deg + amplitude_deg * math.sin(math.tau * hz * 0.02 * i), -20.0), math.nan)
        for i in range(round(seconds / 0.02))
    ]


def test_a_slow_sway_is_told_by_its_width() -> None:
    motion = motion_of(readings(amplitude_deg=2.0, hz=0.3), since_s=0.0)
    assert motion is not None
    assert motion.sway_deg == pytest.approx(2.0, abs=0.05)
    assert motion.speed_deg_s == pytest.approx(math.tau * 0.3 * 2.0 * math.sqrt(0.5), rel=0.15)


def test_a_shake_is_told_by_its_speed() -> None:
    """As an ArduCopter whose frame type is wrong: 1.2° at 15 Hz."""
    motion = motion_of(readings(amplitude_deg=1.2, hz=15.26), since_s=0.0)
    assert motion is not None
    assert motion.speed_deg_s > 10.0


def test_what_moved_before_the_turn_had_ended_does_not_count() -> None:
    turned = [Reading(r.time_s, rotation(10.0 * r.time_s, -20.0), math.nan) for r in readings(amplitude_deg=0, hz=1)]
    still = [Reading(8.0 + r.time_s, r.rotation, math.nan) for r in readings(amplitude_deg=0.0, hz=1.0)]
    motion = motion_of([*turned, *still], since_s=8.0)
    assert motion is not None
    assert (motion.sway_deg, motion.speed_deg_s) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert motion_of(turned, since_s=7.0) is None, "less than two seconds"
    assert motion_of([], since_s=0.0) is None


def test_it_takes_two_headings_and_four_attempts_in_a_row() -> None:
    hold = NoseHold()
    for _ in range(5):
        hold.failed(SWAY, shot=0, yaw_deg=175.0)
        assert hold.cannot_hold(2.0, 5.0) == "", "one heading"
    hold.failed(SWAY, shot=1, yaw_deg=-179.0)
    assert hold.cannot_hold(2.0, 5.0) == "", "6° apart"
    hold.failed(None, shot=2, yaw_deg=0.0)
    assert hold.cannot_hold(2.0, 5.0) == "", "nothing is known of that one"
    hold.failed(SWAY, shot=2, yaw_deg=0.0)
    assert hold.cannot_hold(2.0, 5.0) == (
        "the vehicle holds its heading within 2.4° only, at 2 headings (7 attempts in a row): it cannot hold"
        " tolerance_yaw_deg = 2; plan with 3.6 or more, or wait for less wind, then resume"
    )
    assert hold.shots == (0, 1, 2)
    assert hold.cannot_hold(2.5, 5.0) == "", "that wide a tolerance is held: what failed was something else"
    hold.settled()
    assert hold.cannot_hold(2.0, 5.0) == ""


def test_one_calm_wait_among_them_is_enough_to_go_on() -> None:
    hold = NoseHold()
    for shot in range(4):
        hold.failed(SHAKE, shot=shot, yaw_deg=90.0 * shot)
    assert "moves at 15°/s at 4 headings" in hold.cannot_hold(2.0, 5.0)
    hold.failed(NoseMotion(sway_deg=0.3, speed_deg_s=0.5), shot=4, yaw_deg=45.0)
    assert hold.cannot_hold(2.0, 5.0) == ""
