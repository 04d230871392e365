"""Suggestions that would meet a budget of images or time: a smaller overlap, or a lower top of the band."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from panoexec.errors import PlanningError
from panoexec.planning.model import Constraints, Plan
from panoexec.planning.order.duration import budget_problems

_OVERLAP_STEP = 0.01
_ELEVATION_STEP_DEG = 1.0


def what_would_fit(
    constraints: Constraints,
    plan_with: Callable[[Constraints], Plan],
    *,
    max_images: int | None,
    max_duration_s: float | None,
) -> str:
    """Describe the overlap, and the band, that would meet the budget.

    Bisection finds the largest overlap in steps of 0.01 and the highest band end in steps of 1°, each with all other
    constraints unchanged. A larger value is assumed never to need fewer images (true to within an image or two).

    Args:
        constraints: the requested constraints, which exceed the budget.
        plan_with: makes the plan, with its estimate, for other constraints.
        max_images: as for `check_budget`.
        max_duration_s: as for `check_budget`.

    Returns:
        A sentence for the error message.
    """

    def plan_that_fits(changed: Constraints) -> Plan | None:
        try:
            plan = plan_with(changed)
        except PlanningError:
            return None
        return None if budget_problems(plan, max_images=max_images, max_duration_s=max_duration_s) else plan

    return _sentence([_smaller_overlap(constraints, plan_that_fits), _lower_band(constraints, plan_that_fits)])


def _smaller_overlap(constraints: Constraints, plan_that_fits: Callable[[Constraints], Plan | None]) -> str:
    larger = max(constraints.overlap_h, constraints.overlap_v)
    share = min(constraints.overlap_h, constraints.overlap_v) / larger if larger else 0.0

    def with_overlap(steps: int) -> Constraints:
        overlap = steps * _OVERLAP_STEP
        horizontal = overlap if constraints.overlap_h == larger else overlap * share
        vertical = overlap if constraints.overlap_v == larger else overlap * share
        return replace(constraints, overlap_h=horizontal, overlap_v=vertical)

    found = _largest(lambda steps: plan_that_fits(with_overlap(steps)), int(larger / _OVERLAP_STEP))
    if found is None:
        return ""
    steps, plan = found
    changed = with_overlap(steps)
    text = f"--overlap {changed.overlap_h:.2g}"
    if changed.overlap_h != changed.overlap_v:
        text = f"--overlap-h {changed.overlap_h:.2g} --overlap-v {changed.overlap_v:.2g}"
    return f"{text} ({_cost(plan)})"


def _lower_band(constraints: Constraints, plan_that_fits: Callable[[Constraints], Plan | None]) -> str:
    low, high = constraints.band.elevation_min_deg, constraints.band.elevation_max_deg

    def with_top(steps: int) -> Constraints:
        top = low + steps * _ELEVATION_STEP_DEG
        return replace(constraints, band=replace(constraints.band, elevation_max_deg=top))

    found = _largest(lambda steps: plan_that_fits(with_top(steps)) if steps else None, int(high - low), least=1)
    if found is None:
        return ""
    steps, plan = found
    return f"--elevation {low:g} {low + steps * _ELEVATION_STEP_DEG:g} ({_cost(plan)})"


def _largest(fits: Callable[[int], Plan | None], most: int, least: int = 0) -> tuple[int, Plan] | None:
    """The largest integer in [least, most] that fits, with its plan; None if not even `least` fits."""
    best = fits(least)
    if best is None:
        return None
    low, high = least, most + 1
    while high - low > 1:
        middle = (low + high) // 2
        plan = fits(middle)
        if plan is None:
            high = middle
        else:
            low, best = middle, plan
    return low, best


def _cost(plan: Plan) -> str:
    duration = f", {plan.estimate.duration_s:.0f} s" if plan.estimate else ""
    return f"{len(plan.shots)} images{duration}"


def _sentence(options: list[str]) -> str:
    possible = [option for option in options if option]
    if not possible:
        return "no overlap and no lower band would fit"
    return " or ".join(possible) + " would fit"
