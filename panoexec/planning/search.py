"""The certified planner: the fewest images whose plan passes the certificate, then the least time.

`RowSearch` proposes ways to cover the band by rows, those with the fewest images first; `polish` gives the rows of a
proposal all the room there is; the certificate decides. The first plan that it certifies is the answer: what it does
not certify is never returned while a certified plan exists.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.certificate import certify
from panoexec.planning.duration import estimate
from panoexec.planning.model import Band, Constraints, GimbalLimits, Plan, Shot, Timing
from panoexec.planning.request import check_request
from panoexec.planning.row_family import NeighbourDemand
from panoexec.planning.row_polish import Rows, polish
from panoexec.planning.row_rules import RowRules
from panoexec.planning.row_search import RowSearch
from panoexec.planning.sequence import Order, order_shots

_WAYS_A_TOTAL = 4
"""Proposals looked at for each number of images."""
_MOST_WAYS = 200
"""Proposals looked at before giving up."""
_MARGINS = (0.0, 0.01)
"""Room between rows that a proposal is asked for; more where the certificate finds the first too little."""


def plan_certified(
    camera: Camera, constraints: Constraints, *, timing: Timing | None = None, order: Order = "fastest"
) -> Plan:
    """Plan with the fewest images that the search can certify.

    Args:
        camera: the camera.
        constraints: what the plan must satisfy.
        timing: what a shot costs, for order and estimate.
        order: of shooting.

    Returns:
        The plan with certificate, estimate and lower bound. If nothing that the search proposes is certified, the best
        of it, whose certificate says so.

    Raises:
        PlanningError: nothing can satisfy the constraints; the message says which and by how much.
    """
    check_request(camera, constraints)
    found = next((plan for plan in _candidates(camera, constraints) if _is_certified(plan)), None)
    plan = found or _best_effort(camera, constraints)
    limits, pace = constraints.gimbal or GimbalLimits(), timing or Timing()
    ordered = replace(plan, shots=order_shots(plan.shots, limits, pace, order=order))
    return replace(
        ordered,
        certificate=certify(ordered),
        estimate=estimate(ordered.shots, camera, limits, pace),
        lower_bound=lower_bound(camera, constraints.band),
    )


def lower_bound(camera: Camera, band: Band) -> int:
    """No plan has fewer images: the solid angle of the band over that of an image."""
    low, high = math.radians(band.elevation_min_deg), math.radians(band.elevation_max_deg)
    area = math.radians(min(band.azimuth_span_deg, 360.0)) * (math.sin(high) - math.sin(low))
    return max(1, math.ceil(area / camera.solid_angle_sr - 1e-9))


def _is_certified(plan: Plan) -> bool:
    return certify(plan).certified


def _candidates(camera: Camera, constraints: Constraints) -> Iterator[Plan]:
    rules = _rules(camera, constraints)
    search = RowSearch(rules)
    if search.least_images is None:
        raise PlanningError(_no_first_row(camera, constraints))
    ways = 0
    for _, labels in search.waves():
        for label in labels[:_WAYS_A_TOTAL]:
            for margin in _MARGINS:
                rows = polish(rules, label.path(), margin)
                if rows is not None:
                    yield _plan(camera, constraints, rules, rows)
        ways += len(labels[:_WAYS_A_TOTAL])
        if ways >= _MOST_WAYS:
            return


def _rules(camera: Camera, constraints: Constraints) -> RowRules:
    worst = constraints.overlap_h if constraints.guarantee == "all" else 0.0
    demand = NeighbourDemand(planned=constraints.overlap_h, worst=worst, tolerance=constraints.tolerance)
    return RowRules(camera, constraints, demand, constraints.overlap_v)


def _plan(camera: Camera, constraints: Constraints, rules: RowRules, rows: Rows) -> Plan:
    shots: list[Shot] = []
    for row, (pitch, count, phase) in enumerate(zip(rows.pitch_deg, rows.count, rows.phase_deg, strict=True)):
        for yaw in np.sort(rules.layout.yaws_deg(pitch, count, phase)):
            shots.append(Shot(index=len(shots), row=row, pitch_deg=pitch, yaw_deg=float(yaw)))
    return Plan(method="certified", camera=camera, constraints=constraints, shots=tuple(shots))


def _best_effort(camera: Camera, constraints: Constraints) -> Plan:
    plan = next(_candidates(camera, constraints), None)
    if plan is None:
        reach = RowSearch(_rules(camera, constraints)).highest_reach_deg()
        top = constraints.band.elevation_max_deg
        raise PlanningError(
            f"no rows of images cover elevation {constraints.band.elevation_min_deg:g} to {top:g}° "
            f"(they reach {reach:.1f}°, {top - reach:.1f}° short): "
            "ask for a lower band, less overlap or smaller tolerances"
        )
    return plan


def _no_first_row(camera: Camera, constraints: Constraints) -> str:
    tolerance = constraints.tolerance
    return (
        f"no row of images of {camera.name} ({camera.hfov_deg:.1f}° × {camera.vfov_deg:.1f}°) covers elevation "
        f"{constraints.band.elevation_min_deg:g}° with overlap {constraints.overlap_h:g} and tolerances "
        f"{tolerance.pitch_deg:g}/{tolerance.roll_deg:g}/{tolerance.yaw_deg:g}° (pitch/roll/yaw) "
        "within the gimbal's limits"
    )
