"""Missions that do not exist yet, and the stops that they get.

A request that sets the vehicle in motion takes time before its mission exists: it is stored, a plan is computed,
directory and journal are created. A stop that arrives meanwhile is obeyed: it calls the beginning off, or it is kept
and given to the mission as soon as that exists.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, TypeVar

from panoexec.daemon.errors import SupersededError
from panoexec.mission.mission_requests import CommandRefusedError

T = TypeVar("T")
StopVerb: TypeAlias = Literal["abort", "finish", "pause", "interrupt"]


@dataclass(frozen=True, slots=True)
class StopCommand:
    """A command that stops a mission, the reason given with it and who sent it; `interrupt`: the process ends."""

    verb: StopVerb
    reason: str = ""
    by: str = ""


class Beginning:
    """A mission from the arrival of its request until it exists.

    Args:
        verb: `start` for a new mission, `resume` for one that was paused or interrupted.

    Attributes:
        stops: commands that the mission gets as soon as it exists, in order.
        committed: the mission is being created or opened and cannot be called off any more.
    """

    def __init__(self, verb: Literal["start", "resume"]) -> None:
        self.stops: list[StopCommand] = []
        self.committed = False
        self._verb = verb
        self._called_off: StopCommand | None = None
        self._over = asyncio.Event()

    @property
    def ends(self) -> bool:
        """Whether no mission follows, or one that ends before it takes a photo."""
        return self._called_off is not None or any(command.verb != "pause" for command in self.stops)

    def stop(self, command: StopCommand) -> None:
        """Obey a stop: an `abort` calls it off, as a `pause` does a `resume`; other stops are kept for the mission."""
        ends = command.verb in ("abort", "interrupt") or (self._verb, command.verb) == ("resume", "pause")
        if not ends or self.committed:
            self.stops.append(command)
        elif self._called_off is None:
            self._called_off = command
            self._over.set()

    def check(self) -> None:
        """Raise if it was called off.

        Raises:
            CommandRefusedError: by `abort`, or because the process ends.
            SupersededError: a `resume`, by a later `pause`.
        """
        match self._called_off:
            case None:
                return
            case StopCommand(verb="pause"):
                raise SupersededError("a later pause arrived before the mission was resumed")
            case StopCommand(verb="interrupt"):
                raise CommandRefusedError("panoexec was stopped before the mission began")
            case _:
                raise CommandRefusedError("aborted before it began")

    def commit(self) -> None:
        """Exclude that it is called off from now on: stops are kept for the mission.

        Raises:
            CommandRefusedError: it was called off before.
        """
        self.check()
        self.committed = True

    async def before_it(self, work: Coroutine[Any, Any, T], *, deadline_s: float) -> T:
        """Return the result of the work; the work is cancelled when this is called off or at the deadline.

        Args:
            work: what must be done before the mission can begin.
            deadline_s: time.monotonic.

        Raises:
            CommandRefusedError: it was called off.
            TimeoutError: the deadline passed.
        """
        working = asyncio.create_task(work, name="before a mission begins")
        over = asyncio.create_task(self._over.wait(), name="called off")
        # the event loop's clock is time.monotonic
        try:
            async with asyncio.timeout_at(deadline_s):
                await asyncio.wait({working, over}, return_when=asyncio.FIRST_COMPLETED)
            self.check()
            return await working
        finally:
            working.cancel()
            over.cancel()
            await asyncio.gather(working, over, return_exceptions=True)
