"""A gimbal that rests beside its commands is told from one that is stuck, disturbed or still moving."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from panoexec.angles import rotation
from panoexec.devices import SteadyError
from panoexec.mission.pointing.poses import Reading
from panoexec.mission.pointing.steady_error import SteadyErrorWatch, cannot_hold, error_at_rest
from panoexec.planning.model import Tolerance

TIGHT = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7)


def at(pitch_deg: float, yaw_deg: float, wobble: Callable[[float], float] = lambda _: 0.0) -> list[Reading]:
    return [Reading(t / 20, rotation(yaw_deg, pitch_deg + wobble(t / 20)), math.nan) for t in range(60)]


def test_the_error_at_rest_is_the_mean_and_its_bound() -> None:
    steady = error_at_rest(at(-24.7, 50.2, lambda t: 0.05 * math.sin(9 * t)), pitch_deg=-25.0, yaw_deg=50.0)
    assert steady is not None
    assert steady.mean_deg == pytest.approx((0.3, 0.0, 0.2), abs=0.02)
    assert steady.hold_deg == pytest.approx((0.35, 0.0, 0.2), abs=0.02)


@pytest.mark.parametrize(
    "readings",
    [
        [],
        at(-24.7, 50.0)[:3],
        at(-24.7, 50.0, lambda t: 2 * t),
        [*at(-24.7, 50.0)[:-1], Reading(2.95, None, math.nan, "frozen")],
    ],
    ids=["silent", "few", "moving", "unusable"],
)
def test_what_is_not_at_rest_has_no_steady_error(readings: list[Reading]) -> None:
    assert error_at_rest(readings, pitch_deg=-25.0, yaw_deg=50.0) is None


def failed(watch: SteadyErrorWatch, error_deg: float, *poses: tuple[float, float]) -> None:
    for pitch, yaw in poses:
        watch.failed(
            error_at_rest(at(pitch + error_deg, yaw), pitch_deg=pitch, yaw_deg=yaw), pitch_deg=pitch, yaw_deg=yaw
        )


def test_the_same_error_at_two_poses_is_the_gimbals() -> None:
    watch = SteadyErrorWatch()
    failed(watch, 0.3, (-25.0, 0.0), (-25.0, 0.0))
    assert watch.found is None, "one pose may be obstructed"
    failed(watch, 0.32, (-25.0, 50.0))
    assert watch.found is not None
    assert cannot_hold(watch.found, TIGHT) == (
        "the gimbal comes to rest with a steady error of pitch +0.32°: it cannot hold tolerance_pitch_deg = 0.1; set"
        " [pointing] tolerance_pitch_deg = 0.5 or more, or trim the gimbal"
    )
    assert cannot_hold(watch.found, Tolerance(pitch_deg=1.0, roll_deg=1.0, yaw_deg=2.0)) == ""


def test_a_stuck_gimbal_has_another_error_at_each_pose() -> None:
    watch = SteadyErrorWatch()
    for yaw in (0.0, 50.0, 100.0):
        watch.failed(error_at_rest(at(0.0, 0.0), pitch_deg=-25.0, yaw_deg=yaw), pitch_deg=-25.0, yaw_deg=yaw)
    assert watch.found is None


def test_a_pose_that_settles_or_does_not_rest_clears_what_was_seen() -> None:
    for clear in (SteadyErrorWatch.settled, lambda watch: watch.failed(None, pitch_deg=0.0, yaw_deg=0.0)):
        watch = SteadyErrorWatch()
        failed(watch, 0.3, (-25.0, 0.0))
        clear(watch)
        failed(watch, 0.3, (-25.0, 50.0))
        assert watch.found is None


def test_a_large_error_is_no_matter_of_tolerances() -> None:
    why = cannot_hold(SteadyError(mean_deg=(0.0, 0.0, -60.0), hold_deg=(0.02, 0.02, 60.0)), TIGHT)
    assert why.startswith("the gimbal comes to rest yaw -60.00° beside its commands, at every pose: calibrate it")
    assert "tolerance_yaw_deg" not in why
