"""The certified planner: fewest images, then least time, with a certificate or a clear refusal.

    plan_certified → variants of what is asked of rows (`_variants`)
                   → rows by a shortest path (`panoexec.planning.row_search`), in ascending number of images
                   → slack shared out, rows turned (`panoexec.planning.row_polish`)
                   → the certificate (`panoexec.planning.certificate`), which has the last word
                   → images dropped that see masks only (`panoexec.planning.thinning`), order, estimate, bound

C1 to C3 are what the search is built on. C4 mostly follows; where it does not (no overlap asked for, large tolerances,
a single row or column, which is a chain that breaks at any link) the search is run again with more asked of the rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from panoexec.angles import rotation
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.bound import least_images
from panoexec.planning.certificate import certify, certify_poses
from panoexec.planning.duration import estimate
from panoexec.planning.model import Certificate, Constraints, GimbalLimits, Plan, Shot, Timing
from panoexec.planning.refusal import refusal
from panoexec.planning.request import MAX_IMAGES, check_request
from panoexec.planning.row_polish import Rows, polish
from panoexec.planning.row_rules import RowRules
from panoexec.planning.row_search import Label, RowSearch
from panoexec.planning.sequence import Order, order_shots
from panoexec.planning.thinning import narrowed, thinned
from panoexec.planning.variants import variants

_LABELS_TRIED = 3
"""So many ways of one total are tried before a larger total is."""

_MOST_TRIED = 30
_MANY = 500
_RETRIES = 2
_DECIMALS = 7
"""Of pitch and yaw in a plan, degrees."""


def plan_certified(
    camera: Camera, constraints: Constraints, *, timing: Timing | None = None, order: Order | None = "fastest"
) -> Plan:
    """The plan with the fewest images found, certified, in shooting order.

    Args:
        camera: the camera.
        constraints: what the plan has to satisfy.
        timing: what a shot costs besides the slew.
        order: of shooting; None for the fastest.

    Returns:
        A certified plan; or, where only the certificate cannot be had, the best one found, with `certified` False and
        the reasons in its certificate.

    Raises:
        PlanningError: nothing can be planned; the message names the constraint and by how much it fails.
    """
    check_request(camera, constraints)
    found = _Planner(camera, constraints).best()
    limits, costs = constraints.gimbal or GimbalLimits(), timing or Timing()
    shots = order_shots(found.shots, limits, costs, order=order or "fastest")
    plan = Plan(
        method="certified",
        camera=camera,
        constraints=constraints,
        shots=shots,
        estimate=estimate(shots, camera, limits, costs),
        lower_bound=least_images(camera, constraints),
    )
    return replace(plan, certificate=certify(plan))


@dataclass(frozen=True, slots=True)
class _Found:
    """Shots with their verdict, row by row."""

    shots: tuple[Shot, ...]
    certificate: Certificate

    @property
    def rank(self) -> tuple[int, int]:
        """Lower is better: certified ones by images, others by what fails."""
        certificate = self.certificate
        return (0 if certificate.certified else 1 + len(certificate.failures), certificate.images)


class _Planner:
    def __init__(self, camera: Camera, constraints: Constraints) -> None:
        self._camera = camera
        self._asked = constraints
        self._constraints = narrowed(constraints)
        self._best: _Found | None = None

    def best(self) -> _Found:
        """The best plan.

        Raises:
            PlanningError: there is none.
        """
        rules: RowRules | None = None
        for variant in variants(self._camera, self._constraints):
            if self._best is not None and self._best.certificate.certified and not variant.may_be_better:
                continue
            rules = RowRules(self._camera, self._constraints, variant.demands, variant.loss)
            self._try(rules)
        if self._best is None:
            raise refusal(self._camera, self._constraints)
        if self._asked.masks and self._best.certificate.certified:
            shots = thinned(self._camera, self._asked, self._best.shots)
            return _Found(shots, self._best.certificate)
        return self._best

    def _try(self, rules: RowRules) -> None:
        """Look for a certified plan with fewer images than the best one so far."""
        search = RowSearch(rules)
        if search.least_images is not None and search.least_images > MAX_IMAGES:
            raise PlanningError(
                f"at least {search.least_images} images are needed, more than the {MAX_IMAGES} that panoexec plans: "
                "ask for less overlap, a smaller band or a shorter focal length"
            )
        tried = 0
        for total, labels in search.waves():
            if self._best is not None and self._best.certificate.certified and total >= self._best.certificate.images:
                return
            for label in labels[:_LABELS_TRIED]:
                tried += 1
                if self._certified(rules, label):
                    return
            if tried >= (_MOST_TRIED if total < _MANY else _MOST_TRIED // 5):
                return

    def _certified(self, rules: RowRules, label: Label) -> bool:
        """Whether rows of a label's counts can be certified; keeps them if so, or if they are the nearest to it."""
        margin = 0.0
        for _ in range(1 + _RETRIES):
            rows = polish(rules, label.path(), margin)
            if rows is None:
                return False
            found = self._judged(rules, rows)
            if self._best is None or found.rank < self._best.rank:
                self._best = found
            if found.certificate.certified:
                return True
            lacking = _lacking(found.certificate, self._constraints)
            if lacking is None:
                return False
            margin = rows.margin + lacking
        return False

    def _judged(self, rules: RowRules, rows: Rows) -> _Found:
        shots = row_shots(rules, rows)
        rotations = rotation([s.yaw_deg for s in shots], [s.pitch_deg for s in shots])
        numbers = [shot.row for shot in shots]
        return _Found(shots, certify_poses(self._camera, self._constraints, rotations, numbers, explain=False))


def row_shots(rules: RowRules, rows: Rows) -> tuple[Shot, ...]:
    """The shots of rows, row by row."""
    shots: list[Shot] = []
    for number, (pitch, count, phase) in enumerate(zip(rows.pitch_deg, rows.count, rows.phase_deg, strict=True)):
        tilt = round(pitch, _DECIMALS)
        for yaw in np.round(rules.layout.yaws_deg(pitch, count, phase), _DECIMALS).tolist():
            shots.append(Shot(index=len(shots), row=number, pitch_deg=tilt, yaw_deg=yaw if yaw < 180.0 else -180.0))
    return tuple(shots)


def _lacking(certificate: Certificate, constraints: Constraints) -> float | None:
    """The margin by which rows that are all but certified fall short of C1 or C3; None if more is wrong."""
    least = certificate.worst_overlap_v if constraints.guarantee == "all" else certificate.min_overlap_v
    lacking = 0.0 if least is None else constraints.overlap_v - least
    if lacking > 0.05 or not certificate.two_edge_connected:
        return None
    if lacking > 0:
        return lacking + 2e-4
    return 2e-3 if certificate.uncovered_fraction > 0 else None
