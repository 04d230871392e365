"""Stops of missions that do not exist yet, and of requests that they overtake."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from panoexec.daemon import planning_desk
from panoexec.daemon.beginnings import Beginning, StopCommand
from panoexec.daemon.errors import SupersededError
from panoexec.errors import MissionError
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import CommandRefusedError
from panoexec.planning.model import Plan
from panoexec.store.session import Devices
from tests.unit.daemon.test_commands import Desk, a_desk
from tests.waiting import eventually

SHOTS: dict[str, Any] = {"plan": {"shots": [{"pitch_deg": -20, "yaw_deg": yaw} for yaw in (0, 15, 30)]}}


class Planning:
    """In place of the planner's process: plans wait for `go`."""

    def __init__(self) -> None:
        self.go = asyncio.Event()
        self.began: list[PlanSpec] = []
        self.ended = 0

    async def __call__(self, spec: PlanSpec) -> Plan:
        self.began.append(spec)
        try:
            await self.go.wait()
        finally:
            self.ended += 1
        return spec.plan()


@asynccontextmanager
async def planning(folder: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[tuple[Desk, Planning]]:
    planner = Planning()
    monkeypatch.setattr(planning_desk, "plan_apart", planner)
    async with a_desk(folder) as desk:
        ready: Callable[[], Devices] = lambda: Devices(gimbal=None, camera=None, vehicle=None)  # type: ignore[arg-type]  # noqa: E731
        monkeypatch.setattr(desk.commands._vehicle, "ready_devices", ready)
        yield desk, planner


def by_transaction(desk: Desk) -> dict[Any, dict[str, Any]]:
    return {answer["transaction"]: answer for answer in desk.answers}


async def test_an_abort_ends_planning_and_the_start_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with planning(tmp_path, monkeypatch) as (desk, planner):
        desk.ask("start", "s", **SHOTS)
        await eventually(lambda: planner.began)
        desk.ask("abort", "a")
        await desk.heard(2)
        answers = by_transaction(desk)
        assert answers["a"]["data"] == {"mission_id": None, "durable": True}
        assert answers["s"]["error"]["message"] == "aborted before it began"
        assert planner.ended == 1
        assert not (tmp_path / "missions").exists()


async def test_an_abort_that_comes_before_its_start_is_stored_calls_it_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with planning(tmp_path, monkeypatch) as (desk, planner):
        desk.ask("start", "s", **SHOTS)
        desk.ask("abort", "a")  # in the same moment
        await desk.heard(2)
        answers = by_transaction(desk)
        assert answers["a"]["status"] == "ok"
        assert answers["s"]["error"]["message"] == "aborted before it began"
        desk.ask("start", "t", **SHOTS)
        await eventually(lambda: planner.began)  # a later start is not affected
        desk.ask("abort", "b")
        await desk.heard(4)


@pytest.mark.parametrize("verb", ["pause", "finish"])
async def test_other_stops_are_kept_for_the_mission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str) -> None:
    async with planning(tmp_path, monkeypatch) as (desk, planner):
        missions = desk.commands._missions
        desk.ask("start", "s", **SHOTS)
        await eventually(lambda: planner.began)
        assert missions.beginning is not None
        kept = missions.beginning.stops
        desk.ask(verb, "p", reason="wind")
        await desk.heard(1)
        assert desk.answers[0]["data"] == {"mission_id": None, "state": "idle", "durable": False}
        assert kept == [StopCommand(verb, "wind")]  # type: ignore[arg-type]
        desk.ask("abort", "a")
        await desk.heard(3)


async def test_a_stop_while_the_mission_is_created_is_kept_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with planning(tmp_path, monkeypatch) as (desk, planner):
        missions = desk.commands._missions
        planner.go.set()
        disk = threading.Event()
        monkeypatch.setattr(missions, "_check_space", disk.wait)
        desk.ask("start", "s", **SHOTS)
        await eventually(lambda: missions.beginning is not None and missions.beginning.committed)
        assert missions.beginning is not None
        beginning = missions.beginning
        desk.ask("abort", "a", reason="now")
        await desk.heard(1)
        assert desk.answers[0]["transaction"] == "a", "while the disk hangs"
        disk.set()
        await desk.heard(2)
        answers = by_transaction(desk)
        assert answers["s"]["status"] == "ok", "it begins, and is aborted at once"
        assert answers["a"]["status"] == "ok"
        assert answers["a"]["data"]["durable"] is False, "there is no journal that it could be in"
        assert beginning.stops == [StopCommand("abort", "now")]
        await missions._next.get_nowait()[0].journal.close()
        missions._free()


@pytest.mark.parametrize("command", ["start", "plan"])
async def test_a_request_that_expires_while_it_is_planned_does_not_act(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    async with planning(tmp_path, monkeypatch) as (desk, planner):
        desk.ask(command, "s", expires_s=asyncio.get_running_loop().time() + 0.2, **SHOTS)
        assert (await desk.heard(1))[0]["error"]["code"] == "expired"
        assert (len(planner.began), planner.ended) == (1, 1), "and its planning ends"


async def test_one_plan_for_each_sender_the_newest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with planning(tmp_path, monkeypatch) as (desk, planner):
        for number in range(64):
            desk.ask("plan", number, overlap_h=0.1 + 0.005 * number, elevation_deg=[-20, 0])
        await desk.heard(63)
        assert {answer["error"]["code"] for answer in desk.answers} == {"superseded"}
        planner.go.set()
        assert (await desk.heard(64))[63]["transaction"] == 63
        assert desk.answers[63]["status"] == "ok"


async def test_a_mission_is_planned_before_plans_that_are_only_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with planning(tmp_path, monkeypatch) as (desk, planner):
        desk.ask("plan", "p", elevation_deg=[-20, 0])
        await eventually(lambda: planner.began)
        desk.ask("start", "s", **SHOTS)
        await eventually(lambda: len(planner.began) == 2)
        assert planner.ended == 1, "one process at a time"
        assert planner.began[1].given is not None
        desk.ask("abort", "a")
        await eventually(lambda: len(planner.began) == 3)
        assert planner.began[2] == planner.began[0], "the plan that made way is computed now"
        planner.go.set()
        await desk.heard(3)
        assert by_transaction(desk)["p"]["status"] == "ok"


async def test_a_resume_is_called_off_by_a_later_pause_and_a_start_keeps_it() -> None:
    resume, start = Beginning("resume"), Beginning("start")
    for one in (resume, start):
        one.stop(StopCommand("pause"))
    with pytest.raises(SupersededError):
        resume.commit()
    start.commit()
    start.stop(StopCommand("abort"))
    assert start.stops == [StopCommand("pause"), StopCommand("abort")]
    late = Beginning("start")
    late.stop(StopCommand("interrupt"))
    with pytest.raises(CommandRefusedError, match="panoexec was stopped"):
        late.commit()


async def test_no_command_waits_for_a_journal_that_has_failed(tmp_path: Path) -> None:
    async def fails() -> None:
        raise MissionError("not in the mission's journal (disk is full)")

    record = SimpleNamespace(mission_id="m", state=MissionState.CAPTURING, asked=SimpleNamespace(end=None))
    commands = SimpleNamespace(
        skip=lambda _, **by: 3,
        repeat=lambda _, **by: 3,
        resume=lambda **by: None,
        pause=lambda _, **by: None,
        abort=lambda _, **by: None,
    )
    async with a_desk(tmp_path) as desk:
        flying: Any = SimpleNamespace(record=record, commands=commands, durable=fails)
        desk.commands._missions.mission = flying
        for command in ("skip", "repeat", "resume"):
            desk.ask(command, command)
        await desk.heard(3)
        for command in ("pause", "abort"):
            desk.ask(command, command)
        answers = {answer["transaction"]: answer for answer in await desk.heard(5)}
    for command in ("skip", "repeat", "resume"):
        assert answers[command]["error"]["code"] == "storage"
        assert "disk is full" in answers[command]["error"]["message"]
    for command in ("pause", "abort"):
        assert answers[command]["data"] == {"mission_id": "m", "state": "capturing", "durable": False}
