"""The search for rows: a shortest path from the lowest row to the highest, by number of images (A*).

A *label* is a way to cover the band from its lower end up to a row: that row's pitch and count, the images so far and
the label it came from. From a label the search steps to every count of images that could make the next row, with that
row as high as C1 and C3 let it be and, in steepness, no lower than C2 asks of that count. Rows as high as possible lose
nothing: whatever can follow a row can follow the same row a little higher, but for the places where a higher row needs
more images (there rows of either count are tried) and for rows of a few images, which may cover a wider band when they
stand lower (there a few lower pitches are tried).

What is still to come is estimated by `panoexec.planning.row_outlook`: a relaxation that knows C2's counts and how long
steps are at the best, and not whether rows fit. `waves` takes one total after the other, from the least that the
relaxation allows, and works only on labels that may lead to it; it ends with the first total that the caller accepts.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from panoexec.angles import FloatArray
from panoexec.planning.row_layout import IntArray
from panoexec.planning.row_outlook import NEVER, Outlook
from panoexec.planning.row_rules import RowRules
from panoexec.planning.row_steps import highest_pitch

_SMALLEST_STEP = 0.15
"""Rows closer than this share of the vertical field of view are not tried."""

_MORE_IMAGES = 2
"""How many images more than C2 asks for are tried in a row."""

FEW = 6
_LOWER = (0.08, 0.16, 0.24, 0.32)
"""Rows of few images are also tried so many vertical fields of view lower."""

_AT_ONCE = 0.004
"""Totals are taken so many at once, as a share of the total."""

_HUGE = 500
"""In plans of so many images, rows that are not few-image rows are all alike: only how high they stand matters."""

_MOST_LABELS = 20_000


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

    Attributes:
        wanted: margin that pairs of rows have to have: in plans with very many rows a little, as those are not looked
            at one by one.
    """

    def __init__(self, rules: RowRules) -> None:
        self._rules = rules
        self._outlook = Outlook(rules)
        self.wanted = self._outlook.wanted
        self._steps: list[_Step] = []
        self._labels: list[tuple[int, Label]] = []
        self._known = _Front(rules.camera.vfov_deg)
        self._begin()
        self._known.coarse = (self.least_images or 0) > _HUGE

    @property
    def least_images(self) -> int | None:
        """Fewest images that the relaxation allows; None if it allows no way."""
        promises = [promise for promise, _ in self._labels if promise < NEVER]
        return min(promises) if promises else None

    def waves(self) -> Iterator[tuple[int, list[Label]]]:
        """Totals in ascending order, each with the complete labels that have it, those with the most to spare first."""
        while self._labels or self._steps:
            total = min([promise for promise, _ in self._labels] + [step.promise for step in self._steps])
            if total >= NEVER:
                return
            total += int(_AT_ONCE * total)
            complete: list[Label] = []
            while True:
                ready = [label for promise, label in self._labels if promise <= total]
                self._labels = [(promise, label) for promise, label in self._labels if promise > total]
                complete += [label for label in ready if label.reaches]
                for label in ready:
                    if not label.reaches and self._known.admit(label):
                        self._steps += self._steps_from(label)
                steps = [step for step in self._steps if step.promise <= total]
                self._steps = [step for step in self._steps if step.promise > total]
                if not steps:
                    break
                self._take(steps)
            if len(self._known) > _MOST_LABELS:
                return
            complete.sort(key=lambda label: (label.images, label.rows, -label.highest_deg))
            for images, group in itertools.groupby(complete, key=lambda label: label.images):
                yield images, list(group)

    def highest_reach_deg(self) -> float:
        """Upper end of what rows could cover at all, -90 if there is no first row: for error messages."""
        level = [label for _, label in self._labels]
        highest = max((label.highest_deg for label in level), default=-90.0)
        while level:
            self._labels = []
            level = sorted(level, key=lambda label: -label.pitch_deg)[:4]
            self._take([step for label in level for step in self._steps_from(label)])
            level = [label for _, label in self._labels]
            highest = max([highest, *(label.highest_deg for label in level)])
            if any(label.reaches for label in level):
                break
        return highest

    def _begin(self) -> None:
        """First rows: for each count as high as it can be and still cover from the band's lower end."""
        rules = self._rules
        pitch, count = rules.first_rows(_MORE_IMAGES)
        self._add(pitch, count, [None] * len(count), np.full(len(count), rules.pitch_deg[0]))

    def _steps_from(self, label: Label) -> list[_Step]:
        """All rows that may follow a label."""
        rules, height = self._rules, self._rules.camera.vfov_deg
        start = label.pitch_deg + _SMALLEST_STEP * height
        stop = min(label.pitch_deg + height * self._outlook.longest_step, rules.pitch_deg[1])
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

    def _take(self, steps: list[_Step]) -> None:
        rules = self._rules
        low_deg = np.array([step.label.pitch_deg for step in steps])
        low_count = np.array([step.label.count for step in steps])
        count = np.array([step.count for step in steps])
        start = np.array([step.start_deg for step in steps])
        stop = np.array([step.stop_deg for step in steps])
        pitch = np.minimum(low_deg + self._outlook.smooth_step_deg(low_deg, low_count, count), stop)
        exact = np.nonzero(np.isnan(pitch))[0]
        pitch[pitch < start] = np.nan
        pairs = rules.pairs(low_deg[exact], low_count[exact], count[exact])
        wanted = np.full(len(exact), self.wanted)
        height = rules.camera.vfov_deg
        pitch[exact] = highest_pitch(rules.margin, pairs, start[exact], stop[exact], wanted=wanted, height_deg=height)
        good = ~np.isnan(pitch)
        before: list[Label | None] = [step.label for step, g in zip(steps, good.tolist(), strict=True) if g]
        self._add(pitch[good], count[good], before, start[good])

    def _add(self, pitch_deg: FloatArray, count: IntArray, before: list[Label | None], lowest: FloatArray) -> None:
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
        for p, c, h, b in zip(pitch.tolist(), number.tolist(), high.tolist(), origins, strict=True):
            images, rows = c + (b.images if b else 0), 1 + (b.rows if b else 0)
            reaches = h >= top and rows >= self._rules.demands.least_rows
            label = Label(pitch_deg=p, count=c, images=images, rows=rows, highest_deg=h, reaches=reaches, before=b)
            promise = images if reaches else images + self._outlook.least_after(p)
            self._labels.append((promise, label))


class _Front:
    """Labels that no other label makes superfluous."""

    def __init__(self, height_deg: float) -> None:
        self._height = height_deg
        self._rows = np.empty((64, 4))
        self._count = 0
        self.coarse = False

    def __len__(self) -> int:
        return self._count

    def admit(self, label: Label) -> bool:
        """Take a label in, unless whatever can follow it can as well follow another one that is no dearer."""
        known = self._rows[: self._count]
        near = known[:, 0] <= label.images
        if self.coarse and label.count > FEW:
            near &= known[:, 1] >= label.pitch_deg - 0.003 * self._height
        else:
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
