"""A panorama to be planned, with nothing left open: what command line, daemon and doctor hand to the planner.

This module does not import pydantic, so that the planner's process starts at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from panoexec.optics import Camera
from panoexec.planning.cautions import cautions
from panoexec.planning.make_plan import finished, make_plan
from panoexec.planning.model import Constraints, Plan, Timing
from panoexec.planning.order.shot_order import Order
from panoexec.planning.reach import check_not_rolled
from panoexec.planning.request import check_request
from panoexec.planning.search.budget import DEFAULT_BUDGET_S


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanSpec:
    """A panorama to be planned, or a given plan to be judged.

    Attributes:
        camera: optics, as mounted.
        constraints: what the plan must satisfy.
        method: planner, one of `panoexec.planning.make_plan.METHODS`.
        order: of shooting.
        timing: what a shot costs besides the slew.
        columns: for hdrpano: images at the horizon.
        rows: for hdrpano.
        budget_s: for certified: processor time of the search.
        given: a plan that is only certified and estimated, as it is; method, order, columns and rows do not apply.
    """

    camera: Camera
    constraints: Constraints
    method: str = "certified"
    order: Order = "fastest"
    timing: Timing = field(default_factory=Timing)
    columns: int | None = None
    rows: int | None = None
    budget_s: float = DEFAULT_BUDGET_S
    given: Plan | None = None

    def plan(self) -> Plan:
        """Plan, certify and estimate, with cautions as notes; takes seconds, or minutes, and a core.

        Raises:
            PlanningError: no plan can satisfy the constraints, or the given one cannot be flown.
        """
        made = self._made()
        return replace(made, notes=(*made.notes, *cautions(made.certificate)))

    def _made(self) -> Plan:
        if self.given is not None:
            check_not_rolled(self.given.shots)
            check_request(self.given.camera, self.given.constraints)
            return finished(self.given, self.timing)
        return make_plan(
            self.camera,
            self.constraints,
            method=self.method,
            timing=self.timing,
            order=self.order,
            columns=self.columns,
            rows=self.rows,
            budget_s=self.budget_s,
        )
