"""Parameters of a MAVLink command become a request, its response a MAV_RESULT."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import pytest

from panoexec.adapters.link.command_inbox import Result, StationCommand
from panoexec.daemon.station_requests import StationRequests
from panoexec.inputs.config import Config
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.parsing import parse_request

NAN = float("nan")
CONFIG = Config.model_validate({"presets": {"roof": {"overlap": 0.2}, "all": {}}})


@dataclass
class Daemon:
    """Takes requests and answers them with the same response."""

    response: dict[str, Any]
    taken: list[Incoming] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def take(self, incoming: Incoming) -> None:
        parse_request(incoming.command, incoming.payload, retained=False, size=incoming.size)
        self.taken.append(incoming)
        assert incoming.reply is not None
        incoming.reply(json.dumps(self.response).encode())

    async def say(self, text: str) -> None:
        self.said.append(text)

    async def after(self, *params: float) -> Result:
        requests = StationRequests(config=lambda: CONFIG, take=self.take, say=self.say, boot_id="b")
        given = (*params, *(NAN,) * (7 - len(params)))
        _, work = requests.execute(StationCommand(sender=(255, 190), params=given))
        return await work


def request(incoming: Incoming) -> tuple[str, dict[str, Any]]:
    fields = json.loads(incoming.payload)
    assert fields.pop("transaction").startswith("mavlink/station 255/190/b-")
    return incoming.command, fields


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        ((1, 1), ("start", {"preset": "roof"})),
        ((1, 2), ("start", {"preset": "all"})),
        ((1, 0), ("start", {})),
        ((1,), ("start", {})),
        ((2, 0), ("pause", {"reason": "station 255/190"})),
        ((3, 0), ("resume", {})),
        ((4, 0), ("abort", {"reason": "station 255/190"})),
        ((5, 0), ("finish", {"reason": "station 255/190"})),
        ((6, 0), ("skip", {})),
        ((6, 1), ("skip", {"shot": 0})),
        ((7, 8), ("repeat", {"shot": 7})),
    ],
)
async def test_what_is_asked_for(params: tuple[float, ...], expected: tuple[str, dict[str, Any]]) -> None:
    daemon = Daemon({"status": "ok", "data": {}})
    assert await daemon.after(*params) is Result.ACCEPTED
    assert [request(incoming) for incoming in daemon.taken] == [expected]
    assert daemon.said == []


@pytest.mark.parametrize(
    ("params", "why"),
    [
        ((), "command refused: param1 must be 1 to 7"),
        ((8, 0), "command refused: param1 must be 1 to 7"),
        ((1.5, 0), "command refused: param1 must be 1 to 7"),
        ((float("inf"), 0), "command refused: param1 must be 1 to 7"),
        ((1, -1), "start refused: param2 must be a whole number, from 0"),
        ((1, 0.5), "start refused: param2 must be a whole number, from 0"),
        ((1, 3), "start refused: there is no preset 3, 2 are configured"),
    ],
)
async def test_wrong_parameters_are_denied_and_said(params: tuple[float, ...], why: str) -> None:
    daemon = Daemon({"status": "ok", "data": {}})
    assert await daemon.after(*params) is Result.DENIED
    assert daemon.taken == []
    assert daemon.said == [f"Pano: {why}"]


@pytest.mark.parametrize(
    ("code", "result"),
    [
        ("busy", Result.TEMPORARILY_REJECTED),
        ("not_ready", Result.TEMPORARILY_REJECTED),
        ("refused", Result.DENIED),
        ("planning", Result.DENIED),
        ("device", Result.FAILED),
        ("internal", Result.FAILED),
    ],
)
async def test_a_refusal_is_told_by_its_kind_and_in_words(code: str, result: Result) -> None:
    daemon = Daemon({"status": "error", "error": {"code": code, "message": "because of that"}})
    assert await daemon.after(1, 1) is result
    assert daemon.said == ["Pano: start refused: because of that"]
