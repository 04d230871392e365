"""A plan by the method asked for, with everything that belongs to it: order, certificate, estimate."""

from __future__ import annotations

from dataclasses import replace

from panoexec.errors import PlanningError
from panoexec.optics import Camera
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
) -> Plan:
    """The plan, certified or found wanting, ordered and estimated.

    Args:
        camera: to cover the band with.
        constraints: to satisfy.
        method: one of `METHODS`.
        timing: what a shot costs.
        order: of shooting.
        columns: for hdrpano: images at the horizon.
        rows: for hdrpano.

    Raises:
        PlanningError: no plan can satisfy the constraints, or the method needs what is missing.
    """
    # imported here, as each method is heavy and one is used
    if method == "certified":
        from panoexec.planning.search.planner import plan_certified  # noqa: PLC0415

        return plan_certified(camera, constraints, timing=timing, order=order)
    if method == "hdrpano":
        from panoexec.planning.baselines.hdrpano import plan_hdrpano  # noqa: PLC0415

        if not (columns and rows):
            raise PlanningError("method hdrpano needs a number of columns and of rows")
        return finished(plan_hdrpano(camera, constraints, columns=columns, rows=rows), timing, order=order)
    from panoexec.planning.baselines.paper import plan_paper  # noqa: PLC0415

    return finished(plan_paper(camera, constraints), timing, order=order)


def finished(plan: Plan, timing: Timing, *, order: Order | None = None) -> Plan:
    """The plan with its shots in order (as they are without one), its certificate and its estimate."""
    limits = plan.constraints.gimbal or GimbalLimits()
    if order is not None:
        plan = replace(plan, shots=order_shots(plan.shots, limits, timing, order=order))
    return replace(
        plan,
        certificate=plan.certificate or certify(plan),
        estimate=estimate(plan.shots, plan.camera, limits, timing),
    )
