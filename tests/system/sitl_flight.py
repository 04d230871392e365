"""A dry-run on an autopilot in software with another ground station beside it, for tests that disturb the flight."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import math
import socket
import struct
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from panoexec.cli import dry_run
from panoexec.dryrun.rigs import SitlVehicle
from panoexec.dryrun.run import DryRunOptions, DryRunSummary, run_dry_run
from panoexec.mission.executor import Mission
from panoexec.mission.guards import EARTH_RADIUS_M
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_ports
from tests.system.sitl_kinds import Autopilot
from tests.system.sitl_runs import WHOLE
from tests.waiting import eventually

SPEEDUP = 2
SOON_S = 60.0
_GRANTED_S = 180.0
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
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
        self.armed = False
        self.climbs: Callable[[], None] = lambda: None

    def send(self, message: Any) -> None:
        packer = mavlink.MAVLink(None, srcSystem=STATION[0], srcComponent=STATION[1])
        if self._vehicle is not None:
            self._socket.sendto(message.pack(packer), self._vehicle)

    def command(self, number: int, *params: float) -> None:
        self.send(self.packed(number, *params))

    def packed(self, number: int, *params: float) -> Any:
        """A command as a message."""
        seven = (*params, *(0.0,) * (7 - len(params)))
        return mavlink.MAVLink_command_long_message(1, 1, number, 0, *seven)

    def parameter(self, name: str, value: float, *, whole: bool = False) -> None:
        kind = mavlink.MAV_PARAM_TYPE_INT32 if whole else mavlink.MAV_PARAM_TYPE_REAL32
        if whole:  # PX4 has the bytes of the integer in the field
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))

    def reposition(self, at: ev.ShotExposed, *, north_m: float) -> None:
        """Send the vehicle so far north of where a photo was taken; it stays in GUIDED or Hold."""
        latitude_deg = at.latitude_deg + math.degrees(north_m / EARTH_RADIUS_M)
        where = (round(latitude_deg * 1e7), round(at.longitude_deg * 1e7), at.altitude_m)
        self.send(
            mavlink.MAVLink_command_int_message(
                1, 1, mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, math.nan, *where
            )
        )

    @contextlib.contextmanager
    def again_and_again(self, *messages: Any, interval_s: float) -> Iterator[None]:
        """Keep sending messages, as autopilots expect of sticks and of set points."""

        async def send() -> None:
            while True:
                for message in messages:
                    self.send(message)
                await asyncio.sleep(interval_s)

        task = asyncio.create_task(send(), name="again and again")
        try:
            yield
        finally:
            task.cancel()

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
        if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 1:
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            if armed and not self.armed:
                self.climbs()
            self.armed = armed
        elif message.get_type() == "STATUSTEXT":
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

    async def exposed(self) -> ev.ShotExposed:
        """The last photo that was exposed."""
        await self.until(lambda: self.of(ev.ShotExposed), "a photo")
        return self.of(ev.ShotExposed)[-1]  # type: ignore[no-any-return]

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

        async with asyncio.timeout(_GRANTED_S):
            while not granted():
                assert self.task is not None
                assert not self.task.done()
                assert len(self.events) < since + 100
                await asyncio.sleep(0.5)


@asynccontextmanager
async def flight(
    autopilot: Autopilot,
    output: Path,
    *arguments: str,
    guards: Mapping[str, Any] | None = None,
    max_pause_s: float | None = None,
    climbing: Callable[[Station], None] = lambda _: None,
) -> AsyncIterator[Flight]:
    """A mission that has begun, or ended already; it is cancelled at the end.

    Args:
        autopilot: flies it.
        output: folder for the mission.
        arguments: of `dry-run`.
        guards: changed settings of the guards.
        max_pause_s: as in the settings; None: that of a dry-run.
        climbing: what the station does when the vehicle takes off.
    """
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

    settings = plain.settings
    settings = replace(
        settings,
        guards=replace(settings.guards, **(guards or {})),
        max_pause_s=max_pause_s or settings.max_pause_s,
    )
    options = Options(**{f.name: getattr(plain, f.name) for f in fields(plain)} | {"settings": settings})
    under_way = Flight(station=Station(port))
    under_way.station.climbs = lambda: climbing(under_way.station)

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


def pauses(one: Flight, since: int) -> set[str]:
    """Codes of all reasons for which it has paused."""
    return {code for event in one.of(ev.MissionPaused, since) for code in event.code.split("+")}
