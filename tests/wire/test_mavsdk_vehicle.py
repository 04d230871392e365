"""The vehicle over real sockets: what it says, and what is believed of it."""

from __future__ import annotations

import asyncio
import math

import pytest

from panoexec.adapters import mavsdk_vehicle
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.mavsdk_vehicle import MavsdkVehicle
from panoexec.clock import SystemClock
from panoexec.devices import Vehicle
from panoexec.errors import DeviceError
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState
from panoexec.mission.pilot_messages import PilotMessenger
from panoexec.planning.model import Shot
from panoexec.sim.config import AirframeConfig, SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.waiting import eventually
from tests.wire.scripted_peer import ACCEPTED, FAILED, ScriptedPeer

GPS = 0x20


def sys_status(battery: int = 73, health: int = GPS) -> mavlink.MAVLink_sys_status_message:
    return mavlink.MAVLink_sys_status_message(GPS, GPS, health, 0, 15000, 1000, battery, 0, 0, 0, 0, 0, 0)


def ekf(flags: int) -> mavlink.MAVLink_ekf_status_report_message:
    return mavlink.MAVLink_ekf_status_report_message(flags, 0, 0, 0, 0, 0, 0)


async def test_the_status_is_what_the_vehicle_says(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    autopilot.builders |= {
        1: sys_status,
        193: lambda: ekf(16 + 1),
        245: lambda: mavlink.MAVLink_extended_sys_state_message(0, 2),
    }
    autopilot.armed = True
    async with MavsdkVehicle(link) as mavsdk_vehicle:
        vehicle: Vehicle = mavsdk_vehicle
        autopilot.send(sys_status())
        autopilot.send(ekf(17))
        autopilot.send(mavlink.MAVLink_extended_sys_state_message(0, 2))
        await eventually(lambda: vehicle.status.armed and vehicle.status.position_ok and vehicle.status.in_air)
        status = vehicle.status
        assert status.connected
        assert status.armed
        assert status.mode == "OFFBOARD"  # GUIDED
        assert (status.latitude_deg, status.longitude_deg) == pytest.approx((47.397742, 8.545594))
        assert (status.altitude_m, status.relative_altitude_m, status.heading_deg) == (488.0, 30.0, 90.0)
        assert status.battery_frac == pytest.approx(0.73)
        assert status.boot_count == 0
        autopilot.custom_mode, autopilot.armed = 0, False
        await eventually(lambda: vehicle.status.mode == "STABILIZED" and not vehicle.status.armed)


async def test_a_charge_that_is_not_told_again_is_unknown(
    autopilot: ScriptedPeer, link: MavsdkLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with MavsdkVehicle(link) as vehicle:
        autopilot.send(sys_status(battery=50))
        await eventually(lambda: vehicle.status.battery_frac == 0.5)
        assert mavsdk_vehicle._BATTERY_STALE_S == 30.0
        monkeypatch.setattr(mavsdk_vehicle, "_BATTERY_STALE_S", 0.0)
        assert math.isnan(vehicle.status.battery_frac)
        monkeypatch.undo()
        autopilot.send(sys_status(battery=49))
        await eventually(lambda: vehicle.status.battery_frac == 0.49)


async def test_nothing_is_made_up(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    autopilot.builders[33] = lambda: mavlink.MAVLink_global_position_int_message(
        autopilot.boot_ms(), 0, 0, 0, 1500, 0, 0, 0, 65535
    )
    async with MavsdkVehicle(link) as vehicle:
        autopilot.send(sys_status(battery=-1, health=0))
        await eventually(lambda: vehicle.status.relative_altitude_m == 1.5)
        status = vehicle.status
        unknown = (status.latitude_deg, status.longitude_deg, status.altitude_m, status.heading_deg)
        assert all(math.isnan(value) for value in (*unknown, status.battery_frac))
        assert not status.position_ok
        assert not status.in_air


@pytest.mark.parametrize(
    ("flags", "gps", "trusted"),
    [(16, 0, True), (16 + 128, GPS, False), (0, GPS, False), (None, GPS, True), (None, 0, False)],
    ids=["estimator", "constant position", "no position", "GPS alone", "nothing"],
)
async def test_the_estimator_is_believed_before_the_gps(
    autopilot: ScriptedPeer, link: MavsdkLink, flags: int | None, gps: int, trusted: bool
) -> None:
    async with MavsdkVehicle(link) as vehicle:
        if flags is not None:
            autopilot.send(ekf(flags))
        autopilot.send(sys_status(battery=50, health=gps))
        await eventually(lambda: vehicle.status.battery_frac == 0.5 and vehicle.status.latitude_deg > 0)
        assert vehicle.status.position_ok is trusted


async def test_sensors_that_are_used_and_unhealthy_are_named(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    compass, barometer, flow, estimator = 4, 8, 0x40, 0x200000
    all_of_them = compass | barometer | flow | estimator

    def told(enabled: int, health: int, battery: int) -> mavlink.MAVLink_sys_status_message:
        return mavlink.MAVLink_sys_status_message(
            all_of_them, enabled, health, 0, 15000, 1000, battery, 0, 0, 0, 0, 0, 0
        )

    async with MavsdkVehicle(link) as vehicle:
        autopilot.send(told(all_of_them, barometer, 51))
        await eventually(lambda: vehicle.status.battery_frac == 0.51)
        assert " and ".join(vehicle.status.unhealthy) == "compass and attitude estimator"
        autopilot.send(told(all_of_them & ~compass, barometer | estimator, 52))  # one that is not used does not matter
        await eventually(lambda: vehicle.status.battery_frac == 0.52)
        assert not vehicle.status.unhealthy


async def test_other_components_do_not_speak_for_the_vehicle(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    async with MavsdkVehicle(link) as vehicle:
        autopilot.send(sys_status(battery=10), component=100)
        autopilot.send(mavlink.MAVLink_heartbeat_message(30, 8, 128, 0, 4, 3), component=100)
        autopilot.send(sys_status(battery=60))
        await eventually(lambda: vehicle.status.battery_frac == 0.6)
        await eventually(lambda: 100 in link.components)
        assert not vehicle.status.armed


async def test_a_reboot_takes_the_position_away_until_it_is_told_again(
    autopilot: ScriptedPeer, link: MavsdkLink
) -> None:
    async with MavsdkVehicle(link) as vehicle:
        autopilot.send(ekf(16))
        await eventually(lambda: vehicle.status.position_ok)
        autopilot.reboot()
        # the count is raised in the vendor's thread, what it means for the vehicle comes after it on the loop
        await eventually(lambda: vehicle.status.boot_count == 1 and not vehicle.status.position_ok, 10)
        autopilot.send(ekf(16))
        await eventually(lambda: vehicle.status.position_ok, 10)
        assert vehicle.status.boot_count == 1


async def test_the_pilot_is_told(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    """Start, guard, resumption, abort and end of missions, as a ground station reads them."""
    record = MissionRecord(mission_id="m", shots=[Shot(index=i, row=0, pitch_deg=0.0, yaw_deg=0.0) for i in range(18)])
    happened: list[ev.Event] = [
        ev.MissionStarted(shots_total=18),
        ev.PreflightPassed(),
        ev.ShotStarted(shot=0, attempt=1, round=0, pitch_deg=0.0, yaw_deg=0.0, patience_s=1.0),
        ev.MissionPaused(code="position", reason="3.1 m from where the mission began", automatic=True),
        ev.MissionResumed(paused_s=4.0),
        ev.MissionPaused(code="command", reason="coffee"),
        ev.MissionFinished(reason="enough", accepted=0, missing=(0,), state=MissionState.ABORTED),
    ]

    def told() -> list[tuple[int, str]]:
        return [(m.severity, m.text) for m in autopilot.others if m.get_type() == "STATUSTEXT"]

    async with MavsdkVehicle(link) as vehicle:
        voice = PilotMessenger(vehicle=vehicle, record=record)
        speaking = asyncio.create_task(voice.run(), name="pilot messages")
        for event in happened:
            voice.publish(event)
        await autopilot.until(lambda: len(told()) == 6, 20)
        speaking.cancel()
        await asyncio.wait({speaking})
    assert told() == [
        (6, "Pano: 18 shots, preflight checks"),
        (5, "Pano: shooting, hold position"),
        (4, "Pano: paused: drifted, return to start position"),
        (5, "Pano: continues at 0/18"),
        (5, "Pano: paused: by command"),
        (4, "Pano: aborted at 0/18, gimbal released"),
    ]


async def test_an_ardupilot_is_turned_by_condition_yaw_in_guided(autopilot: ScriptedPeer, link: MavsdkLink) -> None:
    autopilot.answers[115] = lambda command: FAILED if command.param1 == 90.0 else ACCEPTED
    async with MavsdkVehicle(link) as vehicle:
        assert vehicle.turn_modes == ("OFFBOARD",)
        await vehicle.turn(-30.0, 45.0)
        command = autopilot.sent(115)[-1]
        assert (command.param1, command.param2, command.param3, command.param4) == (330.0, 45.0, 0.0, 0.0)
        with pytest.raises(DeviceError, match=r"turning the vehicle to 90\.0°: failed"):
            await vehicle.turn(90.0, 45.0)


async def test_a_px4_is_turned_by_a_reposition_to_where_it_holds() -> None:
    """The embedded vehicle with a PX4's habits: it flies nowhere, and looks elsewhere."""
    port = free_udp_port()
    config = SimConfig(port=port, autopilot="px4", speedup=5.0, airframe=AirframeConfig(wind_m_s=0.0, heading_deg=20.0))
    async with running_simulator(config), MavsdkLink(f"udpin://127.0.0.1:{port}", clock=SystemClock(5.0)) as link:
        await link.wait_autopilot(30)
        async with MavsdkVehicle(link) as vehicle:
            assert vehicle.turn_modes == ("HOLD",)
            await eventually(lambda: vehicle.status.mode == "HOLD" and math.isfinite(vehicle.status.latitude_deg), 30)
            before = vehicle.status
            await vehicle.turn(80.0, 45.0)
            await eventually(lambda: abs(vehicle.status.heading_deg - 80.0) < 3.0, 30)
            assert vehicle.status.mode == "HOLD"
            assert vehicle.status.latitude_deg == pytest.approx(before.latitude_deg, abs=2e-5)
