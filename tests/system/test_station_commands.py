"""MAV_CMD_USER_1 of a MAVLink ground station: obeyed once, acknowledged once; strangers are not obeyed.

`PANOEXEC_COMMANDS=1000` sends so many, a fifth of them twice, and measures how soon they are acknowledged.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import socket
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.system.daemon import Ground, ground_station, ready, serving
from tests.waiting import eventually
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto

COMMANDS = int(os.environ.get("PANOEXEC_COMMANDS", "20"))
SPEEDUP = 4.0
USER_1 = 31010
PRESETS = '[presets.front]\nname = "In front"\nelevation_deg = [-60, 30]\n'
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = 0, 1, 2, 3, 4, 5
REQUEST_MESSAGE, ARM = 512, 400
START, PAUSE, RESUME, ABORT = 1, 2, 3, 4


@dataclass
class Station:
    """A MAVLink ground station that speaks to the daemon's port directly."""

    port: int
    system: int = 255
    acks: list[tuple[float, int]] = field(default_factory=list)
    other_acks: list[tuple[int, int]] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._out = mavlink.MAVLink(None, srcSystem=self.system, srcComponent=190)
        self._in = mavlink.MAVLink(None)
        self._in.robust_parsing = True

    def send(self, message: Any) -> bytes:
        frame = bytes(message.pack(self._out))
        self.forward(frame)
        return frame

    def forward(self, frame: bytes) -> None:
        """Send bytes, once more."""
        self._socket.sendto(frame, ("127.0.0.1", self.port))

    def command(self, *params: float, to: int = 191, confirmation: int = 0) -> bytes:
        seven = (*params, *(0.0,) * (7 - len(params)))
        return self.send(mavlink.MAVLink_command_long_message(1, to, USER_1, confirmation, *seven))

    def command_int(self, *params: float) -> bytes:
        four = (*params, *(0.0,) * (4 - len(params)))
        return self.send(mavlink.MAVLink_command_int_message(1, 191, 0, USER_1, 0, 0, *four, 0, 0, 0.0))

    def listen(self) -> None:
        """Called when something has arrived."""
        while True:
            try:
                data = self._socket.recv(65535)
            except BlockingIOError:
                return
            for message in self._in.parse_buffer(data) or ():
                kind = message.get_type()
                if kind == "COMMAND_ACK" and message.target_system == self.system and message.command == USER_1:
                    self.acks.append((time.monotonic(), message.result))
                elif (
                    kind == "COMMAND_ACK" and message.target_system == self.system and message.get_srcComponent() == 191
                ):
                    self.other_acks.append((message.command, message.result))
                elif kind == "STATUSTEXT" and message.get_srcComponent() == 191:
                    self.texts.append(message.text)

    async def beat(self) -> None:
        """Send heartbeats, until cancelled."""
        asyncio.get_running_loop().add_reader(self._socket, self.listen)
        try:
            while True:
                self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
                await asyncio.sleep(0.5)
        finally:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()

    @property
    def results(self) -> list[int]:
        return [result for _, result in self.acks]


async def known(station: Station) -> None:
    """Wait until the daemon hears a station: MAVSDK and the link look for new systems once a second.

    It says of what is no command for it that it does not support it, to everybody.
    """

    def asks(number: int) -> None:
        station.send(mavlink.MAVLink_command_long_message(1, 191, number, 0, 280, 0, 0, 0, 0, 0, 0))

    async with asyncio.timeout(120):
        while not station.other_acks:
            asks(REQUEST_MESSAGE)
            with contextlib.suppress(TimeoutError):
                await eventually(lambda: station.other_acks, 2.0)
        asks(ARM)  # the last answer that was asked for
        await eventually(lambda: (ARM, UNSUPPORTED) in station.other_acks, 60)
    station.other_acks.clear()


@asynccontextmanager
async def vehicle(folder: Path, *systems: int) -> AsyncIterator[tuple[Ground, list[Station]]]:
    """A daemon beside a simulated vehicle, and stations that it has heard."""
    port = free_udp_port()
    with running_broker(folder) as broker:
        async with (
            running_simulator(SimConfig(port=port, speedup=SPEEDUP)),
            ground_station(broker) as ground,
            serving(folder, broker, port, more=PRESETS, speedup=SPEEDUP),
        ):
            await ready(ground)
            stations = [Station(port, system) for system in systems]
            beats = [asyncio.create_task(station.beat()) for station in stations]
            try:
                await asyncio.gather(*(known(station) for station in stations))
                yield ground, stations
            finally:
                for beat in beats:
                    beat.cancel()
                await asyncio.gather(*beats, return_exceptions=True)


async def test_a_mission_is_started_paused_and_ended_from_a_ground_station(tmp_path: Path) -> None:
    async with vehicle(tmp_path, 255) as (ground, (station,)):
        start = station.command(START, 1)
        for _ in range(3):  # what a router forwards
            station.forward(start)
        await ground.until(lambda: station.results == [IN_PROGRESS, ACCEPTED])
        station.command(START, 1, confirmation=1)  # the acknowledgement was lost
        await ground.until(lambda: station.results == [IN_PROGRESS, ACCEPTED, ACCEPTED])
        await ground.until(lambda: ground.state["mission_id"] and "mission_started" in ground.types())
        station.command_int(PAUSE)
        await ground.until(lambda: ground.state["state"] == "paused")
        await ground.until(lambda: station.results[3:] == [ACCEPTED])
        station.command(START)  # a second mission
        await ground.until(lambda: len(station.results) >= 6)
        assert station.results[4:] == [IN_PROGRESS, REJECTED]
        await ground.until(lambda: any(text.startswith("Pano: start refused") for text in station.texts))
        station.command(RESUME)
        await ground.until(lambda: station.results[6:] == [IN_PROGRESS, ACCEPTED])
        station.command(ABORT)
        await ground.until(lambda: ground.state["state"] == "aborted")
        await ground.until(lambda: station.results[8:] == [ACCEPTED])
        assert ground.types().count("mission_started") == 1


async def test_strangers_other_components_and_wrong_parameters_start_nothing(tmp_path: Path) -> None:
    async with vehicle(tmp_path, 255, 250) as (ground, (station, stranger)):
        stranger.command(START, 1)
        await ground.until(lambda: stranger.results == [DENIED])
        station.command(START, 1, to=190)
        station.command(START, 1, to=0)
        station.command(START, 2)
        await ground.until(lambda: station.results == [DENIED])
        await ground.until(lambda: "Pano: start refused: there is no preset 2, 1 are" in station.texts)
        for number in (REQUEST_MESSAGE, REQUEST_MESSAGE, ARM):  # others' programs ask each component again and again
            station.send(mavlink.MAVLink_command_long_message(1, 191, number, 0, 280, 0, 0, 0, 0, 0, 0))
        await ground.until(lambda: len(station.other_acks) == 3)
        expected = [(ARM, UNSUPPORTED)] + [(REQUEST_MESSAGE, UNSUPPORTED)] * 2
        assert sorted(station.other_acks) == expected  # in any order
        station.command(9)
        await ground.until(lambda: station.results == [DENIED, DENIED])
        assert ground.types() == []
        assert ground.state["state"] == "idle"


async def test_many_commands_are_acknowledged_once_each(tmp_path: Path) -> None:
    """Pauses without a mission, which are refused: each is a request that is executed, whose answer is a result."""
    draw = random.Random(1)
    took_s = []
    async with vehicle(tmp_path, 255) as (ground, (station,)):
        for number in range(COMMANDS):
            before = len(station.acks)
            sent_s = time.monotonic()
            frame = station.command(PAUSE, 0, float(number))
            if draw.random() < 0.2:
                station.forward(frame)
            await ground.until(lambda: len(station.acks) > before)  # noqa: B023
            took_s.append(station.acks[before][0] - sent_s)
        await asyncio.sleep(1.0)
        assert len(station.acks) == COMMANDS
        assert set(station.results) == {DENIED}
        assert ground.types() == []
    took_s.sort()
    print(f"{COMMANDS} commands: median {took_s[len(took_s) // 2]:.3f} s, p99 {took_s[int(0.99 * len(took_s))]:.3f} s")
