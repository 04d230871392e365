"""The effect of every fault on the wire."""

from __future__ import annotations

import math
from typing import Any

import pytest

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import parse_fault
from panoexec.sim.mavlink.dialect import mavlink
from tests.wire.sim_peer import EmbeddedPeer, Heard, command, result_of

LOCK = mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
SHOOT = command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1, 1, to=100)
ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
STATUS = "GIMBAL_DEVICE_ATTITUDE_STATUS"


class Bench:
    """A vehicle with faults, its streams on, its gimbal under control."""

    def __init__(self, *faults: str) -> None:
        self.peer = EmbeddedPeer(SimConfig(faults=tuple(parse_fault(text) for text in faults)))
        for message_id in (mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS):
            self.peer.send(command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 20_000))
        self.peer.send(command(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, -2, -2, -1, -1))
        self.point(-10.0, 0.0)
        self.peer.listen(2.0)

    def point(self, pitch: float, yaw: float) -> None:
        angles = (pitch, yaw, math.nan, math.nan, LOCK, 0, 0)
        self.peer.send(command(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, *angles))

    def shoot(self, wait_s: float = 1.5) -> tuple[int | None, list[Heard]]:
        self.peer.send(SHOOT)
        heard = self.peer.listen(wait_s)
        return result_of(heard, SHOOT.command, 100), heard

    def request(self, name: str, component: int = 1) -> Any:
        message_id = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        self.peer.send(command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id, to=component))
        return next(item.message for item in self.peer.listen(0.1) if item.name == name and item.component == component)

    @property
    def exposures(self) -> list[dict[str, Any]]:
        return [event for event in self.peer.truth.events if event["event"] == "exposure"]


def count(heard: list[Heard], name: str, component: int | None = None) -> int:
    return sum(item.name == name and component in (None, item.component) for item in heard)


def test_link_loss_blocks_both_directions_and_ends() -> None:
    bench = Bench("link-loss=1+5")
    bench.shoot(0.99)
    assert bench.peer.listen(5.0) == []
    assert count(bench.peer.listen(1.0), STATUS, 154) == 50

    deaf = Bench("link-loss=1+5")
    deaf.shoot(2.0)
    deaf.point(-60.0, 90.0)
    deaf.peer.listen(3.0)
    assert deaf.peer.simulation.physics.estimate.pitch_deg == pytest.approx(-10.0, abs=0.2)


def test_reboot_resets_requested_streams() -> None:
    bench = Bench("reboot=1,x4")
    bench.shoot(1.05)
    assert bench.peer.listen(3.9) == []
    assert {item.name for item in bench.peer.listen(3.0)} == {"HEARTBEAT"}
    assert bench.request("GIMBAL_MANAGER_STATUS").primary_control_compid == 0


@pytest.mark.parametrize("component", [1, 154])
def test_attitude_stops_and_comes_back_while_all_else_goes_on(component: int) -> None:
    bench = Bench("attitude-stop=1+4")
    bench.shoot(1.05)
    heard = bench.peer.listen(3.9)
    assert count(heard, STATUS, component) == 0
    assert count(heard, "ATTITUDE") == 195
    assert count(bench.peer.listen(1.0), STATUS, component) >= 48


def test_attitude_freezes_with_fresh_stamps() -> None:
    bench = Bench("attitude-frozen=1+4")
    bench.shoot(1.1)
    bench.point(-70.0, 90.0)
    frozen = [item.message for item in bench.peer.listen(3.0) if item.name == STATUS and item.component == 154]
    assert len({tuple(message.q) for message in frozen}) == 1
    assert len({message.time_boot_ms for message in frozen}) == len(frozen) == 150
    assert bench.peer.simulation.physics.truth.pitch_deg == pytest.approx(-70.0, abs=0.2)
    bench.peer.listen(1.0)
    assert len({tuple(i.message.q) for i in bench.peer.listen(1.0) if i.name == STATUS and i.component == 154}) == 50


@pytest.mark.parametrize("component", [1, 154])
def test_attitudes_are_held_up_and_come_in_time_again(component: int) -> None:
    bench = Bench("attitude-late=1+6,x2")

    def ages_s(seconds: float) -> list[float]:
        heard = bench.peer.listen(seconds)
        newest_ms = max(item.message.time_boot_ms for item in heard if item.name == "ATTITUDE")
        told = [item.message for item in heard if item.name == STATUS and item.component == component]
        return [(newest_ms - message.time_boot_ms) / 1000 for message in told]

    bench.shoot(1.05)
    assert ages_s(1.9) == []
    held_up = ages_s(1.0)
    assert len(held_up) >= 45
    assert min(held_up) >= 1.9
    bench.peer.listen(4.0)
    in_time = ages_s(1.0)
    assert len(in_time) >= 45
    assert min(in_time) <= 0.3, "the gimbal has a boot time of its own"


@pytest.mark.parametrize("component", [1, 154])
def test_attitude_is_nan(component: int) -> None:
    bench = Bench("attitude-nan=1+4")
    bench.shoot(1.1)
    heard = [i.message for i in bench.peer.listen(2.0) if i.name == STATUS and i.component == component]
    assert len(heard) == 100
    assert all(math.isnan(part) for message in heard for part in message.q)


def test_the_gimbal_sticks_with_commands_accepted_and_moves_again() -> None:
    bench = Bench("gimbal-stuck=1+5")
    bench.shoot(1.1)
    bench.point(-70.0, 0.0)
    assert result_of(bench.peer.listen(3.0), mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW) == ACCEPTED
    assert bench.peer.simulation.physics.estimate.pitch_deg == pytest.approx(-10.0, abs=0.2)
    bench.peer.listen(4.0)
    assert bench.peer.simulation.physics.estimate.pitch_deg == pytest.approx(-70.0, abs=0.2)


def test_the_gimbal_is_slow() -> None:
    bench = Bench("gimbal-slow=1+30,x0.2")
    bench.shoot(1.1)
    bench.point(-70.0, 0.0)
    bench.peer.listen(3.0)
    assert -50.0 < bench.peer.simulation.physics.estimate.pitch_deg < -35.0
    bench.peer.listen(4.0)
    assert bench.peer.simulation.physics.estimate.pitch_deg == pytest.approx(-70.0, abs=0.2)


def test_drift_occurs_while_the_shutter_is_open_and_shows_in_the_feedback() -> None:
    bench = Bench("drift=#2,x2")
    bench.shoot()
    _, heard = bench.shoot()
    bench.shoot()
    target = (0.0, 0.0, -10.0)
    off = [
        max(abs(a - b) for a, b in zip(exposure["estimated_yaw_roll_pitch_deg"], target, strict=True))
        for exposure in bench.exposures
    ]
    assert off == pytest.approx([0.0, 2.0, 0.0], abs=0.1)
    reported = [item.message.q for item in heard if item.name == STATUS and item.component == 154]
    calm = [i.message.q for i in bench.peer.listen(0.5) if i.name == STATUS and i.component == 154][-1]
    cosines = [abs(sum(a * b for a, b in zip(q, calm, strict=True))) for q in reported]
    # relative to the nose, which sways
    assert 1.3 < math.degrees(2 * math.acos(min(cosines))) < 2.7


def test_another_station_takes_the_gimbal_and_points_it_ahead() -> None:
    bench = Bench("control-stolen=1")
    bench.shoot(3.0)
    status = bench.request("GIMBAL_MANAGER_STATUS")
    assert (status.primary_control_sysid, status.primary_control_compid) == (255, 190)
    assert bench.peer.simulation.physics.estimate.pitch_deg == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize(("autopilot", "before", "after"), [("ardupilot", 4, 0), ("px4", 0x03040000, 7 << 16)])
def test_the_pilot_changes_the_mode(autopilot: Any, before: int, after: int) -> None:
    peer = EmbeddedPeer(SimConfig(autopilot=autopilot, faults=(parse_fault("mode-change=t2"),)))
    modes = [i.message.custom_mode for i in peer.listen(5.0) if i.name == "HEARTBEAT" and i.component == 1]
    assert (modes[0], modes[-1]) == (before, after)


@pytest.mark.parametrize("counts", [True, False])
def test_a_photo_command_is_lost_with_its_retransmissions(counts: bool) -> None:
    """MAVSDK repeats after 0.5 s, three times, with the same sequence number and without counting `confirmation`."""
    bench = Bench("photo-lost=#1")
    for repeat in range(4):
        again = command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1, 7, to=100, confirmation=repeat if counts else 0)
        bench.peer.send(again)
        assert result_of(bench.peer.listen(0.5), again.command, 100) is None
    bench.peer.listen(1.0)
    assert bench.exposures == []
    assert bench.shoot()[0] == ACCEPTED
    assert len(bench.exposures) == 1


def test_a_new_command_soon_after_a_lost_one_is_no_retransmission() -> None:
    bench = Bench("photo-lost=#1")
    first, second = (command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1, n, to=100) for n in (7, 8))
    bench.peer.send(first)
    bench.peer.listen(0.2)
    bench.peer.send(second)
    assert result_of(bench.peer.listen(0.5), second.command, 100) == ACCEPTED


def test_a_photo_is_refused() -> None:
    bench = Bench("photo-refused=#1")
    assert bench.shoot()[0] == mavlink.MAV_RESULT_DENIED
    assert bench.shoot()[0] == ACCEPTED
    assert len(bench.exposures) == 1


def test_a_capture_message_is_lost_and_the_photo_is_there() -> None:
    bench = Bench("capture-lost=#1")
    result, heard = bench.shoot()
    assert result == ACCEPTED
    assert count(heard, "CAMERA_IMAGE_CAPTURED") == 0
    assert len(bench.exposures) == 1
    assert bench.request("CAMERA_CAPTURE_STATUS", 100).image_count == 1
    # it can be asked for again, by its index
    bench.peer.send(command(mavlink.MAV_CMD_REQUEST_MESSAGE, 263, 1, to=100))
    assert count(bench.peer.listen(0.2), "CAMERA_IMAGE_CAPTURED", 100) == 1


def test_a_photo_is_reported_twice() -> None:
    bench = Bench("capture-twice=#1")
    messages = [item.message for item in bench.shoot()[1] if item.name == "CAMERA_IMAGE_CAPTURED"]
    assert [message.image_index for message in messages] == [1, 1]
    assert len(bench.exposures) == 1


def test_the_storage_is_full() -> None:
    bench = Bench("storage-full=1")
    assert bench.shoot()[0] == ACCEPTED
    assert bench.shoot()[0] == mavlink.MAV_RESULT_FAILED
    assert bench.request("STORAGE_INFORMATION", 100).available_capacity == 0.0


def test_camera_sends_storage_information_at_every_change() -> None:
    """As the protocol wants it: who asks every few real seconds learns it late of a sped-up vehicle."""
    bench = Bench("storage-full=1+4")
    told = [item.message for item in bench.shoot(7.0)[1] if item.name == "STORAGE_INFORMATION"]
    assert [message.available_capacity > 0 for message in told] == [False, True]


def test_the_battery_is_low() -> None:
    bench = Bench("battery-low=1,x0.07")
    assert bench.request("SYS_STATUS").battery_remaining > 90
    bench.shoot(2.0)
    assert bench.request("SYS_STATUS").battery_remaining == 7
    assert bench.request("BATTERY_STATUS").charge_state == mavlink.MAV_BATTERY_CHARGE_STATE_LOW


def test_a_gust_leans_the_vehicle_and_shakes_the_camera() -> None:
    bench = Bench("gust=1+6,x14")
    bench.shoot(1.1)
    bench.peer.listen(1.0)
    heard = bench.peer.listen(4.0)
    leans = [math.hypot(i.message.roll, i.message.pitch) for i in heard if i.name == "ATTITUDE"]
    assert math.degrees(max(leans)) > 20
    assert bench.peer.simulation.physics.wind_m_s == 16.0
    bench.peer.listen(3.0)
    assert bench.peer.simulation.physics.wind_m_s == 2.0


def test_the_clock_jumps_and_boot_time_does_not() -> None:
    bench = Bench("clock-jump=1,x3600")
    before = bench.request("SYSTEM_TIME")
    bench.shoot(2.0)
    after = bench.request("SYSTEM_TIME")
    boot_s = (after.time_boot_ms - before.time_boot_ms) * 1e-3
    assert boot_s == pytest.approx(2.1, abs=0.05)
    assert (after.time_unix_usec - before.time_unix_usec) * 1e-6 - boot_s == pytest.approx(3600, abs=0.01)


def test_faults_combine() -> None:
    bench = Bench("photo-refused=#1", "capture-twice=#2", "gimbal-stuck=0+50")
    assert bench.shoot()[0] == mavlink.MAV_RESULT_DENIED
    bench.point(-80.0, 0.0)
    _, heard = bench.shoot(3.0)
    assert count(heard, "CAMERA_IMAGE_CAPTURED") == 2
    assert bench.exposures[0]["estimated_yaw_roll_pitch_deg"][2] == pytest.approx(-10.0, abs=0.2)


def test_photo_faults_of_a_servo_camera() -> None:
    config = SimConfig(
        camera_kind="servo",
        faults=tuple(parse_fault(t) for t in ("photo-lost=#1", "photo-refused=#2", "capture-lost=#3")),
    )
    peer = EmbeddedPeer(config)
    seen = []
    for number in (1, 1, 2, 3, 4):
        peer.send(command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1, number))
        heard = peer.listen(0.5)
        seen.append((result_of(heard, mavlink.MAV_CMD_IMAGE_START_CAPTURE), count(heard, "CAMERA_FEEDBACK")))
        peer.listen(0.6 if number > 1 else 0.0)
    assert seen == [(None, 0), (None, 0), (mavlink.MAV_RESULT_DENIED, 0), (ACCEPTED, 0), (ACCEPTED, 1)]
    assert len([event for event in peer.truth.events if event["event"] == "exposure"]) == 2
