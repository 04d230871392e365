"""The certified planner: it minimises the number of images, then the time, and returns a certified plan or an error.

    plan_certified → variants of the demands on rows (`panoexec.planning.search.variants`)
                   → rows by a shortest path (`panoexec.planning.search.row_search`), in ascending number of images
                   → slack distributed, rows rotated (`panoexec.planning.search.row_refinement`)
                   → the certificate (`panoexec.planning.certificate.verdict`), which decides
                   → images that see only masks dropped (`panoexec.planning.search.thinning`); order, estimate, bound

The search includes C1 to C3. C4 mostly follows; where it does not (no overlap requested, large tolerances, a single row
or column, which is a chain in which every edge is a bridge) the search is repeated with stronger demands on the rows.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from panoexec.angles import rotation
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.certificate.verdict import certify, certify_poses
from panoexec.planning.model import Certificate, Constraints, GimbalLimits, Plan, Shot, Timing
from panoexec.planning.order.duration import estimate
from panoexec.planning.order.shot_order import Order, order_shots
from panoexec.planning.reach import check_reachable
from panoexec.planning.request import MAX_IMAGES, check_request
from panoexec.planning.search.infeasible import empty_cores, excessive_overlap, infeasibility_error, nothing_to_cover
from panoexec.planning.search.lower_bound import least_images
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_refinement import Rows, refine
from panoexec.planning.search.row_seam import optimise_seam
from panoexec.planning.search.row_search import Label, searches
from panoexec.planning.search.thinning import drop_redundant_shots, trim_band
from panoexec.planning.search.variants import variants

_LABELS_TRIED = 3
"""Number of solutions of one total that are certified before a larger total is tried."""

_MOST_TRIED, _MOST_TRIED_MANY = 9, 1
_ROUNDS = 4
_FACTOR = 4.0
_UNKNOWN = 0.02
"""Maximum number of repeated searches where C1 or C3 fails; each increases the margin by this factor."""

_WORK, _LEAST_WORK = 6, 600
"""Budget of certified images per search: this multiple of the plan's images, and at least this number."""

_LOOSE_TRIED = 6
"""Number of plans that fail only C4 after which stronger demands are tried."""

_RETRIES = 2
_MARGIN_MANY = 6e-4
"""Margin for plans of very many rows, where certification dominates the run time and not an additional row."""

_DECIMALS = 7
"""Digits of pitch and yaw in a plan, degrees."""


def plan_certified(
    camera: Camera, constraints: Constraints, *, timing: Timing | None = None, order: Order | None = "fastest"
) -> Plan:
    """The certified plan with the fewest images found, in shooting order.

    Args:
        camera: the camera.
        constraints: the constraints to satisfy.
        timing: settle time, exposure time and camera interval.
        order: order of the shots; None for the fastest.

    Returns:
        A certified plan; or, if only certification fails, the best plan found, with `certified` False and the reasons
        in its certificate.

    Raises:
        PlanningError: the request is infeasible; the message names the constraint and by how much it fails.
    """
    check_request(camera, constraints)
    hopeless = nothing_to_cover(constraints) or excessive_overlap(camera, constraints)
    hopeless = hopeless or empty_cores(camera, constraints)
    if hopeless:
        raise PlanningError(hopeless)
    found = _Planner(camera, constraints).best()
    limits, costs = constraints.gimbal or GimbalLimits(), timing or Timing()
    check_reachable(found.shots, constraints.gimbal)
    shots = order_shots(found.shots, limits, costs, order=order or "fastest")
    plan = Plan(
        method="certified",
        camera=camera,
        constraints=constraints,
        shots=shots,
        estimate=estimate(shots, camera, limits, costs),
        lower_bound=least_images(camera, constraints),
    )
    if not found.certificate.certified:
        return replace(plan, certificate=certify(plan))
    return replace(plan, certificate=_reindexed(found, shots))


def _reindexed(found: _Found, shots: Sequence[Shot]) -> Certificate:
    """The certificate with image numbers adapted to a new order of the shots."""
    place = {(shot.row, shot.yaw_deg): shot.index for shot in shots}
    name = [place[shot.row, shot.yaw_deg] for shot in found.shots]
    pair, image = found.certificate.weakest_h, found.certificate.weakest_v
    return replace(
        found.certificate,
        weakest_h=None if pair is None else (name[pair[0]], name[pair[1]]),
        weakest_v=None if image is None else name[image],
    )


@dataclass(frozen=True, slots=True)
class _Found:
    """Shots, row by row, with their certificate."""

    shots: tuple[Shot, ...]
    certificate: Certificate

    @property
    def rank(self) -> tuple[int, int]:
        """Sort key, lower is better: certified plans by images, others by the number of failed conditions."""
        certificate = self.certificate
        return (0 if certificate.certified else 1 + len(certificate.failures), certificate.images)


class _Planner:
    def __init__(self, camera: Camera, constraints: Constraints) -> None:
        self._camera = camera
        self._asked = constraints
        self._constraints = trim_band(constraints)
        self._best: _Found | None = None
        self._spent = 0

    def best(self) -> _Found:
        """The best plan.

        Raises:
            PlanningError: there is none.
        """
        group, closes = 0, False
        for variant in variants(self._camera, self._constraints):
            if (self._best_images is not None and variant.group > group) or self._budget_spent:
                break
            group = variant.group
            some = self._try(RowConstraints(self._camera, self._constraints, variant.demands, variant.loss))
            closes = closes or some
            if not closes and group == 1:
                break  # all other variants have stronger demands
        if self._best is None:
            raise infeasibility_error(self._camera, self._constraints)
        if self._asked.masks and self._best.certificate.certified:
            shots = drop_redundant_shots(self._camera, self._asked, self._best.shots)
            return _Found(shots, _verdict(self._camera, self._asked, shots))
        return self._best

    def _try(self, rules: RowConstraints) -> bool:
        """Search a certified plan with fewer images than the best so far; return whether any rows cover the band."""
        rules = optimise_seam(rules)
        margin = _MARGIN_MANY if rules.many else 0.0
        closes = False
        for _ in range(_ROUNDS):
            solutions = self._solutions(rules, margin)
            closes = closes or bool(solutions)
            missing = self._try_solutions(rules, solutions, margin)
            if missing is None:
                break
            # search again, with the missing margin added: other counts may result
            margin = max(margin + missing, _FACTOR * margin)
        return closes

    def _solutions(self, rules: RowConstraints, margin: float) -> list[Label]:
        for search in searches(rules, wanted=margin):
            if search.least_images is None:
                continue
            if search.least_images > MAX_IMAGES:
                raise PlanningError(
                    f"the plan needs at least {search.least_images} images, more than the limit of {MAX_IMAGES}: "
                    "ask for less overlap, a smaller band or a shorter focal length"
                )
            solutions = search.solutions()
            if solutions:
                return solutions
        return []

    def _try_solutions(self, rules: RowConstraints, solutions: Sequence[Label], margin: float) -> float | None:
        """Certify solutions; return the margin missing for C1 or C3 if nothing else fails, else None."""
        tried = loose = 0
        missing: list[float] = []
        for label in _first_of_each_total(solutions):
            if self._best_images is not None and label.images >= self._best_images:
                return None
            found = self._certify_label(rules, label, margin)
            if found is None:
                continue
            if self._best is None or found.rank < self._best.rank:
                self._best = found
            if found.certificate.certified or self._budget_spent:
                return None
            lack = _missing_margin(found.certificate, self._constraints)
            missing += [] if lack is None else [lack]
            tried += 1
            loose += not found.certificate.two_edge_connected
            if not found.certificate.connected:
                loose += _LOOSE_TRIED // (1 if rules.many else 2)
            if loose >= _LOOSE_TRIED or tried >= (_MOST_TRIED_MANY if rules.many else _MOST_TRIED):
                break
        return min(missing, default=None)

    @property
    def _best_images(self) -> int | None:
        """Number of images of the best certified plan so far."""
        return len(self._best.shots) if self._best is not None and self._best.certificate.certified else None

    @property
    def _budget_spent(self) -> bool:
        """Whether the budget of certified images is used up."""
        return self._best is not None and self._spent > _WORK * max(_LEAST_WORK, len(self._best.shots))

    def _certify_label(self, rules: RowConstraints, label: Label, margin: float) -> _Found | None:
        """Refine and certify the rows of a label; None if they do not reach the top of the band."""
        found: _Found | None = None
        for _ in range(1 + _RETRIES):
            rows = refine(rules, label.path(), margin)
            if rows is None:
                break
            found = self._certify(rules, rows)
            missing = None if found.certificate.certified else _missing_margin(found.certificate, self._constraints)
            if missing is None:
                break
            margin = rows.margin + missing
        return found

    def _certify(self, rules: RowConstraints, rows: Rows) -> _Found:
        shots = row_shots(rules, rows)
        self._spent += len(shots)
        return _Found(shots, _verdict(self._camera, self._constraints, shots))


def _first_of_each_total(solutions: Sequence[Label]) -> Iterator[Label]:
    for _, group in itertools.groupby(solutions, key=lambda label: label.images):
        yield from itertools.islice(group, _LABELS_TRIED)


def _verdict(camera: Camera, constraints: Constraints, shots: Sequence[Shot]) -> Certificate:
    poses = rotation([shot.yaw_deg for shot in shots], [shot.pitch_deg for shot in shots])
    return certify_poses(camera, constraints, poses, [shot.row for shot in shots], explain=False)


def row_shots(rules: RowConstraints, rows: Rows) -> tuple[Shot, ...]:
    """The shots of rows, row by row."""
    shots: list[Shot] = []
    for number, (pitch, count, phase) in enumerate(zip(rows.pitch_deg, rows.count, rows.phase_deg, strict=True)):
        tilt = round(pitch, _DECIMALS)
        for yaw in np.round(rules.layout.yaws_deg(pitch, count, phase), _DECIMALS).tolist():
            shots.append(Shot(index=len(shots), row=number, pitch_deg=tilt, yaw_deg=yaw if yaw < 180.0 else -180.0))
    return tuple(shots)


def _missing_margin(certificate: Certificate, constraints: Constraints) -> float | None:
    """The margin missing for C1 or C3, if the rows are close to certified; None if more fails."""
    least = certificate.worst_overlap_v if constraints.guarantee == "all" else certificate.min_overlap_v
    missing = 0.0 if least is None else constraints.overlap_v - least
    if missing > 0.05 or not certificate.two_edge_connected:
        return None
    if missing > 0:
        # overlaps are clamped at 0, so there the missing margin is unknown
        return missing + 2e-4 if least else max(missing, _UNKNOWN)
    return 2e-3 if certificate.uncovered_fraction > 0 else None
