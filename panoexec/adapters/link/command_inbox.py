"""Commands that ground stations address to panoexec's own MAVLink component: MAV_CMD_USER_1 (31010).

MAVSDK passes COMMAND_LONG (76) and COMMAND_INT (75) on and does not answer this command itself (measured with 4.1), so
the acknowledgements (COMMAND_ACK, 77) are sent here: IN_PROGRESS at once where the work takes longer, then one result.

Other commands that are addressed to it are answered with UNSUPPORTED. MAVSDK answers none of them, and the MAVSDK of
another program on the vehicle, which asks each component for messages (512) again and again, waits for its answer
before it sends its next command (measured: the photos of two panoexec with different ids were 2.6 s late, or failed).

MAVLink delivers a command more than once: a sender that misses the acknowledgement repeats it with a higher
`confirmation`, and routers forward copies. A copy is never carried out again. A repetition gets the acknowledgement
again; a copy with the same `confirmation` does not. Where the first copy of a command was lost, its repetition is the
first that arrives. A stop is therefore carried out again if its sender has commanded something else since.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Collection
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, TypeAlias

import structlog

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.errors import DeviceError

USER_1: Final = 31010
COPY_S: Final = 0.5
"""Copies of a command that took other ways arrive within this time."""
REPEAT_S: Final = 5.0
"""Repetitions with a higher `confirmation` arrive within this time of the result."""
_REMEMBERED: Final = 64
_NAMES: Final = ("COMMAND_LONG", "COMMAND_INT")
_PARAMS: Final = {
    "COMMAND_LONG": tuple(f"param{number}" for number in range(1, 8)),
    "COMMAND_INT": ("param1", "param2", "param3", "param4", "x", "y", "z"),
}

_log = structlog.get_logger(__name__)


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class StationCommand:
    """A command of a ground station.

    Attributes:
        sender: MAVLink system and component id.
        params: the seven parameters; NaN where none was given.
        confirmation: 0, or the number of the repetition.
    """

    sender: tuple[int, int]
    params: tuple[float, ...]
    confirmation: int = 0


Execute: TypeAlias = Callable[[StationCommand], tuple[bool, Awaitable[Result]]]
"""Begins a command; whether it takes long, and its result."""


@dataclass(slots=True)
class _Known:
    """A command that was taken.

    Attributes:
        heard_s: when its last copy arrived.
        confirmation: the highest so far.
        result: IN_PROGRESS until there is one.
        done_s: when there was one.
    """

    heard_s: float
    confirmation: int
    result: Result = Result.IN_PROGRESS
    done_s: float = field(default=float("inf"))


class Repetitions:
    """Tells new commands from copies and repetitions of known ones.

    Args:
        stops: whether a command stops a mission.
    """

    def __init__(self, stops: Callable[[StationCommand], bool] = lambda _: False) -> None:
        self._stops = stops
        self._known: OrderedDict[tuple[object, ...], _Known] = OrderedDict()

    def take(self, command: StationCommand, now_s: float) -> tuple[bool, Result | None]:
        """Whether to carry it out, and what to acknowledge at once otherwise; (False, None) for a copy.

        Args:
            command: as received.
            now_s: time.monotonic.
        """
        key = _key(command)
        known = self._known.get(key)
        if known is not None and (known.result is Result.IN_PROGRESS or now_s - known.done_s <= REPEAT_S):
            if command.confirmation > known.confirmation and not self._is_another_stop(command, known):
                known.confirmation, known.heard_s = command.confirmation, now_s
                return False, known.result
            if known.result is Result.IN_PROGRESS or (
                now_s - known.heard_s <= COPY_S and command.confirmation <= known.confirmation
            ):
                return False, None
        self._known.pop(key, None)
        self._known[key] = _Known(heard_s=now_s, confirmation=command.confirmation)
        while len(self._known) > _REMEMBERED:
            self._known.popitem(last=False)
        return True, None

    def _is_another_stop(self, command: StationCommand, known: _Known) -> bool:
        """Whether a stop was carried out, and its sender has commanded something else since."""
        if known.result is Result.IN_PROGRESS or not self._stops(command):
            return False
        newest = next(one for key, one in reversed(self._known.items()) if key[0] == command.sender)
        return newest is not known

    def done(self, command: StationCommand, result: Result, now_s: float) -> None:
        """It was carried out, or refused."""
        known = self._known.get(_key(command))
        if known is not None:
            known.result, known.done_s = result, now_s


def _key(command: StationCommand) -> tuple[object, ...]:
    return command.sender, tuple(str(param) for param in command.params)


class CommandInbox:
    """Takes commands from the systems that may command, and acknowledges them; `run` it beside an open link.

    Args:
        link: to the vehicle, open.
        commanders: MAVLink system ids; None: 255, as ground stations have, and the vehicle's own.
        execute: carries one out.
        stops: whether a command stops a mission.
    """

    def __init__(
        self,
        link: MavsdkLink,
        *,
        commanders: Collection[int] | None,
        execute: Execute,
        stops: Callable[[StationCommand], bool] = lambda _: False,
    ) -> None:
        self._link = link
        self._commanders = commanders
        self._execute = execute
        self._repetitions = Repetitions(stops)
        self._group: asyncio.TaskGroup | None = None

    async def run(self) -> None:
        """Serve until cancelled."""
        offs = [self._link.on_any_system(name, self._received) for name in _NAMES]
        try:
            async with asyncio.TaskGroup() as group:
                self._group = group
                await asyncio.Event().wait()
        finally:
            self._group = None
            for off in offs:
                off()

    def _received(self, message: MavMessage) -> None:
        """In MAVSDK's thread."""
        fields = message.fields
        if not self._is_for_us(fields["target_system"], fields["target_component"]):
            return
        self._link.post(self._take if int(fields["command"]) == USER_1 else self._refuse, message)

    def _is_for_us(self, system: int, component: int) -> bool:
        return (int(system), int(component)) == self._link.own_ids

    def _refuse(self, message: MavMessage) -> None:
        sender, number = (message.system_id, message.component_id), int(message.fields["command"])
        self._spawn(self._answer(sender, number, Result.UNSUPPORTED))

    def _take(self, message: MavMessage) -> None:
        command = _command_of(message)
        is_new, known = self._repetitions.take(command, time.monotonic())
        if not is_new:
            if known is not None:
                self._spawn(self._acknowledge(command, known))
            return
        self._spawn(self._serve(command))

    async def _serve(self, command: StationCommand) -> None:
        result = Result.FAILED
        try:
            if not self._may_command(command.sender[0]):
                _log.warning("command of a system that may not command", sender=command.sender)
                result = Result.DENIED
            else:
                takes_long, work = self._execute(command)
                if takes_long:
                    await self._acknowledge(command, Result.IN_PROGRESS)
                result = await work
        except Exception:  # noqa: BLE001  (the edge of the service: no command may end it)
            _log.exception("command failed", sender=command.sender)
        self._repetitions.done(command, result, time.monotonic())
        await self._acknowledge(command, result)

    def _may_command(self, system: int) -> bool:
        if self._commanders is None:
            return system in {255, self._link.own_ids[0]}
        return system in self._commanders

    async def _acknowledge(self, command: StationCommand, result: Result) -> None:
        await self._answer(command.sender, USER_1, result)

    async def _answer(self, sender: tuple[int, int], command: int, result: Result) -> None:
        system, component = sender
        fields = {"command": command, "result": int(result), "progress": 255, "result_param2": 0}
        fields |= {"target_system": system, "target_component": component}
        try:
            await self._link.requests.send("acknowledging a command", "COMMAND_ACK", fields)
        except DeviceError as error:
            _log.info("acknowledgement could not be sent", error=str(error))

    def _spawn(self, work: Awaitable[None]) -> None:
        assert self._group is not None

        async def working() -> None:
            await work

        self._group.create_task(working(), name="station command")


def _command_of(message: MavMessage) -> StationCommand:
    fields = message.fields
    values = [fields.get(name) for name in _PARAMS[message.name]]
    return StationCommand(
        sender=(message.system_id, message.component_id),
        params=tuple(float("nan") if value is None else float(value) for value in values),
        confirmation=int(fields.get("confirmation") or 0),
    )
