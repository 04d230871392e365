"""The rows of the fault table (docs/mission.md) that `test_sitl_faults.py` leaves, on ArduCopter's and PX4's software.

Opt in: ARDUPILOT_SITL and PX4_SITL name the binaries.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from panoexec.mission.log import events as ev
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.sim.mavlink.dialect import mavlink
from tests.support.truth import untruths
from tests.system.sitl_flight import SET_MODE, STATION, Flight, Station, flight, pauses
from tests.system.sitl_kinds import ARDUCOPTER, Autopilot, autopilots
from tests.system.sitl_runs import TWO_AXES

CONFIGURE, ARM = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM
LOITER, OFFBOARD, TAKEOFF = (1, 5, 0), (1, 6, 0), (1, 4, 2)
HEIGHT_M = 30.0
GROUND_S = 150.0
"""To land from there, or to climb."""
PARALLAX_PX = 600.0
"""Reached by 2 m at that height."""


async def the_gimbal_is_nobodys(one: Flight) -> None:
    """A manager that was restarted; it is acquired again even where it is never reclaimed from another station."""
    since = len(one.events)
    one.station.command(CONFIGURE, 0, 0, 0, 0)
    assert (await one.paused("gimbal_lost", since)).automatic
    await one.goes_on(since)


async def control_is_stolen_and_given_back(one: Flight) -> None:
    """With `reclaim = "never"` a `resume` is refused while another station has the gimbal."""
    since = len(one.events)
    one.station.command(CONFIGURE, *STATION, -1, -1)
    assert not (await one.paused("gimbal_control", since)).automatic
    assert one.mission is not None
    with pytest.raises(CommandRefusedError):
        one.mission.commands.resume()
    await asyncio.sleep(3.0)
    assert not one.of(ev.MissionResumed, since)
    one.station.command(CONFIGURE, 0, 0, 0, 0)
    await one.resumed()


async def it_is_moved_away(one: Flight, autopilot: Autopilot) -> None:
    since, at = len(one.events), await one.exposed()
    one.station.reposition(at, north_m=10.0)
    assert (await one.paused("position", since)).automatic
    assert "parallax" in pauses(one, since)
    if autopilot is ARDUCOPTER:  # PX4 tells the last charge for ever
        await the_charge_is_told_no_more(one)
    accepted = one.of(ev.ShotAccepted, since)
    one.station.reposition(at, north_m=0.0)
    await one.goes_on(since)
    assert one.of(ev.ShotAccepted, since)[len(accepted) :] == [], "no photo is taken out there"


async def the_charge_is_told_no_more(one: Flight) -> None:
    """A battery of unknown capacity: the mission warns, and does not pause for it."""
    since = len(one.events)
    one.station.parameter("BATT_CAPACITY", 0.0)
    await one.until(lambda: any(event.code == "battery_unknown" for event in one.of(ev.Warned, since)), "a warning")
    assert "battery" not in pauses(one, since)
    one.station.parameter("BATT_CAPACITY", 16000.0)


async def it_lands_and_takes_off(one: Flight, autopilot: Autopilot) -> None:
    since = len(one.events)
    one.station.command(SET_MODE, *autopilot.land)
    assert not (await one.paused("pilot", since)).automatic
    await one.released()
    assert one.mission is not None
    mission = one.mission
    await one.until(lambda: "landed" in pauses(one, since), "it is on the ground", GROUND_S)
    await one.until(lambda: not one.station.armed, "it is disarmed", GROUND_S)
    one.station.command(SET_MODE, *autopilot.hold)
    await asyncio.sleep(2.0)
    with pytest.raises(CommandRefusedError, match="air"):
        mission.commands.resume()
    while not one.station.armed:
        one.station.command(ARM, 1)
        await asyncio.sleep(1.0)
    if autopilot is ARDUCOPTER:
        one.station.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, HEIGHT_M)
    else:
        one.station.command(SET_MODE, *TAKEOFF)
    await asyncio.sleep(GROUND_S / 10)
    await one.until(lambda: height_m(one) > 0.95 * HEIGHT_M, "it is up again", GROUND_S)
    one.station.command(SET_MODE, *autopilot.hold)
    await asyncio.sleep(3.0)
    await one.resumed()


def height_m(one: Flight) -> float:
    assert one.mission is not None
    return one.mission._context.vehicle.status.relative_altitude_m


@autopilots()
async def test_rows_of_the_autopilot(autopilot: Autopilot, tmp_path: Path) -> None:
    guards = {"reclaim": "never", "hover_s": 20.0, "parallax_px": PARALLAX_PX}
    async with flight(autopilot, tmp_path, guards=guards, max_pause_s=600.0) as one:
        await one.shots(1)
        assert [event for event in one.of(ev.Warned) if event.code == "battery_estimate"], (
            "even a full one is too small"
        )
        await the_gimbal_is_nobodys(one)
        await one.shots(1)
        await control_is_stolen_and_given_back(one)
        await one.shots(1)
        await it_is_moved_away(one, autopilot)
        await one.shots(1)
        await it_lands_and_takes_off(one, autopilot)
        assert one.task is not None
        summary = await asyncio.wait_for(one.task, 300)
        assert summary.state == "complete"
        assert untruths(summary.directory) == []


@autopilots()
async def test_a_mode_in_which_it_cannot_turn_and_a_pause_that_lasts(autopilot: Autopilot, tmp_path: Path) -> None:
    async with flight(autopilot, tmp_path, *TWO_AXES, max_pause_s=40.0) as one:
        await one.shots(1)
        since = len(one.events)
        if autopilot is ARDUCOPTER:  # sticks in the middle
            sticks, mode = (
                mavlink.MAVLink_rc_channels_override_message(1, 1, 1500, 1500, 1500, 1500, 0, 0, 0, 0),
                LOITER,
            )
        else:
            mode = OFFBOARD
            stay = 0b0000_0101_1100_0111  # velocity and yaw rate 0
            sticks = mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, stay, *[0.0] * 11)
        with one.station.again_and_again(sticks, interval_s=0.1):
            await asyncio.sleep(1.0)
            # a turn that is commanded before the mode is told takes PX4 back to Hold
            with one.station.again_and_again(one.station.packed(SET_MODE, *mode), interval_s=0.4):
                assert (await one.paused("turning", since)).automatic
            assert "pilot" not in pauses(one, since)
            await asyncio.sleep(1.0)
            one.station.command(SET_MODE, *autopilot.hold)
            await one.goes_on(since)
        await one.shots(1)
        since = len(one.events)
        one.station.command(SET_MODE, *autopilot.rtl)
        await one.paused("pilot", since)
        assert one.task is not None
        summary = await asyncio.wait_for(one.task, 180)
        assert (summary.state, summary.vehicle["landed"]) == ("failed", True)
        assert "paused" in summary.reason
        assert untruths(summary.directory) == []


def _empty_battery(autopilot: Autopilot, station: Station) -> None:
    if autopilot is ARDUCOPTER:
        station.parameter("BATT_CAPACITY", 40.0)
    else:
        station.parameter("SIM_BAT_MIN_PCT", 15.0)
        station.parameter("SIM_BAT_DRAIN", 1.0)


@autopilots()
async def test_nothing_moves_with_a_battery_that_is_too_low(autopilot: Autopilot, tmp_path: Path) -> None:
    async with flight(autopilot, tmp_path, climbing=lambda station: _empty_battery(autopilot, station)) as one:
        assert one.task is not None
        summary = await asyncio.wait_for(one.task, 240)
        assert (summary.state, summary.accepted) == ("failed", 0)
        assert "battery" in summary.reason
        assert not one.of(ev.ShotStarted)
        assert summary.vehicle["landed"] is True


@autopilots()
async def test_rows_of_gimbal_and_camera_behind_a_real_autopilot(autopilot: Autopilot, tmp_path: Path) -> None:
    """Seconds after the first photo command: one after the other."""
    faults = (
        *("storage-full=3+6", "gimbal-stuck=14+12", "gimbal-slow=32+10", "attitude-nan=45+3", "attitude-frozen=51+3"),
        *("attitude-stop=57+4", "attitude-late=66+5", "drift=#2", "photo-lost=#6,#11", "photo-refused=#8,#14"),
    )
    arguments = [word for fault in faults for word in ("--fault", fault)]
    async with flight(autopilot, tmp_path, *arguments, "--overlap", "0.3") as one:
        assert one.task is not None
        summary = await asyncio.wait_for(one.task, 600)
        assert summary.state == "complete"
        assert {"storage", "attitude"} <= pauses(one, 0)
        assert {"not_settled", "pointing", "trigger"} <= {event.code for event in one.of(ev.ShotRejected)}
        assert all(event.automatic for event in one.of(ev.MissionPaused))
        assert untruths(summary.directory) == []
