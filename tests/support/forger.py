"""A stranger on the MAVLink network: hears what panoexec sends, and answers and reports from ids of its own.

Everything that would prove a pose or a photo is told: attitudes exactly at the target, acknowledgements at once, photos
with the next index. The ids are those of other systems, or of other components of the vehicle's system; who sends as
the vehicle's own autopilot, gimbal or camera cannot be told from them without signing (docs/security.md).
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from panoexec.adapters.link.connection_url import parse_connection
from panoexec.dryrun.rigs import EmbeddedVehicle, Note, Rig
from panoexec.sim.mavlink.dialect import mavlink

OWN_SYSTEM = 1
STRANGER_COMPONENTS = (1, 2, 100, 101, 154, 155, 191, 195)
IMPOSTOR_COMPONENTS = (2, 25, 101, 105, 155, 171, 190, 192, 195)
"""Components of the vehicle's system that are neither its autopilot (1), camera (100), gimbal (154), nor panoexec."""

SECRET = b"file:///etc/hostname"
_TICK_S = 0.02
_BURST = 6


class Forger(asyncio.DatagramProtocol):
    """Sends forged messages to a UDP port that MAVSDK listens on.

    Attributes:
        sent: how many messages of each name.
        heard: commands that it heard, as MAVSDK sends to everybody on a UDP port.
    """

    def __init__(self, seed: int, *, impostors: bool = True, strangers: bool = True) -> None:
        self.random = random.Random(seed)
        self.sent: dict[str, int] = {}
        self.heard = 0
        self._sources = [(self.random.randint(2, 254), component) for component in STRANGER_COMPONENTS if strangers]
        self._sources += [(OWN_SYSTEM, component) for component in IMPOSTOR_COMPONENTS if impostors]
        self._packers = {source: mavlink.MAVLink(None, *source) for source in self._sources}
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._transport: asyncio.DatagramTransport | None = None
        self._target = (0.0, 0.0)
        self._index = 0
        self._began_s = time.monotonic()
        self._loud = False

    # --- life

    @asynccontextmanager
    async def speaking(self, port: int) -> AsyncIterator[None]:
        """Send to that port while the block runs."""
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(lambda: self, remote_addr=("127.0.0.1", port))
        self._transport = transport
        task = asyncio.create_task(self._run(), name="forger")
        try:
            yield
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            transport.close()

    def speak_up(self) -> None:
        """From now on tell everything; before, only heartbeats and attitudes of other systems."""
        self._loud = True

    async def _run(self) -> None:
        while True:
            for _ in range(_BURST):
                self._forge()
            await asyncio.sleep(_TICK_S)

    # --- what is heard

    def error_received(self, exc: Exception) -> None:
        """Nobody listens yet."""

    def datagram_received(self, data: bytes, addr: Any) -> None:
        for message in self._parser.parse_buffer(data) or ():
            kind = message.get_type()
            if kind in ("COMMAND_LONG", "COMMAND_INT"):
                self.heard += 1
                self._command(message)
            elif kind == "GIMBAL_MANAGER_SET_ATTITUDE":
                w, x, y, z = message.q
                yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
                pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
                self._target = (pitch, yaw)
            elif kind == "GIMBAL_MANAGER_SET_PITCHYAW":
                self._target = (message.pitch, message.yaw)

    def _command(self, command: Any) -> None:
        if command.command == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW:
            self._target = (math.radians(command.param1), math.radians(command.param2))
        if not self._loud:
            return
        for source in self._sources:
            result = self.random.choice((0, 0, 0, 1, 2, 4))
            self._send(mavlink.MAVLink_command_ack_message(command.command, result, 0, 0, 1, 191), source)
        if command.command == mavlink.MAV_CMD_IMAGE_START_CAPTURE:
            self._index += 1
            for source in self._sources:
                self._send(self._captured(), source)

    # --- what is told

    def _forge(self) -> None:
        source = self.random.choice(self._sources)
        if not self._loud and source[0] == OWN_SYSTEM:
            return
        makers = self._makers if self._loud else self._makers[:3]
        self._send(self.random.choice(makers)(), source)

    @property
    def _makers(self) -> tuple[Any, ...]:
        return (
            self._heartbeat,
            self._attitude_of_gimbal,
            self._attitude,
            self._attitude_of_gimbal,
            self._captured,
            self._feedback,
            self._capture_status,
            self._position,
            self._manager_status,
            self._manager_information,
            self._camera_information,
            self._camera_settings,
            self._storage,
            self._sys_status,
            self._landed,
            self._system_time,
        )

    def _send(self, message: Any, source: tuple[int, int]) -> None:
        if self._transport is not None:
            self._transport.sendto(message.pack(self._packers[source]))
            name = message.get_type()
            self.sent[name] = self.sent.get(name, 0) + 1

    def _boot_ms(self) -> int:
        honest = int((time.monotonic() - self._began_s) * 1000)
        return honest + self.random.choice((0, 0, 1_000, 3_600_000, 2_000_000_000))

    def _heartbeat(self) -> Any:
        kind, autopilot = self.random.choice(((2, 3), (2, 12), (30, 8), (26, 8), (6, 8), (18, 8)))
        return mavlink.MAVLink_heartbeat_message(kind, autopilot, 209, self.random.choice((0, 4, 9, 50593792)), 4, 3)

    def _at_target(self) -> list[float]:
        pitch, yaw = self._target
        cp, sp, cy, sy = math.cos(pitch / 2), math.sin(pitch / 2), math.cos(yaw / 2), math.sin(yaw / 2)
        return [cp * cy, -sp * sy, sp * cy, cp * sy]

    def _attitude_of_gimbal(self) -> Any:
        flags = self.random.choice((12 | 64, 12 | 32, 28))
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, self._boot_ms(), flags, self._at_target(), 0, 0, 0, 0, 0, 0, self.random.choice((0, 1))
        )

    def _attitude(self) -> Any:
        return mavlink.MAVLink_attitude_message(self._boot_ms(), 0, 0, self._target[1], 0, 0, 0)

    def _captured(self) -> Any:
        index = self._index + self.random.choice((-1, 0, 0, 1, 2))
        result = self.random.choice((1, 1, 1, 0))
        return mavlink.MAVLink_camera_image_captured_message(
            self._boot_ms(), int(time.time() * 1e6), 0, 0, 0, 0, 0, [1, 0, 0, 0], index, result, SECRET
        )

    def _feedback(self) -> Any:
        return mavlink.MAVLink_camera_feedback_message(
            int(time.time() * 1e6), 1, 0, self._index, 0, 0, 0, 0, 0, 0, 0, 0, 0, self._index
        )

    def _capture_status(self) -> Any:
        count = self._index + self.random.randint(0, 3)
        return mavlink.MAVLink_camera_capture_status_message(self._boot_ms(), 0, 0, 0, 0, 1000.0, count)

    def _position(self) -> Any:
        return mavlink.MAVLink_global_position_int_message(self._boot_ms(), 1, 1, 1, 1, 0, 0, 0, 100)

    def _manager_status(self) -> Any:
        return mavlink.MAVLink_gimbal_manager_status_message(self._boot_ms(), 12, 1, 255, 190, 0, 0)

    def _manager_information(self) -> Any:
        return mavlink.MAVLink_gimbal_manager_information_message(self._boot_ms(), 206847, 1, -1, 1, -0.1, 0.1, -1, 1)

    def _camera_information(self) -> Any:
        vendor, model = list(b"forged".ljust(32, b"\0")), list(b"forged".ljust(32, b"\0"))
        return mavlink.MAVLink_camera_information_message(
            self._boot_ms(), vendor, model, 1, 10.0, 10.0, 10.0, 640, 480, 0, 2, 0, b""
        )

    def _camera_settings(self) -> Any:
        return mavlink.MAVLink_camera_settings_message(self._boot_ms(), 1)

    def _storage(self) -> Any:
        return mavlink.MAVLink_storage_information_message(self._boot_ms(), 1, 1, 2, 1.0, 1.0, 0.0, 0, 0)

    def _sys_status(self) -> Any:
        return mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 1000, 0, 3, 0, 0, 0, 0, 0, 0)

    def _landed(self) -> Any:
        return mavlink.MAVLink_extended_sys_state_message(0, 1)

    def _system_time(self) -> Any:
        return mavlink.MAVLink_system_time_message(int(time.time() * 1e6) + 10**12, self._boot_ms())


class ForgedVehicle(EmbeddedVehicle):
    """The embedded vehicle with a forger on its network."""

    forger: Forger

    @contextlib.asynccontextmanager
    async def running(self, *, images: Path | None, note: Note) -> AsyncIterator[Rig]:
        async with (
            super().running(images=images, note=note) as rig,
            self.forger.speaking(parse_connection(rig.connection).port),
        ):
            yield rig


def forged(vehicle: EmbeddedVehicle, forger: Forger) -> ForgedVehicle:
    """That vehicle with that forger."""
    out = ForgedVehicle(simulation=vehicle.simulation)
    object.__setattr__(out, "forger", forger)
    return out
