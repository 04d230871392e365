"""What another station and the autopilot's own troubles do to a mission on ArduCopter's and PX4's own software.

Opt in: ARDUPILOT_SITL and PX4_SITL name the binaries. One flight each, in which one fault follows the other; what ends
a mission comes last. Rows of the fault table that a real autopilot can be made to produce (docs/mission.md).
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import signal
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from panoexec.cli import dry_run
from panoexec.dryrun.firmware import free_udp_ports
from panoexec.dryrun.rigs import SitlVehicle
from panoexec.dryrun.run import DryRunOptions, DryRunSummary, run_dry_run
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.sim.mavlink.dialect import mavlink
from tests.support.truth import untruths
from tests.system.sitl_kinds import ARDUCOPTER, PX4, Autopilot, autopilots
from tests.system.sitl_runs import WHOLE, children_of
from tests.waiting import eventually

SPEEDUP = 2
SOON_S = 60.0
CONFIGURE, MOUNT_CONTROL = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, mavlink.MAV_CMD_DO_MOUNT_CONTROL
MOUNT = (MOUNT_CONTROL, 5.0, 0.0, 0.0, 0, 0, 0, mavlink.MAV_MOUNT_MODE_MAVLINK_TARGETING)
ROI = (mavlink.MAV_CMD_DO_SET_ROI_LOCATION, 0, 0, 0, 0, 47.4977, 8.5456, 600.0)
SET_MODE, REBOOT = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
FORCED = 20190226
STATION = (255, 190)


class Station:
    """Another ground station, on a link of its own."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._vehicle: Any = None
        self._in = mavlink.MAVLink(None)
        self._in.robust_parsing = True
        self.texts: list[str] = []
        self.acks: list[tuple[int, int]] = []

    def send(self, message: Any) -> None:
        packer = mavlink.MAVLink(None, srcSystem=STATION[0], srcComponent=STATION[1])
        if self._vehicle is not None:
            self._socket.sendto(message.pack(packer), self._vehicle)

    def command(self, number: int, *params: float) -> None:
        seven = (*params, *(0.0,) * (7 - len(params)))
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *seven))

    def parameter(self, name: str, value: float, *, whole: bool = False) -> None:
        import struct  # noqa: PLC0415

        kind = mavlink.MAV_PARAM_TYPE_INT32 if whole else mavlink.MAV_PARAM_TYPE_REAL32
        if whole:  # PX4 has the bytes of the integer in the field
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))

    async def run(self) -> None:
        """Send heartbeats and listen, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            try:
                async with asyncio.timeout(1.0):
                    while True:
                        data, self._vehicle = await loop.sock_recvfrom(self._socket, 65535)
                        for message in self._in.parse_buffer(data) or ():
                            self._hear(message)
            except TimeoutError:
                pass
            self.send(
                mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
            )

    def _hear(self, message: Any) -> None:
        if message.get_type() == "STATUSTEXT":
            self.texts.append(message.text.rstrip("\0"))
        elif message.get_type() == "COMMAND_ACK":
            self.acks.append((message.command, message.result))

    def close(self) -> None:
        self._socket.close()


@dataclass(slots=True)
class Flight:
    """A mission under way, with all its events, and the station beside it."""

    station: Station
    events: list[ev.Event] = field(default_factory=list)
    mission: Mission | None = None
    task: asyncio.Task[DryRunSummary] | None = None

    @property
    def state(self) -> MissionState:
        assert self.mission is not None
        return self.mission.record.state

    def of(self, kind: type[ev.Event], since: int = 0) -> list[Any]:
        return [event for event in self.events[since:] if isinstance(event, kind)]

    async def until(self, condition: Callable[[], object], what: str, timeout_s: float = SOON_S) -> None:
        """Wait; the mission must not end before."""
        assert self.task is not None
        try:
            await eventually(lambda: condition() or self.task is None or self.task.done(), timeout_s)
        except TimeoutError:
            last = [type(event).__name__ for event in self.events[-5:]]
            raise AssertionError(f"{what}: not within {timeout_s:g} s; {self.state}; {last}") from None
        if self.task.done() and not condition():
            self.task.result()
            raise AssertionError(f"{what}: the mission has ended: {self.mission and self.mission.record.reason}")

    async def shots(self, more: int) -> None:
        """Wait until so many more shots are accepted."""
        assert self.mission is not None
        enough = self.mission.record.shots_done + more
        await self.until(
            lambda: self.mission is not None and self.mission.record.shots_done >= enough, "shots", timeout_s=240.0
        )

    async def paused(self, code: str, since: int) -> ev.MissionPaused:
        """Wait for a pause for that reason."""

        def found() -> list[ev.MissionPaused]:
            return [event for event in self.of(ev.MissionPaused, since) if code in event.code.split("+")]

        await self.until(found, f"a pause for {code!r}")
        return found()[0]

    async def released(self) -> None:
        """Wait until the gimbal is released, which takes an answer of the autopilot."""
        await self.until(lambda: self.mission and not self.mission.record.gimbal_held, "the gimbal is released", 10.0)

    async def goes_on(self, since: int) -> None:
        """Wait until the mission continues by itself."""
        await self.until(lambda: self.of(ev.MissionResumed, since), "goes on by itself")

    async def resumed(self) -> None:
        """The operator's `resume`, until it is granted."""
        assert self.mission is not None
        mission, since = self.mission, len(self.events)

        def granted() -> bool:
            if self.state is MissionState.PAUSED:
                with contextlib.suppress(CommandRefusedError):  # the cause lasts
                    mission.commands.resume()
            return self.state is MissionState.CAPTURING

        while not granted():
            assert self.task is not None
            assert not self.task.done()
            assert len(self.events) < since + 100
            await asyncio.sleep(0.5)


@asynccontextmanager
async def flight(autopilot: Autopilot, output: Path, *arguments: str) -> AsyncIterator[Flight]:
    parser = argparse.ArgumentParser()
    dry_run.add_arguments(parser)
    args = parser.parse_args(
        [
            *("--sitl", str(autopilot.binary()), "--speedup", str(SPEEDUP), "--wind", "4", "--image-width", "100"),
            *("--method", "paper"),
            *(*WHOLE, *arguments, "--output", str(output)),
        ]
    )
    plain = dry_run._options(args)
    (port,) = free_udp_ports(1)

    class Options(DryRunOptions):
        @property
        def vehicle(self) -> SitlVehicle:
            return SitlVehicle(binary=autopilot.binary(), simulation=self.simulation, station_port=port)

    options = Options(**{f.name: getattr(plain, f.name) for f in fields(plain)})
    under_way = Flight(station=Station(port))

    def begins(mission: Mission) -> None:
        under_way.mission = mission

    station = asyncio.create_task(under_way.station.run(), name="station")
    under_way.task = asyncio.create_task(
        run_dry_run(options, on_event=under_way.events.append, on_mission=begins), name="dry-run"
    )
    try:
        await eventually(lambda: under_way.mission is not None or under_way.task is None or under_way.task.done(), 180)
        yield under_way
    finally:
        for task in (under_way.task, station):
            task.cancel()
        await asyncio.gather(under_way.task, station, return_exceptions=True)
        under_way.station.close()


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
            await asyncio.sleep(0.8)

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


def pauses(one: Flight, since: int) -> set[str]:
    return {code for event in one.of(ev.MissionPaused, since) for code in event.code.split("+")}


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
