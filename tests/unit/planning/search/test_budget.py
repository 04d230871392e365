"""The budget of a search cuts its tail only, and stricter requests never beat the request itself."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import pytest

from panoexec.daemon.planner_process import CPU_S
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import NO_TOLERANCE, Band, Certificate, Constraints, Plan
from panoexec.planning.search.budget import DEFAULT_BUDGET_S, MOST_BUDGET_S, SearchBudget
from panoexec.planning.search.planner import plan_certified
from panoexec.planning.search.proposal import missing
from panoexec.planning.search.siblings import siblings

MAPPER = Camera.from_fov(54.0, 42.7)
SPHERE = Constraints(
    overlap_h=0.0,
    overlap_v=0.0,
    band=Band(elevation_min_deg=-90.0, elevation_max_deg=90.0),
    tolerance=NO_TOLERANCE,
)


@lru_cache
def whole_plan() -> Plan:
    return plan_certified(MAPPER, SPHERE)


def spent_after(monkeypatch: pytest.MonkeyPatch, work: int) -> None:
    """Let the processor time of every search end with a certain amount of work."""
    monkeypatch.setattr(SearchBudget, "spent", property(lambda self: self.work > work))


def certified(plan: Plan) -> bool:
    return plan.certificate is not None and plan.certificate.certified and certify(plan).certified


def test_a_request_needs_no_more_images_than_its_stricter_siblings() -> None:
    plan = whole_plan()
    assert certified(plan)
    assert len(plan.shots) <= 25
    assert not plan.notes


def test_a_spent_budget_ends_with_the_best_certified_plan_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = whole_plan()
    spent_after(monkeypatch, 3_000)
    plan = plan_certified(MAPPER, SPHERE, budget_s=7.0)
    assert certified(plan)
    assert len(plan.shots) > len(whole.shots)
    (note,) = plan.notes
    assert note.startswith("the search ended at its budget of 7 s of processor time")
    assert note.endswith(f"may find fewer images, but in even rows not fewer than {plan.lower_bound}")


def test_a_budget_that_is_spent_before_any_plan_is_an_error_that_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    spent_after(monkeypatch, 0)
    with pytest.raises(PlanningError, match=r"within the budget of 2 s .*--budget"):
        plan_certified(MAPPER, SPHERE, budget_s=2.0)


def test_a_budget_that_is_not_reached_changes_nothing() -> None:
    camera = Camera.from_fov(60.0, 47.0)
    constraints = replace(SPHERE, overlap_h=0.1, overlap_v=0.1, band=replace(SPHERE.band, elevation_max_deg=-20.0))
    assert plan_certified(camera, constraints, budget_s=600.0) == plan_certified(camera, constraints)


def test_the_clock_ends_a_search() -> None:
    budget = SearchBudget(0.0)
    assert budget.spent
    assert not SearchBudget(None).spent
    assert not SearchBudget(60.0).spent


def test_the_daemons_process_outlives_every_budget() -> None:
    assert DEFAULT_BUDGET_S <= MOST_BUDGET_S <= CPU_S - 60


def test_siblings_are_stricter_and_within_range() -> None:
    top = replace(SPHERE, overlap_h=0.9, overlap_v=0.9, band=replace(SPHERE.band, elevation_max_deg=89.5))
    some = list(siblings(top))
    assert some
    for one in some:
        assert top.overlap_h <= one.overlap_h < 1
        assert top.overlap_v <= one.overlap_v < 1
        assert one.band.elevation_min_deg == -90.0
        assert 89.5 <= one.band.elevation_max_deg <= 90.0
        assert one != top


@pytest.mark.parametrize(
    ("h", "v", "uncovered", "edges", "expected"),
    [
        (0.14, 0.2, 0.0, True, (0.0, 0.0102)),
        (0.2, 0.14, 0.0, True, (0.0102, 0.0)),
        (0.2, 0.2, 0.1, True, (0.002, 0.0)),
        (0.14, 0.14, 0.0, True, (0.0102, 0.0102)),
        (0.05, 0.2, 0.0, True, None),
        (0.14, 0.2, 0.0, False, None),
    ],
    ids=["C2", "C3", "C1", "both", "far off", "C4"],
)
def test_what_is_missing_for_c2_is_planned_again_as_for_c1_and_c3(
    h: float, v: float, uncovered: float, edges: bool, expected: tuple[float, float] | None
) -> None:
    certificate = Certificate(
        certified=False,
        images=9,
        min_overlap_h=h,
        min_overlap_v=v,
        worst_overlap_h=0.0,
        worst_overlap_v=0.0,
        uncovered_fraction=uncovered,
        connected=edges,
        two_edge_connected=edges,
    )
    lack = missing(certificate, replace(SPHERE, overlap_h=0.15, overlap_v=0.15))
    if expected is None:
        assert lack is None
    else:
        assert lack is not None
        assert (lack.margin, lack.across) == pytest.approx(expected)
