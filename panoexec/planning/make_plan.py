"""Make a complete plan with the requested method: shots, order, certificate, estimate."""

from __future__ import annotations

from dataclasses import replace

from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.certificate.texture import mark_geometry_only
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Constraints, GimbalLimits, Plan, Timing
from panoexec.planning.order.duration import estimate
from panoexec.planning.order.shot_order import Order, order_shots

METHODS = ("certified", "paper", "hdrpano")


def make_plan(
    camera: Camera,
    constraints: Constraints,
    *,
    method: str,
    timing: Timing,
    order: Order,
    columns: int | None = None,
    rows: int | None = None,
    budget_s: float | None = None,
) -> Plan:
    """Make a plan, order its shots, certify it and estimate its duration.

    Args:
        camera: the camera.
        constraints: the constraints to satisfy.
        method: one of `METHODS`.
        timing: settle time, exposure time and camera interval.
        order: the order of the shots.
        columns: hdrpano only: images at the horizon.
        rows: hdrpano only: steps between rows.
        budget_s: certified only: processor time of the search, see `panoexec.planning.search.budget`; None: no limit.

    Returns:
        The plan; its certificate says whether it satisfies the constraints.

    Raises:
        PlanningError: no plan can satisfy the constraints, or a parameter of the method is missing.
    """
    # lazy imports: each method is slow to import and only one is used
    if method == "certified":
        from panoexec.planning.search.planner import plan_certified  # noqa: PLC0415

        return plan_certified(camera, constraints, timing=timing, order=order, budget_s=budget_s)
    if method == "hdrpano":
        from panoexec.planning.baselines.hdrpano import plan_hdrpano  # noqa: PLC0415

        if not (columns and rows):
            raise PlanningError("method hdrpano needs a number of columns and of rows")
        return finished(plan_hdrpano(camera, constraints, columns=columns, rows=rows), timing, order=order)
    from panoexec.planning.baselines.paper import plan_paper  # noqa: PLC0415

    return finished(plan_paper(camera, constraints), timing, order=order)


def finished(plan: Plan, timing: Timing, *, order: Order | None = None) -> Plan:
    """The plan with its shots ordered (unchanged if `order` is None), certified and estimated."""
    limits = plan.constraints.gimbal or GimbalLimits()
    plan = replace(plan, shots=mark_geometry_only(plan.camera, plan.constraints, plan.shots))
    if order is not None:
        plan = replace(plan, shots=order_shots(plan.shots, limits, timing, order=order))
    return replace(
        plan,
        certificate=plan.certificate or certify(plan),
        estimate=estimate(plan.shots, plan.camera, limits, timing, plan.constraints.band),
    )
