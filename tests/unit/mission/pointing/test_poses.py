"""Attitude reports as poses of the camera, in every frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import rotation, wrap_180
from panoexec.devices import AttitudeSample, Quaternion, VehicleAttitude, YawFrame
from panoexec.mission.pointing.poses import (
    GIMBAL_FAILURES,
    PoseReader,
    Reading,
    heading_deg,
    mean_pose,
    read_pose,
    to_north,
)
from panoexec.mission.pointing.tolerance_gate import (
    SettleLimits,
    SettleTracker,
    Target,
)
from tests.unit.fakes.gimbal import FakeFeed
from tests.unit.fakes.virtual import VirtualClock
from tests.unit.mission.pointing.readings import (
    NAN,
    TOLERANCE,
    quaternion_of,
    sample_of,
)

angles = st.floats(-180, 180)


@given(
    yaw=angles,
    pitch=st.floats(-90, 60),
    roll=st.floats(-20, 20),
    heading=angles,
    lean=st.floats(-35, 35),
    bank=st.floats(-35, 35),
    reference=angles,
)
def test_every_frame_gives_the_same_pose(
    yaw: float, pitch: float, roll: float, heading: float, lean: float, bank: float, reference: float
) -> None:
    world = rotation(yaw, pitch, roll)
    # an airframe by its 3-2-1 angles, as autopilots state them
    airframe = rotation(heading, 0.0) @ rotation(0.0, lean) @ rotation(0.0, 0.0, bank)
    vehicle = VehicleAttitude(1.0, 1.0, quaternion_of(airframe))
    expected = rotation(-reference, 0.0) @ world
    for frame, relative in (
        (YawFrame.EARTH, world),
        (YawFrame.VEHICLE, rotation(-heading, 0.0) @ world),
        (YawFrame.BODY, airframe.T @ world),
    ):
        reading = read_pose(sample_of(relative, frame), vehicle, reference)
        assert reading.rotation is not None
        np.testing.assert_allclose(reading.rotation, expected, atol=1e-9)
    assert wrap_180(heading_deg(vehicle) - heading) == pytest.approx(0.0, abs=1e-6)


def test_a_body_frame_pose_needs_the_vehicle_and_an_earth_pose_does_not() -> None:
    level = rotation(10.0, -20.0)
    assert read_pose(sample_of(level), None, 0.0).problem == ""
    for frame in (YawFrame.VEHICLE, YawFrame.BODY):
        assert "vehicle" in read_pose(sample_of(level, frame), None, 0.0).problem
        broken = VehicleAttitude(1.0, 1.0, (NAN, 0.0, 0.0, 0.0))
        assert "non-finite attitude" in read_pose(sample_of(level, frame), broken, 0.0).problem


def test_a_leaning_servo_mount_is_not_taken_for_level() -> None:
    """The measured fault: body-frame angles read as earth angles are off by the vehicle's lean."""
    airframe = rotation(0.0, -14.0)
    sample = sample_of(airframe.T @ rotation(0.0, 0.0), YawFrame.BODY)
    good = read_pose(sample, VehicleAttitude(1.0, 1.0, quaternion_of(airframe)), 0.0)
    fooled = read_pose(replace(sample, yaw_frame=YawFrame.EARTH), None, 0.0)
    assert good.rotation is not None
    assert fooled.rotation is not None
    np.testing.assert_allclose(good.rotation, np.eye(3), atol=1e-9)
    assert math.degrees(math.acos(fooled.rotation[0, 0])) == pytest.approx(14.0)


@pytest.mark.parametrize("q", [(NAN, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (1.0, 0.0, math.inf, 0.0)])
def test_a_pose_that_is_no_number_is_a_problem(q: Quaternion) -> None:
    sample = replace(sample_of(np.eye(3)), q_wxyz=q)
    reading = read_pose(sample, None, 0.0)
    assert reading.rotation is None
    assert "non-finite attitude" in reading.problem


@pytest.mark.parametrize("flag", [1 << bit for bit in range(10)])
def test_failure_flags_count_but_limit_flags_do_not(flag: int) -> None:
    reading = read_pose(sample_of(np.eye(3), failure_flags=flag), None, 0.0)
    assert bool(reading.problem) is (flag in GIMBAL_FAILURES)
    assert (flag in GIMBAL_FAILURES) is (8 <= flag <= 256)


@given(yaw=angles, pitch=st.floats(-90, 90), spread=st.lists(st.floats(-1, 1), min_size=1, max_size=8))
def test_the_mean_lies_in_the_middle(yaw: float, pitch: float, spread: list[float]) -> None:
    matrices = [rotation(yaw, pitch, s) for s in spread] + [rotation(yaw, pitch, -s) for s in spread]
    mean = mean_pose(np.array(matrices))
    assert abs(float(np.dot(mean.q_wxyz, quaternion_of(rotation(yaw, pitch))))) == pytest.approx(1.0, abs=1e-9)


def test_at_the_nadir_roll_and_yaw_keep_their_meaning() -> None:
    target = Target(pitch_deg=-90.0, yaw_deg=0.0, tolerance=TOLERANCE)
    turned = Reading(1.0, rotation(0.4, -90.0), 0.0)
    tracker = SettleTracker(target=target, limits=SettleLimits(settle_s=0.0, max_rate_deg_s=2.0, max_gap_s=0.1))
    tracker.add(turned)
    assert tracker.is_settled(1.0)
    tracker.add(Reading(1.02, rotation(0.0, -90.0, 0.2), 0.0))
    assert "roll off by +0.2" in tracker.problem


def test_yaw_from_north() -> None:
    assert to_north(170.0, 30.0) == pytest.approx(-160.0)


def _reader(q: list[Quaternion]) -> tuple[PoseReader, list[bool]]:
    feed = FakeFeed(clock=VirtualClock())
    reader = PoseReader(feed=feed, reference_yaw_north_deg=0.0)
    good = []
    for i, one in enumerate(q):
        feed.push(AttitudeSample(0.02 * (i + 1), 0.02 * (i + 1), one, YawFrame.EARTH, 0.0))
        good += [reading.rotation is not None for reading in reader.since(0.02 * i + 0.001)]
    return reader, good


def test_a_gimbal_that_measures_and_then_repeats_itself_is_frozen_until_it_measures_again() -> None:
    alive = [quaternion_of(rotation(i * 0.001, -20.0)) for i in range(60)]
    reader, good = _reader(alive + [alive[-1]] * 100 + alive[:10])
    assert reader.measures
    assert good[:60] == [True] * 60
    assert good[60:63] == [True, True, False]
    assert not any(good[63:160])
    assert good[160:] == [True] * 10


def test_a_gimbal_that_always_repeats_itself_only_echoes_and_is_not_called_frozen() -> None:
    still = [quaternion_of(rotation(0.0, -20.0))] * 40 + [quaternion_of(rotation(1.0, -20.0))] * 40
    reader, good = _reader(still)
    assert not reader.measures
    assert all(good)


def test_samples_that_share_a_stamp_are_all_read_and_none_twice() -> None:
    feed = FakeFeed(clock=VirtualClock())
    reader = PoseReader(feed=feed, reference_yaw_north_deg=0.0)
    for i, stamp in enumerate([0.1, 0.1, 0.2, 0.2, 0.2, 0.3]):
        feed.push(AttitudeSample(stamp, stamp, quaternion_of(rotation(i * 0.01, -20.0)), YawFrame.EARTH, 0.0))
        assert len(reader.since(0.0)) == i + 1
    assert len(reader.since(0.2)) == 1
