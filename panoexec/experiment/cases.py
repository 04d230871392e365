"""The cases: scenarios and plans, with the paper's results (Table 2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from panoexec.errors import UsageError
from panoexec.planning.baselines.published import published_plan
from panoexec.planning.make_plan import make_plan
from panoexec.planning.model import Plan, Timing

PLANS: Final = ("proposed", "hdrpano", "certified")
DEFAULT_WIDTH_PX: Final[Mapping[int, int]] = MappingProxyType({1: 640, 2: 420, 3: 520})
"""Width of the rendered photos, a tenth of the camera's or less: enough for control points everywhere on the ground."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Published:
    """A line of Table 2.

    Attributes:
        images: number of images.
        completeness: fraction, equation (8).
    """

    images: int
    completeness: float


TABLE_2: Final[Mapping[tuple[int, str], Published]] = MappingProxyType(
    {
        (1, "proposed"): Published(images=25, completeness=1.0),
        (1, "hdrpano"): Published(images=28, completeness=1.0),
        (2, "proposed"): Published(images=155, completeness=1.0),
        (2, "hdrpano"): Published(images=161, completeness=0.9997),
        (3, "proposed"): Published(images=49, completeness=1.0),
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One capture to be stitched.

    Attributes:
        scenario: 1 to 3.
        plan: one of `PLANS`.
        seed: random seed of the pointing errors.
        repeat: from 1; the search for control points is not deterministic.
    """

    scenario: int
    plan: str
    seed: int
    repeat: int = 1

    @property
    def name(self) -> str:
        """The name of its folder."""
        return f"scenario-{self.scenario}-{self.plan}-seed-{self.seed}-run-{self.repeat}"


def cases(scenarios: tuple[int, ...], plans: tuple[str, ...], seeds: int, repeats: int) -> list[Case]:
    """All requested cases, ordered by seed, so that an interrupted run is useful.

    Raises:
        UsageError: none of the plans exists for these scenarios.
    """
    pairs = [(s, p) for s in scenarios for p in plans if (s, p) in TABLE_2 or p == "certified"]
    if not pairs:
        raise UsageError("the paper has no HDRpano plan for Scenario 3: choose proposed or certified")
    return [
        Case(scenario=scenario, plan=plan, seed=seed, repeat=repeat)
        for seed in range(1, seeds + 1)
        for repeat in range(1, repeats + 1)
        for scenario, plan in pairs
    ]


def plan_of(scenario: int, plan: str) -> Plan:
    """The plan: as published, or certified for the same camera, band, thresholds and tolerances."""
    if plan != "certified":
        return published_plan(f"scenario-{scenario}-{plan}")
    published = published_plan(f"scenario-{scenario}-proposed")
    return make_plan(published.camera, published.constraints, method="certified", timing=Timing(), order="fastest")
