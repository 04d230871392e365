"""Planning in a process of its own: the same plans and errors, and gone as soon as nobody waits."""

from __future__ import annotations

import asyncio
import os
import pickle
import sys
from pathlib import Path

import pytest

from panoexec.daemon import planner
from panoexec.daemon.mission_request import Wish, wish_of
from panoexec.daemon.planner import plan_apart
from panoexec.errors import PanoexecError, PlanningError
from panoexec.inputs.config import Config
from panoexec.mqtt.requests import PlanRequest
from panoexec.planning.job import Job, outcome_of
from tests.waiting import eventually


def a_wish(**fields: object) -> Wish:
    return wish_of(Config(), PlanRequest.model_validate({"transaction": 1, "elevation_deg": [-30, 0]} | fields))


def children() -> set[int]:
    path = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
    return {int(pid) for pid in path.read_text(encoding="utf-8").split()}


async def test_gives_the_plan_that_this_process_would_have_made() -> None:
    wish = a_wish(method="paper")
    plan = await plan_apart(wish.job())
    assert plan == wish.plan()
    assert children() == set()


async def test_what_cannot_be_planned_is_the_same_error() -> None:
    wish = a_wish(tolerance_deg={"pitch": 40.0})
    with pytest.raises(PlanningError) as here:
        wish.plan()
    with pytest.raises(PlanningError) as there:
        await plan_apart(wish.job())
    assert str(there.value) == str(here.value)


async def test_nothing_goes_on_when_nobody_waits_any_more() -> None:
    long = a_wish(camera={"name": "tele", **SENSOR, "focal_length_mm": 400.0}, elevation_deg=[-90, 90])
    before = children()
    planning = asyncio.create_task(plan_apart(long.job()), name="planning")
    await eventually(lambda: children() - before)
    planning.cancel()
    with pytest.raises(asyncio.CancelledError):
        await planning
    assert children() == before


async def test_a_child_that_dies_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(PanoexecError, match="planning ended with code 1"):
        await plan_apart(a_wish().job())


async def test_planning_that_does_not_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner, "MOST_S", 0.01)
    with pytest.raises(PlanningError, match="given up: ask for a smaller band"):
        await plan_apart(a_wish().job())
    assert children() == set()


def test_other_errors_of_ours_are_told_by_their_text(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_job: Job) -> None:
        raise PanoexecError("not today")

    monkeypatch.setattr(Job, "done", fail)
    outcome = pickle.loads(pickle.dumps(outcome_of(a_wish().job())))
    assert (outcome.plan, outcome.text) == (None, "not today")


SENSOR = {
    "sensor_width_mm": 36.0,
    "sensor_height_mm": 24.0,
    "image_width_px": 6000,
    "image_height_px": 4000,
    "source": "the test",
}
