"""The search for rows: the shortest path from the lowest row to the highest by number of images, in a beam.

A *label* is a way to cover the band from its lower end up to a row: that row's pitch and count, the images so far and
the label it came from. From a label the search steps to every count of images that could make the next row, with that
row as high as C1 and C3 let it be and, in steepness, no lower than C2 asks of that count. Rows as high as possible lose
nothing: whatever can follow a row can follow the same row a little higher, but for the places where a higher row needs
more images (there rows of either count are tried) and for rows of a few images, which may cover a wider band when they
stand lower (there a few lower pitches are tried).

Labels advance together, a row at a time. Of those with equally many rows only the most promising go on: a label
promises its images and what `row_relaxation` says must still come, a relaxation that knows C2's counts
and how long steps are at the best, and not whether rows fit. A label that another one makes superfluous is dropped.
So each row costs the same, and a plan of n images, which has about √n rows, costs about √n steps; all steps of a row
are looked at in one go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from panoexec.angles import FloatArray
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_layout import IntArray
from panoexec.planning.search.row_relaxation import NEVER, RowRelaxation
from panoexec.planning.search.row_steps import highest_pitch

_SMALLEST_STEP = 0.15
"""Rows closer than this share of the vertical field of view are not tried."""

_MORE_IMAGES = 2
"""How many images more than C2 asks for are tried in a row."""

FEW = 6
_LOWER = (0.08, 0.16, 0.24, 0.32)
"""Rows of few images are also tried so many vertical fields of view lower."""

WIDTH, _WIDTH_MANY = 24, 8
"""So many labels of equally many rows go on; and in plans of very many rows, which are all alike."""

_SLACK = 3
_SLACK_FRAC = 0.002
"""What promises so many images more than the best complete label is given up."""

_STEPS_AT_ONCE = (20, 100, 400)
"""So many steps are looked at for a row, and all that promise no more than the best and the slack; more if that leads
nowhere. Promises are good where there are many images, which begin with the first number, others with the second."""

_LARGE = 80

_MORE_ROWS = 2
"""Labels with so many rows more than the best complete one are given up."""

_MOST_ROWS = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """See the module's text.

    Attributes:
        pitch_deg: of the row.
        count: images in the row.
        images: in all rows so far.
        rows: so far.
        highest_deg: up to which elevation the row covers all round.
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
    """A row still to be tried on top of a label, and the least total it may lead to."""

    label: Label
    count: int
    start_deg: float
    stop_deg: float
    promise: int


class RowSearch:
    """One search, for one set of rules.

    Args:
        rules: what rows have to satisfy.
        wanted: margin that pairs of rows have to have, see `PairMargin`.
        width: so many labels of equally many rows go on.
    """

    def __init__(self, rules: RowConstraints, *, wanted: float = 0.0, width: int = WIDTH) -> None:
        self._rules = rules
        self._width = min(width, _WIDTH_MANY) if rules.many else width
        self._wanted = wanted
        self._outlook = RowRelaxation(rules, wanted)
        pitch, count = rules.first_rows(_MORE_IMAGES)
        self._first = self._labels(pitch, count, [None] * len(count), np.full(len(count), rules.pitch_deg[0]))

    @property
    def least_images(self) -> int | None:
        """Fewest images that the relaxation allows; None if it allows no way."""
        promises = [promise for promise in map(self._promise, self._first) if promise < NEVER]
        return min(promises) if promises else None

    def ways(self, *, patient: bool = True) -> list[Label]:
        """Complete labels: the fewest images first, then the fewest rows, then those that reach highest.

        Args:
            patient: where none are found, look at more steps.
        """
        large = (self.least_images or 0) >= _LARGE
        tries = _STEPS_AT_ONCE if large else _STEPS_AT_ONCE[1:]
        for at_once in tries if patient else tries[:-1]:
            ways, complete = self._ways(at_once)
            if ways or complete:
                return ways
        return []

    def _ways(self, at_once: int) -> tuple[list[Label], bool]:
        """Complete labels, and whether all steps were looked at."""
        everything = True
        front = _Front(self._rules.camera.vfov_deg)
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
            going = self._going_on([label for label in level if not label.reaches], best, front)
            if not going:
                break
            steps, all_steps = self._next_steps(going, best, at_once)
            everything = everything and all_steps
            level = self._take(steps)
        return sorted(complete, key=lambda label: (label.images, label.rows, -label.highest_deg)), everything

    def highest_reach_deg(self) -> float:
        """Upper end of what rows could cover at all, -90 if there is no first row: for error messages."""
        level = self._first
        highest = max((label.highest_deg for label in level), default=-90.0)
        while level and not any(label.reaches for label in level):
            level = sorted(level, key=lambda label: -label.pitch_deg)[:4]
            level = self._take([step for label in level for step in self._steps_from(label)])
            highest = max([highest, *(label.highest_deg for label in level)])
        return highest

    def _promise(self, label: Label) -> int:
        return label.images if label.reaches else label.images + self._outlook.least_after(label.pitch_deg)

    def _going_on(self, labels: list[Label], best: int, front: _Front) -> list[Label]:
        """The most promising labels of one number of rows."""
        ranked = sorted(
            (promise, label.images + self._outlook.about_after(label.pitch_deg), i)
            for i, (promise, label) in enumerate((self._promise(label), label) for label in labels)
            if promise <= _with_slack(best)
        )
        out: list[Label] = []
        for _, _, i in ranked:
            if front.admit(labels[i]):
                out.append(labels[i])
                if len(out) == self._width:
                    break
        return out

    def _next_steps(self, labels: list[Label], best: int, at_once: int) -> tuple[list[_Step], bool]:
        """The steps worth a look, and whether these are all."""
        steps = [step for label in labels for step in self._steps_from(label)]
        steps = sorted((step for step in steps if step.promise <= _with_slack(best)), key=lambda step: step.promise)
        good = sum(step.promise <= _with_slack(steps[0].promise) for step in steps)
        most = max(good, at_once)
        return steps[:most], len(steps) <= most

    def _steps_from(self, label: Label) -> list[_Step]:
        """All rows that may follow a label."""
        rules, height = self._rules, self._rules.camera.vfov_deg
        start = label.pitch_deg + _SMALLEST_STEP * height
        stop = min(label.pitch_deg + self._outlook.longest_step_deg(label.pitch_deg), rules.pitch_deg[1])
        if stop <= start:
            start = (label.pitch_deg + stop) / 2
        if stop - label.pitch_deg < 1e-6:
            return []
        fewest, most = rules.counts_between(start, stop)
        out: list[_Step] = []
        for count in range(fewest, most + _MORE_IMAGES + 1):
            for zone in rules.zones(count):
                a, b = max(start, zone[0]), min(stop, zone[1])
                if a <= b:
                    promise = label.images + count + self._outlook.least_above(b, count)
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
            guess=np.where(np.minimum(low_count, count) > FEW, low_deg + self._outlook.usual_step_deg(low_deg), np.nan),
        )
        good = ~np.isnan(pitch)
        if not rules.layout.closed:
            good[good] = rules.allowed(pitch[good], count[good])
        before: list[Label | None] = [step.label for step, g in zip(steps, good.tolist(), strict=True) if g]
        return self._labels(pitch[good], count[good], before, start[good])

    def _labels(
        self, pitch_deg: FloatArray, count: IntArray, before: list[Label | None], lowest: FloatArray
    ) -> list[Label]:
        """New labels of rows, and of few-image rows also somewhat lower."""
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


def _with_slack(images: int) -> int:
    return min(images + _SLACK + int(_SLACK_FRAC * images), NEVER - 1)


class _Front:
    """Labels that no other label makes superfluous."""

    def __init__(self, height_deg: float) -> None:
        self._height = height_deg
        self._rows = np.empty((64, 4))
        self._count = 0

    def admit(self, label: Label) -> bool:
        """Take a label in, unless whatever can follow it can as well follow another one that is no dearer."""
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
