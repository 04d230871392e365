"""Lower bound of the number of images of plans in closed rows that also cover the band between their rows.

**The class of plans** is that of `row_bound`: rows of one pitch each, roll 0, closed, at any phase and any spacing;
caps of one or two images that see the pole at the two ends alone. Without `overlap_h` C2 asks nothing, and a row is
closed if the sides of neighbours leave no gap on the parallel of its own pitch.

**Coverage.** On each parallel of the band the robust cores of all images must fill 360°, so that the sum of n·s(p, e)
over the rows is at least that, whatever their phases and spacings, with s what one core shows (`parallels`).

**Which rows show a parallel.** A step from a row to the next one is *short* if the lower row shows anything more than δ
above the pitch of the upper one, or the upper row anything more than δ below that of the lower one. Rows joined by
short steps are a *group*. From δ above the highest row of a group to δ below the lowest row of the next one no third
group shows anything, so that these two alone fill the parallels; so do the first two below that, down to the end of the
band, and the last two above. The bound is a shortest path over groups, each of which counts as showing what it can at
most:

* one row of n images shows n times what one does;
* a cap of one or two images and a row: likewise, with the cap that shows most of those that fill, with this row, the
  parallels that no other group shows;
* another group of up to M images in all: as if all were where they show most, at the pitch of the row next to the gap
  or beyond it;
* a group of more images shows all.

C3 limits the steps, C2 the images in a row from below (`row_limits`). All is computed for cells of pitch, with the most
favourable values in each; rows in one cell count as one row of all their images.

Cells that are in no chain of T images under C2 and C3 are left out. If no path of so many covers, T + 1 is a bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import Constraints
from panoexec.planning.search.row_cells import FIRST, LAST, LOW, TOP, BoolArray, Cells, IntArray, Nodes, cells_of

_CELLS = (80, 240)
"""Cells of pitch per vertical field of view: few ones first, and more where these do not raise the bound any more."""
_NEAR = 3
"""The more cells are not tried if a plan is known whose images are more above the bound: it is not tight there."""
_BESIDE = 0.15
"""δ of the module docstring, in vertical fields of view."""
_GROUP = 14
"""M of the module docstring."""
_FURTHER = (0, 0, 1, 3, 7)
"""By how much more than the bound the chains cost that are looked at in turn."""
_MORE = 4
"""Images more than the least of a row that are told apart; this many or more may fill all that one image shows of."""
_MOST_IMAGES = 400
"""Plans of more images have so many rows that the cells' widths add up to more than the bound gains."""
_MOST_NODES = 1000
"""Where so many cells are left the search ends: it would take seconds."""
_EPS = 1e-6
_ANY = 1e8


def least_images_that_cover(
    camera: Camera,
    constraints: Constraints,
    known: int,
    *,
    images: int | None = None,
    go_on: Callable[[], bool] = lambda: True,
) -> int:
    """The bound, at least `known`.

    Args:
        camera: the camera.
        constraints: of a full circle, without masks and skyline.
        known: another bound for plans in closed rows.
        images: there is a plan with so many, so that a larger bound is not looked for; None if none is known.
        go_on: asked now and then; with False the bound is what is known by then.
    """
    if known > _MOST_IMAGES or camera.vfov_deg > 170.0:
        return known
    bound = known
    for per_vfov in _CELLS:
        if not go_on() or (images is not None and per_vfov > _CELLS[0] and images > bound + _NEAR):
            break
        cells = cells_of(camera, constraints, per_vfov)
        if np.any(cells.begins & cells.ends & (cells.low_caps | cells.top_caps)):
            return known
        nodes = Nodes.of(cells)
        alone = (360.0 / cells.shown).max(axis=1, initial=0.0)
        single = np.where(cells.begins & cells.ends, np.maximum(cells.images, np.ceil(alone - _EPS)), np.inf).min()
        least = min(float(nodes.through().min(initial=np.inf)), float(single))
        if not math.isfinite(least):
            return known
        bound = max(bound, int(least))
        for further in _FURTHER:
            if images is not None and bound >= images:
                return bound
            most = bound + further if images is None else min(bound + further, images - 1)
            left = nodes.within(most)
            if bound >= single or left.count > _MOST_NODES or not go_on():
                break
            found = min(_Search(cells, left, most, _BESIDE * camera.vfov_deg).least(), float(single), most + 1.0)
            bound = max(bound, int(found))
            if found <= most:
                break
    return bound


class _Search:
    """Shortest path over groups of rows, from the lowest to the highest, of at most `most` images.

    A group is left by an *exit*: as one row of k images more than C2 asks for, as a cap of one or of two images with
    such a row, as any other group of m images in all, or as one of more than M.
    """

    def __init__(self, cells: Cells, nodes: Nodes, most: int, beside_deg: float) -> None:
        self._cells, self._nodes, self._most, self._beside = cells, nodes, most, beside_deg
        kind, cell = nodes.kind, nodes.cell
        self._is_low, self._is_top = kind == LOW, kind == TOP
        self._caps = {images: np.nonzero(self._is_top & (nodes.images == images))[0] for images in (1, 2)}
        self._first, self._last = (kind == FIRST) | self._is_low, (kind == LAST) | self._is_top
        slack = int(most - float(nodes.through().min(initial=most)))
        more = np.arange(min(slack, _MORE) + 1)
        self._totals = np.arange(2, _GROUP + 1)
        self._counts = nodes.images[:, None] + more
        self._counts[self._is_low | self._is_top, 1:] = np.inf
        self._fill = np.where(np.isfinite(self._counts), self._counts, 0.0)
        """As many images as what a row shows is multiplied by."""
        if slack > _MORE:
            self._fill[~(self._is_low | self._is_top), _MORE:] = _ANY
        self._bottom, self._top = cells.bottom[cell], cells.top[cell]
        e = cells.elevations[None]
        self._above = e >= self._top[:, None] + beside_deg
        self._below = e <= self._bottom[:, None] - beside_deg
        self._shown = cells.shown[cell]
        most_below = np.maximum.accumulate(cells.shown, axis=0)[cell]
        most_above = np.maximum.accumulate(cells.shown[::-1], axis=0)[::-1][cell]
        # what a group leaves of each parallel to the next one, and what one image of the next one adds
        filled = self._fill[:, :, None] * self._shown[:, None]
        alone = (self._above | self._first[:, None])[:, None]
        single = np.where(alone, np.maximum(360.0 - filled, 0.0), 0.0)
        capped = np.full((nodes.count, 2 * len(more), e.size), 360.0)
        others = np.maximum(360.0 - most_below[:, None] * self._totals[:, None], 0.0)
        self._lack = np.concatenate([single, capped, np.where(self._above[:, None], others, 0.0)], axis=1)
        self._adds = np.where(self._below | self._last[:, None], self._shown, np.inf)
        self._adds_others = np.where(self._below, most_above, np.inf)
        # costs: of the exits, of those of large groups, and when a group is entered of which this is the lowest row
        self._exits = np.full((nodes.count, 3 * len(more) + len(self._totals)), np.inf)
        self._large = np.full(nodes.count, np.inf)
        self._enter = np.full((nodes.count, len(self._totals)), np.inf)
        self._enter_large = np.full(nodes.count, np.inf)
        self._rows = np.full((nodes.count, nodes.count), np.inf, dtype=np.float32)
        """Fewest images (n, n) of rows joined by short steps, from the first to the second."""
        self._best = math.inf

    def least(self) -> float:
        """The fewest images of such a path; infinite if there is none."""
        nodes, reach = self._nodes, self._cells.reach
        begin = np.searchsorted(nodes.cell, np.searchsorted(reach, nodes.cell))
        stop = np.searchsorted(nodes.cell, nodes.cell)
        room = self._most - (nodes.after - nodes.images)
        for j in range(nodes.count):
            earlier = np.arange(begin[j], stop[j])
            earlier = earlier[self._may_follow(earlier, j)]
            short = self._short(earlier, j)
            self._enter_group(j, earlier[~short])
            self._join(j, earlier[short])
            self._exits[j][self._exits[j] > room[j]] = np.inf
            if self._last[j]:
                self._end(j)
        return self._best

    def _may_follow(self, i: IntArray, j: int) -> BoolArray:
        """Whether row j may be next after rows i, but for C3."""
        nodes, cells = self._nodes, self._cells
        if self._first[j]:
            return np.zeros(len(i), dtype=bool)
        allowed = ~self._last[i]
        if self._is_top[j]:
            highest = cells.after_caps[int(nodes.images[j]) - 1]
            return np.asarray(allowed & (self._is_low[i] | (-cells.middle[nodes.cell[i]] <= highest)))
        for caps, highest in zip((1, 2), cells.after_caps, strict=True):
            if cells.middle[nodes.cell[j]] > highest:
                allowed &= ~(self._is_low[i] & (nodes.images[i] == caps))
        return np.asarray(allowed)

    def _short(self, i: IntArray, j: int | IntArray) -> BoolArray:
        """Whether the step from i up to j is short."""
        cells, cell = self._cells, self._nodes.cell
        up = cells.highest[cell[i]] > self._bottom[j] + self._beside
        return np.asarray(up | (cells.lowest[cell[j]] < self._top[i] - self._beside))

    def _enter_group(self, j: int, before: IntArray) -> None:
        """Begin a group with row j, after the groups that end with rows `before`."""
        images, totals = self._counts[j], self._totals
        if self._first[j]:
            needed = (360.0 / self._adds_others[j]).max(initial=0.0)
            single, large = np.zeros(len(images)), 0.0
            others = np.where(totals >= needed - _EPS, 0.0, np.inf)
        else:
            large = float(self._large[before].min(initial=np.inf))
            reached = self._exits[before]
            some = np.isfinite(reached).any(axis=1)
            reached = reached[some]
            where = self._parallels(before[some], j)
            lack = self._lack[before[some], :, where]
            single = np.minimum(_cheapest(reached, lack / self._adds[j, where], self._fill[j]), large)
            others = np.minimum(_cheapest(reached, lack / self._adds_others[j, where], totals), large)
            large = min(large, float(reached.min(initial=np.inf)))
        self._exits[j, : len(images)] = single + images
        self._enter[j], self._enter_large[j] = others + totals, large
        if self._is_low[j] or self._last[j] or not math.isfinite(large):
            return
        for top in (1.0, 2.0):
            self._under_a_cap(j, before, top)

    def _parallels(self, before: IntArray, j: int) -> slice:
        """Those that groups which end with rows `before` and one that begins with row j must fill alone."""
        if not len(before):
            return slice(0, 0)
        start = 0 if self._first[before].any() else int((~self._above[before[0]]).sum())
        return slice(start, None if self._last[j] else int(self._below[j].sum()))

    def _under_a_cap(self, j: int, before: IntArray, top: float) -> None:
        """End the chain with row j and a cap of so many images, joined by a short step."""
        cell = self._nodes.cell
        caps = self._caps[int(top)]
        caps = caps[(cell[caps] > cell[j]) & (cell[caps] <= self._cells.reach[cell[j]])]
        if not len(caps):
            return
        caps = caps[self._short(np.array([j]), caps)]
        if -self._cells.middle[cell[j]] > self._cells.after_caps[int(top) - 1]:
            return
        if not len(caps):
            return
        alone = self._above[j] | self._first[j]
        for images, fill in zip(self._counts[j], self._fill[j], strict=True):
            filled = fill * self._shown[j] + top * self._shown[caps]
            fits = np.all((filled >= 360.0 - _EPS) | ~alone, axis=1)
            if not fits.any():
                continue
            least = 0.0 if self._first[j] else float(self._large[before].min(initial=np.inf))
            lacking = (self._lack[before] > filled[fits].max(axis=0) + _EPS).any(axis=2)
            least = min(least, float(np.where(lacking, np.inf, self._exits[before]).min(initial=np.inf)))
            self._best = min(self._best, least + images + top)

    def _join(self, j: int, near: IntArray) -> None:
        """Add row j to groups, after rows `near` of them, and leave them."""
        nodes, more = self._nodes, self._counts.shape[1]
        self._rows[j, j] = nodes.images[j]
        if not len(near):
            return
        via = self._rows[:j, near]
        self._rows[:j, j] = via.min(axis=1) + nodes.images[j]
        # a row and a cap are reckoned more exactly than as a group of any rows
        exact = near[~self._is_low[near] if self._is_top[j] else self._is_low[near]]
        via[exact, np.searchsorted(near, exact)] = np.inf
        images = via.min(axis=1) + nodes.images[j]
        self._large[j] = (self._enter_large[:j] + np.maximum(images, _GROUP + 1)).min(initial=np.inf)
        some = np.nonzero(images <= _GROUP)[0]
        enough = images[some][:, None] <= self._totals
        self._exits[j, 3 * more :] = np.where(enough, self._enter[some], np.inf).min(axis=0, initial=np.inf)
        if self._is_top[j]:
            return
        alone = self._below[j] | self._last[j]
        for bottom in (1, 2):
            caps = near[self._is_low[near] & (nodes.images[near] == bottom)]
            if not len(caps):
                continue
            filled = self._fill[j][:, None, None] * self._shown[j] + bottom * self._shown[caps]
            fits = np.all((filled >= 360.0 - _EPS) | ~alone, axis=2)
            left = np.where(fits[:, :, None], np.maximum(360.0 - filled, 0.0), 360.0).min(axis=1)
            where = slice(bottom * more, (bottom + 1) * more)
            self._lack[j, where] = left
            self._exits[j, where] = np.where(fits.any(axis=1), self._counts[j] + bottom, np.inf)

    def _end(self, j: int) -> None:
        """End the chain with row j: as one row, as a cap and a row, or as another group."""
        more = self._counts.shape[1]
        # as one row it has been compared with the rows below on all parallels
        found = self._exits[j].copy()
        found[3 * more :][(self._lack[j, 3 * more :] > _EPS).any(axis=1)] = np.inf
        self._best = min(self._best, float(found.min()), float(self._large[j]))


def _cheapest(reached: FloatArray, needed: FloatArray, images: FloatArray | IntArray) -> FloatArray:
    """The least cost (y,) of exits (k, x) of which the next group of `images` (y,) fills what they leave.

    Args:
        reached: their costs.
        needed: (k, x, m) images that each parallel needs.
        images: (y,).
    """
    some = reached < np.inf
    most, costs = needed.max(axis=2, initial=0.0)[some], reached[some]
    order = np.argsort(most)
    least = np.concatenate([[np.inf], np.minimum.accumulate(costs[order])])
    return np.asarray(least[np.searchsorted(most[order], images + _EPS, side="right")])
