"""Lower bound of the remaining cost: fewest images above a row, by a relaxation that knows only counts and steps.

On a fine grid of pitches, each pitch is a row with the minimum number of images by C2. A row may follow another one at
the step that a pair with the best phase allows, measured at a few pitches and slightly lengthened. Whether rows fit
otherwise is ignored, so the relaxation is slightly optimistic.
"""

from __future__ import annotations

import math

import numpy as np

from panoexec.angles import FloatArray
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_steps import highest_pitch

_LEAST_STEP_DEG = 1e-9
"""A range of pitches with smaller steps is one pitch."""
_GRID = 250
_GRID_MANY = 600
"""Grid steps per vertical field of view; more where there are many rows, so that rounding does not accumulate."""

_NODES = 17
_STEEPEST_DEG = 76.0
_GENEROUS = 5e-4
"""Amount by which measured steps are lengthened, in vertical fields of view."""

_POLAR_GENEROUS = 1.01
_POLAR_SHARE = 0.3
_MANY = 40
"""From this number of images in a row, one more or less hardly changes the pitch of the next row."""

_LOW_DEG = 8.0
_TALL_DEG = 60.0
"""With a larger vertical field of view steps are not measured, as there are only a few rows."""

NEVER = 10**7
"""Number of images above a row from which the top of the band cannot be reached."""


class RowRelaxation:
    """Lower bound of the number of images above a row.

    Args:
        rules: the constraints on rows.
        wanted: margin of pairs of rows for which steps are measured.
        more_images: number of images above C2's minimum with which rows may reach the upper end.
    """

    def __init__(self, rules: RowConstraints, wanted: float = 0.0, *, more_images: int = 4) -> None:
        self._rules = rules
        self._wanted = wanted
        self._more_images = more_images
        height = rules.camera.vfov_deg
        # no image farther away sees anything of the band
        beyond = rules.camera.hfov_deg + height
        low, high = (min(max(end, rules.band_deg[0] - beyond), rules.band_deg[1] + beyond) for end in rules.pitch_deg)
        grid = _GRID if height > _LOW_DEG else _GRID_MANY
        count = max(2, math.ceil((high - low) / height * grid) + 1)
        self._grid = np.linspace(low, high, count)
        step_deg = float(self._grid[1] - self._grid[0])
        self._step = step_deg if step_deg > _LEAST_STEP_DEG else 1.0
        steps_deg = self._steps_deg(self._grid)
        self._longest = steps_deg
        density = rules.layout.span_deg / np.clip(rules.widest(self._grid), 1e-3, rules.layout.span_deg) / steps_deg
        self._about = np.cumsum((density * self._step)[::-1])[::-1]
        self._closing = self._closing_counts()
        self._after = self._solve(steps_deg)

    def longest_step_deg(self, pitch_deg: float) -> float:
        """The largest pitch difference from a row to the next, degrees."""
        return float(self._longest[self._index(pitch_deg)])

    def least_after(self, pitch_deg: float) -> int:
        """Fewest images above a row that does not reach the band's upper end."""
        return round(float(self._after[self._index(pitch_deg)]))

    def least_above(self, pitch_deg: float, count: int) -> int:
        """Fewest images above a row that may reach the band's upper end."""
        i = self._index(pitch_deg)
        return 0 if float(self._closing[i]) <= count else round(float(self._after[i]))

    def _index(self, pitch_deg: float) -> int:
        i = math.ceil((pitch_deg - float(self._grid[0])) / self._step - 1e-6)
        return min(max(i, 0), len(self._grid) - 1)

    def approximate_step_deg(self, pitch_deg: FloatArray) -> FloatArray:
        """Approximate pitch difference to the next row, for rows at pitches (k,), degrees."""
        return np.asarray(np.interp(pitch_deg, self._grid, self._longest) - _GENEROUS * self._rules.camera.vfov_deg)

    def estimate_after(self, pitch_deg: float) -> float:
        """Estimated, fractional number of images above a row: it breaks ties between labels with equal bounds."""
        return float(np.interp(pitch_deg, self._grid, self._about))

    def _steps_deg(self, pitch_deg: FloatArray) -> FloatArray:
        """Largest pitch differences to the next row, for rows at pitches (k,)."""
        rules, camera = self._rules, self._rules.camera
        height, half = camera.vfov_deg, camera.half_height
        # an infinite strip of images along a great circle, with the overlap `overlap_v` of C3
        strip = height / 2 + math.degrees(math.atan(half * (1 - 2 * rules.overlap_v)))
        # near a pole an image sees all azimuths, and a row more than a strip
        steep = np.minimum(np.abs(pitch_deg) + height / 2, 90.0)
        polar = np.cos(np.radians(steep)) < camera.half_width * _POLAR_SHARE
        limit = np.where(polar, height, min(strip * _POLAR_GENEROUS, height))
        nodes = np.linspace(-_STEEPEST_DEG, _STEEPEST_DEG - strip, 4 * _NODES if rules.many else _NODES)
        nodes = nodes[(nodes > rules.pitch_deg[0]) & (nodes + strip < rules.pitch_deg[1])]
        if not len(nodes) or not rules.layout.closed or height > _TALL_DEG:
            return limit
        found = self._measured(nodes, strip)
        nodes, found = nodes[~np.isnan(found)], found[~np.isnan(found)]
        if not len(nodes):
            return limit
        measured = np.interp(pitch_deg, nodes, found - nodes + _GENEROUS * height)
        inner = (pitch_deg >= nodes[0]) & (pitch_deg <= nodes[-1])
        return np.where(inner, np.minimum(measured, limit), limit)

    def _measured(self, nodes: FloatArray, strip_deg: float) -> FloatArray:
        rules, height = self._rules, self._rules.camera.vfov_deg
        low, high = rules.fewest(nodes) + 1, rules.fewest(nodes + strip_deg) + 1
        # where the phase hardly matters, use counts without a common divisor: every relative position occurs
        high = np.where((low >= _MANY) & (np.gcd(low, high) > 1), high + 1, high)
        pairs = rules.pairs(nodes, low, high)
        stop = nodes + min(height, strip_deg * _POLAR_GENEROUS)
        wanted = np.full(len(nodes), self._wanted)
        return highest_pitch(rules.margin, pairs, nodes + 0.3 * height, stop, wanted=wanted, height_deg=height)

    def _closing_counts(self) -> FloatArray:
        """Fewest images with which rows on the grid reach the band's upper end, infinite where none do."""
        rules, grid = self._rules, self._grid
        top = rules.band_deg[1]
        fewest = rules.fewest(grid)
        closing = np.full(len(grid), np.inf)
        near = np.nonzero(grid + rules.camera.vfov_deg >= top)[0]
        for more in range(self._more_images):
            _, high = rules.band(grid[near], fewest[near] + more)
            # half a grid step higher, the row may just reach the end
            reaches = high >= top - self._step
            closing[near[reaches]] = fewest[near[reaches]] + more
            near = near[~reaches]
            if not len(near):
                break
        return closing

    def _solve(self, steps_deg: FloatArray) -> FloatArray:
        grid, fewest = self._grid, self._rules.fewest(self._grid)
        after = np.full(len(grid), np.inf)
        cost = self._closing.copy()
        reach = np.floor(steps_deg / self._step).astype(int) + 1
        for i in range(len(grid) - 2, -1, -1):
            after[i] = cost[i + 1 : i + 1 + reach[i]].min()
            cost[i] = min(cost[i], fewest[i] + after[i])
        # rows that do not reach the top and cannot go higher are dead ends
        return np.where(np.isinf(after), NEVER, after)
