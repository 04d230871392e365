import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.gimbal.attitude_messages import (
    gimbal_sample,
    interpolate,
    manager_limits,
    number,
    told_heading_deg,
    vehicle_attitude,
    yaw_frame,
)
from panoexec.angles import rotation_from_quaternion
from panoexec.devices import VehicleAttitude, YawFrame
from panoexec.sim.physics.gimbal import Angles, Rates, body_rates, quaternion

ANGLE = st.floats(-math.pi, math.pi)


def fields_285(**changes: Any) -> dict[str, Any]:
    return {
        "time_boot_ms": 12_345,
        "flags": 44,
        "q": [1.0, 0.0, 0.0, 0.0],
        "angular_velocity_x": 0.03,
        "angular_velocity_y": -0.04,
        "angular_velocity_z": 0.0,
        "failure_flags": 0,
    } | changes


def turning_285(pitch: float, roll: float, rates: Rates, **changes: Any) -> dict[str, Any]:
    """A report relative to the vehicle's nose, which turns at 1.5°/s, of a camera with these rates of its axes."""
    x, y, z = body_rates(Angles(20.0, roll, pitch), Rates(rates.yaw_deg_s - 1.5, rates.roll_deg_s, rates.pitch_deg_s))
    return fields_285(
        q=list(quaternion(Angles(20.0, roll, pitch))),
        angular_velocity_x=x,
        angular_velocity_y=y,
        angular_velocity_z=z,
        **{"delta_yaw_velocity": math.radians(1.5)} | changes,
    )


def fields_30(roll: float, pitch: float, yaw: float, **changes: Any) -> dict[str, Any]:
    return {"time_boot_ms": 12_345, "roll": roll, "pitch": pitch, "yaw": yaw} | changes


@pytest.mark.parametrize(
    ("flags", "frame"),
    [
        (64, YawFrame.EARTH),
        (64 + 16 + 12, YawFrame.EARTH),
        (32, YawFrame.VEHICLE),
        (32 + 16, YawFrame.VEHICLE),  # ArduPilot, yaw-locked: the frame flag wins over the lock
        (16, YawFrame.EARTH),  # before the frame flags existed
        (12, YawFrame.VEHICLE),
        (0, YawFrame.VEHICLE),
    ],
)
def test_the_frame_follows_from_the_flags(flags: int, frame: YawFrame) -> None:
    assert yaw_frame(flags) is frame


def test_a_sample_carries_all_that_the_message_tells() -> None:
    sample = gimbal_sample(fields_285(q=[0.0, 0.0, -2.0, 0.0], failure_flags=8, delta_yaw_velocity=1e-12), 77.0)
    assert (sample.received_s, sample.vehicle_s) == (77.0, 12.345)
    assert sample.q_wxyz == (0.0, 0.0, -1.0, 0.0)
    assert sample.yaw_frame is YawFrame.VEHICLE
    assert sample.rate_deg_s == pytest.approx(math.degrees(0.05))
    assert sample.failure_flags == 8


def test_a_configured_frame_overrules_the_flags() -> None:
    assert gimbal_sample(fields_285(), 0.0, YawFrame.BODY).yaw_frame is YawFrame.BODY


@pytest.mark.parametrize("q", [[None] * 4, [0.0] * 4, [1.0, None, 0.0, 0.0]])
def test_no_attitude_is_not_a_number(q: list[float | None]) -> None:
    sample = gimbal_sample(fields_285(q=q), 0.0)
    assert all(math.isnan(part) for part in sample.q_wxyz)


def test_an_untold_rate_is_not_a_number() -> None:
    assert math.isnan(gimbal_sample(fields_285(angular_velocity_y=None), 0.0).rate_deg_s)
    assert math.isnan(number(None))


@given(pitch=st.floats(-90, 60), roll=st.floats(-0.5, 0.5), rates=st.tuples(*[st.floats(-3, 3)] * 3))
def test_the_rates_of_the_axes_are_those_of_the_gimbal(
    pitch: float, roll: float, rates: tuple[float, float, float]
) -> None:
    told = gimbal_sample(turning_285(pitch, roll, Rates(*rates)), 0.0).axis_rates_deg_s
    # a roll of half a degree mixes one rate into the others by a hundredth
    assert told == pytest.approx((rates[2], rates[1], rates[0]), abs=0.05)


def test_rates_that_are_not_measured_are_unknown() -> None:
    rates = Rates(0.5, -0.25, 2.0)
    pitch, roll, yaw = gimbal_sample(turning_285(-30.0, 0.0, rates, delta_yaw_velocity=None), 0.0).axis_rates_deg_s
    assert (pitch, roll) == pytest.approx((2.0, -0.25))
    assert math.isnan(yaw), "the vehicle's own rate is not told"
    nothing = {f"angular_velocity_{axis}": 0.0 for axis in "xyz"}
    for changes in (nothing, {"angular_velocity_z": None}):
        sample = gimbal_sample(fields_285(delta_yaw_velocity=0.1) | changes, 0.0)
        assert all(math.isnan(rate) for rate in sample.axis_rates_deg_s)


@pytest.mark.parametrize("changes", [{}, {"delta_yaw_velocity": None}, {"delta_yaw_velocity": 0.0}])
def test_a_rate_in_the_vehicles_frame_is_none_against_the_world(changes: dict[str, Any]) -> None:
    assert math.isnan(gimbal_sample(fields_285(**changes), 0.0).rate_deg_s)
    assert gimbal_sample(fields_285(flags=12 + 64, **changes), 0.0).rate_deg_s == pytest.approx(math.degrees(0.05))


@given(yaw=ANGLE, pitch=st.floats(-1.5, 1.5), roll=st.floats(-0.5, 0.5), turning=st.floats(0.01, 1.0))
def test_the_vehicles_turning_is_added_to_a_rate_in_its_frame(
    yaw: float, pitch: float, roll: float, turning: float
) -> None:
    airframe = vehicle_attitude(fields_30(roll, pitch, yaw), 0.0)  # any attitude will do
    down = rotation_from_quaternion(np.array(airframe.q_wxyz)).T @ np.array([0.0, 0.0, 1.0])
    relative = -turning * down  # a camera that stands still over a vehicle that turns
    sample = gimbal_sample(
        fields_285(q=list(airframe.q_wxyz), delta_yaw_velocity=turning)
        | {f"angular_velocity_{axis}": float(value) for axis, value in zip("xyz", relative, strict=True)},
        0.0,
    )
    assert sample.rate_deg_s == pytest.approx(0.0, abs=1e-9)


@given(yaw=ANGLE, heading=st.floats(-180, 180))
def test_a_known_heading_turns_a_sample_into_the_earths_frame(yaw: float, heading: float) -> None:
    sample = gimbal_sample(fields_285(q=[math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]), 0.0, heading_deg=heading)
    assert sample.yaw_frame is YawFrame.EARTH
    ahead = rotation_from_quaternion(np.array(sample.q_wxyz))[:, 0]
    angle = yaw + math.radians(heading)
    assert ahead == pytest.approx([math.cos(angle), math.sin(angle), 0.0], abs=1e-9)


@pytest.mark.parametrize("changes", [{"flags": 64 + 12}, {"flags": 64 + 16 + 12}])
def test_a_heading_does_not_turn_what_is_in_the_earths_frame_already(changes: dict[str, Any]) -> None:
    assert gimbal_sample(fields_285(**changes), 0.0, heading_deg=90.0).q_wxyz == (1.0, 0.0, 0.0, 0.0)


def test_a_servo_mounts_angles_are_not_turned_by_a_heading() -> None:
    sample = gimbal_sample(fields_285(), 0.0, YawFrame.BODY, heading_deg=90.0)
    assert (sample.yaw_frame, sample.q_wxyz) == (YawFrame.BODY, (1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("changes", "heading_deg"),
    [
        ({"delta_yaw": math.pi / 2}, 90.0),
        ({"delta_yaw": None}, math.nan),
        ({}, math.nan),
        ({"delta_yaw": 1.0, "flags": 12 + 16}, math.nan),  # 285: without a frame flag the field is to be ignored
    ],
)
def test_the_heading_that_a_gimbal_tells(changes: dict[str, Any], heading_deg: float) -> None:
    assert told_heading_deg(fields_285(**changes)) == pytest.approx(heading_deg, nan_ok=True)


@given(roll=ANGLE, pitch=st.floats(-1.5, 1.5), yaw=ANGLE)
def test_the_airframe_turns_by_yaw_then_pitch_then_roll(roll: float, pitch: float, yaw: float) -> None:
    m = rotation_from_quaternion(vehicle_attitude(fields_30(roll, pitch, yaw), 0.0).q_wxyz)
    nose, right = m[:, 0], m[:, 1]
    assert math.atan2(nose[1], nose[0]) == pytest.approx(yaw, abs=1e-6) or abs(abs(yaw) - math.pi) < 1e-6
    assert -nose[2] == pytest.approx(math.sin(pitch), abs=1e-9)
    assert right[2] == pytest.approx(math.sin(roll) * math.cos(pitch), abs=1e-9)


@pytest.mark.parametrize(
    ("radians", "degrees"),
    [
        ((-1.5707963267, 0.7853981, -3.1415927, 3.1415927), (-90.0, 45.0, -180.0, 180.0, True)),
        ((-1.2, 0.3, -0.5, 0.6), (-68.755, 17.189, -28.648, 34.377, False)),
        ((-1.5, 0.5, -3.14, 3.14), (-85.944, 28.648, -179.909, 179.909, True)),
    ],
)
def test_limits_come_in_radians(radians: tuple[float, ...], degrees: tuple[float, ...]) -> None:
    limits = manager_limits(dict(zip(("pitch_min", "pitch_max", "yaw_min", "yaw_max"), radians, strict=True)))
    assert limits is not None
    told = (limits.pitch_min_deg, limits.pitch_max_deg, limits.yaw_min_deg, limits.yaw_max_deg, limits.yaw_endless)
    assert told == degrees


@pytest.mark.parametrize("pan", [(0.0, 0.0), (None, None)])
def test_a_gimbal_that_says_that_it_has_no_pan_axis_has_none(pan: tuple[float | None, float | None]) -> None:
    fields = {"pitch_min": -1.5, "pitch_max": 0.5, "yaw_min": pan[0], "yaw_max": pan[1], "cap_flags": 32 | 4}
    limits = manager_limits(fields)
    assert limits is not None
    assert (limits.yaw_min_deg, limits.yaw_max_deg, limits.pans) == (0.0, 0.0, False)
    assert manager_limits(fields | {"cap_flags": 32 | 256}) is None, "it has an axis, and does not say how far it goes"


@pytest.mark.parametrize("radians", [(0.0, 0.0, 0.0, 0.0), (None, 0.5, -3.0, 3.0), (0.5, -1.5, -3.0, 3.0)])
def test_limits_that_are_none_are_not_made_up(radians: tuple[float | None, ...]) -> None:
    assert manager_limits(dict(zip(("pitch_min", "pitch_max", "yaw_min", "yaw_max"), radians, strict=True))) is None


@given(
    roll=ANGLE,
    pitch=st.floats(-1.3, 1.3),
    yaw=ANGLE,
    turned=st.tuples(*[st.floats(-0.03, 0.03)] * 3),
    fraction=st.floats(0, 1),
)
def test_between_two_attitudes_lies_the_one_between(
    roll: float, pitch: float, yaw: float, turned: tuple[float, float, float], fraction: float
) -> None:
    a = vehicle_attitude(fields_30(roll, pitch, yaw), 1.0)
    b = vehicle_attitude(fields_30(roll + turned[0], pitch + turned[1], yaw + turned[2], time_boot_ms=12_365), 1.02)
    q = b.q_wxyz
    b = VehicleAttitude(b.received_s, b.vehicle_s, (-q[0], -q[1], -q[2], -q[3]))  # the same attitude
    m = [rotation_from_quaternion(x.q_wxyz) for x in (a, interpolate(a, b, fraction), b)]
    whole, part = (math.acos(min(1.0, (np.trace(m[0].T @ x) - 1) / 2)) for x in (m[2], m[1]))
    assert part == pytest.approx(fraction * whole, abs=2e-5)
    middle = interpolate(a, b, 0.5)
    assert (middle.received_s, middle.vehicle_s) == pytest.approx((1.01, 12.355))
