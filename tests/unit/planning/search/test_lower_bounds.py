"""The lower bounds are computed when they are needed, and as far as they are needed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.model import Band, Constraints, GimbalLimits
from panoexec.planning.search import lower_bounds
from panoexec.planning.search.budget import SearchBudget
from panoexec.planning.search.lower_bounds import LowerBounds
from panoexec.planning.search.planner import plan_certified
from panoexec.planning.search.row_bound import least_images_in_rows

CAMERA = Camera.from_fov(56.2, 42.7)
SPHERE = Constraints(overlap_h=0.3, overlap_v=0.3, band=Band(elevation_min_deg=-90.0, elevation_max_deg=90.0))
POLE = replace(SPHERE, band=Band(elevation_min_deg=-90.0, elevation_max_deg=-75.0))


@pytest.fixture
def asked_for(monkeypatch: pytest.MonkeyPatch) -> list[int | None]:
    """The numbers of images for which the bound of rows was computed."""
    calls: list[int | None] = []

    def counted(*args: Any, **options: Any) -> int | None:
        calls.append(options["images"])
        return least_images_in_rows(*args, **options)

    monkeypatch.setattr(lower_bounds, "least_images_in_rows", counted)
    return calls


def test_a_plan_of_one_image_and_a_refusal_need_no_bound_of_rows(asked_for: list[int | None]) -> None:
    plan = plan_certified(CAMERA, POLE)
    assert len(plan.shots) == plan.lower_bound == 1
    with pytest.raises(PlanningError):
        plan_certified(CAMERA, replace(SPHERE, gimbal=GimbalLimits(pitch_max_deg=20.0)))
    assert asked_for == []


def test_the_bound_of_rows_is_computed_once_for_the_first_certified_plan(asked_for: list[int | None]) -> None:
    plan = plan_certified(CAMERA, replace(SPHERE, overlap_h=0.15, overlap_v=0.15))
    assert len(asked_for) == 1
    assert asked_for[0] is not None
    assert plan.lower_bound is not None
    assert plan.lower_bound <= len(plan.shots) <= asked_for[0]


@pytest.mark.parametrize("images", [36, 37, 38, 60])
def test_a_known_plan_changes_the_bound_only_above_its_number_of_images(images: int) -> None:
    whole = least_images_in_rows(CAMERA, SPHERE)
    found = least_images_in_rows(CAMERA, SPHERE, images=images)
    assert whole is not None
    assert found is not None
    assert found <= whole
    if images <= whole + 1:
        assert found == min(whole, images)


def test_without_time_the_bound_is_what_is_known_at_once() -> None:
    hurried = least_images_in_rows(CAMERA, SPHERE, go_on=lambda: False)
    whole = least_images_in_rows(CAMERA, SPHERE)
    assert hurried is not None
    assert whole is not None
    assert 1 < hurried < whole


def test_the_bound_leaves_the_time_that_is_reserved() -> None:
    now = [0.0]
    budget = SearchBudget(10.0, clock=lambda: now[0])
    budget.reserve(5.0)
    now[0] = 6.0
    whole = LowerBounds(CAMERA, SPHERE, SearchBudget()).in_rows(None)
    assert LowerBounds(CAMERA, SPHERE, budget).in_rows(None) < whole
    assert LowerBounds(CAMERA, SPHERE, budget).in_rows(None, after_s=4.5) < whole
    assert LowerBounds(CAMERA, SPHERE, budget).in_rows(None, after_s=3.0) == whole
