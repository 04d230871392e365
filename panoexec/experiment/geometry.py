"""Exact holes of a plan with pointing errors, by geometry alone, without photos.

A stitcher cannot recover parts of the ground that no photo shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from panoexec.experiment.capture import PointingErrors, Spread, true_rotations
from panoexec.experiment.cases import Case, plan_of
from panoexec.planning.baselines.published import PAPER_TOLERANCE
from panoexec.planning.certificate.holes import coverage_holes
from panoexec.planning.model import NO_TOLERANCE, Plan

HORIZON_DEG: Final = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Flights:
    """The results of a plan over all seeds.

    Attributes:
        scenario, plan: the case.
        images: number of images of the plan.
        runs: number of seeds.
        complete: runs whose photos cover all of the ground.
        holes: the most holes in one run.
        largest_deg: size of the largest hole of all runs, 0 without one.
        elevation_deg: its elevation; None without one.
    """

    scenario: int
    plan: str
    images: int
    runs: int
    complete: int
    holes: int
    largest_deg: float
    elevation_deg: float | None


def fly(wanted: Sequence[Case], spread: Spread) -> list[Flights]:
    """Compute the exact holes in the ground for all cases.

    Args:
        wanted: from `cases`; repeats have the same result.
        spread: distribution of the pointing errors.
    """
    seeds: dict[tuple[int, str], set[int]] = {}
    for case in wanted:
        seeds.setdefault((case.scenario, case.plan), set()).add(case.seed)
    return [
        _flights(scenario, name, plan_of(scenario, name), sorted(numbers), spread)
        for (scenario, name), numbers in sorted(seeds.items(), key=lambda item: item[0][0])
    ]


def _flights(scenario: int, name: str, plan: Plan, seeds: Sequence[int], spread: Spread) -> Flights:
    band = plan.constraints.band
    ground = replace(
        plan.constraints,
        band=replace(band, elevation_max_deg=min(band.elevation_max_deg, HORIZON_DEG)),
        tolerance=NO_TOLERANCE,
    )
    found = []
    for seed in seeds:
        errors = PointingErrors(size=PAPER_TOLERANCE, spread=spread, seed=seed)
        found.append([region.hole for region in coverage_holes(plan.camera, ground, true_rotations(plan, errors))])
    largest = max((hole for holes in found for hole in holes), key=lambda hole: hole.size_deg, default=None)
    return Flights(
        scenario=scenario,
        plan=name,
        images=len(plan.shots),
        runs=len(seeds),
        complete=sum(1 for holes in found if not holes),
        holes=max(len(holes) for holes in found),
        largest_deg=0.0 if largest is None else largest.size_deg,
        elevation_deg=None if largest is None else largest.elevation_deg,
    )
