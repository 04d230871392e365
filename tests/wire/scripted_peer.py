"""A scripted MAVLink peer: says and answers exactly what a test wants, at moments that the test chooses.

The simulated vehicle (`panoexec.sim`) behaves as a vehicle does; this one also lies, stammers and forgets.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator, Callable
from typing import Any, TypeAlias, TypeVar

from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_port

Answer: TypeAlias = Callable[[Any], int | None]
"""From a command to its MAV_RESULT; None is no answer at all."""

ACCEPTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = 0, 2, 3, 4, 5
NAN = math.nan
_TICK_S = 0.01


class ScriptedPeer(asyncio.Protocol, asyncio.DatagramProtocol):
    """An autopilot (component 1) and whatever else `send` is told to speak for.

    Attributes:
        port: where it sends to, if it speaks UDP.
        streams: message number to interval, seconds, as commanded.
        builders: message number to what makes it, for streams and single requests.
        answers: command to its answer; unknown ones are not supported.
        commands: every COMMAND_LONG that came.
        arrivals: when each of them came, `time.monotonic`.
        others: every other message that came, but heartbeats.
        heard: system and component of every heartbeat that came.
        parameters: by name.
        beating: whether heartbeats are sent.
    """

    def __init__(self, *, system: int = 1, heartbeat_s: float = 0.03) -> None:
        self.port = 0
        self.system = system
        self.heartbeat_s = heartbeat_s
        self.streams: dict[int, float] = {}
        self.builders: dict[int, Callable[[], Any]] = {30: self.airframe, 33: self.position}
        self.answers: dict[int, Answer] = {511: self._set_interval, 512: self._request}
        self.commands: list[Any] = []
        self.arrivals: list[float] = []
        self.others: list[Any] = []
        self.heard: list[tuple[int, int]] = []
        self.parameters: dict[str, float] = {}
        self.beating = True
        self.armed = False
        self.custom_mode = 4
        self.euler = (0.0, 0.0, 0.0)
        self.boot_at = time.monotonic()
        self.came = asyncio.Event()
        self._due: dict[int, float] = {}
        self._beat_at = 0.0
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._packers: dict[int, Any] = {}
        self._write: Callable[[bytes], None] = lambda _: None
        self._timer: asyncio.TimerHandle | None = None
        self._transport: asyncio.BaseTransport | None = None

    # --- life

    async def send_to(self, port: int) -> None:
        """Speak to a UDP port of this machine."""
        self.port = port
        await asyncio.get_running_loop().create_datagram_endpoint(lambda: self, remote_addr=("127.0.0.1", port))

    @property
    def url(self) -> str:
        """Where a link must listen."""
        return f"udpin://127.0.0.1:{self.port}"

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        self._write = transport.sendto if hasattr(transport, "sendto") else transport.write
        self._tick()

    def use(self, write: Callable[[bytes], None]) -> None:
        """Speak through something else, whose bytes go to `data_received`."""
        self._write = write
        self._tick()

    def connection_lost(self, exc: Exception | None) -> None:
        self.close()

    def error_received(self, exc: Exception) -> None:
        """Nobody listens yet."""

    async def aclose(self) -> None:
        self.close()
        await asyncio.sleep(0)  # the transport closes in the next round of the loop

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._write = lambda _: None
        if self._transport is not None:
            self._transport.close()

    def reboot(self) -> None:
        """Forget all intervals and start to count anew, as an autopilot does."""
        self.streams.clear()
        self._due.clear()
        self.boot_at = time.monotonic()

    # --- speaking

    def boot_ms(self) -> int:
        return int((time.monotonic() - self.boot_at) * 1000)

    def send(self, message: Any, component: int = 1) -> None:
        packer = self._packers.setdefault(component, mavlink.MAVLink(None, self.system, component))
        self._write(message.pack(packer))

    def beat(self, component: int, kind: int) -> None:
        self.send(mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3), component)

    def acknowledge(self, command: Any, result: int, component: int = 1) -> None:
        self.send(
            mavlink.MAVLink_command_ack_message(
                command.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
            ),
            component,
        )

    def airframe(self) -> Any:
        return mavlink.MAVLink_attitude_message(self.boot_ms(), *self.euler, 0, 0, 0)

    def position(self) -> Any:
        return mavlink.MAVLink_global_position_int_message(
            self.boot_ms(), 473977420, 85455940, 488000, 30000, 0, 0, 0, 9000
        )

    def _tick(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(_TICK_S, self._tick)
        now = time.monotonic()
        if self.beating and now - self._beat_at >= self.heartbeat_s:
            self._beat_at = now
            base = 128 if self.armed else 0
            self.send(mavlink.MAVLink_heartbeat_message(2, 3, 81 + base, self.custom_mode, 4, 3))
        for number, interval_s in self.streams.items():
            due = self._due.setdefault(number, now)
            if now >= due:
                self._due[number] = max(due + interval_s, now)
                self.send(self.builders[number]())

    # --- listening

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.data_received(data)

    def data_received(self, data: bytes) -> None:
        arrived = time.monotonic()
        for message in self._parser.parse_buffer(data) or []:
            kind = message.get_type()
            if kind == "HEARTBEAT":
                self.heard.append((message.get_srcSystem(), message.get_srcComponent()))
            elif kind == "COMMAND_LONG":
                self.commands.append(message)
                self.arrivals.append(arrived)
                result = self.answers.get(message.command, lambda _: UNSUPPORTED)(message)
                if result is not None:
                    self.acknowledge(message, result, message.target_component or 1)
            elif kind == "PARAM_REQUEST_READ":
                self._parameter(message)
            elif kind != "BAD_DATA":
                self.others.append(message)
        self.came.set()

    async def until(self, condition: Callable[[], object], timeout_s: float = 30.0) -> None:
        """Return when a condition on what came is true."""
        async with asyncio.timeout(timeout_s):
            while not condition():
                self.came.clear()
                await self.came.wait()

    def sent(self, command: int) -> list[Any]:
        """The commands of one kind that came."""
        return [message for message in self.commands if message.command == command]

    def _set_interval(self, command: Any) -> int:
        number = int(command.param1)
        if number not in self.builders:
            return FAILED
        self.streams[number] = command.param2 / 1e6
        self._due.pop(number, None)
        return ACCEPTED

    def _request(self, command: Any) -> int | None:
        builder = self.builders.get(int(command.param1))
        if builder is None:
            return FAILED
        component = command.target_component
        asyncio.get_running_loop().call_soon(lambda: self.send(builder(), component))
        return ACCEPTED

    def _parameter(self, request: Any) -> None:
        name = request.param_id
        if name in self.parameters:
            self.send(
                mavlink.MAVLink_param_value_message(
                    name.encode(), self.parameters[name], mavlink.MAV_PARAM_TYPE_INT8, 1, 0
                )
            )


class GimbalPeer(ScriptedPeer):
    """An ArduPilot that drives a gimbal itself: manager 1, device 1, no GIMBAL_DEVICE_INFORMATION.

    Attributes:
        control: system and component in primary control.
        q: attitude, [w, x, y, z].
        flags: GIMBAL_DEVICE_FLAGS.
        failures: GIMBAL_DEVICE_ERROR_FLAGS.
        rates: angular velocity, radians a second.
        limits: roll, pitch, yaw ranges, radians.
    """

    def __init__(self, *, system: int = 1, heartbeat_s: float = 0.03) -> None:
        super().__init__(system=system, heartbeat_s=heartbeat_s)
        self.control = (0, 0)
        self.q = [1.0, 0.0, 0.0, 0.0]
        self.flags = 44
        self.failures = 0
        self.rates = (0.0, 0.0, 0.0)
        self.limits = (-0.5, 0.5, -math.pi / 2, 0.5, -math.pi, math.pi)
        self.builders |= {280: self.manager, 281: self.manager_status, 285: self.attitude}
        self.answers |= {1000: lambda _: ACCEPTED, 1001: self._configure}
        self.parameters["MNT1_TYPE"] = 6

    def manager(self) -> Any:
        return mavlink.MAVLink_gimbal_manager_information_message(self.boot_ms(), 206847, 1, *self.limits)

    def manager_status(self) -> Any:
        return mavlink.MAVLink_gimbal_manager_status_message(self.boot_ms(), 12, 1, *self.control, 0, 0)

    def attitude(self, boot_ms: int | None = None, device: int = 1) -> Any:
        boot = self.boot_ms() if boot_ms is None else boot_ms
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            0, 0, boot, self.flags, self.q, *self.rates, self.failures, NAN, NAN, device
        )

    def _configure(self, command: Any) -> int:
        self.control = (0, 0) if command.param1 == -3 else (int(command.param1), int(command.param2))
        return ACCEPTED


P = TypeVar("P", bound=ScriptedPeer)


@contextlib.asynccontextmanager
async def listening(one: P, port: int = 0) -> AsyncIterator[P]:
    """A peer that speaks to a UDP port (a free one, unless told) for the time of the context."""
    await one.send_to(port or free_udp_port())
    try:
        yield one
    finally:
        await one.aclose()
