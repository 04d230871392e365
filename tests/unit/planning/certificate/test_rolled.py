"""Plans of others may be rolled: the certificate sees them as they are, and nothing flies them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.errors import PlanningError, UsageError
from panoexec.exports import export_plan
from panoexec.exports.model import from_plan
from panoexec.exports.qgc_plan import qgc_text
from panoexec.inputs.plan_file import plan_from_data, plan_to_data
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.planning.baselines.published import X5S_15MM
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Band, Constraints, Plan, Tolerance
from panoexec.planning.search.planner import plan_certified
from tests.unit.planning.sampling import directions_in, uncovered

CONSTRAINTS = Constraints(
    overlap_h=0.2,
    overlap_v=0.2,
    band=Band(elevation_min_deg=-90, elevation_max_deg=20),
    tolerance=Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.5),
)
PORTRAIT = X5S_15MM.rotated()


@pytest.fixture(scope="module")
def plan() -> Plan:
    return plan_certified(X5S_15MM, CONSTRAINTS)


def rolled(plan: Plan, row: int, roll_deg: float) -> Plan:
    return replace(plan, shots=tuple(replace(s, roll_deg=roll_deg) if s.row == row else s for s in plan.shots))


@settings(max_examples=15, deadline=None)
@given(row=st.integers(0, 2), roll=st.floats(3, 90), seed=st.integers(0, 99))
def test_a_rolled_row_is_judged_as_it_is(plan: Plan, row: int, roll: float, seed: int) -> None:
    changed = rolled(plan, row, roll)
    found = certify(changed)
    missed = uncovered(changed, directions_in(CONSTRAINTS.band, 20_000, np.random.default_rng(seed)))
    assert not (found.certified and len(missed))
    assert not (found.uncovered_fraction == 0 and len(missed))


def test_the_hole_that_a_rolled_row_leaves_is_found(plan: Plan) -> None:
    assert plan.certificate is not None
    assert plan.certificate.certified
    changed = rolled(plan, 1, 90.0)
    assert len(uncovered(changed, directions_in(CONSTRAINTS.band, 20_000, np.random.default_rng(1))))
    assert certify(changed).uncovered_fraction > 0
    # also from a file, where such plans come from
    again = plan_from_data(plan_to_data(changed), source="plan.json").plan()
    assert again.shots == changed.shots
    assert not certify(again).certified


def test_a_camera_rolled_by_a_right_angle_is_the_camera_mounted_so() -> None:
    exactly = replace(CONSTRAINTS, tolerance=Tolerance(pitch_deg=0, roll_deg=0, yaw_deg=0))
    upright = plan_certified(PORTRAIT, exactly)
    turned = replace(upright, camera=X5S_15MM, shots=tuple(replace(shot, roll_deg=90.0) for shot in upright.shots))
    unrolled = replace(upright, camera=X5S_15MM)
    a, b, c = (certify(one) for one in (upright, turned, unrolled))
    assert (a.certified, b.certified, c.certified) == (True, True, False)
    assert b.min_overlap_h == pytest.approx(a.min_overlap_h)
    assert b.min_overlap_v == pytest.approx(a.min_overlap_v)


def test_a_rolled_plan_is_not_flown_and_exports_keep_its_roll(plan: Plan, tmp_path: Path) -> None:
    changed = rolled(plan, 2, 12.0)
    with pytest.raises(PlanningError, match=r"has roll_deg 12, as have \d+ of \d+: gimbals are commanded with roll 0"):
        PlanSpec(camera=X5S_15MM, constraints=CONSTRAINTS, given=changed).plan()
    with pytest.raises(UsageError, match="rolled by 12"):
        qgc_text(from_plan(changed))
    path = tmp_path / "plan.csv"
    export_plan("csv", changed, path)
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    column = header.split(",").index("hugin_r_deg")
    rolls = {round(float(line.split(",")[column]), 3) for line in lines}
    assert rolls == {0.0, 12.0}
