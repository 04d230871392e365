"""Hostile but valid plan requests: the planner's process stays within its memory, and each request is answered.

`PANOEXEC_PLANS` sets how many there are (default 1, the worst known), `PANOEXEC_SEED` which. Each gets `CPU_S` of
processor time.
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
import sys
from collections import Counter

import pytest

from panoexec.daemon import planner
from panoexec.daemon.error_codes import refusal_of
from panoexec.daemon.mission_request import spec_of
from panoexec.daemon.planner_process import MEMORY_MB
from panoexec.errors import PanoexecError
from panoexec.inputs.config import Config
from panoexec.mqtt.requests import MAX_PAYLOAD, PlanRequest
from tests.system.hostile_plans import requests
from tests.system.test_stops import TELE

PLANS = int(os.environ.get("PANOEXEC_PLANS", "1"))
SEED = int(os.environ.get("PANOEXEC_SEED", "1"))
CPU_S = 5
CHILD = f"from panoexec.daemon import planner_process as p; p.CPU_S = {CPU_S}; p._NICE = 0; p.main()"


async def answers(count: int) -> dict[str, int]:
    """Plan as the daemon does; how often there was a plan, or which error."""
    codes = Counter[str]()
    for number, (kind, fields) in enumerate(requests(count, SEED), 1):
        assert len(json.dumps(fields)) < MAX_PAYLOAD
        code = "ok"
        try:
            await planner.plan_apart(spec_of(Config(), PlanRequest.model_validate({"transaction": 1} | fields)))
        except PanoexecError as error:
            code = refusal_of(error).code
        codes[code] += 1
        print(f"request {number}, {kind}: {code}; largest planner {peak_mb():.0f} MB", file=sys.stderr, flush=True)
    return dict(codes)


def peak_mb() -> float:
    """The largest resident memory of a child process of this one so far, 10^6 bytes."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e6


async def test_the_planner_keeps_within_its_memory_whatever_is_asked_for() -> None:
    # the largest child is known of a process without other children
    program = (
        "import asyncio, json; from panoexec.daemon import planner; from tests.system import test_planner_budget as t;"
        f" planner._CHILD = t.CHILD; codes = asyncio.run(t.answers({PLANS})); print(json.dumps([codes, t.peak_mb()]))"
    )
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdout=asyncio.subprocess.PIPE)
    out, _ = await process.communicate()
    assert process.returncode == 0
    codes, largest_mb = json.loads(out)
    print(f"{PLANS} requests: {codes}, largest planner {largest_mb:.0f} MB")
    assert codes.keys() <= {"ok", "planning", "planning_budget", "invalid"}
    assert sum(codes.values()) == PLANS
    assert largest_mb <= MEMORY_MB


@pytest.mark.skipif(PLANS == 1, reason="takes minutes: set PANOEXEC_PLANS")
@pytest.mark.parametrize("overlap", [None, 0.2, 0.3])
async def test_the_whole_sphere_at_400_mm_is_planned_within_the_memory(overlap: float | None) -> None:
    fields = {"transaction": 1, "camera": TELE, "elevation_deg": [-90, 90], "overlap": overlap}
    plan = await planner.plan_apart(spec_of(Config(), PlanRequest.model_validate(fields)))
    assert 4000 < len(plan.shots) < 5000
