"""Hostile but valid plan requests: the planner's process stays within its memory, and each request is answered.

`PANOEXEC_PLANS` sets how many there are (default 1, the worst known). Each gets `CPU_S` of processor time.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import random
import sys
from collections import Counter
from typing import Any

import pytest

from panoexec.daemon import planner
from panoexec.daemon.error_codes import refusal_of
from panoexec.daemon.mission_request import spec_of
from panoexec.daemon.planner_process import MEMORY_MB
from panoexec.errors import PanoexecError
from panoexec.inputs.config import Config
from panoexec.mqtt.requests import MAX_PAYLOAD, PlanRequest
from tests.system.test_stops import TELE

PLANS = int(os.environ.get("PANOEXEC_PLANS", "1"))
CPU_S = 5
CHILD = f"from panoexec.daemon import planner_process as p; p.CPU_S = {CPU_S}; p._NICE = 0; p.main()"


def camera(rng: random.Random, hfov_deg: float, vfov_deg: float) -> dict[str, Any]:
    """A profile with this field of view, to the pixel."""
    width, focal = rng.choice([3000, 6000, 9000]), 10.0
    height = round(width * math.tan(math.radians(vfov_deg / 2)) / math.tan(math.radians(hfov_deg / 2)))
    wide = 2 * focal * math.tan(math.radians(hfov_deg / 2))
    return {
        "name": "hostile",
        "sensor_width_mm": wide,
        "sensor_height_mm": wide * height / width,
        "image_width_px": width,
        "image_height_px": height,
        "focal_length_mm": focal,
        "source": "the test",
    }


def hostile(rng: random.Random) -> dict[str, Any]:
    """A request as large as its kind can make it."""
    kind = rng.choice(["wide", "tele", "given", "masks"])
    tolerance = {axis: rng.choice([0.0, 0.5, 2.0, 5.0]) for axis in ("pitch", "roll", "yaw")}
    fields: dict[str, Any] = {"guarantee": rng.choice(["coverage", "all"]), "tolerance_deg": tolerance}
    if kind == "wide":
        fields |= {
            "camera": camera(rng, rng.uniform(40, 110), rng.uniform(30, 60)),
            "overlap_h": rng.uniform(0.5, 0.85),
            "overlap_v": rng.uniform(0.0, 0.6),
            "elevation_deg": [-rng.uniform(5, 90), rng.uniform(5, 90)],
            "azimuth_deg": [-rng.uniform(20, 180), rng.uniform(20, 180)],
        }
    elif kind == "tele":
        fov_deg = rng.uniform(0.5, 6.0)
        fields |= {
            "camera": camera(rng, fov_deg, 2 * fov_deg / 3),
            "elevation_deg": [-90, rng.uniform(-80, 90)],
            "overlap": rng.uniform(0.0, 0.5),
            "tolerance_deg": {axis: value / 20 for axis, value in tolerance.items()},
        }
    elif kind == "given":
        count = rng.randrange(200, 1300)
        shots = [
            {"pitch_deg": round(rng.uniform(-90, 90), 2), "yaw_deg": round(rng.uniform(-180, 180), 2)}
            for _ in range(count)
        ]
        fields |= {"camera": camera(rng, rng.uniform(5, 110), rng.uniform(5, 60)), "plan": {"shots": shots}}
    else:
        masks = []
        for _ in range(rng.randrange(20, 400)):
            low, left = rng.uniform(-90, 80), rng.uniform(-180, 170)
            masks.append({"elevation_deg": [low, low + rng.uniform(0.1, 9)], "azimuth_deg": [left, left + 9.0]})
        constraints = {
            "overlap_h": 0.2,
            "overlap_v": 0.2,
            "elevation_deg": [-90, 90],
            "tolerance_deg": tolerance,
            "masks": masks,
        }
        shots = [{"pitch_deg": pitch, "yaw_deg": yaw} for pitch in range(-80, 81, 20) for yaw in range(-180, 180, 15)]
        fields |= {"camera": camera(rng, 40, 30), "plan": {"shots": shots, "constraints": constraints}}
    return fields


WORST: dict[str, Any] = {
    "camera": camera(random.Random(0), 60, 47),
    "elevation_deg": [-10, 10],
    "azimuth_deg": [-40, 40],
    "overlap_h": 0.7,
    "tolerance_deg": {"pitch": 5, "roll": 5, "yaw": 5},
    "guarantee": "all",
}


async def answers(count: int) -> dict[str, int]:
    """Plan as the daemon does; how often there was a plan, or which error."""
    rng, codes = random.Random(20260101), Counter[str]()
    requests = [WORST, *(hostile(rng) for _ in range(count - 1))]
    for fields in requests:
        assert len(json.dumps(fields)) < MAX_PAYLOAD
        try:
            await planner.plan_apart(spec_of(Config(), PlanRequest.model_validate({"transaction": 1} | fields)))
            codes["ok"] += 1
        except PanoexecError as error:
            codes[refusal_of(error).code] += 1
    return dict(codes)


async def test_the_planner_keeps_within_its_memory_whatever_is_asked_for() -> None:
    # the largest child is known of a process without other children
    program = (
        "import asyncio, json, resource; from panoexec.daemon import planner; from tests.system import"
        f" test_planner_budget as t; planner._CHILD = t.CHILD; codes = asyncio.run(t.answers({PLANS}));"
        "print(json.dumps([codes, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e6]))"
    )
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdout=asyncio.subprocess.PIPE)
    out, _ = await process.communicate()
    assert process.returncode == 0
    codes, peak_mb = json.loads(out)
    print(f"{PLANS} requests: {codes}, largest planner {peak_mb:.0f} MB")
    assert codes.keys() <= {"ok", "planning", "planning_budget", "invalid"}
    assert sum(codes.values()) == PLANS
    assert peak_mb <= MEMORY_MB


@pytest.mark.skipif(PLANS == 1, reason="takes minutes: set PANOEXEC_PLANS")
@pytest.mark.parametrize("overlap", [None, 0.2, 0.3])
async def test_the_whole_sphere_at_400_mm_is_planned_within_the_memory(overlap: float | None) -> None:
    fields = {"transaction": 1, "camera": TELE, "elevation_deg": [-90, 90], "overlap": overlap}
    plan = await planner.plan_apart(spec_of(Config(), PlanRequest.model_validate(fields)))
    assert 4000 < len(plan.shots) < 5000
