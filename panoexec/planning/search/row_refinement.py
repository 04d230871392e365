"""From a search result to rows: the same counts, with the slack distributed evenly, and the phases chosen.

The search places every row as high as possible. Here the counts are fixed and the largest margin μ is determined with
which the rows still reach the top of the band. Every pair of rows then has this margin, and the lowest and the highest
row extend beyond the ends of the band by the same amount, so that a single row is in the middle of its band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_pairs import FINE, PHASES
from panoexec.planning.search.row_search import FEW
from panoexec.planning.search.row_steps import highest_pitch

_RUNGS = (0.3, 0.6, 0.8, 0.92, 0.99)
"""Fractions of the estimated margin that are tried."""

_MOST_MARGIN = 0.4
_LEFT = 5e-4
"""Margin that a phase must have to be preferred for what it ties."""

_LOWEST_NODES, _CENTRED_NODES = 33, 400
_FLATTEST_END_DEG = 89.9
"""Beyond this elevation the end of a band is a pole: rows cannot extend beyond it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Rows of evenly spaced images, the lowest first.

    Attributes:
        pitch_deg: pitch of each row.
        count: number of images of each row.
        phase_deg: yaw of each row's first image, if rows may have any phase.
        margin: margin of every pair of rows, see `PairMargin`.
    """

    pitch_deg: tuple[float, ...]
    count: tuple[int, ...]
    phase_deg: tuple[float, ...]
    margin: float

    @property
    def images(self) -> int:
        """Number of images."""
        return sum(self.count)


def refine(rules: RowConstraints, path: Sequence[tuple[float, int]], least_margin: float = 0.0) -> Rows | None:
    """Give rows with the given counts the largest common margin.

    Args:
        rules: the constraints on the rows.
        path: (pitch_deg, count) of the rows, lowest first; the pitches are upper limits for C2, and for rows of a few
            images in general.
        least_margin: minimum margin.

    Returns:
        The rows; None if they do not reach the top of the band with `least_margin`.
    """
    if len(path) == 1 and all(_free_ends(rules)):
        return _centred(rules, *path[0], least_margin)
    extra = np.array([0.0, *(part * _promising(rules, path) for part in _RUNGS)])
    pitches = _climb(rules, path, least_margin + extra, extra)
    reaches = _reaches(rules, path[-1][1], pitches[-1], extra)
    if not rules.layout.closed:
        counts_of = np.array([count for _, count in path])
        for i in np.nonzero(reaches)[0].tolist():
            reaches[i] = rules.allowed(pitches[:, i], counts_of).all()
    good = np.nonzero(reaches)[0]
    if not len(good) or good[0] != 0:
        return None
    last = int(good[-1])
    counts = tuple(count for _, count in path)
    return Rows(
        pitch_deg=tuple(pitches[:, last].tolist()),
        count=counts,
        phase_deg=_phases(rules, pitches[:, last], counts),
        margin=float(least_margin + extra[last]),
    )


def _centred(rules: RowConstraints, pitch_deg: float, count: int, margin: float) -> Rows:
    """A single row, not above the given pitch, that extends equally beyond both ends of the band."""
    height = rules.camera.vfov_deg
    floor, _ = rules.zone_of(pitch_deg, count)
    pitch = np.linspace(max(floor, pitch_deg - height), pitch_deg, _CENTRED_NODES)
    low, high = rules.band(pitch, np.full(len(pitch), count))
    over = np.minimum(rules.band_deg[0] - low, high - rules.band_deg[1])
    best = float(pitch[int(np.argmax(over))])
    return Rows(pitch_deg=(best,), count=(count,), phase_deg=(0.0,), margin=margin)


def _promising(rules: RowConstraints, path: Sequence[tuple[float, int]]) -> float:
    """Estimate of the margin that the slack at the top allows, if rows may be moved freely."""
    pitch, count = path[-1]
    _, high = rules.band(np.array([pitch]), np.array([count]))
    height = rules.camera.vfov_deg
    bottom, top = _free_ends(rules)
    places = len(path) - 1 + bottom + top
    slack = max(float(high[0]) - rules.band_deg[1], 0.0)
    if not top:
        # an image near a pole extends far beyond it: what counts is the lowest permitted pitch of the last row
        floor, _ = rules.zone_of(pitch, count)
        lower = np.linspace(max(floor, pitch - height), pitch, _LOWEST_NODES)
        _, highs = rules.band(lower, np.full(len(lower), count))
        slack = pitch - float(lower[highs >= rules.band_deg[1]].min(initial=pitch))
    return min(slack / (max(places, 1) * height), _MOST_MARGIN)


def _free_ends(rules: RowConstraints) -> tuple[bool, bool]:
    """Whether rows can extend beyond the lower and the upper end of the band."""
    low, high = rules.band_deg
    return low > -_FLATTEST_END_DEG, high < _FLATTEST_END_DEG


def _climb(
    rules: RowConstraints, path: Sequence[tuple[float, int]], margins: FloatArray, extra: FloatArray
) -> FloatArray:
    """Highest pitches (rows, margins) of rows for each margin, at most the given ones; NaN where infeasible.

    Args:
        rules: the constraints on the rows.
        path: as for `refine`.
        margins: of pairs of rows.
        extra: extension of the first row beyond the lower end of the band, in vertical fields of view.
    """
    height = rules.camera.vfov_deg
    floor, _ = rules.zone_of(*path[0])
    over = height * extra if _free_ends(rules)[0] else np.zeros(len(margins))
    out = np.full((len(path), len(margins)), np.nan)
    out[0] = np.maximum(path[0][0] - over, floor)
    for i in range(1, len(path)):
        (before_deg, before), (pitch, count) = path[i - 1], path[i]
        floor, _ = rules.zone_of(pitch, count)
        low = np.maximum(out[i - 1] + 0.05 * height, floor)
        high = np.minimum(np.full(len(margins), pitch), out[i - 1] + height)
        possible = np.nonzero(low <= high + 1e-9)[0]  # not for NaN
        if len(possible):
            low, high, lower = np.minimum(low, high)[possible], high[possible], out[i - 1][possible]
            guess = lower + (pitch - before_deg) - margins[possible] * height
            out[i, possible] = highest_pitch(
                rules.margin,
                rules.pairs(lower, np.full(len(possible), before), np.full(len(possible), count)),
                low,
                high,
                wanted=margins[possible],
                height_deg=height,
                guess=np.where(min(before, count) > FEW, guess, np.nan),
            )
    return out


def _reaches(rules: RowConstraints, count: int, pitch_deg: FloatArray, extra: FloatArray) -> NDArray[np.bool_]:
    """Whether the top rows cover up to the band's end, and beyond it by `extra` vertical fields of view."""
    some = ~np.isnan(pitch_deg)
    _, high = rules.band(np.where(some, pitch_deg, 0.0), np.full(len(pitch_deg), count))
    over = extra * rules.camera.vfov_deg * _free_ends(rules)[1]
    return np.asarray(some & (high >= rules.band_deg[1] + over))


def _phases(rules: RowConstraints, pitch_deg: FloatArray, counts: tuple[int, ...]) -> tuple[float, ...]:
    """The best of the phases of each row relative to the row below it.

    In plans of very many images, adjacent rows of equally many share one phase all round. With the one that mostly is
    the best, half a spacing, no image is sure to share enough with any of the next row, where errors of yaw are large:
    such rows face each other instead, as far as they can.
    """
    phases = [0.0]
    if len(counts) > 1:
        n = np.array(counts)
        pairs = rules.pairs(pitch_deg[:-1], n[:-1], n[1:]).at(np.arange(len(n) - 1), pitch_deg[1:])
        margins = rules.margin.margins(pairs, FINE).round(9)
        best = np.argmax(margins, axis=1)
        if rules.many and not rules.demands.neighbours.tolerance.is_zero:
            enough = margins >= _LEFT
            best = np.where((n[:-1] == n[1:]) & enough.any(axis=1), np.argmax(enough, axis=1), best)
        recurs = 360.0 / np.lcm(n[:-1], n[1:])
        for i, choice in enumerate(best.tolist()):
            phases.append((phases[-1] + PHASES[choice] * float(recurs[i])) % (360.0 / counts[i + 1]))
    return tuple(phases)
