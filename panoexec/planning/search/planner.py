"""The certified planner: fewest images, then least time, with a certificate or a clear refusal.

    plan_certified → variants of what is asked of rows (`_variants`)
                   → rows by a shortest path (`panoexec.planning.search.row_search`), in ascending number of images
                   → slack shared out, rows turned (`panoexec.planning.search.row_refinement`)
                   → the certificate (`panoexec.planning.certificate.verdict`), which has the last word
                   → images dropped that see masks only (`panoexec.planning.search.thinning`), order, estimate, bound

C1 to C3 are what the search is built on. C4 mostly follows; where it does not (no overlap asked for, large tolerances,
a single row or column, which is a chain that breaks at any link) the search is run again with more asked of the rows.
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
from panoexec.planning.request import MAX_IMAGES, check_request
from panoexec.planning.search.infeasible import nothing_to_cover, refusal, tolerance_eats_image, too_dense
from panoexec.planning.search.lower_bound import least_images
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_refinement import Rows, refine
from panoexec.planning.search.row_seam import with_best_seam
from panoexec.planning.search.row_search import Label, RowSearch
from panoexec.planning.search.thinning import narrowed, thinned
from panoexec.planning.search.variants import variants

_LABELS_TRIED = 3
"""So many ways of one total are tried before a larger total is."""

_MOST_TRIED, _MOST_TRIED_MANY = 9, 1
_ROUNDS = 4
_FACTOR = 4.0
_UNKNOWN = 0.02
"""So many searches, each for rows with so many times the margin of the last, where C1 or C3 fails."""

_WORK, _LEAST_WORK = 6, 600
"""So many times the images of a plan, and no fewer than so many, are judged at the most."""

_LOOSE_TRIED = 6
"""After so many plans that only C4 keeps from being certified, more is asked of the rows."""

_RETRIES = 2
_MARGIN_MANY = 6e-4
"""Margin asked for in plans of very many rows: there the certificate, not a row more, is what costs time."""

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
    hopeless = nothing_to_cover(constraints) or too_dense(camera, constraints)
    hopeless = hopeless or tolerance_eats_image(camera, constraints)
    if hopeless:
        raise PlanningError(hopeless)
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
    if not found.certificate.certified:
        return replace(plan, certificate=certify(plan))
    return replace(plan, certificate=_renamed(found, shots))


def _renamed(found: _Found, shots: Sequence[Shot]) -> Certificate:
    """The certificate of shots that were put into another order."""
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
        self._spent = 0

    def best(self) -> _Found:
        """The best plan.

        Raises:
            PlanningError: there is none.
        """
        group, closes = 0, False
        for variant in variants(self._camera, self._constraints):
            if (self._best_images is not None and variant.group > group) or self._exhausted:
                break
            group = variant.group
            some = self._try(RowConstraints(self._camera, self._constraints, variant.demands, variant.loss))
            closes = closes or some
            if not closes and group == 1:
                break  # all other variants ask for more
        if self._best is None:
            raise refusal(self._camera, self._constraints)
        if self._asked.masks and self._best.certificate.certified:
            shots = thinned(self._camera, self._asked, self._best.shots)
            return _Found(shots, _verdict(self._camera, self._asked, shots))
        return self._best

    def _try(self, rules: RowConstraints) -> bool:
        """Look for a certified plan with fewer images than the best one so far; tells whether rows close the band."""
        rules = with_best_seam(rules)
        margin = _MARGIN_MANY if rules.many else 0.0
        closes = False
        for _ in range(_ROUNDS):
            search = RowSearch(rules, wanted=margin)
            if search.least_images is None:
                break
            if search.least_images > MAX_IMAGES:
                raise PlanningError(
                    f"at least {search.least_images} images are needed, more than the {MAX_IMAGES} that panoexec "
                    "plans: ask for less overlap, a smaller band or a shorter focal length"
                )
            ways = search.ways()
            closes = closes or bool(ways)
            lacking = self._try_ways(rules, ways, margin)
            if lacking is None:
                break
            # rows of other numbers, with what these lacked
            margin = max(margin + lacking, _FACTOR * margin)
        return closes

    def _try_ways(self, rules: RowConstraints, ways: Sequence[Label], margin: float) -> float | None:
        """Judge ways; tells what those lack that only C1 or C3 keeps from being certified, None if that is not it."""
        tried = loose = 0
        lacking: list[float] = []
        for label in _some_of_each_total(ways):
            if self._best_images is not None and label.images >= self._best_images:
                return None
            found = self._judged_label(rules, label, margin)
            if found is None:
                continue
            if self._best is None or found.rank < self._best.rank:
                self._best = found
            if found.certificate.certified or self._exhausted:
                return None
            lack = _lacking(found.certificate, self._constraints)
            lacking += [] if lack is None else [lack]
            tried += 1
            loose += not found.certificate.two_edge_connected
            if not found.certificate.connected:
                loose += _LOOSE_TRIED // (1 if rules.many else 2)
            if loose >= _LOOSE_TRIED or tried >= (_MOST_TRIED_MANY if rules.many else _MOST_TRIED):
                break
        return min(lacking, default=None)

    @property
    def _best_images(self) -> int | None:
        """Images of the best certified plan so far."""
        return len(self._best.shots) if self._best is not None and self._best.certificate.certified else None

    @property
    def _exhausted(self) -> bool:
        """Whether as much was judged as a plan is worth."""
        return self._best is not None and self._spent > _WORK * max(_LEAST_WORK, len(self._best.shots))

    def _judged_label(self, rules: RowConstraints, label: Label, margin: float) -> _Found | None:
        """Rows of a label's counts with their verdict; None where they do not reach the top of the band."""
        found: _Found | None = None
        for _ in range(1 + _RETRIES):
            rows = refine(rules, label.path(), margin)
            if rows is None:
                break
            found = self._judged(rules, rows)
            lacking = None if found.certificate.certified else _lacking(found.certificate, self._constraints)
            if lacking is None:
                break
            margin = rows.margin + lacking
        return found

    def _judged(self, rules: RowConstraints, rows: Rows) -> _Found:
        shots = row_shots(rules, rows)
        self._spent += len(shots)
        return _Found(shots, _verdict(self._camera, self._constraints, shots))


def _some_of_each_total(ways: Sequence[Label]) -> Iterator[Label]:
    for _, group in itertools.groupby(ways, key=lambda label: label.images):
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


def _lacking(certificate: Certificate, constraints: Constraints) -> float | None:
    """The margin by which rows that are all but certified fall short of C1 or C3; None if more is wrong."""
    least = certificate.worst_overlap_v if constraints.guarantee == "all" else certificate.min_overlap_v
    lacking = 0.0 if least is None else constraints.overlap_v - least
    if lacking > 0.05 or not certificate.two_edge_connected:
        return None
    if lacking > 0:
        # less than nothing in common counts as nothing, so what is lacking there is not known
        return lacking + 2e-4 if least else max(lacking, _UNKNOWN)
    return 2e-3 if certificate.uncovered_fraction > 0 else None
