"""A plan keeps within its budget on every way to its end, by a clock that advances with what is computed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.certificate import verdict
from panoexec.planning.model import AngleBox, Band, Certificate, Constraints, Plan, Tolerance
from panoexec.planning.search import infeasible, planner, proposal, thinning
from panoexec.planning.search.budget import BudgetSpentError, SearchBudget
from panoexec.planning.search.infeasible import infeasibility_error
from panoexec.planning.search.planner import plan_certified
from panoexec.planning.search.row_pairs import PairMargin
from panoexec.planning.search.row_spacing import NeighbourDemand

CAMERA = Camera.from_fov(40.0, 30.0)
BAND = Constraints(overlap_h=0.15, overlap_v=0.15, band=Band(elevation_min_deg=-50.0, elevation_max_deg=20.0))
MASKED = replace(
    BAND, masks=(AngleBox(elevation_min_deg=-30, elevation_max_deg=20, azimuth_min_deg=-60, azimuth_max_deg=60),)
)
INFEASIBLE = Constraints(
    overlap_h=0.8,
    overlap_v=0.1,
    band=Band(elevation_min_deg=-10.0, elevation_max_deg=10.0, azimuth_min_deg=0.0, azimuth_max_deg=60.0),
    tolerance=Tolerance(pitch_deg=0.5, roll_deg=0.5, yaw_deg=6.0),
    guarantee="all",
)

IMAGE_S, PAIR_S, SPACING_S, SHOT_S = 4e-3, 1e-4, 1e-5, 5e-4
"""What a verdict takes for each image, and each pair of rows, spacing and shot in order."""


class Clock:
    """Processor time that advances with what is computed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.verdicts = 0
        self.longest = 0.0
        monkeypatch.setattr(time, "thread_time", lambda: self.now)
        for module in (proposal, thinning, verdict):
            self.charge(monkeypatch, module, "certify_poses", lambda args: IMAGE_S * len(args[2]))
        self.charge(monkeypatch, PairMargin, "overlap_margins", lambda args: PAIR_S * len(args[1]))
        self.charge(monkeypatch, NeighbourDemand, "surplus", lambda args: SPACING_S * len(args[2]))
        self.charge(monkeypatch, planner, "order_shots", lambda args: SHOT_S * len(args[0]))

    def charge(self, patch: pytest.MonkeyPatch, owner: Any, name: str, seconds: Callable[[Any], float]) -> None:
        """Let a function take time."""
        real = getattr(owner, name)

        def charged(*args: Any, **named: Any) -> Any:
            took = seconds(args)
            self.longest = max(self.longest, took)
            self.now += took
            self.verdicts += name == "certify_poses"
            return real(*args, **named)

        patch.setattr(owner, name, charged)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def certified(plan: Plan) -> bool:
    return plan.certificate is not None and plan.certificate.certified


def test_dropping_images_that_see_masks_ends_with_the_budget(clock: Clock) -> None:
    whole = plan_certified(CAMERA, MASKED)
    took, verdicts = clock.now, clock.verdicts
    assert not whole.notes
    clock.now, clock.verdicts = 0.0, 0
    budget_s = 0.8 * took
    plan = plan_certified(CAMERA, MASKED, budget_s=budget_s)
    assert certified(plan)
    assert clock.now <= budget_s
    assert clock.verdicts < verdicts
    assert len(plan.shots) >= len(whole.shots)
    assert plan.notes[0].startswith("the search ended at its budget")


@pytest.mark.parametrize("budget_s", [1.5, 4.0])
def test_an_uncertified_plan_is_explained_within_the_budget(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, budget_s: float
) -> None:
    for module in (proposal, verdict):
        real = module.certify_poses

        def failed(*args: Any, real: Callable[..., Certificate] = real, **named: Any) -> Certificate:
            found = real(*args, **named)
            return replace(found, certified=False, two_edge_connected=False, failures=("C4: made to fail",))

        monkeypatch.setattr(module, "certify_poses", failed)
    plan = plan_certified(CAMERA, BAND, budget_s=budget_s)
    assert clock.now <= budget_s
    assert not certified(plan)
    assert plan.certificate is not None
    assert plan.certificate.failures == ("C4: made to fail",)
    assert [shot.index for shot in plan.shots] == list(range(len(plan.shots)))


def test_an_infeasible_request_is_refused_within_the_budget_with_what_is_known_of_the_reason(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(infeasible, "_BISECTIONS", 2)
    with pytest.raises(PlanningError, match=r"horizontal overlap of 0\.8 .* the maximum is about 0\.\d+") as refusal:
        plan_certified(CAMERA, INFEASIBLE)
    whole, took = str(refusal.value), clock.now
    texts = []
    for share in (0.2, 0.6):
        clock.now = 0.0
        budget = SearchBudget(share * took)
        budget.reserve(0.0)
        texts.append(str(infeasibility_error(CAMERA, INFEASIBLE, budget)))
        assert clock.now <= share * took + clock.longest
    assert texts[0] != whole
    assert all(text == whole or "ended the search for a closer reason" in text for text in texts)
    assert any("infeasible" in text and text != whole for text in texts)


@pytest.mark.parametrize("share", [0.5, 0.7, 0.8, 0.9, 0.95])
def test_a_refusal_does_not_exceed_its_budget_by_a_piece_of_the_analysis(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    monkeypatch.setattr(infeasible, "_BISECTIONS", 2)
    with pytest.raises(PlanningError):
        plan_certified(CAMERA, INFEASIBLE)
    budget_s = share * clock.now
    clock.now = 0.0
    with pytest.raises(PlanningError):
        plan_certified(CAMERA, INFEASIBLE, budget_s=budget_s)
    assert clock.now <= budget_s


def test_what_does_not_fit_any_more_is_not_begun() -> None:
    now = [0.0]
    budget = SearchBudget(10.0, clock=lambda: now[0])
    budget.use(seconds=8.9)
    with pytest.raises(BudgetSpentError):
        budget.use(seconds=9.1)  # a tenth is reserved
    budget.reserve(3.0)
    with pytest.raises(BudgetSpentError):
        budget.use(seconds=8.0)
    now[0] = 6.9
    budget.use()
    now[0] = 7.1
    assert budget.spent
    assert budget.left == pytest.approx(2.9)
    budget.reserve(1e9)
    now[0] = 3.9
    assert not budget.spent  # at most six tenths are reserved
    SearchBudget(None).use(seconds=1e9)
