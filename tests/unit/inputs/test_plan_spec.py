"""A specification is planned by the method asked for, or its given plan is judged; and it pulls in nothing slow."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from typing import Any

import pytest

from panoexec.errors import PlanningError
from panoexec.inputs.camera_profiles import load_profile
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.planning.baselines.published import published_plan
from panoexec.planning.model import Band, Constraints, Timing


def spec_by(method: str, **changes: Any) -> PlanSpec:
    band = Band(elevation_min_deg=-10.0, elevation_max_deg=10.0, azimuth_min_deg=0.0, azimuth_max_deg=60.0)
    needs = Constraints(overlap_h=0.15, overlap_v=0.15, band=band)
    return replace(PlanSpec(camera=load_profile("dji-x5s-15mm").camera, constraints=needs, method=method), **changes)


def test_the_method_asked_for_plans() -> None:
    assert spec_by("paper").plan().method == "paper"
    plan = spec_by("certified", timing=Timing(settle_s=5.0)).plan()
    assert plan.method == "certified"
    assert plan.certificate is not None
    assert plan.certificate.certified
    assert plan.estimate is not None
    assert plan.estimate.duration_s > 5.0 * len(plan.shots)
    grid, finer = spec_by("hdrpano", columns=8, rows=4).plan(), spec_by("hdrpano", columns=16, rows=4).plan()
    assert grid.method == "hdrpano"
    assert (len(grid.rows()), len(grid.shots)) < (len(finer.rows()), len(finer.shots))
    with pytest.raises(PlanningError, match="columns"):
        spec_by("hdrpano").plan()


def test_a_given_plan_is_judged_and_left_as_it_is() -> None:
    plan = published_plan("scenario-1-proposed")
    judged = spec_by("certified", given=plan, order="rows").plan()
    assert replace(judged, certificate=None, estimate=None) == plan
    assert judged.certificate is not None
    assert judged.estimate is not None
    with pytest.raises(PlanningError, match="horizontal overlap"):
        spec_by("certified", given=replace(plan, constraints=replace(plan.constraints, overlap_h=1.5))).plan()


def test_neither_pydantic_nor_asyncio_is_needed() -> None:
    program = "import sys, panoexec.inputs.plan_spec; print(*sorted({'pydantic', 'asyncio'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
