"""The certified planner: it minimises the number of images, then the time, and returns a certified plan or an error.

    plan_certified → variants of the demands on rows (`panoexec.planning.search.variants`)
                   → trials of each (`panoexec.planning.search.trials`):
                   → rows by a shortest path (`panoexec.planning.search.row_search`), in ascending number of images
                   → slack distributed, rows rotated (`panoexec.planning.search.row_refinement`)
                   → rows that lack a little, image by image (`panoexec.planning.search.uneven_rows`)
                   → the certificate (`panoexec.planning.certificate.verdict`), which decides
                   → images that see only masks dropped (`panoexec.planning.search.thinning`); order, estimate, bound

The search includes C1 to C3. C4 mostly follows; where it does not (no overlap requested, large tolerances, a single row
or column, which is a chain in which every edge is a bridge) the search is repeated with stronger demands on the rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.certificate.texture import mark_geometry_only
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Constraints, GimbalLimits, Plan, Timing
from panoexec.planning.order.duration import estimate
from panoexec.planning.order.shot_order import Order, order_shots
from panoexec.planning.reach import check_reachable
from panoexec.planning.request import check_request
from panoexec.planning.search.budget import BudgetSpentError, SearchBudget
from panoexec.planning.search.infeasible import empty_cores, excessive_overlap, infeasibility_error, nothing_to_cover
from panoexec.planning.search.lower_bounds import LowerBounds
from panoexec.planning.search.proposal import Found, reindexed, verdict
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.siblings import siblings
from panoexec.planning.search.thinning import drop_redundant_shots, trim_band
from panoexec.planning.search.trials import Trials
from panoexec.planning.search.uneven_rows import uneven_rows
from panoexec.planning.search.variants import Variant, can_tie, variants
from panoexec.planning.search.verdicts import TimedVerdicts, ordering_s

_MORE_WORK, _LEAST_WORK_ON = 1.5, 1000
"""Once a plan is certified, the search goes on for fewer images up to this multiple of the work, or of this number."""

_MENDED_WORK = 1.5
"""Times as far if what is certified is a proposal that was mended: others often need fewer images."""

_SET_UP_WORK = 400
"""What it takes to begin with other demands, as work."""

_ONLY_FOR_TIES = 2
"""From this group on demands are for C4 alone; their rows stay within the band."""

_MANY_IMAGES = 1000
"""Plans of so many images are not searched on for one fewer: it takes seconds."""

_MUCH_OVERLAP = 0.1
"""Where so much overlap is asked for, demands of C4 change nothing once a plan is certified."""

_LAST_GROUP_ON = 3
"""Variants that are tried for fewer images: stronger demands than these seldom need fewer."""

_ANALYSED_AT_ONCE_S = 0.2
"""Processor time of a piece of the analysis why there is no plan, which is not interrupted; more than was measured."""


def plan_certified(
    camera: Camera,
    constraints: Constraints,
    *,
    timing: Timing | None = None,
    order: Order | None = "fastest",
    budget_s: float | None = None,
) -> Plan:
    """The certified plan with the fewest images found, in shooting order.

    Args:
        camera: the camera.
        constraints: the constraints to satisfy.
        timing: settle time, exposure time and camera interval.
        order: order of the shots; None for the fastest.
        budget_s: processor time for all of it; the search ends early enough with the best plan so far. None for no
            limit.

    Returns:
        A certified plan; or, if only certification fails, the best plan found, with `certified` False and the reasons
        in its certificate.

    Raises:
        PlanningError: the request is infeasible; the message names the constraint and by how much it fails.
    """
    budget = SearchBudget(budget_s)
    check_request(camera, constraints)
    hopeless = nothing_to_cover(constraints) or excessive_overlap(camera, constraints)
    hopeless = hopeless or empty_cores(camera, constraints)
    if hopeless:
        raise PlanningError(hopeless)
    planner = _Planner(camera, constraints, budget)
    found = planner.best()
    bound = planner.lower_bound(found)
    limits, costs = constraints.gimbal or GimbalLimits(), timing or Timing()
    check_reachable(found.shots, constraints.gimbal)
    shots = mark_geometry_only(camera, constraints, found.shots)
    explains = found.certificate.certified or budget.left > planner.verdicts.explaining_s(len(shots))
    if explains:
        shots = order_shots(shots, limits, costs, order=order or "fastest")
    plan = Plan(
        method="certified",
        camera=camera,
        constraints=constraints,
        shots=shots,
        estimate=estimate(shots, camera, limits, costs, constraints.band),
        lower_bound=bound,
        notes=(_cut_note(budget_s, bound),) if found.cut and budget_s is not None else (),
    )
    if not found.certificate.certified and explains:
        verdict_s = planner.verdicts.one_s(len(shots))
        return replace(plan, certificate=certify(plan, go_on=lambda: budget.left > verdict_s))
    return replace(plan, certificate=reindexed(found, shots))


def _cut_note(budget_s: float, bound: int) -> str:
    return (
        f"the search ended at its budget of {budget_s:g} s of processor time; "
        f"a longer one may find fewer images, but in even rows not fewer than {bound}"
    )


class _Planner:
    def __init__(self, camera: Camera, constraints: Constraints, budget: SearchBudget | None = None) -> None:
        self._camera = camera
        self._asked = constraints
        self._constraints = trim_band(constraints)
        self._budget = budget or SearchBudget()
        self._bounds = LowerBounds(camera, constraints, self._budget)
        self.verdicts = TimedVerdicts(camera, self._budget)
        self._trials = Trials(self._constraints, self.verdicts, self._budget, masked=bool(constraints.masks))
        self._tried: dict[tuple[object, ...], bool] = {}

    def best(self) -> Found:
        """The best plan.

        Raises:
            PlanningError: there is none, or none was found within the budget.
        """
        cut = False
        try:
            group = self._search(self._constraints)
            if self._trials.best is not None:
                self._search_on(group)
                self._search_uneven()
        except BudgetSpentError:
            cut = True
        self._trials.take_mended()
        if self._trials.best is None:
            if cut:
                raise PlanningError(
                    f"no plan was found within the budget of {self._budget.seconds:g} s of processor time: "
                    "allow more (--budget), or ask for a smaller band, less overlap or a shorter focal length"
                )
            self._budget.reserve(_ANALYSED_AT_ONCE_S)
            raise infeasibility_error(self._camera, self._constraints, self._budget)
        best = replace(self._trials.best, cut=cut)
        if self._asked.masks and best.certificate.certified:
            return self._without_redundant(best)
        return best

    def lower_bound(self, found: Found) -> int:
        """No plan of its class has fewer images than this, see `LowerBounds`."""
        images, certified = len(found.shots), found.certificate.certified
        after_s = ordering_s(images) if certified else self.verdicts.explaining_s(images)
        bound = self._bounds.in_rows(images if certified else None, after_s=after_s)
        # that holds for even rows
        return bound if images >= bound else self._bounds.of_any

    def _without_redundant(self, best: Found) -> Found:
        """A certified plan without images that see only masks, as far as there is time to tell."""
        images, cut = len(best.shots), False

        def go_on() -> bool:
            nonlocal cut
            # this verdict, and that on the result
            cut = cut or self._budget.left < 2 * self.verdicts.one_s(images) + ordering_s(images)
            return not cut

        shots = drop_redundant_shots(self._camera, self._asked, best.shots, go_on)
        certificate = verdict(self._camera, self._asked, shots)
        return replace(best, shots=shots, certificate=certificate, cut=best.cut or cut)

    def _search(self, constraints: Constraints) -> int:
        """Search with every set of demands, the weakest first, until a plan is certified; return the last group."""
        group, closes, self._trials.spent = 0, False, 0
        left: Variant | None = None
        for variant in variants(self._camera, constraints):
            if variant.group == 0 and not can_tie(self._camera, constraints, variant.demands):
                left = variant  # this search alone may use up the budget
                continue
            if (self._trials.best_images is not None and variant.group > group) or self._trials.many_certified:
                break
            group = variant.group
            closes = self._try_variant(constraints, variant, within_band=group >= _ONLY_FOR_TIES) or closes
            if not closes and group == 1:
                break  # all other variants have stronger demands
        if left is not None and self._trials.best is None:
            self._try_variant(constraints, left)
        if closes and self._trials.best_images is None and not self._trials.many_certified:
            # rows beyond the band's ends, which only tie others, where nothing else is certified
            for variant in variants(self._camera, constraints):
                if variant.group >= _ONLY_FOR_TIES and self._trials.best_images is None:
                    self._try_variant(constraints, variant)
        return group

    def _search_on(self, group: int) -> None:
        """Search for fewer images with stronger demands, and of slightly stricter requests, as far as the work allows.

        The work allowed is a multiple of that of the search before, unless nothing at all is certified yet.
        """
        if self._trials.best_images is not None and self._trials.best_images >= _MANY_IMAGES:
            return
        allowed = _MORE_WORK * max(self._budget.work, _LEAST_WORK_ON)
        for constraints, variant in self._further(group):
            images = self._trials.best_images
            if images is not None and (self._budget.work > allowed or images <= self._bounds.in_rows(images)):
                return
            if self._trials.mended is not None and self._budget.work > _MENDED_WORK * allowed:
                return
            self._try_variant(constraints, variant, within_band=variant.group >= _ONLY_FOR_TIES)

    def _search_uneven(self) -> None:
        """Search for fewer images in rows that are not even."""

        def images() -> int:
            return self._trials.best_images or 0

        for shots in uneven_rows(self._camera, self._asked, images, enough=self._bounds.of_any, budget=self._budget):
            certificate = self.verdicts.on(self._asked, shots)
            if certificate.certified:
                self._trials.keep(Found(shots, certificate))

    def _further(self, group: int) -> Iterator[tuple[Constraints, Variant]]:
        """What to try after the search of the request itself, which ended at a group of variants."""
        certified = self._trials.best_images is not None
        asked = self._constraints
        if certified and min(asked.overlap_h, asked.overlap_v) < _MUCH_OVERLAP:
            own = [v for v in variants(self._camera, self._constraints) if group < v.group <= _LAST_GROUP_ON]
            yield from ((self._constraints, variant) for variant in reversed(own))
        for sibling in siblings(self._constraints):
            self._trials.spent = 0
            for variant in variants(self._camera, sibling):
                if not certified or variant.group == group:
                    yield sibling, variant

    def _try_variant(self, constraints: Constraints, variant: Variant, *, within_band: bool = False) -> bool:
        """A trial with the demands of a variant, and with no row outside the band, if its images only tie others."""
        self._budget.use()
        rules = RowConstraints(
            self._camera, constraints, variant.demands, variant.loss, budget=self._budget, within_band=within_band
        )
        signature = rules.signature()
        if signature not in self._tried:
            self._budget.use(_SET_UP_WORK)
            self._tried[signature] = self._trials.with_rules(rules)
        return self._tried[signature]
