"""A MAVLink program that talks to a vehicle: the embedded one in this process, in simulated time and without sockets,
or any other over UDP."""

from __future__ import annotations

import math
import socket
import time
from dataclasses import dataclass, field
from typing import Any, Protocol

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.physics.world import SimClock, TruthLog
from panoexec.sim.simulation import Simulation

SYSTEM, COMPONENT = 1, 195


@dataclass(slots=True)
class Heard:
    """One message and when it came, seconds of the peer's own clock."""

    time_s: float
    message: Any

    @property
    def name(self) -> str:
        return str(self.message.get_type())

    @property
    def component(self) -> int:
        return int(self.message.get_srcComponent())


class Peer(Protocol):
    """Sends and listens."""

    def send(self, message: Any, *, component: int = COMPONENT) -> None: ...

    def listen(self, seconds: float) -> list[Heard]: ...


def command(command_id: int, *params: float, to: int = 1, confirmation: int = 0) -> Any:
    """COMMAND_LONG to a component of system 1."""
    seven = (*params, *(0.0,) * (7 - len(params)))
    return mavlink.MAVLink_command_long_message(1, to, command_id, confirmation, *seven)


def command_int(command_id: int, *params: float, to: int = 1) -> Any:
    """COMMAND_INT to a component of system 1; the fifth and sixth parameters are integers."""
    seven = (*params, *(0.0,) * (7 - len(params)))
    return mavlink.MAVLink_command_int_message(
        1, to, 0, command_id, 0, 0, *seven[:4], int(seven[4]), int(seven[5]), seven[6]
    )


class UdpPeer:
    """Talks to whoever sends to a UDP port of this machine."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._vehicle: Any = None
        self._in = mavlink.MAVLink(None)
        self._in.robust_parsing = True

    def send(self, message: Any, *, component: int = COMPONENT) -> None:
        packer = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=component)
        self._socket.sendto(message.pack(packer), self._vehicle)

    def talk_to(self, vehicle: tuple[str, int]) -> None:
        """Where to send to, before anything was heard."""
        self._vehicle = vehicle

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def listen(self, seconds: float) -> list[Heard]:
        heard, end = [], time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                data, self._vehicle = self._socket.recvfrom(65535)
            except TimeoutError:
                break
            messages = self._in.parse_buffer(data) or ()
            heard += [Heard(time.monotonic(), m) for m in messages if m.get_type() != "BAD_DATA"]
        return heard


@dataclass(slots=True)
class _Wire:
    """The vehicle's link: packs and unpacks as a socket would."""

    heard: list[Heard] = field(default_factory=list)
    name: str = "ground"
    simulation: Simulation | None = None
    parser: Any = field(default_factory=lambda: mavlink.MAVLink(None))

    def send(self, frame: bytes, message: Any) -> None:
        assert self.simulation is not None
        # from bytes, as floats on the wire are not those of Python
        decoded = self.parser.decode(bytearray(frame))
        self.heard.append(Heard(self.simulation.timeline.now_s, decoded))


class EmbeddedPeer:
    """Talks to an embedded vehicle of its own; time passes only while it listens.

    Attributes:
        simulation: the vehicle, to look at the truth.
        exposures: what its camera wrote into the truth log.
    """

    def __init__(self, config: SimConfig | None = None) -> None:
        self._wire = _Wire()
        self.truth = _Memory()
        self.simulation = Simulation(
            config or SimConfig(), clock=SimClock(), link=self._wire, truth=self.truth, develop=None
        )
        self._wire.simulation = self.simulation
        self.simulation.start()
        self._now = 0.0

    def send(self, message: Any, *, component: int = COMPONENT) -> None:
        packer = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=component)
        frame = message.pack(packer)
        self.simulation.receiver(self._wire.parser.decode(bytearray(frame)), frame)

    def listen(self, seconds: float) -> list[Heard]:
        self._now += seconds
        self.simulation.advance(self._now, budget_s=math.inf)
        heard, self._wire.heard = self._wire.heard, []
        return heard


class _Memory(TruthLog):
    def __init__(self) -> None:
        super().__init__(None)
        self.events: list[dict[str, Any]] = []

    def write(self, event: str, t_s: float, fields: Any) -> None:
        self.events.append({"event": event, "sim_s": t_s, **fields})


def result_of(heard: list[Heard], command_id: int, component: int = 1) -> int | None:
    """The MAV_RESULT that a component answered a command with; None if it did not."""
    for item in heard:
        if item.name == "COMMAND_ACK" and item.component == component and item.message.command == command_id:
            return int(item.message.result)
    return None
