"""A pilot at a ground station, on the autopilot's way to the daemon: uploads missions, flies, hears what is said."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from panoexec.sim.mavlink.dialect import mavlink
from tests.waiting import eventually
from tests.wire.mission_conversation import ARM, MODES, SET_CURRENT, SET_MODE, TAKEOFF
from tests.wire.sim_peer import command

_AUTOPILOT = 1
_ARMING_TRIES, _ARM_AGAIN_S = 240, 0.5


@dataclass(slots=True)
class Said:
    """What the autopilot and panoexec have said so far.

    Attributes:
        custom_mode: of the autopilot's heartbeat.
        modes: its values, each change.
        current: current items, each change.
        reached: reached items.
        texts: of panoexec, in order; long ones joined.
        told: what panoexec told the autopilot about its mission: `current SEQ` and `mode MAIN SUB`.
        autopilot_texts: of the autopilot.
        acks: MAV_RESULT by command.
        height_m: above home.
        armed: motors turn.
        fix_type: of the GPS receiver, GPS_FIX_TYPE.
        beats_s: when each heartbeat of the daemon was passed on to the autopilot, time.monotonic.
        floats: NAMED_VALUE_FLOAT, the last value of each name.
    """

    custom_mode: int = -1
    modes: list[int] = field(default_factory=list)
    current: list[int] = field(default_factory=list)
    reached: list[int] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    autopilot_texts: list[str] = field(default_factory=list)
    acks: dict[int, int] = field(default_factory=dict)
    height_m: float = 0.0
    armed: bool = False
    fix_type: int = 0
    beats_s: list[float] = field(default_factory=list)
    floats: dict[str, float] = field(default_factory=dict)


class Pilot:
    """Passes everything on between autopilot and daemon, and speaks as system 255.

    Args:
        port: where the autopilot sends to.
        daemon_port: where the daemon listens.
        kind: of the autopilot.
        second_port: where another daemon listens; each hears the other, as through a router.
    """

    def __init__(self, port: int, daemon_port: int, kind: str = "ardupilot", second_port: int | None = None) -> None:
        self.said = Said()
        self.kind = kind
        self._out = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._in = mavlink.MAVLink(None)
        self._in.robust_parsing = True
        self._autopilot: tuple[str, int] | None = None
        self._items: list[Any] = []
        self._known: dict[int, socket.socket] = {}
        self._uploaded: asyncio.Future[int] | None = None
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", port))
        self._near.setblocking(False)
        asyncio.get_running_loop().add_reader(self._near, self._to_daemon)
        self._far = [self._daemon(one) for one in (daemon_port, second_port) if one is not None]

    def _daemon(self, port: int) -> socket.socket:
        far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        far.connect(("127.0.0.1", port))
        far.setblocking(False)
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        asyncio.get_running_loop().add_reader(far, self._to_autopilot, far, parser)
        return far

    def close(self) -> None:
        for one in (self._near, *self._far):
            asyncio.get_running_loop().remove_reader(one)
            one.close()

    # --- what it does

    def send(self, message: Any) -> None:
        assert self._autopilot is not None
        self._near.sendto(message.pack(self._out), self._autopilot)

    async def until(self, condition: Callable[[], object], timeout_s: float = 300.0) -> None:
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

    async def mode(self, name: str, *, timeout_s: float = 30.0) -> None:
        """Change the flight mode, and see it."""
        numbers = MODES[self.kind][name]
        custom = int(numbers[1]) if len(numbers) == 2 else int(numbers[1]) << 16 | int(numbers[2]) << 24
        self.send(command(SET_MODE, *numbers))
        await self.until(lambda: self.said.custom_mode == custom, timeout_s)

    async def mode_at_last(self, name: str) -> None:
        """Ask for a flight mode until the autopilot accepts it."""
        for _ in range(60):
            with contextlib.suppress(TimeoutError):
                await self.mode(name, timeout_s=1.0)
                return
        raise AssertionError(f"{name} was not accepted; {self.said.autopilot_texts[-3:]}")

    def jump_to(self, seq: int) -> None:
        """Make an item of the mission the current one, as ground stations do."""
        self.send(mavlink.MAVLink_mission_set_current_message(1, 1, seq))

    def parameter(self, name: str, value: float, *, whole: bool = False) -> None:
        """Set a parameter of the autopilot."""
        kind = mavlink.MAV_PARAM_TYPE_INT32 if whole else mavlink.MAV_PARAM_TYPE_REAL32
        if whole:  # PX4 has the bytes of the integer in the field
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))

    async def take_off(self, height_m: float) -> None:
        """Arm and climb: ArduCopter in GUIDED, PX4 in its mission."""
        await self.mode("guided" if self.kind == "ardupilot" else "auto")
        for _ in range(_ARMING_TRIES):
            if self.said.armed:
                break
            self.send(command(ARM, 1))
            await asyncio.sleep(_ARM_AGAIN_S)
        assert self.said.armed, f"the autopilot does not arm: {self.said.autopilot_texts[-3:]}"
        if self.kind == "ardupilot":
            self.send(command(TAKEOFF, 0, 0, 0, 0, 0, 0, height_m))
            await self.until(lambda: self.said.height_m > 0.95 * height_m)

    # --- what it hears

    def _to_daemon(self) -> None:
        data, self._autopilot = self._near.recvfrom(65535)
        for far in self._far:
            with contextlib.suppress(OSError):  # it does not listen yet
                far.send(data)
        for message in self._in.parse_buffer(data) or ():
            self._take(message)

    def _to_autopilot(self, far: socket.socket, parser: Any) -> None:
        with contextlib.suppress(OSError):
            data = far.recv(65535)
            if self._autopilot is not None:
                self._near.sendto(data, self._autopilot)
            for message in parser.parse_buffer(data) or ():
                self._take_daemons(message)
                self._route(message, far)

    def _route(self, message: Any, far: socket.socket) -> None:
        """To the other daemon: what is addressed to it, or to everybody."""
        self._known[message.get_srcComponent()] = far
        to = getattr(message, "target_component", 0)
        for other in self._far:
            if other is not far and (to == 0 or self._known.get(to) is other):
                other.send(message.get_msgbuf())

    def _take_daemons(self, message: Any) -> None:
        kind, said = message.get_type(), self.said
        if kind == "STATUSTEXT" and message.id and message.chunk_seq and said.texts:
            said.texts[-1] += message.text
        elif kind == "STATUSTEXT":
            said.texts.append(message.text)
        elif kind == "HEARTBEAT":
            said.beats_s.append(time.monotonic())
        elif kind == "MISSION_SET_CURRENT":
            said.told.append(f"current {message.seq}")
        elif kind == "COMMAND_LONG" and message.command == SET_CURRENT:
            said.told.append(f"current {message.param1:.0f}")
        elif kind == "COMMAND_LONG" and message.command == SET_MODE:
            said.told.append(f"mode {message.param2:.0f} {message.param3:.0f}")

    def _take(self, message: Any) -> None:
        kind, said = message.get_type(), self.said
        if message.get_srcComponent() != _AUTOPILOT:
            return
        if kind == "HEARTBEAT":
            said.custom_mode, said.armed = message.custom_mode, bool(message.base_mode & 128)
            if said.modes[-1:] != [message.custom_mode]:
                said.modes.append(message.custom_mode)
        elif kind == "MISSION_CURRENT":
            if said.current[-1:] != [message.seq]:
                said.current.append(message.seq)
        elif kind == "MISSION_ITEM_REACHED":
            said.reached.append(message.seq)
        elif kind == "GPS_RAW_INT":
            said.fix_type = message.fix_type
        elif kind == "GLOBAL_POSITION_INT":
            said.height_m = message.relative_alt / 1000.0
        elif kind == "STATUSTEXT":
            said.autopilot_texts.append(message.text)
        elif kind == "NAMED_VALUE_FLOAT":
            said.floats[message.name] = message.value
        elif kind == "COMMAND_ACK":
            said.acks[message.command] = message.result
        elif message.get_type().startswith("MISSION_") and getattr(message, "target_system", 0) == 255:
            if kind in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                self.send(self._items[message.seq])
            elif kind == "MISSION_ACK" and self._uploaded is not None and not self._uploaded.done():
                self._uploaded.set_result(message.type)
