"""Tries sets of demands on rows: the rows that they lead to, their verdicts, and what is mended where these fail."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from panoexec.errors import PlanningError
from panoexec.planning.model import Constraints
from panoexec.planning.request import MAX_IMAGES
from panoexec.planning.search.budget import SearchBudget
from panoexec.planning.search.longer_rows import Lengthened, with_longer_row
from panoexec.planning.search.proposal import Found, Lack, missing, row_shots
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_refinement import Rows, refine
from panoexec.planning.search.row_seam import optimise_seam
from panoexec.planning.search.row_search import Label, searches
from panoexec.planning.search.verdicts import TimedVerdicts, ordering_s

_LABELS_TRIED = 3
"""Number of solutions of one total that are certified before a larger total is tried."""

_MOST_TRIED, _MOST_TRIED_MANY = 9, 1
_ROUNDS = 4
_FACTOR = 4.0
"""Maximum number of repeated searches where C1 or C3 fails; each increases the margin by this factor."""

_WORK, _LEAST_WORK = 6, 600
"""Budget of certified images per search: this multiple of the plan's images, and at least this number."""

_LOOSE_TRIED = 6
"""Number of plans that fail only C4 after which stronger demands are tried."""

_RETRIES = 2
_LONGER = 4
"""Number of rows of a proposal, one after the other, to which images are added below a sky, see `with_longer_row`."""

_MARGIN_MANY = 2e-3
"""Margin for plans of very many rows. Without, the rows about the poles lack up to 0.0016, and the search, which takes
most of the time, is repeated; 0.002 costs no more images than the repetition does."""

_THINNING_VERDICTS = 12
"""Verdicts for which time is kept where masks may make images redundant."""


class Trials:
    """The trials of one plan, and the best proposal of them.

    Args:
        constraints: what proposals are certified for.
        verdicts: on proposals.
        budget: of the search.
        masked: whether masks may make images of the best plan redundant.

    Attributes:
        best: the best proposal so far.
        mended: a certified one with longer rows below a sky, for the case that no other is certified with fewer images.
        spent: certified images of the search so far, see `many_certified`.
    """

    def __init__(
        self, constraints: Constraints, verdicts: TimedVerdicts, budget: SearchBudget, *, masked: bool
    ) -> None:
        self._constraints = constraints
        self._verdicts = verdicts
        self._budget = budget
        self._masked = masked
        self.best: Found | None = None
        self.mended: Found | None = None
        self.spent = 0

    @property
    def best_images(self) -> int | None:
        """Number of images of the best certified plan so far."""
        return len(self.best.shots) if self.best is not None and self.best.certificate.certified else None

    @property
    def many_certified(self) -> bool:
        """Whether enough proposals of one search were certified."""
        return self.best is not None and self.spent > _WORK * max(_LEAST_WORK, len(self.best.shots))

    def keep(self, found: Found) -> None:
        """Take a plan for the best, and keep the time that it takes to complete it."""
        self.best = found
        self._reserve()

    def take_mended(self) -> None:
        """Take the proposal with longer rows for the best, if it is."""
        if self.mended is not None and (self.best_images is None or len(self.mended.shots) < self.best_images):
            self.keep(self.mended)

    def _reserve(self) -> None:
        self._budget.reserve(max(self._after_s(found) for found in (self.best, self.mended) if found is not None))

    def _after_s(self, found: Found) -> float:
        """What it takes to complete a plan, seconds of processor time."""
        images = len(found.shots)
        if not found.certificate.certified:
            return self._verdicts.explaining_s(images)
        return ordering_s(images) + (_THINNING_VERDICTS * self._verdicts.one_s(images) if self._masked else 0.0)

    def with_rules(self, rules: RowConstraints) -> bool:
        """Search a certified plan with fewer images than the best so far; return whether any rows cover the band."""
        rules = optimise_seam(rules)
        margin = _MARGIN_MANY if rules.many else 0.0
        closes = False
        for _ in range(_ROUNDS):
            solutions = self._solutions(rules, margin)
            closes = closes or bool(solutions)
            lack = self._try_solutions(rules, solutions, margin)
            if lack is None:
                break
            # search again, with what is missing added: other counts may result
            if lack.across > 0:
                rules = rules.with_more_overlap(lack.across, worst=self._constraints.guarantee == "all")
            if lack.margin > 0:
                margin = max(margin + lack.margin, _FACTOR * margin)
        return closes

    def _solutions(self, rules: RowConstraints, margin: float) -> list[Label]:
        fewer_than = self.best_images or MAX_IMAGES + 1
        for search in searches(rules, wanted=margin):
            if search.least_images is None or search.least_images >= fewer_than:
                continue
            if search.least_images > MAX_IMAGES:
                raise PlanningError(
                    f"the plan needs at least {search.least_images} images, more than the limit of {MAX_IMAGES}: "
                    "ask for less overlap, a smaller band or a shorter focal length"
                )
            solutions = search.solutions(retry=self.best_images is None, fewer_than=fewer_than)
            if solutions:
                return solutions
        return []

    def _try_solutions(self, rules: RowConstraints, solutions: Sequence[Label], margin: float) -> Lack | None:
        """Certify solutions; return the least that is missing for C1 to C3 if nothing else fails, else None."""
        tried = loose = 0
        lacks: list[Lack] = []
        for label in _first_of_each_total(solutions):
            if self.best_images is not None and label.images >= self.best_images:
                return None
            found = self._certify_label(rules, label, margin)
            if found is None:
                continue
            if self.best is None or found.rank < self.best.rank:
                self.keep(found)
            if found.certificate.certified or self.many_certified:
                return None
            lack = missing(found.certificate, self._constraints)
            lacks += [] if lack is None else [lack]
            tried += 1
            if tried <= _LABELS_TRIED and self.mended is None and self._constraints.textured_below is not None:
                self._mend(rules, label, margin, found)
            loose += not found.certificate.two_edge_connected
            if not found.certificate.connected:
                loose += _LOOSE_TRIED // (1 if rules.many else 2)
            if loose >= _LOOSE_TRIED or tried >= (_MOST_TRIED_MANY if rules.many else _MOST_TRIED):
                break
        return min(lacks, key=lambda lack: (lack.across, lack.margin), default=None)

    def _certify_label(self, rules: RowConstraints, label: Label, margin: float) -> Found | None:
        """Refine and certify the rows of a label; None if they do not reach the top of the band."""
        found: Found | None = None
        for _ in range(1 + _RETRIES):
            rows = refine(rules, label.path(), margin)
            if rows is None:
                break
            found = self._certify(rules, rows)
            lack = None if found.certificate.certified else missing(found.certificate, self._constraints)
            if lack is None or lack.across > 0:
                break
            margin = rows.margin + lack.margin
        return found

    def _mend(self, rules: RowConstraints, label: Label, margin: float, found: Found) -> None:
        """Look for a certified proposal with more images in rows of which the sky takes so much that they fail C2."""
        path, before = label.path(), None
        for _ in range(_LONGER):
            now = Lengthened(tuple(path), found)
            path = with_longer_row(now, before, self._constraints)
            rows = refine(rules, path, margin) if path else None
            if rows is None:
                return
            found, before = self._certify(rules, rows), now
            if found.certificate.certified:
                self.mended = found
                self._reserve()
                return

    def _certify(self, rules: RowConstraints, rows: Rows) -> Found:
        shots = row_shots(rules, rows)
        self.spent += len(shots)
        return Found(shots, self._verdicts.on(self._constraints, shots))


def _first_of_each_total(solutions: Sequence[Label]) -> Iterator[Label]:
    for _, group in itertools.groupby(solutions, key=lambda label: label.images):
        yield from itertools.islice(group, _LABELS_TRIED)
