"""Requests of a MAVLink ground station: a command's parameters become a request, its response a MAV_RESULT.

| param1 | request | param2 |
|---|---|---|
| 1 | `start` | number of the preset in the configuration, from 1; 0: the configured panorama |
| 2, 3, 4, 5 | `pause`, `resume`, `abort`, `finish` | |
| 6, 7 | `skip`, `repeat` | number of the shot plus 1; 0: the current, or the last accepted one |
"""

from __future__ import annotations

import json
import math
from collections.abc import Awaitable, Callable
from typing import Any, Final

from panoexec.adapters.link.command_inbox import Result, StationCommand
from panoexec.daemon.own_requests import submit
from panoexec.inputs.config import Config
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.requests import STOPPING
from panoexec.mqtt.senders import MAVLINK, transaction_of

REQUEST_NAMES: Final = {1: "start", 2: "pause", 3: "resume", 4: "abort", 5: "finish", 6: "skip", 7: "repeat"}
_SLOW: Final = frozenset({"start", "resume"})
_LATER: Final = frozenset({"busy", "not_ready", "overload", "storage", "superseded", "expired", "planning_budget"})
_BROKEN: Final = frozenset({"device", "internal", "interrupted"})


class StationRequests:
    """Executes the commands of ground stations as requests.

    Args:
        config: returns the current configuration.
        take: takes a request.
        say: tells the pilot why a command was refused.
        boot_id: of this process; makes transactions unique.
    """

    def __init__(
        self,
        *,
        config: Callable[[], Config],
        take: Callable[[Incoming], None],
        say: Callable[[str], Awaitable[None]],
        boot_id: str,
    ) -> None:
        self._config = config
        self._take = take
        self._say = say
        self._boot_id = boot_id
        self._count = 0

    def execute(self, command: StationCommand) -> tuple[bool, Awaitable[Result]]:
        """See `command_inbox.Execute`."""
        verb, fields, wrong = self.request_of(command)
        if wrong:
            return False, self._refused(verb or "command", wrong)
        return verb in _SLOW, self.submit(verb, fields, by=_station(command))

    def stops(self, command: StationCommand) -> bool:
        """Whether a command stops a mission."""
        return self.request_of(command)[0] in STOPPING

    def submit(self, verb: str, fields: dict[str, Any], *, by: str) -> Awaitable[Result]:
        """Execute a request of `by`; its result. The pilot hears why it was refused."""
        self._count += 1
        transaction = transaction_of(MAVLINK, by, f"{self._boot_id}-{self._count}")
        answer = submit(self._take, verb, fields, transaction=transaction)
        return self._result(verb, answer)

    def request_of(self, command: StationCommand) -> tuple[str, dict[str, Any], str]:
        """The request's command and its fields, or what is wrong.

        Returns:
            (command, fields, problem); "" for no problem.
        """
        number, detail = (_whole(param) for param in command.params[:2])
        verb = REQUEST_NAMES.get(-1 if number is None else number, "")
        if not verb:
            return "", {}, f"param1 must be 1 to {max(REQUEST_NAMES)}"
        if detail is None:
            return verb, {}, "param2 must be a whole number, from 0"
        if verb == "start":
            presets = list(self._config().presets)
            if detail > len(presets):
                return verb, {}, f"there is no preset {detail}, {len(presets)} are configured"
            return verb, {"preset": presets[detail - 1]} if detail else {}, ""
        if verb in {"skip", "repeat"}:
            return verb, {"shot": detail - 1} if detail else {}, ""
        return verb, {} if verb == "resume" else {"reason": _station(command)}, ""

    async def _refused(self, verb: str, why: str) -> Result:
        await self._say(f"Pano: {verb} refused: {why}")
        return Result.DENIED

    async def _result(self, verb: str, answer: Awaitable[bytes]) -> Result:
        response = json.loads(await answer)
        if response["status"] == "ok":
            return Result.ACCEPTED
        error = response["error"]
        await self._say(f"Pano: {verb} refused: {error['message']}")
        code = error["code"]
        return Result.TEMPORARILY_REJECTED if code in _LATER else Result.FAILED if code in _BROKEN else Result.DENIED


def _station(command: StationCommand) -> str:
    return f"station {command.sender[0]}/{command.sender[1]}"


def _whole(value: float) -> int | None:
    """A whole number from 0; 0 for NaN, which says nothing; None for any other."""
    if math.isnan(value):
        return 0
    return int(value) if math.isfinite(value) and value >= 0 and value == int(value) else None
