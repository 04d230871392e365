"""Echoes of the command are told from measurements by how a slew looks in the reports."""

from __future__ import annotations

import itertools
import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import rotation
from panoexec.mission.pointing.echo import EXACT_POSES, EchoWatch
from panoexec.mission.pointing.poses import Reading

POSES = [(-25.0, 0.0), (-25.0, 50.0), (-25.0, 100.0), (15.0, 100.0), (15.0, 50.0), (15.0, 0.0)]


def reading(time_s: float, pitch_deg: float, yaw_deg: float, roll_deg: float = 0.0) -> Reading:
    return Reading(time_s, rotation(yaw_deg, pitch_deg, roll_deg), math.nan)


def eased(share: float) -> float:
    """From rest to rest with full acceleration and full braking."""
    share = min(max(share, 0.0), 1.0)
    return 2 * share * share if share < 0.5 else 1 - 2 * (1 - share) ** 2


def slew(
    watch: EchoWatch,
    start: tuple[float, float],
    target: tuple[float, float],
    *,
    takes_s: float,
    hz: float = 50.0,
    noise_deg: float = 0.0,
    error_deg: float = 0.0,
    renewed_hz: float = 0.0,
    delay_s: float = 0.03,
    seed: int = 0,
) -> None:
    """A slew as a gimbal would report it, from 0.2 s before the command until 0.5 s after its end."""
    noise = random.Random(seed)
    readings = []
    for tick in range(round((0.7 + delay_s + takes_s) * hz)):
        time_s = tick / hz - 0.2
        known_s = math.floor(time_s * renewed_hz) / renewed_hz if renewed_hz else time_s
        share = eased((known_s - delay_s) / takes_s) if takes_s else float(known_s >= delay_s)
        a, b, c = (noise.gauss(0, noise_deg) for _ in range(3))
        pitch = start[0] + share * (target[0] + error_deg - start[0])
        yaw = start[1] + share * (target[1] - start[1])
        readings.append(reading(time_s, pitch + a, yaw + b, c))
    watch.slew(readings, commanded_s=0.0, pitch_deg=target[0], yaw_deg=target[1])


def test_an_exact_echo_is_found_with_its_first_slew() -> None:
    watch = EchoWatch()
    slew(watch, POSES[0], POSES[1], takes_s=0.0)
    assert watch.reason.startswith("a slew of ")
    assert "took 20 ms in its reports, which no gimbal can do" in watch.reason
    assert not watch.has_moved


@pytest.mark.parametrize("hz", [50.0, 25.0, 10.0])
def test_an_echo_is_found_at_every_rate(hz: float) -> None:
    watch = EchoWatch()
    slew(watch, POSES[0], POSES[1], takes_s=0.0, hz=hz)
    assert watch.reason


def test_an_echo_that_a_moving_vehicle_is_composed_into_takes_two_slews() -> None:
    watch = EchoWatch()
    slew(watch, POSES[0], POSES[1], takes_s=0.0, noise_deg=0.05)
    assert not watch.reason
    slew(watch, POSES[1], POSES[2], takes_s=0.0, noise_deg=0.05, seed=1)
    assert watch.reason


def test_an_echo_of_the_pitch_is_found_while_the_vehicle_turns_the_yaw() -> None:
    watch = EchoWatch()
    readings = [reading(t / 50 - 0.2, 15.0 if t >= 12 else -25.0, 40 * eased(t / 90)) for t in range(100)]
    watch.slew(readings, commanded_s=0.0, pitch_deg=15.0, yaw_deg=40.0, yaw_follows=True)
    assert watch.reason


@pytest.mark.parametrize("noise_deg", [0.0, 0.02])
@pytest.mark.parametrize("axis", ["pitch", "yaw"])
def test_an_echo_of_one_axis_is_found_beside_another_that_is_measured(axis: str, noise_deg: float) -> None:
    """A servo that tilts on a motor that pans, or the other way round; most slews are of the measured axis."""
    noise = random.Random(1)
    watch = EchoWatch()
    rows = [(pitch, yaw) for pitch in (-40.0, 0.0, 40.0) for yaw in (0.0, 45.0, 90.0, 135.0)]
    for start, target in itertools.pairwise(rows if axis == "pitch" else sorted(rows, key=lambda pose: pose[1])):
        readings = []
        for tick in range(70):
            a, b, c = (noise.gauss(0, noise_deg) for _ in range(3))
            shares = [eased(tick / 50 - 0.25), float(tick >= 12)][:: 1 if axis == "pitch" else -1]
            yaw, pitch = (start[1 - k] + shares[k] * (target[1 - k] - start[1 - k]) for k in (0, 1))
            readings.append(reading(tick / 50 - 0.2, pitch + a, yaw + b, c))
        watch.slew(readings, commanded_s=0.0, pitch_deg=target[0], yaw_deg=target[1])
    assert f"° in {axis} took 20 ms in its reports" in watch.reason
    assert watch.has_moved


@given(
    st.floats(200, 800),
    st.lists(st.tuples(st.floats(-90, 50), st.floats(-180, 180)), min_size=3, max_size=12),
    st.sampled_from([10.0, 25.0, 50.0]),
    st.integers(0, 2**16),
)
def test_a_gimbal_that_moves_in_both_axes_is_never_taken_for_an_echo(
    acceleration_deg_s2: float, poses: list[tuple[float, float]], hz: float, seed: int
) -> None:
    watch = EchoWatch()
    for turn, (start, target) in enumerate(itertools.pairwise(poses)):
        takes_s = 2 * math.sqrt(max(abs(target[0] - start[0]), abs(target[1] - start[1]), 1.0) / acceleration_deg_s2)
        slew(watch, start, target, takes_s=takes_s, hz=hz, noise_deg=0.01, seed=seed + turn)
    assert not watch.reason


def test_an_echo_that_pretends_to_move_is_found_by_its_exactness() -> None:
    watch = EchoWatch()
    for number, (start, target) in enumerate(itertools.pairwise(POSES), 1):
        slew(watch, start, target, takes_s=0.5)
        assert bool(watch.reason) == (number >= EXACT_POSES)
    assert "without any noise" in watch.reason
    assert watch.has_moved


def test_what_was_known_before_stays_known() -> None:
    watch = EchoWatch("MNT_MODE_OUT = 0")
    slew(watch, POSES[0], POSES[1], takes_s=0.5, noise_deg=0.01)
    assert watch.reason == "MNT_MODE_OUT = 0"


@given(
    st.floats(200, 1200),
    st.floats(10, 170),
    st.sampled_from([10.0, 20.0, 25.0, 50.0, 100.0]),
    st.floats(0.0, 0.3),
    st.integers(0, 2**16),
)
def test_a_gimbal_that_moves_is_never_taken_for_an_echo(
    acceleration_deg_s2: float, angle_deg: float, hz: float, delay_s: float, seed: int
) -> None:
    watch = EchoWatch()
    takes_s = 2 * math.sqrt(angle_deg / acceleration_deg_s2)
    for turn in range(6):
        here, there = (0.0, 0.0), (0.0, angle_deg)
        start, target = (here, there) if turn % 2 == 0 else (there, here)
        slew(watch, start, target, takes_s=takes_s, hz=hz, noise_deg=0.01, delay_s=delay_s, seed=seed + turn)
    assert not watch.reason


@given(
    st.floats(200, 450), st.floats(10, 170), st.sampled_from([0.0, -0.4]), st.floats(0.0, 0.1), st.integers(0, 2**16)
)
def test_reports_that_are_renewed_ten_times_a_second_are_no_echo(
    acceleration_deg_s2: float, angle_deg: float, tilt: float, delay_s: float, seed: int
) -> None:
    watch = EchoWatch()
    takes_s = 2 * math.sqrt(angle_deg / acceleration_deg_s2)
    for turn in range(6):
        start, target = ((0.0, 0.0), (tilt * angle_deg, angle_deg))[:: 1 if turn % 2 == 0 else -1]
        slew(
            watch,
            start,
            target,
            takes_s=takes_s,
            renewed_hz=10.0,
            error_deg=0.05,
            delay_s=delay_s,
            seed=seed,
        )
    assert not watch.reason


def test_a_noiseless_gimbal_that_rests_beside_its_target_is_no_echo() -> None:
    watch = EchoWatch()
    for start, target in itertools.pairwise(POSES * 3):
        slew(watch, start, target, takes_s=0.5, error_deg=0.01)
    assert not watch.reason


def test_gaps_and_short_slews_decide_nothing() -> None:
    watch = EchoWatch()
    for _ in range(5):
        watch.slew([reading(-0.1, 0.0, 0.0), reading(2.0, 0.0, 60.0)], commanded_s=0.0, pitch_deg=0.0, yaw_deg=60.001)
        slew(watch, (0.0, 0.0), (0.0, 5.0), takes_s=0.0, noise_deg=0.01)
        watch.slew([reading(0.1, 0.0, 60.0)], commanded_s=0.0, pitch_deg=0.0, yaw_deg=60.0)
    assert not watch.reason
    assert not watch.has_moved


@pytest.mark.parametrize("delay_s", [0.03, 0.25])
def test_the_age_of_reports_is_seen_in_slews(delay_s: float) -> None:
    watch = EchoWatch()
    assert math.isnan(watch.delay_s)
    for start, target in itertools.pairwise(POSES):
        slew(watch, start, target, takes_s=0.9, noise_deg=0.05, delay_s=delay_s)
    assert watch.delay_s == pytest.approx(delay_s, abs=0.06)


def test_a_stream_that_falls_behind_is_waited_for_at_once() -> None:
    watch = EchoWatch()
    assert math.isnan(watch.longest_delay_s)
    for start, target in itertools.pairwise(POSES[:4]):
        slew(watch, start, target, takes_s=1.0, noise_deg=0.01)
    usual_s = watch.delay_s
    assert watch.longest_delay_s == pytest.approx(usual_s, abs=0.05)
    slew(watch, POSES[3], POSES[4], takes_s=1.0, noise_deg=0.01, delay_s=1.0)
    assert watch.longest_delay_s == pytest.approx(usual_s + 1.0, abs=0.1)
    assert watch.delay_s == pytest.approx(usual_s, abs=0.05), "the median is that of before"


def test_a_slew_that_ends_elsewhere_tells_no_age() -> None:
    """A gimbal that reports in another convention comes nearer to its target by chance, at any time."""
    watch = EchoWatch()
    readings = [reading(0.1 * tick, -0.5 * tick, 40.0) for tick in range(60)]
    shown = watch.slew(readings, commanded_s=0.5, pitch_deg=-40.0, yaw_deg=-120.0)
    assert not shown
    assert math.isnan(watch.delay_s)
