"""What another station and the autopilot's own troubles do to a mission on ArduCopter's and PX4's own software.

Opt in: ARDUPILOT_SITL and PX4_SITL name the binaries. One flight each, in which one fault follows the other; what ends
a mission comes last. Rows of the fault table that a real autopilot can be made to produce (docs/mission.md).
"""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.sim.mavlink.dialect import mavlink
from tests.support.truth import untruths
from tests.system.sitl_flight import SET_MODE, SPEEDUP, STATION, Flight, flight, pauses
from tests.system.sitl_kinds import ARDUCOPTER, PX4, Autopilot, autopilots
from tests.system.sitl_runs import children_of

CONFIGURE, MOUNT_CONTROL = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, mavlink.MAV_CMD_DO_MOUNT_CONTROL
MOUNT = (MOUNT_CONTROL, 5.0, 0.0, 0.0, 0, 0, 0, mavlink.MAV_MOUNT_MODE_MAVLINK_TARGETING)
ROI = (mavlink.MAV_CMD_DO_SET_ROI_LOCATION, 0, 0, 0, 0, 47.4977, 8.5456, 600.0)
REBOOT = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
FORCED = 20190226


async def control_is_stolen(one: Flight) -> None:
    since = len(one.events)
    one.station.command(CONFIGURE, *STATION, -1, -1)
    assert (await one.paused("gimbal_control", since)).automatic
    await one.goes_on(since)


async def a_station_points_the_gimbal(one: Flight, *pointing_command: float) -> None:
    """Both obey DO_MOUNT_CONTROL and a region of interest of a station without control."""
    since, (number, *params) = len(one.events), pointing_command

    async def keep_pointing() -> None:
        while True:
            one.station.command(int(number), *params)
            await asyncio.sleep(0.8 / SPEEDUP)  # before a pose that is commanded again is settled

    pointing = asyncio.create_task(keep_pointing())
    try:
        paused = await one.paused("foreign", since)
        assert "another station points the gimbal" in paused.reason
        assert not paused.automatic
        assert sum(event.code == "foreign" for event in one.of(ev.ShotRejected, since)) >= 2
    finally:
        pointing.cancel()
        await asyncio.gather(pointing, return_exceptions=True)
        one.station.command(mavlink.MAV_CMD_DO_SET_ROI_NONE)
    await one.resumed()


async def the_gps_is_lost(one: Flight, autopilot: Autopilot) -> None:
    since = len(one.events)
    name, without, with_gps, whole = autopilot.gps
    one.station.parameter(name, without, whole=whole)
    try:
        assert (await one.paused("fix", since)).automatic
    finally:
        one.station.parameter(name, with_gps, whole=whole)
    await one.until(lambda: one.state is MissionState.CAPTURING or "pilot" in pauses(one, since), "GPS is back")
    if one.state is not MissionState.CAPTURING:  # the estimator's failsafe was faster
        one.station.command(SET_MODE, *autopilot.hold)
        await one.resumed()


def process_of(autopilot: Autopilot) -> int:
    """The autopilot below this process."""
    (pid,) = [
        pid
        for pid in children_of(os.getpid())
        if Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8").startswith(str(autopilot.binary()))
    ]
    return pid


async def the_autopilot_is_silent(one: Flight, autopilot: Autopilot) -> None:
    since = len(one.events)
    pid = process_of(autopilot)
    os.kill(pid, signal.SIGSTOP)
    try:
        paused = await one.paused("link", since)
    finally:
        os.kill(pid, signal.SIGCONT)
    assert paused.automatic
    await one.goes_on(since)


async def the_pilot_returns(one: Flight, autopilot: Autopilot) -> None:
    since, heard = len(one.events), len(one.station.texts)
    one.station.command(SET_MODE, *autopilot.rtl)
    paused = await one.paused("pilot", since)
    await one.released()
    one.station.command(SET_MODE, *autopilot.hold)
    assert not paused.automatic
    await one.resumed()
    said = [text for text in one.station.texts[heard:] if text.startswith("Pano: paused")]
    assert said[0] == "Pano: paused: pilot has control, gimbal released"
    assert not any("another station" in text for text in said)


async def the_battery_is_low(one: Flight, autopilot: Autopilot) -> None:
    since = len(one.events)
    if autopilot is ARDUCOPTER:
        one.station.parameter("BATT_CAPACITY", 200.0)
    else:
        one.station.parameter("SIM_BAT_MIN_PCT", 15.0)
        one.station.parameter("SIM_BAT_DRAIN", 1.0)
    assert not (await one.paused("battery", since)).automatic
    await one.released()
    if autopilot is ARDUCOPTER:  # another battery
        one.station.parameter("BATT_CAPACITY", 16000.0)
        await one.resumed()


async def it_is_rebooted(one: Flight) -> None:
    """Refused while armed; after a forced one it is disarmed and in STABILIZE, so the mission stays paused."""
    since, heard = len(one.events), len(one.station.acks)
    one.station.command(REBOOT, 1)
    await one.until(lambda: any(command == REBOOT for command, _ in one.station.acks[heard:]), "answer to a reboot")
    assert next(result for command, result in one.station.acks[heard:] if command == REBOOT) != 0
    await one.shots(1)
    one.station.command(REBOOT, 1, 0, 0, 0, 0, FORCED)
    await one.until(lambda: any(event.code == "reboot" for event in one.of(ev.Warned, since)), "the reboot is seen")
    await one.until(lambda: pauses(one, since) & {"pilot", "landed"}, "a pause that needs a resume")
    await one.released()
    await asyncio.sleep(5.0)
    assert one.state is MissionState.PAUSED, "it does not go on by itself"


@autopilots()
async def test_faults_of_a_flight_end_as_documented(autopilot: Autopilot, tmp_path: Path) -> None:
    async with flight(autopilot, tmp_path) as one:
        await one.shots(1)
        await control_is_stolen(one)
        await one.shots(1)
        await a_station_points_the_gimbal(one, *MOUNT)
        await one.shots(1)
        await a_station_points_the_gimbal(one, *ROI)
        await one.shots(1)
        await the_autopilot_is_silent(one, autopilot)
        await one.shots(1)
        await the_gps_is_lost(one, autopilot)
        await one.shots(1)
        await the_pilot_returns(one, autopilot)
        await one.shots(1)
        await the_battery_is_low(one, autopilot)
        if autopilot is not PX4:  # its SITL refuses, and a forced reboot ends the process
            await it_is_rebooted(one)
        assert one.mission is not None
        one.mission.commands.abort()
        assert one.task is not None
        summary = await asyncio.wait_for(one.task, 180)
        assert summary.state == "aborted"
        assert not any("No ap_message" in text for text in one.station.texts)
        ends = [text for text in one.station.texts if text.startswith("Pano: aborted")]
        assert len(ends) == 1, one.station.texts[-5:]
        assert summary.accepted >= 6
        assert untruths(summary.directory) == []


@autopilots()
async def test_faults_of_the_payload_behind_a_real_autopilot(autopilot: Autopilot, tmp_path: Path) -> None:
    faults = ("drift=0.2", "photo-lost=0.15", "photo-refused=0.1", "capture-lost=0.15", "capture-twice=0.2")
    arguments = [word for fault in faults for word in ("--fault", fault)]
    async with flight(autopilot, tmp_path, *arguments) as one:
        assert one.task is not None
        summary = await asyncio.wait_for(one.task, 600)
        assert summary.state == "complete"
        assert summary.rejected
        assert untruths(summary.directory) == []
