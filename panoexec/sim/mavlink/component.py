"""Common behaviour of MAVLink components: heartbeat, acknowledgements, messages on request, message intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import Link, Message, Sender
from panoexec.sim.physics.world import Repeater, Timeline

Builder: TypeAlias = Callable[[], Message | None]
"""Builds a message with the current values; None if there is nothing to send."""

NAN = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """COMMAND_LONG or COMMAND_INT in a common form.

    Attributes:
        id: MAV_CMD.
        params: param1 to param7; of COMMAND_INT the fifth and sixth are x and y as sent (scaled integers for
            positions).
        confirmation: 0 for a first transmission; COMMAND_INT has none.
        sender: (system, component).
    """

    id: int
    params: tuple[float, float, float, float, float, float, float]
    confirmation: int
    sender: tuple[int, int]


def command_of(message: Message) -> Command | None:
    """The command in a message, None for other messages."""
    kind = message.get_type()
    if kind == "COMMAND_LONG":
        tail, confirmation = (message.param5, message.param6, message.param7), message.confirmation
    elif kind == "COMMAND_INT":
        tail, confirmation = (message.x, message.y, message.z), 0
    else:
        return None
    return Command(
        id=message.command,
        params=(message.param1, message.param2, message.param3, message.param4, *tail),
        confirmation=confirmation,
        sender=(message.get_srcSystem(), message.get_srcComponent()),
    )


def padded(text: str, size: int) -> list[int]:
    """A name as a fixed-size array of bytes, truncated or padded with zeros."""
    return list(text.encode()[:size].ljust(size, b"\0"))


class Streams:
    """The messages that a component streams on one link, each at its own interval; `clear` resets them."""

    def __init__(self, timeline: Timeline, builders: Mapping[int, Builder], send: Callable[[Message], None]) -> None:
        self._timeline = timeline
        self._builders = builders
        self._send = send
        self._repeaters: dict[int, Repeater] = {}

    def set_interval(self, message_id: int, interval_us: float) -> int:
        """MAV_CMD_SET_MESSAGE_INTERVAL: -1 and 0 stop (nothing is sent by default).

        Returns:
            MAV_RESULT: denied for messages that the component does not have.
        """
        if message_id not in self._builders or (interval_us < 0 and interval_us != -1):
            return int(mavlink.MAV_RESULT_DENIED)
        repeater = self._repeaters.get(message_id)
        if repeater is None:
            repeater = self._repeaters[message_id] = Repeater(self._timeline, lambda: self._emit(message_id))
        if interval_us <= 0:
            repeater.stop()
        else:
            repeater.start(max(interval_us, 1000) * 1e-6)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def interval_us(self, message_id: int) -> int:
        """The interval in microseconds, -1 if it is not streamed."""
        repeater = self._repeaters.get(message_id)
        return round(repeater.interval_s * 1e6) if repeater is not None and repeater.interval_s else -1

    def clear(self) -> None:
        """Stop all."""
        for repeater in self._repeaters.values():
            repeater.stop()

    def _emit(self, message_id: int) -> None:
        message = self._builders[message_id]()
        if message is not None:
            self._send(message)


class Component:
    """A component with one identity on one link.

    Attributes:
        builders: builders of its messages, by id.
        streams: the messages that it streams.
    """

    def __init__(self, *, timeline: Timeline, sender: Sender, link: Link, heartbeat: Builder) -> None:
        self.timeline = timeline
        self.sender = sender
        self.link = link
        self.builders: dict[int, Builder] = {}
        self.streams = Streams(timeline, self.builders, self.send)
        self._beat = Repeater(timeline, lambda: self.send(heartbeat()))

    def start(self, *, phase_s: float) -> None:
        """Send heartbeats at 1 Hz from `phase_s` on."""
        self._beat.start(1.0, first_after_s=phase_s)

    def stop(self) -> None:
        """Stop heartbeat and streams."""
        self._beat.stop()
        self.streams.clear()

    def send(self, message: Message) -> None:
        """Send one message."""
        self.link.send(self.sender.pack(message), message)

    def is_for_me(self, message: Message) -> bool:
        """Whether a message is addressed to this component or to all."""
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.sender.system_id) and component in (0, self.sender.component_id)

    def is_addressed(self, message: Message) -> bool:
        """Whether a message names this component as target; commands to all are handled by the autopilot."""
        return self.is_for_me(message) and getattr(message, "target_component", 0) == self.sender.component_id

    def acknowledge(self, command: Command, result: int) -> None:
        """Send COMMAND_ACK to the command's sender."""
        self.send(
            mavlink.MAVLink_command_ack_message(
                command.id, result, 0, 0, target_system=command.sender[0], target_component=command.sender[1]
            )
        )

    def common_command(self, command: Command, *, unknown_message: int) -> int | None:
        """Answer REQUEST_MESSAGE, SET_MESSAGE_INTERVAL and GET_MESSAGE_INTERVAL.

        Args:
            command: the command.
            unknown_message: MAV_RESULT for a request of a message that the component does not have.

        Returns:
            MAV_RESULT; None for another command, or if it was acknowledged here already.
        """
        if command.id == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self.streams.set_interval(int(command.params[0]), command.params[1])
        if command.id == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
            message_id = int(command.params[0])
            self.send(mavlink.MAVLink_message_interval_message(message_id, self.streams.interval_us(message_id)))
            return int(mavlink.MAV_RESULT_ACCEPTED)
        if command.id == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return self.request(int(command.params[0]), unknown_message)
        return None

    def is_request_to_all(self, message: Message) -> bool:
        """Whether a message asks every component for a message that this one has.

        PX4 looks for gimbals in this way (REQUEST_MESSAGE for 283 to 0/0). Whoever has nothing to send stays silent.
        """
        return (
            message.get_type() == "COMMAND_LONG"
            and message.command == mavlink.MAV_CMD_REQUEST_MESSAGE
            and self.is_for_me(message)
            and message.target_component == 0
            and int(message.param1) in self.builders
        )

    def request(self, message_id: int, unknown: int = mavlink.MAV_RESULT_UNSUPPORTED) -> int:
        """Send one message on request; the caller sends the acknowledgement afterwards."""
        build = self.builders.get(message_id)
        message = build() if build is not None else None
        if message is None:
            return unknown
        self.send(message)
        return int(mavlink.MAV_RESULT_ACCEPTED)


def bitmask(flags: Iterable[int]) -> int:
    """The bitwise union of distinct flags."""
    total = 0
    for flag in flags:
        total |= flag
    return total
