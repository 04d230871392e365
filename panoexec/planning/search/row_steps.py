"""The highest pitch of the next row at which a pair of rows still has a wanted margin.

If an approximate pitch is known, a few secant steps on fine margins converge to it. Otherwise a coarse margin gives a
first result, which a few fine ones correct; cases that the coarse margin misses (coverage) or that do not converge are
solved with fine margins alone. So most of the work is coarse and all results are fine.
"""

from __future__ import annotations

import numpy as np

from panoexec.angles import FloatArray
from panoexec.planning.geometry.root_finding import last_nonnegative
from panoexec.planning.search.row_layout import IntArray
from panoexec.planning.search.row_pairs import COARSE, FINE, PairMargin, Pairs, Resolution

_ROUGH_PRECISION = 2e-3
_PRECISION = 1e-3
"""Precision of pitches, in vertical fields of view."""

_CLOSE = 0.02
"""Fine margins within this distance of the wanted one are improved by a Newton step."""

_SETTLED = 3e-4
_SECANT_STEPS = 5


def highest_pitch(
    margin: PairMargin,
    pairs: Pairs,
    start: FloatArray,
    stop: FloatArray,
    *,
    wanted: FloatArray,
    height_deg: float,
    guess: FloatArray | None = None,
) -> FloatArray:
    """The highest pitch of the upper rows at which pairs have a wanted margin.

    Args:
        margin: evaluates pairs of rows.
        pairs: the rows; the pitches of the upper ones are ignored.
        start: (k,) minimum pitch of the upper rows.
        stop: (k,) maximum pitch.
        wanted: (k,) margins.
        height_deg: vertical field of view.
        guess: (k,) approximate solution, NaN where unknown.

    Returns:
        (k,) degrees, NaN where there is no solution.
    """
    if not len(pairs):
        return np.empty(0)
    rough = _Surplus(margin, pairs, wanted, COARSE)
    exact = _Surplus(margin, pairs, wanted, FINE)
    answer = np.full(len(pairs), np.nan)
    if guess is not None:
        answer = _near(exact, guess, start, stop, height_deg=height_deg)
    rest = np.nonzero(np.isnan(answer))[0]
    if len(rest):
        answer[rest] = _anywhere(rough.of(rest), exact.of(rest), start[rest], stop[rest], height_deg=height_deg)
    return answer


def _near(exact: _Surplus, guess: FloatArray, start: FloatArray, stop: FloatArray, *, height_deg: float) -> FloatArray:
    """Pitches (k,) to which secant steps from a guess converge; NaN where they do not."""
    out = np.full(len(guess), np.nan)
    which: IntArray = np.nonzero(~np.isnan(guess))[0]
    x = np.clip(guess[which], start[which], stop[which])
    before, value_before = x, np.zeros(len(x))
    slope = np.full(len(which), -1.0 / height_deg)
    for turn in range(_SECANT_STEPS):
        if not len(which):
            break
        value = exact(which, x)
        moved = np.abs(x - before) > 1e-9
        if turn:
            slope = np.where(moved, (value - value_before) / np.where(moved, x - before, 1.0), slope)
            slope = np.clip(slope, -5.0 / height_deg, -0.2 / height_deg)
        done = (value >= 0) & ((value <= _SETTLED) | (x >= stop[which]))
        out[which[done]] = x[done]
        following = np.clip(x + (value - _SETTLED / 3) / -slope, start[which], stop[which])
        go_on = ~done & (np.abs(following - x) > 1e-9)
        which, slope = which[go_on], slope[go_on]
        before, value_before, x = x[go_on], value[go_on], following[go_on]
    return out


def _anywhere(
    rough: _Surplus, exact: _Surplus, start: FloatArray, stop: FloatArray, *, height_deg: float
) -> FloatArray:
    """The highest feasible pitches (k,), NaN for none."""
    guess = last_nonnegative(rough, start, stop, _ROUGH_PRECISION * height_deg, 6)
    guess = np.where(np.isnan(guess), start, guess)
    best = np.full(len(start), np.nan)
    which: IntArray = np.arange(len(start))
    value = exact(which, guess)
    best[value >= 0] = guess[value >= 0]
    unsettled = (np.abs(value) > _SETTLED) & ~((value > 0) & (guess >= stop)) & (np.abs(value) < _CLOSE)
    if unsettled.any():
        limits = start[unsettled], stop[unsettled]
        settled = _settled(
            rough, exact, which[unsettled], (guess[unsettled], value[unsettled]), limits=limits, height_deg=height_deg
        )
        best[unsettled] = np.fmax(best[unsettled], settled)
    missing = np.nonzero(np.isnan(best))[0]
    if len(missing):
        # mostly it is coverage that fails, which costs a fraction of the overlaps
        lowest, highest = start[missing], np.maximum(guess[missing], start[missing])
        covers = last_nonnegative(
            lambda index, high_deg: exact.coverage(missing[index], high_deg),
            lowest,
            highest,
            _PRECISION * height_deg,
            8,
        )
        some = np.nonzero(~np.isnan(covers))[0]
        missing, lowest, highest = missing[some], lowest[some], covers[some]
        best[missing] = last_nonnegative(
            lambda index, high_deg: exact(missing[index], high_deg), lowest, highest, _PRECISION * height_deg, 8
        )
    return best


class _Surplus:
    """The surplus of pairs over the wanted margins, as a function of the upper rows' pitches."""

    def __init__(self, margin: PairMargin, pairs: Pairs, wanted: FloatArray, resolution: Resolution) -> None:
        self._margin = margin
        self._pairs = pairs
        self._wanted = wanted
        self._resolution = resolution

    def of(self, which: IntArray) -> _Surplus:
        """The same for a selection of the pairs."""
        return _Surplus(
            self._margin, self._pairs.at(which, self._pairs.high_deg[which]), self._wanted[which], self._resolution
        )

    def coverage(self, which: IntArray, high_deg: FloatArray) -> FloatArray:
        """The surplus of the coverage alone, which is at least that of coverage and overlap."""
        margins = self._margin.coverage_margins(self._pairs.at(which, high_deg), self._resolution)
        return np.asarray(margins.max(axis=1) - self._wanted[which])

    def __call__(self, which: IntArray, high_deg: FloatArray) -> FloatArray:
        pairs = self._pairs.at(which, high_deg)
        if self._resolution.exact:
            margins = self._margin.margins(pairs, self._resolution)
        else:
            margins = self._margin.overlap_margins(pairs, self._resolution)
        return np.asarray(margins.max(axis=1) - self._wanted[which])


def _settled(
    rough: _Surplus,
    exact: _Surplus,
    which: IntArray,
    guess: tuple[FloatArray, FloatArray],
    *,
    limits: tuple[FloatArray, FloatArray],
    height_deg: float,
) -> FloatArray:
    """The highest feasible pitches (m,) to which Newton and secant steps converge, NaN for none."""
    x, value = guess
    nudge = 0.02 * height_deg
    slope = np.minimum((rough(which, x) - rough(which, x - nudge)) / nudge, -0.1 / height_deg)
    best = np.full(len(which), np.nan)
    open_ones: IntArray = np.arange(len(which))
    for _ in range(2):
        start, stop = limits[0][open_ones], limits[1][open_ones]
        # aim slightly low, so that the result is feasible
        following = np.clip(x + (value - _SETTLED / 3) / -slope, start, stop)
        new = exact(which[open_ones], following)
        good = new >= 0
        best[open_ones[good]] = np.fmax(best[open_ones[good]], following[good])
        moved = np.abs(following - x) > 1e-9
        slope = np.where(moved, (new - value) / np.where(moved, following - x, 1.0), slope)
        slope = np.minimum(slope, -0.1 / height_deg)
        again = ((new < 0) | (new > _SETTLED)) & moved & ~((new > 0) & (following >= stop))
        open_ones, x, value, slope = open_ones[again], following[again], new[again], slope[again]
        if not len(open_ones):
            break
    return best
