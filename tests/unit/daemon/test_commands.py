"""Requests at the service's edge: once each, never late, never too many, whatever happens while they are obeyed."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from panoexec.clock import SystemClock
from panoexec.daemon.commands import Commands
from panoexec.daemon.missions import Missions
from panoexec.daemon.thumbnails import Thumbnails
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.errors import DeviceError
from panoexec.inputs.config import Config
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.transactions import MAX_UNDER_WAY, Transactions
from tests.waiting import eventually


@dataclass
class Desk:
    """Commands with nobody behind them but what a test puts there."""

    commands: Commands
    answers: list[dict[str, Any]] = field(default_factory=list)
    refreshed: int = 0

    def ask(self, command: str, transaction: object, *, expires_s: float = float("inf"), **fields: Any) -> None:
        payload = json.dumps({"transaction": transaction} | fields).encode()
        now_s = time.monotonic()
        incoming = Incoming(command=command, payload=payload, size=len(payload), received_s=now_s, expires_s=expires_s)
        self.commands.take(incoming)

    async def heard(self, count: int) -> list[dict[str, Any]]:
        await eventually(lambda: len(self.answers) >= count, 60)
        return self.answers

    def codes(self) -> list[str]:
        return ["ok" if a["status"] == "ok" else a["error"]["code"] for a in self.answers]


class Sink:
    def publish(self, _event: object) -> None: ...


@asynccontextmanager
async def a_desk(folder: Path, boot_id: str = "one", refresh: Any = None) -> AsyncIterator[Desk]:
    config = Config.model_validate({"storage": {"path": folder, "min_free_mb": 0}})
    transactions = await Transactions.open(folder / "t.sqlite", boot_id=boot_id)
    desks: list[Desk] = []

    def respond(_incoming: Incoming, payload: bytes) -> None:
        desks[0].answers.append(json.loads(payload))

    def refreshed() -> dict[str, Any]:
        desks[0].refreshed += 1
        return {} if refresh is None else refresh()

    async def examined(*, photo: bool) -> dict[str, Any]:
        return {"photo": photo}

    try:
        async with asyncio.TaskGroup() as group:
            clock = SystemClock()
            missions = Missions(config=lambda: config, clock=clock, sink=Sink(), changed=lambda: None)
            commands = Commands(
                config=lambda: config,
                missions=missions,
                vehicle=VehicleLink(lambda: config, clock=clock),
                transactions=transactions,
                group=group,
                respond=respond,
                refresh=refreshed,
                examine=examined,
                thumbnails=Thumbnails(config=lambda: config, mqtt=None),
            )
            await commands.restore()
            desks.append(Desk(commands))
            yield desks[0]
    finally:
        await transactions.close()


async def test_a_request_that_comes_too_late_is_not_obeyed(tmp_path: Path) -> None:
    async with a_desk(tmp_path) as desk:
        desk.ask("get", 1, expires_s=time.monotonic() - 0.001)
        desk.ask("set_profile", 2, camera="dji-x5s-45mm", expires_s=time.monotonic() - 0.001)
        desk.ask("get", 3, expires_s=time.monotonic() + 60)
        answers = await desk.heard(3)
        assert {a["transaction"]: a["status"] for a in answers} == {1: "error", 2: "error", 3: "ok"}
        assert [a["error"]["code"] for a in answers if a["error"]] == ["expired", "expired"]
        assert desk.refreshed == 1
        desk.ask("set_profile", 2, camera="dji-x5s-45mm", expires_s=time.monotonic() + 60)
        assert (await desk.heard(4))[3] == next(a for a in answers if a["transaction"] == 2), "the same answer"
        assert desk.commands.camera is None


async def test_the_same_transaction_acts_once_and_gets_the_same_answer_across_restarts(tmp_path: Path) -> None:
    async with a_desk(tmp_path) as desk:
        desk.ask("set_profile", "t", camera="dji-x5s-45mm")
        first = (await desk.heard(1))[0]
        desk.ask("set_profile", "u", camera="dji-x5s-15mm")
        await desk.heard(2)
        desk.ask("set_profile", "t", camera="dji-x5s-45mm")
        assert (await desk.heard(3))[2] == first
        assert desk.commands.camera == "dji-x5s-15mm", "it did not act again"
    async with a_desk(tmp_path, boot_id="two") as desk:
        assert desk.commands.camera == "dji-x5s-15mm", "kept across restarts"
        desk.ask("set_profile", "t", camera="dji-x5s-45mm")
        assert (await desk.heard(1))[0] == first
        assert desk.commands.camera == "dji-x5s-15mm"
        desk.ask("pause", "t")
        assert (await desk.heard(2))[1]["error"]["code"] == "conflict"
    async with a_desk(tmp_path, boot_id="three") as desk:
        desk.ask("set_profile", "null", camera=None)
        await desk.heard(1)
        assert desk.commands.camera is None


async def test_a_request_in_which_the_daemon_died_does_not_act_again(tmp_path: Path) -> None:
    async with a_desk(tmp_path) as desk:
        store = desk.commands._transactions
        payload = json.dumps({"transaction": "x", "camera": "dji-x5s-45mm"}).encode()
        await store.note(parse_request("set_profile", payload))
    async with a_desk(tmp_path, boot_id="two") as desk:
        desk.ask("set_profile", "x", camera="dji-x5s-45mm")
        assert (await desk.heard(1))[0]["error"]["code"] == "interrupted"
        assert desk.commands.camera is None


async def test_repeats_while_one_is_obeyed_get_its_answer_and_a_flood_is_refused(tmp_path: Path) -> None:
    async with a_desk(tmp_path) as desk:
        for _ in range(5):
            desk.ask("set_profile", "same", camera="dji-x5s-45mm")
        desk.ask("pause", "same")
        answers = await desk.heard(6)
        assert desk.codes().count("ok") == 5
        assert desk.codes().count("conflict") == 1
        assert len({json.dumps(a) for a in answers if a["status"] == "ok"}) == 1
        desk.answers.clear()
        for number in range(MAX_UNDER_WAY + 10):
            desk.ask("skip", f"n{number}")
        for number in range(20):
            desk.ask("abort", f"a{number}")
        await desk.heard(MAX_UNDER_WAY + 30)
        codes = {answer["transaction"]: code for answer, code in zip(desk.answers, desk.codes(), strict=True)}
        assert list(codes.values()).count("overload") == 10
        assert {code for transaction, code in codes.items() if transaction[0] == "a"} == {"refused"}, "without a limit"


@pytest.mark.parametrize(
    ("error", "code"), [(DeviceError("it broke"), "device"), (ZeroDivisionError("ours"), "internal")]
)
async def test_whatever_goes_wrong_becomes_an_answer(tmp_path: Path, error: Exception, code: str) -> None:
    def fail() -> dict[str, Any]:
        raise error

    async with a_desk(tmp_path, refresh=fail) as desk:
        desk.ask("get", 1)
        desk.ask("pause", 2)
        await desk.heard(2)
        assert sorted(desk.codes()) == sorted([code, "refused"]), "and the next one is obeyed as ever"


async def test_a_disk_that_is_full_refuses_what_acts_and_answers_the_rest(tmp_path: Path) -> None:
    async with a_desk(tmp_path) as desk:
        desk.commands._transactions._database().execute("PRAGMA query_only = ON")
        desk.ask("set_profile", 1, camera="dji-x5s-45mm")
        desk.ask("get", 2)
        await desk.heard(2)
        assert sorted(desk.codes()) == ["ok", "storage"]
        assert desk.commands.camera is None
