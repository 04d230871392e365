"""The external link of a simulation, which can also carry its time."""

from __future__ import annotations

from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import Message, Sender, TcpLink, UdpLink
from panoexec.sim.pacing import TIME_COMPONENT, TIME_NAME, time_fields
from panoexec.sim.physics.world import Timeline


class Outlet:
    """The external link; it may be replaced while the simulation runs.

    Attributes:
        link: the current link.
        timeline: whose time is sent before the messages of each moment; None sends no time.
    """

    name = "world"

    def __init__(self, link: UdpLink | TcpLink, system_id: int) -> None:
        self.link = link
        self.timeline: Timeline | None = None
        self._sender = Sender(system_id, TIME_COMPONENT)
        self._told_s = -1.0

    def send(self, frame: bytes, message: Message) -> None:
        """See `panoexec.sim.mavlink.wire.Link.send`."""
        self.tell_time()
        self.link.send(frame, message)

    def tell_time(self) -> None:
        """Send the simulated time once per moment, if enabled."""
        if self.timeline is None or self.timeline.now_s == self._told_s:
            return
        self._told_s = self.timeline.now_s
        boot_ms, value = time_fields(self._told_s)
        message = mavlink.MAVLink_named_value_int_message(boot_ms, TIME_NAME.encode(), value)
        self.link.send(self._sender.pack(message), message)
