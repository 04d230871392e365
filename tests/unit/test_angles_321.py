from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from panoexec.angles import rotation, rotation_321, wrap_180, yaw_pitch_roll_321

yaws = st.floats(-180, 179.99)
pitches = st.floats(-180, 179.99)
small = st.floats(-2, 2)


@given(yaw=yaws, pitch=pitches, roll=st.floats(-180, 179.99))
@example(yaw=0, pitch=-90, roll=0)
@example(yaw=37, pitch=-90, roll=12)
@example(yaw=-120, pitch=90, roll=-7)
@example(yaw=10, pitch=-90 + 1e-7, roll=33)
@example(yaw=10, pitch=-90 + 1e-11, roll=33)
def test_the_angles_give_back_the_rotation_everywhere(yaw: float, pitch: float, roll: float) -> None:
    r = rotation_321(yaw, pitch, roll)
    np.testing.assert_allclose(rotation_321(*yaw_pitch_roll_321(r)), r, atol=3e-9)


@given(yaw=yaws, pitch=st.floats(-92, 92), roll=small)
@example(yaw=20, pitch=-90, roll=0.017)
@example(yaw=20, pitch=-90.01, roll=0)
def test_gimbal_poses_survive_the_way_through_the_other_sequence(yaw: float, pitch: float, roll: float) -> None:
    r = rotation(yaw, pitch, roll)
    y, p, rr = yaw_pitch_roll_321(r)
    np.testing.assert_allclose(rotation_321(y, p, rr), r, atol=3e-9)
    # never more than a quarter turn away from the gimbal's own yaw: no image upside down
    assert abs(wrap_180(y - yaw)) <= 90 + 1e-6
    assert abs(rr) <= 90 + 1e-6


@given(yaw=yaws, pitch=st.floats(-100, 100))
def test_without_roll_both_sequences_have_the_same_angles(yaw: float, pitch: float) -> None:
    y, p, r = yaw_pitch_roll_321(rotation(yaw, pitch))
    assert abs(wrap_180(y - yaw)) < 1e-5
    assert abs(p - pitch) < 1e-5
    assert abs(r) < 1e-5


def test_axes_and_signs() -> None:
    # roll positive: the right of the image (y) goes down (world z)
    assert rotation_321(0, 0, 10)[2, 1] > 0
    # yaw 90: the boresight looks along world y; pitch up: along -z
    np.testing.assert_allclose(rotation_321(90, 0, 0)[:, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotation_321(0, 90, 0)[:, 0], [0, 0, -1], atol=1e-15)


def test_arrays_keep_their_shape() -> None:
    r = rotation(np.zeros((2, 3)), -90.0, np.full((2, 3), 0.5))
    for angle in yaw_pitch_roll_321(r):
        assert angle.shape == (2, 3)
