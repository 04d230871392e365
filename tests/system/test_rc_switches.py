"""Switches of the transmitter, on the living daemon: RC_CHANNELS_OVERRIDE sets the simulated autopilot's channels."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from pathlib import Path

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_ports
from panoexec.sim.process import running_simulator
from tests.system.daemon import ground_station, ready, serving
from tests.waiting import eventually
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto

SPEEDUP = 4.0
HIGH, LOW = 2000, 1000
RC = """[presets.around]
name = "All around"
elevation_deg = [-60, 30]
[rc]
start_channel = 8
abort_channel = 9
preset = "around"
"""


class Transmitter:
    """Sets channels of the simulated autopilot, on whose way to the daemon it is.

    Args:
        port: where the autopilot sends to.
        daemon_port: where the daemon listens.
    """

    def __init__(self, port: int, daemon_port: int) -> None:
        self._packer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._autopilot: tuple[str, int] | None = None
        self._near, self._far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._near.bind(("127.0.0.1", port))
        self._far.connect(("127.0.0.1", daemon_port))
        for one, pass_on in ((self._near, self._to_daemon), (self._far, self._to_autopilot)):
            one.setblocking(False)
            asyncio.get_running_loop().add_reader(one, pass_on)

    def _to_daemon(self) -> None:
        data, self._autopilot = self._near.recvfrom(65535)
        with contextlib.suppress(OSError):  # it does not listen yet
            self._far.send(data)

    def _to_autopilot(self) -> None:
        with contextlib.suppress(OSError):
            data = self._far.recv(65535)
            if self._autopilot is not None:
                self._near.sendto(data, self._autopilot)

    def set(self, channel: int, pulse_us: int) -> None:
        assert self._autopilot is not None
        channels = [0] * 18
        channels[channel - 1] = pulse_us
        message = mavlink.MAVLink_rc_channels_override_message(1, 1, *channels)
        self._near.sendto(message.pack(self._packer), self._autopilot)

    def close(self) -> None:
        for one in (self._near, self._far):
            asyncio.get_running_loop().remove_reader(one)
            one.close()


def moves(log: Path) -> int:
    """How many moved switches the daemon has obeyed."""
    return log.read_text(encoding="utf-8").count("switch of the transmitter")


async def moved_up(pilot: Transmitter, channel: int, log: Path) -> None:
    """Move a switch down for longer than half a second and up, as often as it takes.

    A daemon that gets no time for a second has heard nothing of the receiver for a second, and so obeys no switch that
    was moved meanwhile.
    """
    before, down_s = moves(log), 1.5
    async with asyncio.timeout(240):
        while True:
            pilot.set(channel, LOW)
            await asyncio.sleep(down_s)
            if moves(log) > before:
                return
            pilot.set(channel, HIGH)
            with contextlib.suppress(TimeoutError):
                await eventually(lambda: moves(log) > before, 6 * down_s)
                return
            down_s *= 2


async def test_they_start_and_abort_when_they_are_moved(tmp_path: Path) -> None:
    near, far = free_udp_ports(2)
    with running_broker(tmp_path) as broker, contextlib.closing(Transmitter(near, far)) as pilot:
        async with (
            running_simulator(SimConfig(port=near, speedup=SPEEDUP)),
            ground_station(broker) as ground,
            serving(tmp_path, broker, far, more=RC, speedup=SPEEDUP),
        ):
            await ready(ground)
            await moved_up(pilot, 8, tmp_path / "serve.log")
            await ground.until(lambda: "capturing" in ground.states)
            assert ground.state["name"] == "All around"
            await moved_up(pilot, 9, tmp_path / "serve.log")
            await ground.until(lambda: ground.state["state"] == "aborted")
            await asyncio.sleep(2.5)  # both stand high still
            assert ground.types().count("mission_started") == 1
            await moved_up(pilot, 8, tmp_path / "serve.log")
            await ground.until(lambda: ground.types().count("mission_started") == 2)
            assert moves(tmp_path / "serve.log") == 3
