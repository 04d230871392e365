"""Row search: the shortest path by number of images from the lowest row to the highest, as a beam search.

A *label* is a partial solution that covers the band from its lower end up to a row: that row's pitch and count, the
total number of images and the preceding label. From a label the search extends to every count of images that could form
the next row, with that row as high as C1 and C3 permit and at least as steep as C2 demands for that count. Taking rows
as high as possible loses nothing: whatever can follow a row can follow the same row slightly higher. The exceptions are
pitches where a higher row needs more images (there rows of both counts are tried) and rows of a few images, which may
cover a wider band at a lower pitch (there a few lower pitches are tried).

Labels advance together, a row at a time. Of the labels with equally many rows only the most promising are kept: the
bound of a label is its number of images plus the relaxed remaining cost of `row_relaxation`, which knows C2's counts
and the longest steps, but not whether rows fit. Dominated labels are dropped. So each row costs the same, and a plan of
n images, which has about √n rows, costs about √n steps; all steps of a row are evaluated in one batch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from panoexec.angles import FloatArray
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_layout import IntArray
from panoexec.planning.search.row_relaxation import NEVER, RowRelaxation
from panoexec.planning.search.row_steps import highest_pitch

_SMALLEST_STEP = 0.15
"""Rows closer than this fraction of the vertical field of view are not tried."""

_MORE_IMAGES, MORE_AT_LIMITS = 2, 12
"""Number of images above C2's minimum that are tried in a row; and where the band extends beyond the gimbal's pitch
limits and no rows result: more images cover a little more of the elevations beyond."""

FEW = 6
_LOWER = (0.08, 0.16, 0.24, 0.32)
"""Offsets, in vertical fields of view, at which rows of few images are also tried lower."""

WIDTH, _WIDTH_MANY = 24, 8
"""Beam width: labels of equally many rows that are kept; and in plans of very many, similar rows."""

_SLACK = 3
_SLACK_FRAC = 0.002
"""Labels whose bound exceeds the best complete label by this number of images are dropped."""

_STEPS_AT_ONCE = (20, 100, 400)
"""Steps evaluated for a row, in addition to all steps whose bound is at most the best plus the slack; the next number
applies if no solution results. Plans of many images, whose bounds are tight, begin with the first number, others with
the second."""

_LARGE = 80

_MORE_ROWS = 2
"""Labels with this number of rows more than the best complete one are dropped."""

_MOST_ROWS = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """A partial solution; see the module docstring.

    Attributes:
        pitch_deg: pitch of the row.
        count: images in the row.
        images: images in all rows so far.
        rows: number of rows so far.
        highest_deg: highest elevation that the row covers at all azimuths.
        reaches: whether that is the band's upper end.
        before: the label of the row below.
    """

    pitch_deg: float
    count: int
    images: int
    rows: int
    highest_deg: float
    reaches: bool
    before: Label | None

    def path(self) -> list[tuple[float, int]]:
        """(pitch_deg, count) of the rows, lowest first."""
        out: list[tuple[float, int]] = []
        label: Label | None = self
        while label is not None:
            out.append((label.pitch_deg, label.count))
            label = label.before
        return out[::-1]


@dataclass(frozen=True, slots=True)
class _Step:
    """A candidate row on top of a label, and the lower bound of its total."""

    label: Label
    count: int
    start_deg: float
    stop_deg: float
    promise: int


class RowSearch:
    """One search, for one set of constraints.

    Args:
        rules: the constraints on rows.
        wanted: minimum margin of pairs of rows, see `PairMargin`.
        width: beam width.
        more_images: number of images above C2's minimum that are tried in a row.
    """

    def __init__(
        self, rules: RowConstraints, *, wanted: float = 0.0, width: int = WIDTH, more_images: int = _MORE_IMAGES
    ) -> None:
        self._rules = rules
        self._width = min(width, _WIDTH_MANY) if rules.many else width
        self._wanted = wanted
        self._more_images = more_images
        self._most = NEVER - 1
        self._relaxation = RowRelaxation(rules, wanted, more_images=2 * more_images)
        pitch, count = rules.first_rows(more_images)
        self._first = self._labels(pitch, count, [None] * len(count), np.full(len(count), rules.pitch_deg[0]))

    @property
    def least_images(self) -> int | None:
        """Lower bound of the number of images by the relaxation; None if it has no solution."""
        promises = [promise for promise in map(self._bound, self._first) if promise < NEVER]
        return min(promises) if promises else None

    def solutions(self, *, retry: bool = True, fewer_than: int = NEVER) -> list[Label]:
        """Complete labels, sorted by number of images, then number of rows, then highest elevation (descending).

        Args:
            retry: if none are found, evaluate more steps.
            fewer_than: only labels with fewer images than this are of use.
        """
        self._most = fewer_than - 1
        large = (self.least_images or 0) >= _LARGE
        tries = _STEPS_AT_ONCE if large else _STEPS_AT_ONCE[1:]
        for at_once in tries if retry else tries[:-1]:
            solutions, complete = self._solutions(at_once)
            if solutions or complete:
                return solutions
        return []

    def _solutions(self, at_once: int) -> tuple[list[Label], bool]:
        """Complete labels, and whether all steps were evaluated."""
        everything = True
        front = _ParetoFront(self._rules.camera.vfov_deg)
        complete: list[Label] = []
        level, best, rows_left = self._first, NEVER, 1
        for _ in range(_MOST_ROWS):
            reaching = [label for label in level if label.reaches]
            complete += reaching
            if min((label.images for label in reaching), default=NEVER) < best:
                best, rows_left = min(label.images for label in reaching), _MORE_ROWS + 1
            rows_left -= best < NEVER
            if not rows_left:
                break
            going = self._beam([label for label in level if not label.reaches], best, front)
            if not going:
                break
            steps, all_steps = self._next_steps(going, best, at_once)
            everything = everything and all_steps
            level = self._take(steps)
        complete = [label for label in complete if label.images <= self._most]
        return sorted(complete, key=lambda label: (label.images, label.rows, -label.highest_deg)), everything

    def _bound(self, label: Label) -> int:
        return label.images if label.reaches else label.images + self._relaxation.least_after(label.pitch_deg)

    def _beam(self, labels: list[Label], best: int, front: _ParetoFront) -> list[Label]:
        """The most promising labels with equally many rows (the beam)."""
        ranked = sorted(
            (promise, label.images + self._relaxation.estimate_after(label.pitch_deg), i)
            for i, (promise, label) in enumerate((self._bound(label), label) for label in labels)
            if promise <= min(_with_slack(best), self._most + _SLACK)
        )
        out: list[Label] = []
        for _, _, i in ranked:
            if front.admit(labels[i]):
                out.append(labels[i])
                if len(out) == self._width:
                    break
        return out

    def _next_steps(self, labels: list[Label], best: int, at_once: int) -> tuple[list[_Step], bool]:
        """The steps to evaluate, and whether these are all."""
        steps = [step for label in labels for step in self._steps_from(label)]
        limit = min(_with_slack(best), self._most + _SLACK)
        steps = sorted((step for step in steps if step.promise <= limit), key=lambda step: step.promise)
        if not steps:
            return [], True
        good = sum(step.promise <= _with_slack(steps[0].promise) for step in steps)
        most = max(good, at_once)
        return steps[:most], len(steps) <= most

    def _steps_from(self, label: Label) -> list[_Step]:
        """All candidate rows on top of a label."""
        rules, height = self._rules, self._rules.camera.vfov_deg
        start = label.pitch_deg + _SMALLEST_STEP * height
        stop = min(label.pitch_deg + self._relaxation.longest_step_deg(label.pitch_deg), rules.pitch_deg[1])
        if stop <= start:
            start = (label.pitch_deg + stop) / 2
        if stop - label.pitch_deg < 1e-6:
            return []
        fewest, most = rules.counts_between(start, stop)
        out: list[_Step] = []
        for count in range(fewest, most + self._more_images + 1):
            for zone in rules.zones(count):
                a, b = max(start, zone[0]), min(stop, zone[1])
                if a <= b:
                    promise = label.images + count + self._relaxation.least_above(b, count)
                    out.append(_Step(label=label, count=count, start_deg=a, stop_deg=b, promise=promise))
        return out

    def _take(self, steps: list[_Step]) -> list[Label]:
        if not steps:
            return []
        rules = self._rules
        low_deg = np.array([step.label.pitch_deg for step in steps])
        low_count = np.array([step.label.count for step in steps])
        count = np.array([step.count for step in steps])
        start = np.array([step.start_deg for step in steps])
        pitch = highest_pitch(
            rules.margin,
            rules.pairs(low_deg, low_count, count),
            start,
            np.array([step.stop_deg for step in steps]),
            wanted=np.full(len(steps), self._wanted),
            height_deg=rules.camera.vfov_deg,
            guess=np.where(
                np.minimum(low_count, count) > FEW, low_deg + self._relaxation.approximate_step_deg(low_deg), np.nan
            ),
        )
        good = ~np.isnan(pitch)
        if not rules.layout.closed:
            good[good] = rules.allowed(pitch[good], count[good])
        before: list[Label | None] = [step.label for step, g in zip(steps, good.tolist(), strict=True) if g]
        return self._labels(pitch[good], count[good], before, start[good])

    def _labels(
        self, pitch_deg: FloatArray, count: IntArray, before: list[Label | None], lowest: FloatArray
    ) -> list[Label]:
        """Labels of new rows; for rows of few images also at somewhat lower pitches."""
        pitches, counts, origins = [pitch_deg], [count], list(before)
        for share in _LOWER:
            lower = pitch_deg - share * self._rules.camera.vfov_deg
            fine = (count <= FEW) & (lower >= lowest) & self._rules.allowed(lower, count)
            pitches.append(lower[fine])
            counts.append(count[fine])
            origins += [b for b, f in zip(before, fine.tolist(), strict=True) if f]
        pitch, number = np.concatenate(pitches), np.concatenate(counts)
        _, high = self._rules.band(pitch, number)
        top = self._rules.band_deg[1]
        out: list[Label] = []
        for p, c, h, b in zip(pitch.tolist(), number.tolist(), high.tolist(), origins, strict=True):
            images, rows = c + (b.images if b else 0), 1 + (b.rows if b else 0)
            reaches = h >= top and rows >= self._rules.demands.least_rows
            out.append(Label(pitch_deg=p, count=c, images=images, rows=rows, highest_deg=h, reaches=reaches, before=b))
        return out


def searches(rules: RowConstraints, *, wanted: float = 0.0, width: int = WIDTH) -> Iterator[RowSearch]:
    """The searches to make one after the other until one has solutions; the arguments are those of `RowSearch`."""
    yield RowSearch(rules, wanted=wanted, width=width)
    if rules.at_limits:
        yield RowSearch(rules, wanted=wanted, width=width, more_images=MORE_AT_LIMITS)


def _with_slack(images: int) -> int:
    return min(images + _SLACK + int(_SLACK_FRAC * images), NEVER - 1)


class _ParetoFront:
    """The set of non-dominated labels."""

    def __init__(self, height_deg: float) -> None:
        self._height = height_deg
        self._rows = np.empty((64, 4))
        self._count = 0

    def admit(self, label: Label) -> bool:
        """Add a label, unless another one with at most its cost dominates it."""
        known = self._rows[: self._count]
        near = known[:, 0] <= label.images
        near &= known[:, 1] >= label.pitch_deg - 1e-6
        near &= (known[:, 3] >= label.count) | (known[:, 1] > label.pitch_deg + 0.04 * self._height)
        if label.count <= 2 * FEW:
            near &= known[:, 2] >= label.highest_deg - 0.005 * self._height
        if near.any():
            return False
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count] = label.images, label.pitch_deg, label.highest_deg, label.count
        self._count += 1
        return True
