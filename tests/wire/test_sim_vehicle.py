"""Messages of the embedded vehicle: streams, gimbal, camera, differences of ArduPilot and PX4."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np
import pytest

from panoexec.angles import rotation, rotation_from_quaternion, yaw_pitch_roll, yaw_pitch_roll_321
from panoexec.planning.geometry.pose_error import pose_error
from panoexec.sim.config import AirframeConfig, CameraConfig, GimbalConfig, SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from tests.wire.sim_peer import COMPONENT, SYSTEM, EmbeddedPeer, Heard, command, result_of

NAN = math.nan
LOCK = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
PITCHYAW, CONFIGURE = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
INTERVAL, REQUEST = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE
SHOOT = mavlink.MAV_CMD_IMAGE_START_CAPTURE
ACCEPTED, DENIED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_FAILED
BUSY = mavlink.MAV_RESULT_TEMPORARILY_REJECTED

STILL = SimConfig(
    airframe=AirframeConfig(wind_m_s=0.0, attitude_noise_deg=0.0),
    gimbal=dataclasses.replace(GimbalConfig(), heading_error_deg=0.0),
)


def ask(peer: EmbeddedPeer, message: Any, component: int = 1, wait_s: float = 0.2) -> tuple[int | None, list[Heard]]:
    peer.send(message)
    heard = peer.listen(wait_s)
    return result_of(heard, message.command, component), heard


def stream(peer: EmbeddedPeer, **rates_hz: float) -> None:
    for name, rate in rates_hz.items():
        message_id = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        assert ask(peer, command(INTERVAL, message_id, 1e6 / rate))[0] == ACCEPTED


def named(heard: list[Heard], name: str, component: int = 1) -> list[Any]:
    return [item.message for item in heard if item.name == name and item.component == component]


def point(peer: EmbeddedPeer, pitch: float, yaw: float, flags: int = LOCK) -> int | None:
    return ask(peer, command(PITCHYAW, pitch, yaw, NAN, NAN, flags, 0, 0), wait_s=0.02)[0]


def photos(peer: EmbeddedPeer) -> list[dict[str, Any]]:
    return [event for event in peer.truth.events if event["event"] == "exposure"]


def test_heartbeats_come_from_all_three_components_once_a_second() -> None:
    peer = EmbeddedPeer()
    peer.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    heard = [item for item in peer.listen(9.99) if item.name == "HEARTBEAT"]
    kinds = {(item.component, item.message.type, item.message.autopilot) for item in heard}
    assert kinds == {(1, 2, 3), (154, mavlink.MAV_TYPE_GIMBAL, 8), (100, mavlink.MAV_TYPE_CAMERA, 8)}
    assert len(heard) == 30
    assert all(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED for m in named(heard, "HEARTBEAT"))


def test_measured_attitude_composes_with_the_heading_to_the_target() -> None:
    """285 is relative to the nose: with ATTITUDE's yaw added it is the pose that was asked for, at the nadir too."""
    peer = EmbeddedPeer()
    stream(peer, ATTITUDE=50, GIMBAL_DEVICE_ATTITUDE_STATUS=50)
    for pitch, yaw in ((-30.0, 100.0), (-90.0, -135.0), (20.0, 0.0)):
        assert point(peer, pitch, yaw) == ACCEPTED
        peer.listen(4.0)
        heard = peer.listen(1.0)
        statuses, attitudes = named(heard, "GIMBAL_DEVICE_ATTITUDE_STATUS", 154), named(heard, "ATTITUDE")
        assert len(statuses) == 50
        poses = rotation([math.degrees(a.yaw) for a in attitudes], 0.0) @ rotation_from_quaternion(
            [s.q for s in statuses]
        )
        error = pose_error(pitch, yaw, poses)
        for axis in (error.pitch_deg, error.roll_deg, error.yaw_deg):
            assert np.all(np.abs(axis) < 0.15)
        assert 0.010 < error.pitch_deg.std() < 0.030
        assert all(s.flags == 60 and s.failure_flags == 0 for s in statuses)


def test_at_the_nadir_euler_angles_jump_while_the_boresight_is_steady() -> None:
    """As measured on the real one: roll and yaw of the 3-2-1 sequence by tens of degrees, the boresight by 0.02°."""
    peer = EmbeddedPeer(STILL)
    stream(peer, GIMBAL_DEVICE_ATTITUDE_STATUS=50)
    point(peer, -90.0, 0.0)
    peer.listen(4.0)
    poses = rotation_from_quaternion([s.q for s in named(peer.listen(2.0), "GIMBAL_DEVICE_ATTITUDE_STATUS", 1)])
    euler_yaw = yaw_pitch_roll_321(poses)[0]
    assert np.ptp(np.unwrap(euler_yaw, period=360)) > 60
    boresights = poses[:, :, 0]
    off = np.degrees(np.linalg.norm(boresights - boresights.mean(axis=0), axis=1))
    assert off.max() < 0.1


def test_pitch_beyond_the_limit_is_accepted_and_clipped_silently() -> None:
    config = SimConfig(
        gimbal=dataclasses.replace(GimbalConfig(), pitch=dataclasses.replace(GimbalConfig().pitch, max_deg=45))
    )
    peer = EmbeddedPeer(config)
    _, heard = ask(peer, command(REQUEST, mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION))
    (information,) = named(heard, "GIMBAL_MANAGER_INFORMATION")
    assert math.degrees(information.pitch_max) == pytest.approx(45, abs=1e-4)
    assert point(peer, 60.0, 0.0) == ACCEPTED
    peer.listen(3.0)
    _, heard = ask(peer, command(REQUEST, mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS))
    (status,) = named(heard, "GIMBAL_DEVICE_ATTITUDE_STATUS", 1)
    assert float(yaw_pitch_roll(rotation_from_quaternion(status.q))[1]) == pytest.approx(45, abs=0.2)


def test_a_photo_is_reported_with_its_attitude_place_and_time_and_the_truth_is_kept() -> None:
    peer = EmbeddedPeer(STILL)
    point(peer, -20.0, 50.0)
    peer.listen(3.0)
    result, heard = ask(peer, command(SHOOT, 0, 0, 1, 1, to=100), component=100, wait_s=0.5)
    assert result == ACCEPTED
    (captured,) = named(heard, "CAMERA_IMAGE_CAPTURED", 100)
    (truth,) = photos(peer)
    assert (captured.image_index, captured.capture_result) == (1, 1)
    assert captured.file_url == truth["file"] == "IMG_00001.jpg"
    yaw, pitch, roll = (float(a) for a in yaw_pitch_roll(rotation_from_quaternion(captured.q)))
    assert [yaw, roll, pitch] == pytest.approx([50.0, 0.0, -20.0], abs=0.1)
    assert truth["true_yaw_roll_pitch_deg"][0] == pytest.approx([50.0, 0.0, -20.0], abs=0.02)
    assert captured.lat * 1e-7 == pytest.approx(47.3977, abs=1e-4)
    assert captured.relative_alt * 1e-3 == pytest.approx(30.0, abs=3.0)
    boot_s = captured.time_boot_ms * 1e-3 + STILL.payload_boot_s
    assert boot_s == pytest.approx(truth["sim_s"], abs=1e-3)


def test_camera_information_and_storage() -> None:
    peer = EmbeddedPeer(dataclasses.replace(STILL, camera=CameraConfig(storage_mib=25.0, interval_s=0.5)))
    _, heard = ask(peer, command(REQUEST, 259, to=100), component=100)
    (information,) = named(heard, "CAMERA_INFORMATION", 100)
    optics = STILL.camera.optics
    assert information.focal_length == pytest.approx(optics.focal_length_mm)
    assert (information.resolution_h, information.resolution_v) == (optics.image_width_px, optics.image_height_px)
    shoot = command(SHOOT, 0, 0, 1, 1, to=100)
    results = [ask(peer, shoot, component=100, wait_s=1.0)[0] for _ in range(3)]
    assert results == [ACCEPTED, ACCEPTED, FAILED]
    _, heard = ask(peer, command(REQUEST, 261, to=100), component=100)
    (storage,) = named(heard, "STORAGE_INFORMATION", 100)
    assert (storage.used_capacity, storage.available_capacity) == (24.0, 1.0)
    _, heard = ask(peer, command(REQUEST, 262, to=100), component=100)
    assert named(heard, "CAMERA_CAPTURE_STATUS", 100)[0].image_count == 2


def test_camera_denies_within_its_interval_and_repeats_its_ack_to_a_retransmission() -> None:
    peer = EmbeddedPeer(STILL)
    shoot = command(SHOOT, 0, 0, 1, 1, to=100)
    assert ask(peer, shoot, component=100)[0] == ACCEPTED
    again = command(SHOOT, 0, 0, 1, 1, to=100, confirmation=1)
    assert ask(peer, again, component=100)[0] == ACCEPTED
    assert ask(peer, shoot, component=100)[0] == BUSY
    peer.listen(2.0)
    assert len(photos(peer)) == 1


def test_a_series_of_photos_keeps_the_interval_and_can_be_stopped() -> None:
    peer = EmbeddedPeer(STILL)
    ask(peer, command(SHOOT, 0, 2.0, 0, 1, to=100), component=100)
    peer.listen(7.0)
    ask(peer, command(mavlink.MAV_CMD_IMAGE_STOP_CAPTURE, to=100), component=100)
    peer.listen(10.0)
    starts = [photo["sim_s"] for photo in photos(peer)]
    assert len(starts) == 4
    assert np.diff(starts) == pytest.approx(2.0)
    ask(peer, command(SHOOT, 0, 0, 3, 1, to=100), component=100)
    peer.listen(10.0)
    assert len(photos(peer)) == 7


def test_reboot_resets_intervals_control_and_boot_time() -> None:
    peer = EmbeddedPeer()
    stream(peer, ATTITUDE=50, GIMBAL_DEVICE_ATTITUDE_STATUS=50, GIMBAL_MANAGER_STATUS=2)
    ask(peer, command(CONFIGURE, -2, -2, -1, -1, 0, 0, 0))
    before = named(peer.listen(5.0), "ATTITUDE")
    forced = command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1, 0, 0, 0, 0, 20190226)
    assert ask(peer, forced, wait_s=0.05)[0] == ACCEPTED
    peer.listen(0.1)
    assert peer.listen(2.5) == []
    heard = peer.listen(5.0)
    assert {item.name for item in heard} == {"HEARTBEAT"}
    stream(peer, ATTITUDE=50, GIMBAL_MANAGER_STATUS=2)
    heard = peer.listen(2.0)
    assert named(heard, "ATTITUDE")[0].time_boot_ms < before[-1].time_boot_ms
    status = named(heard, "GIMBAL_MANAGER_STATUS")[-1]
    assert (status.primary_control_sysid, status.primary_control_compid) == (0, 0)


@pytest.mark.parametrize(("autopilot", "refusal", "mode"), [("ardupilot", 4, 0), ("px4", 2, 4 << 16 | 3 << 24)])
def test_no_reboot_while_armed_and_after_one_it_is_disarmed(
    autopilot: Literal["ardupilot", "px4"], refusal: int, mode: int
) -> None:
    peer = EmbeddedPeer(SimConfig(autopilot=autopilot))
    assert ask(peer, command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1))[0] == refusal
    peer.listen(1.0)
    assert peer.simulation.airframe.armed
    peer.simulation.vehicle.reboot(2.0)  # type: ignore[union-attr]
    (heard, *_) = named(peer.listen(3.1), "HEARTBEAT")
    assert (heard.custom_mode, heard.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) == (mode, 0)
    assert not peer.simulation.airframe.is_flying
    assert ask(peer, command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1))[0] == ACCEPTED


def test_px4_default_streams_device_id_and_denial_without_control() -> None:
    peer = EmbeddedPeer(SimConfig(autopilot="px4"))
    peer.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    heard = peer.listen(2.01)
    assert named(heard, "HEARTBEAT")[0].autopilot == mavlink.MAV_AUTOPILOT_PX4
    assert len(named(heard, "ATTITUDE")) == 100
    assert named(heard, "GIMBAL_MANAGER_STATUS")[0].gimbal_device_id == 154
    assert ask(peer, command(PITCHYAW, -20, 0, NAN, NAN, LOCK, 0, 154))[0] == DENIED
    assert ask(peer, command(CONFIGURE, SYSTEM, COMPONENT, -1, -1, 0, 0, 154))[0] == ACCEPTED
    assert ask(peer, command(PITCHYAW, -20, 0, NAN, NAN, LOCK, 0, 154))[0] == ACCEPTED
    peer.listen(2.0)
    assert peer.simulation.physics.estimate.pitch_deg == pytest.approx(-20, abs=0.1)
    assert ask(peer, command(REQUEST, 50_000))[0] == DENIED


def test_a_servo_mount_reports_the_demand_relative_to_the_airframe() -> None:
    """The vehicle leans 14° in 8 m/s; the report leans with it while the camera is level (MNT1_TYPE 1)."""
    windy = AirframeConfig(wind_m_s=8.0, wind_from_deg=270.0, heading_deg=0.0, sway_deg=0.0, heading_sway_deg=0.0)
    peer = EmbeddedPeer(dataclasses.replace(STILL, mount="servo", airframe=windy))
    peer.listen(1.0)
    point(peer, 0.0, 0.0)
    peer.listen(3.0)
    heard = ask(peer, command(REQUEST, 285))[1]
    assert named(heard, "GIMBAL_DEVICE_ATTITUDE_STATUS", 154) == []
    (status,) = named(heard, "GIMBAL_DEVICE_ATTITUDE_STATUS", 1)
    roll = float(yaw_pitch_roll(rotation_from_quaternion(status.q))[2])
    assert roll == pytest.approx(14.0, abs=0.1)
    assert peer.simulation.physics.truth.roll_deg == pytest.approx(0.0, abs=0.2)
    point(peer, 0.0, 90.0)
    peer.listen(3.0)
    (status,) = named(ask(peer, command(REQUEST, 285))[1], "GIMBAL_DEVICE_ATTITUDE_STATUS", 1)
    pitch = float(yaw_pitch_roll(rotation_from_quaternion(status.q))[1])
    assert abs(pitch) == pytest.approx(14.0, abs=0.1)


def test_camera_on_a_servo_reports_only_a_count() -> None:
    peer = EmbeddedPeer(dataclasses.replace(STILL, camera_kind="servo"))
    _, heard = ask(peer, command(REQUEST, 259))
    (information,) = named(heard, "CAMERA_INFORMATION")
    assert math.isnan(information.focal_length)
    assert (information.resolution_h, information.resolution_v) == (0, 0)
    result, heard = ask(peer, command(SHOOT, 0, 0, 1, 1), wait_s=1.0)
    assert result == ACCEPTED
    (feedback,) = named(heard, "CAMERA_FEEDBACK")
    assert feedback.img_idx == 1
    assert abs(feedback.pitch) < 5
    assert [item for item in heard if item.name == "CAMERA_IMAGE_CAPTURED"] == []
    assert all(item.component == 1 or item.component == 154 for item in heard)
    assert len(photos(peer)) == 1


def test_flight_by_command_on_the_ground_and_back() -> None:
    config = dataclasses.replace(STILL, airframe=dataclasses.replace(STILL.airframe, in_air=False))
    peer = EmbeddedPeer(config)
    takeoff = command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 30)
    arm = command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert ask(peer, takeoff)[0] == DENIED
    assert ask(peer, command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4))[0] == ACCEPTED
    assert ask(peer, arm)[0] == ACCEPTED
    assert ask(peer, takeoff)[0] == ACCEPTED
    peer.listen(20.0)
    _, heard = ask(peer, command(REQUEST, 33))
    assert named(heard, "GLOBAL_POSITION_INT")[0].relative_alt * 1e-3 == pytest.approx(30, abs=3)
    _, heard = ask(peer, command(REQUEST, 245))
    assert named(heard, "EXTENDED_SYS_STATE")[0].landed_state == mavlink.MAV_LANDED_STATE_IN_AIR
    assert ask(peer, command(mavlink.MAV_CMD_DO_SET_MODE, 1, 9))[0] == ACCEPTED
    heard = peer.listen(45.0)
    assert not named(heard, "HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_parameters_can_be_read_listed_and_set() -> None:
    peer = EmbeddedPeer()
    peer.send(mavlink.MAVLink_param_request_list_message(1, 1))
    listed = named(peer.listen(0.2), "PARAM_VALUE")
    assert len(listed) == listed[0].param_count
    peer.send(mavlink.MAVLink_param_request_read_message(1, 1, b"MNT1_TYPE", -1))
    (value,) = named(peer.listen(0.2), "PARAM_VALUE")
    assert (value.param_id, value.param_value) == ("MNT1_TYPE", 6.0)
    peer.send(mavlink.MAVLink_param_set_message(1, 1, b"MNT1_RC_RATE", 5.0, 9))
    assert named(peer.listen(0.2), "PARAM_VALUE")[0].param_value == 5.0


def test_a_seed_gives_the_same_run_down_to_the_bytes_of_the_physics() -> None:
    def run(seed: int) -> list[Any]:
        peer = EmbeddedPeer(SimConfig(seed=seed))
        point(peer, -40.0, 75.0)
        peer.listen(2.0)
        ask(peer, command(SHOOT, 0, 0, 1, 1, to=100), component=100)
        peer.listen(1.0)
        return photos(peer)

    assert run(5) == run(5)
    assert run(5) != run(6)


def test_an_attached_payload_answers_the_request_to_all_by_which_px4_looks_for_a_gimbal() -> None:
    peer = EmbeddedPeer(SimConfig(attach_url="udpin:127.0.0.1:1"))
    request = mavlink.MAVLink_command_long_message(
        0, 0, REQUEST, 0, mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION, 0, 0, 0, 0, 0, 0
    )
    heard = ask(peer, request, component=154)[1]
    (information,) = named(heard, "GIMBAL_DEVICE_INFORMATION", 154)
    assert math.degrees(information.pitch_min) == pytest.approx(-90.05)
    assert result_of(heard, REQUEST, 154) == ACCEPTED


def test_nobody_answers_a_request_to_all_for_what_it_does_not_have() -> None:
    peer = EmbeddedPeer(SimConfig(attach_url="udpin:127.0.0.1:1"))
    request = mavlink.MAVLink_command_long_message(0, 0, REQUEST, 0, 412, 0, 0, 0, 0, 0, 0)
    heard = ask(peer, request)[1]
    assert not [item for item in heard if item.name == "COMMAND_ACK"]
