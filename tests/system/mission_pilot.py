"""A pilot at a ground station, on the autopilot's way to the daemon: uploads missions, flies, hears what is said."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from panoexec.sim.mavlink.dialect import mavlink
from tests.waiting import eventually
from tests.wire.mission_conversation import ARM, MODES, SET_MODE, TAKEOFF
from tests.wire.sim_peer import command

_AUTOPILOT = 1


@dataclass(slots=True)
class Said:
    """What the autopilot and panoexec have said so far.

    Attributes:
        custom_mode: of the autopilot's heartbeat.
        current: current items, each change.
        reached: reached items.
        texts: of panoexec, in order.
        autopilot_texts: of the autopilot.
        acks: MAV_RESULT by command.
        height_m: above home.
        armed: motors turn.
    """

    custom_mode: int = -1
    current: list[int] = field(default_factory=list)
    reached: list[int] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    autopilot_texts: list[str] = field(default_factory=list)
    acks: dict[int, int] = field(default_factory=dict)
    height_m: float = 0.0
    armed: bool = False


class Pilot:
    """Passes everything on between autopilot and daemon, and speaks as system 255.

    Args:
        port: where the autopilot sends to.
        daemon_port: where the daemon listens.
        kind: of the autopilot.
    """

    def __init__(self, port: int, daemon_port: int, kind: str = "ardupilot") -> None:
        self.said = Said()
        self.kind = kind
        self._out = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._in = mavlink.MAVLink(None)
        self._in.robust_parsing = True
        self._from_daemon = mavlink.MAVLink(None)
        self._from_daemon.robust_parsing = True
        self._autopilot: tuple[str, int] | None = None
        self._items: list[Any] = []
        self._uploaded: asyncio.Future[int] | None = None
        self._near, self._far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._near.bind(("127.0.0.1", port))
        self._far.connect(("127.0.0.1", daemon_port))
        for one, pass_on in ((self._near, self._to_daemon), (self._far, self._to_autopilot)):
            one.setblocking(False)
            asyncio.get_running_loop().add_reader(one, pass_on)

    def close(self) -> None:
        for one in (self._near, self._far):
            asyncio.get_running_loop().remove_reader(one)
            one.close()

    # --- what it does

    def send(self, message: Any) -> None:
        assert self._autopilot is not None
        self._near.sendto(message.pack(self._out), self._autopilot)

    async def until(self, condition: Callable[[], object], timeout_s: float = 120.0) -> None:
        await eventually(condition, timeout_s)

    async def upload(self, items: list[Any]) -> None:
        """Upload a mission; it must be accepted, at last: ArduPilot's SITL refuses items while it boots."""
        await self.until(lambda: self._autopilot is not None)
        self._items = items
        for _ in range(30):
            self._uploaded = asyncio.get_running_loop().create_future()
            self.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), 0))
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(5):
                    if await self._uploaded == 0:
                        return
            await asyncio.sleep(1.0)
        raise AssertionError("the mission was not accepted")

    async def mode(self, name: str) -> None:
        """Change the flight mode, and see it."""
        numbers = MODES[self.kind][name]
        custom = int(numbers[1]) if len(numbers) == 2 else int(numbers[1]) << 16 | int(numbers[2]) << 24
        self.send(command(SET_MODE, *numbers))
        await self.until(lambda: self.said.custom_mode == custom, 30)

    async def take_off(self, height_m: float) -> None:
        """Arm and climb: ArduCopter in GUIDED, PX4 in its mission."""
        await self.mode("guided" if self.kind == "ardupilot" else "auto")
        while not self.said.armed:
            self.send(command(ARM, 1))
            await asyncio.sleep(0.5)
        if self.kind == "ardupilot":
            self.send(command(TAKEOFF, 0, 0, 0, 0, 0, 0, height_m))
            await self.until(lambda: self.said.height_m > 0.95 * height_m)

    # --- what it hears

    def _to_daemon(self) -> None:
        data, self._autopilot = self._near.recvfrom(65535)
        with contextlib.suppress(OSError):  # it does not listen yet
            self._far.send(data)
        for message in self._in.parse_buffer(data) or ():
            self._take(message)

    def _to_autopilot(self) -> None:
        with contextlib.suppress(OSError):
            data = self._far.recv(65535)
            if self._autopilot is not None:
                self._near.sendto(data, self._autopilot)
            for message in self._from_daemon.parse_buffer(data) or ():
                if message.get_type() == "STATUSTEXT":
                    self.said.texts.append(message.text)

    def _take(self, message: Any) -> None:
        kind, said = message.get_type(), self.said
        if message.get_srcComponent() != _AUTOPILOT:
            return
        if kind == "HEARTBEAT":
            said.custom_mode, said.armed = message.custom_mode, bool(message.base_mode & 128)
        elif kind == "MISSION_CURRENT":
            if said.current[-1:] != [message.seq]:
                said.current.append(message.seq)
        elif kind == "MISSION_ITEM_REACHED":
            said.reached.append(message.seq)
        elif kind == "GLOBAL_POSITION_INT":
            said.height_m = message.relative_alt / 1000.0
        elif kind == "STATUSTEXT":
            said.autopilot_texts.append(message.text)
        elif kind == "COMMAND_ACK":
            said.acks[message.command] = message.result
        elif message.get_type().startswith("MISSION_") and getattr(message, "target_system", 0) == 255:
            if kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                self.send(self._items[message.seq])
            elif kind == "MISSION_ACK" and self._uploaded is not None and not self._uploaded.done():
                self._uploaded.set_result(message.type)
