"""Planning in a process of its own: the same plans and errors, and gone as soon as nobody waits."""

from __future__ import annotations

import asyncio
import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from panoexec.daemon import planner, planner_process
from panoexec.daemon.errors import PlanningBudgetError
from panoexec.daemon.mission_request import spec_of
from panoexec.daemon.planner import plan_apart
from panoexec.daemon.planner_process import outcome_of
from panoexec.errors import PanoexecError, PlanningError
from panoexec.inputs.config import Config
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.mqtt.requests import PlanRequest
from tests.waiting import eventually

NONE = {"pitch": 0, "roll": 0, "yaw": 0}


def a_spec(**fields: object) -> PlanSpec:
    return spec_of(Config(), PlanRequest.model_validate({"transaction": 1, "elevation_deg": [-30, 0]} | fields))


def children() -> set[int]:
    path = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
    return {int(pid) for pid in path.read_text(encoding="utf-8").split()}


async def test_gives_the_plan_that_this_process_would_have_made() -> None:
    spec = a_spec(method="paper")
    before = children()
    plan = await plan_apart(spec)
    assert plan == spec.plan()
    assert children() == before


async def test_what_cannot_be_planned_is_the_same_error() -> None:
    spec = a_spec(tolerance_deg={"pitch": 40.0})
    with pytest.raises(PlanningError) as here:
        spec.plan()
    with pytest.raises(PlanningError) as there:
        await plan_apart(spec)
    assert str(there.value) == str(here.value)


async def test_nothing_goes_on_when_nobody_waits_any_more() -> None:
    long = a_spec(
        camera={"name": "tele", **SENSOR, "focal_length_mm": 400.0}, elevation_deg=[-90, 90], tolerance_deg=NONE
    )
    before = children()
    planning = asyncio.create_task(plan_apart(long), name="planning")
    await eventually(lambda: children() - before)
    planning.cancel()
    with pytest.raises(asyncio.CancelledError):
        await planning
    assert children() == before


async def test_a_child_that_dies_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(PanoexecError, match="planning ended with code 1"):
        await plan_apart(a_spec())


@pytest.mark.parametrize(
    ("program", "error", "says"),
    [
        ("limit_memory(80)", PlanningBudgetError, "needs more than 300 MB of memory: ask for a smaller band"),
        ("limit_time(1)", PlanningBudgetError, "more than 300 s of processor time: ask for a smaller band"),
        ("os.abort()", PlanningBudgetError, "needs more than 300 MB of memory"),
        ("os.kill(os.getpid(), 9)", PlanningBudgetError, "the computer is out of memory, or"),
        ("os.write(2, b'blas: memory allocation failed'); os._exit(1)", PlanningBudgetError, "more than 300 MB"),
        ("os.kill(os.getpid(), 24)", PlanningBudgetError, "more than 300 s of processor time"),
        ("sys.exit('no idea')", PanoexecError, "planning ended with code 1: no idea"),
        ("raise MemoryError", PlanningBudgetError, "needs more than 300 MB of memory"),
        (
            "sys.stderr.write('Traceback (most recent call last):\\n limit_memory(7)\\nKeyError: 7'); os._exit(1)",
            PanoexecError,
            "^planning ended with code 1: KeyError: 7$",
        ),
    ],
)
async def test_a_budget_that_is_exceeded_is_an_error(
    monkeypatch: pytest.MonkeyPatch, program: str, error: type[PanoexecError], says: str
) -> None:
    child = (
        "import os, pickle, resource, sys; from panoexec.daemon.planner_process import *;"
        "from panoexec.daemon.planner_process import outcome_of;"
        f"{program}; spec = pickle.loads(sys.stdin.buffer.read());"
        "sys.stdout.buffer.write(pickle.dumps(outcome_of(spec)))"
    )
    monkeypatch.setattr(planner, "_CHILD", child)
    long = a_spec(
        camera={"name": "tele", **SENSOR, "focal_length_mm": 400.0}, elevation_deg=[-90, 90], tolerance_deg=NONE
    )
    before = children()  # without workers of pytest-xdist, this process has what ends leftovers
    with pytest.raises(error, match=says):
        await plan_apart(long)
    assert children() == before


@pytest.mark.parametrize(
    ("raised", "says"), [("_OutOfTimeError", "300 s of processor time"), ("MemoryError", "300 MB of memory")]
)
async def test_a_budget_that_is_exceeded_on_the_way_out_is_the_same_error(
    monkeypatch: pytest.MonkeyPatch, raised: str, says: str
) -> None:
    child = f"from panoexec.daemon.planner_process import *; from panoexec.daemon import planner_process as p\n\
def late(spec): raise p.__dict__.get('{raised}', MemoryError)\np.outcome_of = late; p.main()"
    monkeypatch.setattr(planner, "_CHILD", child)
    with pytest.raises(PlanningBudgetError, match=says):
        await plan_apart(a_spec())


async def test_a_plan_of_too_many_images_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner_process, "MOST_IMAGES", 6)
    outcome = outcome_of(a_spec(method="paper"))
    assert outcome.kind == "budget"
    assert "images, the daemon accepts 6: ask for a smaller band" in outcome.text


def test_the_process_gives_way_and_is_bounded() -> None:
    program = (
        "import os, resource; from pathlib import Path; from panoexec.daemon import planner_process as p;"
        "p.give_way(); p.limit_time(p.CPU_S); p.limit_memory(p.MEMORY_MB);"
        "print(os.nice(0), Path('/proc/self/oom_score_adj').read_text().strip(),"
        " *resource.getrlimit(resource.RLIMIT_CPU), resource.getrlimit(resource.RLIMIT_DATA)[1] < 400e6)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    nice, oom, cpu_s, cpu_most_s, memory = done.stdout.split()
    assert int(nice) == min(19, os.nice(0) + 5)
    assert (oom, cpu_s, cpu_most_s, memory) == ("900", "300", "305", "True")


def test_other_errors_of_ours_are_told_by_their_text(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_spec: PlanSpec) -> None:
        raise PanoexecError("not today")

    monkeypatch.setattr(PlanSpec, "plan", fail)
    outcome = pickle.loads(pickle.dumps(outcome_of(a_spec())))
    assert (outcome.plan, outcome.text) == (None, "not today")


def test_the_child_imports_the_planner_and_nothing_slow() -> None:
    slow = {"pydantic", "asyncio", "structlog", "mavsdk", "aiomqtt"}
    program = (
        "import sys, panoexec.daemon.planner_process;"
        f"print(*sorted({slow} & {{name.partition('.')[0] for name in sys.modules}}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


SENSOR = {
    "sensor_width_mm": 36.0,
    "sensor_height_mm": 24.0,
    "image_width_px": 6000,
    "image_height_px": 4000,
    "source": "the test",
}
