"""The embedded vehicle yaws on command, with gimbals of full, limited and no pan."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import pytest

from panoexec.angles import wrap_180
from panoexec.sim.config import AirframeConfig, AxisConfig, GimbalConfig, SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from tests.wire.sim_peer import EmbeddedPeer, command, command_int, result_of

TURN, MODE, PLACE = mavlink.MAV_CMD_CONDITION_YAW, mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_DO_REPOSITION
ACCEPTED, FAILED, UNSUPPORTED = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_FAILED,
    mavlink.MAV_RESULT_UNSUPPORTED,
)
GUIDED, LOITER = 4, 5
CALM = AirframeConfig(wind_m_s=0.0, attitude_noise_deg=0.0, heading_sway_deg=0.0, heading_deg=20.0)
STILL = SimConfig(airframe=CALM, gimbal=dataclasses.replace(GimbalConfig(), heading_error_deg=0.0))


def with_pan(low_deg: float, high_deg: float) -> SimConfig:
    yaw = AxisConfig(rate_deg_s=90.0, acceleration_deg_s2=360.0, min_deg=low_deg, max_deg=high_deg)
    return dataclasses.replace(STILL, gimbal=dataclasses.replace(STILL.gimbal, yaw=yaw, yaw_endless=False))


def ask(peer: EmbeddedPeer, message: Any) -> int | None:
    peer.send(message)
    return result_of(peer.listen(0.05), message.command, 1)


def heading(peer: EmbeddedPeer) -> float:
    assert peer.simulation.vehicle is not None
    return peer.simulation.vehicle.airframe.state().yaw_deg


def camera_yaw(peer: EmbeddedPeer) -> float:
    return float(wrap_180(peer.simulation.physics.estimate.yaw_deg))


def test_in_guided_it_turns_the_short_way_within_rate_and_acceleration_and_stays() -> None:
    peer = EmbeddedPeer(STILL)
    assert ask(peer, command(TURN, 330.0, 0, 0, 0)) == ACCEPTED
    track = [20.0]
    for _ in range(100):
        peer.listen(0.05)
        track.append(heading(peer))
    speeds = [(b - a) / 0.05 for a, b in itertools.pairwise(track)]
    assert min(speeds) >= -1.15 * CALM.turn_rate_deg_s
    assert min(speeds) < -0.5 * CALM.turn_rate_deg_s
    assert max(speeds) < 8.0, "it swings back a little, no more"
    assert track[-1] == pytest.approx(-30.0, abs=0.1)
    peer.listen(5.0)
    assert heading(peer) == pytest.approx(-30.0, abs=0.01)


def test_it_yaws_in_the_commanded_direction_at_the_commanded_rate() -> None:
    peer = EmbeddedPeer(STILL)
    assert ask(peer, command(TURN, 30.0, 15.0, -1, 0)) == ACCEPTED
    peer.listen(4.0)
    assert heading(peer) == pytest.approx(20.0 - 15.0 * 4.0, abs=6.0)
    peer.listen(24.0)
    assert heading(peer) == pytest.approx(30.0 - 360.0, abs=0.1)
    assert ask(peer, command(TURN, 15.0, 0, 1, 1)) == ACCEPTED
    peer.listen(5.0)
    assert heading(peer) == pytest.approx(45.0 - 360.0, abs=0.1)


def test_outside_guided_the_command_is_accepted_and_ignored_as_in_arducopter() -> None:
    peer = EmbeddedPeer(STILL)
    assert ask(peer, command(MODE, 1, LOITER)) == ACCEPTED
    assert ask(peer, command(TURN, 90.0, 0, 0, 0)) == ACCEPTED
    peer.listen(3.0)
    assert heading(peer) == pytest.approx(20.0)
    assert ask(peer, command(MODE, 1, GUIDED)) == ACCEPTED
    assert ask(peer, command(TURN, 361.0, 0, 0, 0)) == FAILED
    assert ask(peer, command(TURN, 90.0, 0, 0, 0.5)) == FAILED


def test_px4_yaws_by_reposition_and_does_not_support_condition_yaw() -> None:
    peer = EmbeddedPeer(dataclasses.replace(STILL, autopilot="px4"))
    assert ask(peer, command(TURN, 90.0, 0, 0, 0)) == UNSUPPORTED
    place = (math.radians(90.0), 473977420, 85455940, 518.0)
    assert ask(peer, command_int(PLACE, -1, 0, 0, *place)) == UNSUPPORTED
    assert ask(peer, command_int(PLACE, -1, 1, 0, *place)) == ACCEPTED
    peer.listen(6.0)
    assert heading(peer) == pytest.approx(90.0, abs=0.1)


def test_wind_displaces_the_heading_from_its_setpoint() -> None:
    windy = dataclasses.replace(CALM, wind_m_s=8.0, wind_from_deg=65.0)
    peer = EmbeddedPeer(dataclasses.replace(STILL, airframe=windy))
    peer.listen(1.0)
    assert heading(peer) == pytest.approx(20.0 + windy.heading_offset_deg, abs=0.01)


def test_two_axis_gimbal_reports_no_pan_and_points_along_the_nose() -> None:
    peer = EmbeddedPeer(with_pan(0.0, 0.0))
    peer.send(command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION))
    (told,) = [h.message for h in peer.listen(0.2) if h.name == "GIMBAL_MANAGER_INFORMATION"]
    assert (told.yaw_min, told.yaw_max) == (0.0, 0.0)
    assert told.cap_flags & mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS
    assert not told.cap_flags & mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS
    lock = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
    pitchyaw = command(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, -30.0, 100.0, math.nan, math.nan, lock, 0, 0)
    assert ask(peer, pitchyaw) == ACCEPTED
    peer.listen(3.0)
    assert camera_yaw(peer) == pytest.approx(20.0, abs=0.01)
    assert peer.simulation.physics.estimate.pitch_deg == pytest.approx(-30.0, abs=0.1)
    assert ask(peer, command(TURN, 100.0, 0, 0, 0)) == ACCEPTED
    for _ in range(10):
        peer.listen(0.5)
        assert camera_yaw(peer) == pytest.approx(float(wrap_180(heading(peer))), abs=0.5)
    assert camera_yaw(peer) == pytest.approx(100.0, abs=0.1)


def test_a_gimbal_with_little_pan_reaches_beyond_it_once_the_vehicle_has_turned() -> None:
    peer = EmbeddedPeer(with_pan(-40.0, 40.0))
    lock = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
    pitchyaw = command(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, 0.0, 90.0, math.nan, math.nan, lock, 0, 0)
    assert ask(peer, pitchyaw) == ACCEPTED
    peer.listen(4.0)
    assert camera_yaw(peer) == pytest.approx(60.0, abs=0.1)
    assert ask(peer, command(TURN, 60.0, 0, 0, 0)) == ACCEPTED
    peer.listen(5.0)
    assert camera_yaw(peer) == pytest.approx(90.0, abs=0.1)
