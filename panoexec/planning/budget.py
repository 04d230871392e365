"""What would fit a budget of images or seconds: the constraints are never loosened silently, but options are named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from panoexec.errors import PlanningError
from panoexec.planning.model import Band, Constraints, Plan

_OVERLAP_STEP = 0.01
_BAND_STEP_DEG = 0.5


def fit_suggestions(
    constraints: Constraints, make: Callable[[Constraints], Plan], fits: Callable[[Plan], bool]
) -> list[str]:
    """What would fit: the largest overlap with the band as it is, and the highest upper end with the overlap as it is.

    Found by bisection, which takes the number of images to grow with both.

    Args:
        constraints: what was asked for and does not fit.
        make: plans for other constraints; may raise PlanningError.
        fits: whether a plan fits the budget.

    Returns:
        A sentence for each that there is; empty if neither alone can help.
    """

    def suits(changed: Constraints) -> Plan | None:
        try:
            plan = make(changed)
        except PlanningError:
            return None
        certified = plan.certificate is None or plan.certificate.certified
        return plan if certified and fits(plan) else None

    return [*_overlap_that_fits(constraints, suits), *_band_that_fits(constraints, suits)]


def _overlap_that_fits(constraints: Constraints, suits: Callable[[Constraints], Plan | None]) -> Iterator[str]:
    steps = int(max(constraints.overlap_h, constraints.overlap_v) / _OVERLAP_STEP)

    def at(step: int) -> Constraints:
        less = step * _OVERLAP_STEP
        h, v = max(0.0, constraints.overlap_h - less), max(0.0, constraints.overlap_v - less)
        return replace(constraints, overlap_h=round(h, 6), overlap_v=round(v, 6))

    step, plan = _first(steps, lambda k: suits(at(k)))
    if plan is not None:
        made = at(step)
        overlap = (
            f"{made.overlap_h:g}" if made.overlap_h == made.overlap_v else f"{made.overlap_h:g}/{made.overlap_v:g}"
        )
        yield f"overlap {overlap} would fit ({_cost(plan)})"


def _band_that_fits(constraints: Constraints, suits: Callable[[Constraints], Plan | None]) -> Iterator[str]:
    band = constraints.band
    steps = int((band.elevation_max_deg - band.elevation_min_deg) / _BAND_STEP_DEG) - 1

    def at(step: int) -> Constraints:
        top = band.elevation_max_deg - step * _BAND_STEP_DEG
        return replace(constraints, band=_lowered(band, top))

    step, plan = _first(steps, lambda k: suits(at(k)))
    if plan is not None:
        made = at(step).band
        yield f"elevation {made.elevation_min_deg:g} to {made.elevation_max_deg:g}° would fit ({_cost(plan)})"


def _lowered(band: Band, top_deg: float) -> Band:
    return replace(band, elevation_max_deg=top_deg)


def _first(most: int, at: Callable[[int], Plan | None]) -> tuple[int, Plan | None]:
    """The smallest step in 1..most that suits, by bisection, and its plan."""
    if most < 1:
        return 0, None
    low, high, found = 0, most, at(most)
    if found is None:
        return 0, None
    while high - low > 1:
        middle = (low + high) // 2
        plan = at(middle)
        if plan is None:
            low = middle
        else:
            high, found = middle, plan
    return high, found


def _cost(plan: Plan) -> str:
    duration = "" if plan.estimate is None else f", about {plan.estimate.duration_s:.0f} s"
    return f"{len(plan.shots)} images{duration}"
