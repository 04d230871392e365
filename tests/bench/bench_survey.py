"""The planner over 500 seeded requests (tests/support/plan_requests.py), and the standard cases beside others' counts.

Every certified plan is judged a second time, by counting (tests/support/plan_judge.py).

Takes a core for half an hour, so it runs only where it is named: `make bench ARGS=survey`. PANOEXEC_SURVEY sets
another number of requests, PANOEXEC_SURVEY_LIST a file for a line about each.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.baselines.published import A6000_35MM, PAPER_TOLERANCE, X5S_15MM, X5S_45MM
from panoexec.planning.model import NO_TOLERANCE, Band, Constraints, Plan, Tolerance
from panoexec.planning.search.budget import DEFAULT_BUDGET_S
from panoexec.planning.search.planner import plan_certified
from tests.bench.harness import Measurement
from tests.support.plan_judge import violations
from tests.support.plan_requests import SURVEY, request_of, stricter

_REFUSALS = (
    ("gimbal's", "the gimbal does not reach it"),
    ("gimbal pans", "the gimbal does not pan to it"),
    ("masks leave nothing", "masks leave nothing"),
    ("not guaranteed to see", "tolerances larger than an image"),
    ("infeasible", "overlap infeasible with the tolerances"),
    ("of these tolerances", "tolerances infeasible"),
    ("above the limit", "too much overlap"),
    ("within the budget", "budget"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A standard case: what it asks for, others' count (ISAAC's, or of the paper's table), and the most it may need."""

    name: str
    camera: Camera
    constraints: Constraints
    others: int
    goal: int


def standard_cases() -> list[Case]:
    """The paper's scenarios with the nominal lens, and NASA ISAAC's seven cases (field of view less its tolerance)."""
    return [
        _case("Scenario 1 (published)", X5S_15MM.with_lens("nominal"), 0.15, (-90, 50.5), (25, 21), PAPER_TOLERANCE),
        _case("Scenario 2 (published)", X5S_45MM.with_lens("nominal"), 0.15, (-90, 37.7), (155, 134), PAPER_TOLERANCE),
        _case("Scenario 3 (published)", A6000_35MM.with_lens("nominal"), 0.15, (-90, 12.2), (49, 40), PAPER_TOLERANCE),
        _case("ISAAC 0, spherical", Camera.from_fov(54.0, 39.8), 0.3, (-90, 90), (56, 42)),
        _case("ISAAC 1, directional", Camera.from_fov(52.0, 37.8), 0.3, (-30, 30), (12, 8), azimuth=(-60, 60)),
        _case("ISAAC 2, one row", Camera.from_fov(53.0, 53.0), 0.3, (-5, 5), (4, 4), azimuth=(-60, 60)),
        _case("ISAAC 3, one column", Camera.from_fov(53.0, 53.0), 0.3, (-60, 60), (4, 4), azimuth=(-0.05, 0.05)),
        _case("ISAAC 4, mapper", Camera.from_fov(54.0, 42.7), 0.0, (-90, 90), (29, 25)),
        _case("ISAAC 5, mapper and hugin", Camera.from_fov(56.2, 42.7), 0.3, (-90, 90), (56, 37)),
        _case("ISAAC 6, nav and hugin", Camera.from_fov(110.9, 80.4), 0.3, (-90, 90), (15, 11)),
    ]


def measure() -> Iterator[Measurement]:
    """Verdicts, time and images of the survey; images of the standard cases."""
    yield from _standard()
    yield from _survey(int(os.environ.get("PANOEXEC_SURVEY", SURVEY)))


def _standard() -> Iterator[Measurement]:
    for case in standard_cases():
        plan = plan_certified(case.camera, case.constraints)
        assert plan.certificate is not None
        yield Measurement(
            what=f"{case.name}: certified plan, lower bound {plan.lower_bound}",
            ours=len(plan.shots),
            unit="images",
            peer="ISAAC" if case.name.startswith("ISAAC") else "published",
            theirs=case.others,
            goal=f"at most {case.goal}",
            met=plan.certificate.certified and len(plan.shots) <= case.goal,
        )


def _survey(count: int) -> Iterator[Measurement]:
    verdicts: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    seconds: list[float] = []
    above: list[float] = []
    kinds: Counter[str] = Counter()
    for seed in range(count):
        kinds.update(_kinds(*request_of(seed)))
        verdict, plan, took = _judged(seed)
        seconds.append(took)
        verdicts[verdict.partition(":")[0]] += 1
        verdicts["slow"] += took > DEFAULT_BUDGET_S
        if verdict.startswith("refused"):
            refused[verdict.partition(": ")[2]] += 1
        if plan is not None and plan.lower_bound:
            above.append(len(plan.shots) / plan.lower_bound)
        _note(f"{seed} {took:.2f} s {verdict} {0 if plan is None else len(plan.shots)}")
    for kind, times in kinds.most_common():
        yield Measurement(what=f"{count} requests, of them {kind}", ours=times, unit="requests")
    yield Measurement(what="certified", ours=verdicts["certified"], unit="requests")
    yield Measurement(what="refused with a reason", ours=verdicts["refused"], unit="requests")
    for reason, times in refused.most_common():
        yield Measurement(what=f"  {reason}", ours=times, unit="requests")
    yield Measurement(what="uncertified, as are their siblings", ours=verdicts["uncertified"], unit="requests")
    for what, key in (
        ("uncertified, where a stricter one is certified", "beaten"),
        ("slower than the budget", "slow"),
        ("wrong, against brute force", "wrong"),
    ):
        yield Measurement(what=what, ours=verdicts[key], unit="requests", goal="none", met=verdicts[key] == 0)
    for what, value, most in (("median", 50.0, 1.0), ("99th percentile", 99.0, DEFAULT_BUDGET_S)):
        took = float(np.percentile(seconds, value))
        yield Measurement(
            what=f"processor time, {what}", ours=took, unit="s", goal=f"at most {most:g} s", met=took <= most
        )
    yield Measurement(what="images over the lower bound, median", ours=float(np.median(above)), unit="times")


def _judged(seed: int) -> tuple[str, Plan | None, float]:
    """The verdict on a request, its plan, and the processor time that planning took, seconds."""
    camera, constraints = request_of(seed)
    began = time.thread_time()
    try:
        plan = plan_certified(camera, constraints, budget_s=DEFAULT_BUDGET_S)
    except PlanningError as error:
        reason = next((name for part, name in _REFUSALS if part in str(error)), str(error)[:60])
        return f"refused: {reason}", None, time.thread_time() - began
    took = time.thread_time() - began
    assert plan.certificate is not None
    if plan.certificate.certified:
        broken = violations(plan, seed)
        return f"wrong: {'; '.join(broken[:3])}" if broken else "certified", plan, took
    for _, sibling in stricter(constraints):
        with contextlib.suppress(PlanningError):
            other = plan_certified(camera, sibling, budget_s=DEFAULT_BUDGET_S)
            if other.certificate is not None and other.certificate.certified:
                return "beaten", None, took
    return "uncertified", None, took


def _kinds(camera: Camera, constraints: Constraints) -> Iterator[str]:
    """What is special about a request."""
    if constraints.textured_below is not None:
        yield "with a sky"
    if camera.is_calibrated:
        yield "with a calibrated lens"
    if camera.distortion_used is not None:
        yield "with distortion"
    if not constraints.band.is_full_circle:
        yield "sectors" if constraints.band.azimuth_max_deg <= 180.0 else "sectors across ±180°"
    if constraints.masks:
        yield "with a mask"
    if constraints.gimbal is not None:
        yield "with a gimbal's limits"
    if constraints.guarantee == "all":
        yield "for all errors"


def _case(
    name: str,
    camera: Camera,
    overlap: float,
    elevation: tuple[float, float],
    counts: tuple[int, int],
    tolerance: Tolerance = NO_TOLERANCE,
    *,
    azimuth: tuple[float, float] = (-180.0, 180.0),
) -> Case:
    band = Band(elevation_min_deg=elevation[0], elevation_max_deg=elevation[1])
    band = replace(band, azimuth_min_deg=azimuth[0], azimuth_max_deg=azimuth[1])
    constraints = Constraints(overlap_h=overlap, overlap_v=overlap, band=band, tolerance=tolerance)
    return Case(name=name, camera=camera, constraints=constraints, others=counts[0], goal=counts[1])


def _note(line: str) -> None:
    path = os.environ.get("PANOEXEC_SURVEY_LIST")
    if path:
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(line + "\n")
