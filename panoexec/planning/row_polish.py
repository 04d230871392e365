"""From a way through the search to rows: the same counts, with all slack shared out evenly, and turned to fit.

The search stands every row as high as it can. Here the counts are kept and the greatest margin μ is sought with which
the rows still reach the top of the band: then every pair of rows has that margin to spare.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.planning.row_pairs import FINE, PHASES
from panoexec.planning.row_rules import RowRules
from panoexec.planning.row_search import FEW
from panoexec.planning.row_steps import highest_pitch

_LADDER = (0.0, 1e-3, 4e-3, 0.015, 0.05)
_RUNGS = 5
_MOST_ROWS = 40
"""With more rows than this the slack is shared out only roughly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Rows of evenly spaced images, the lowest first.

    Attributes:
        pitch_deg: of each row.
        count: images of each row.
        phase_deg: yaw of each row's first image, where rows are free to turn.
        margin: that every pair of rows has, see `PairMargin`.
    """

    pitch_deg: tuple[float, ...]
    count: tuple[int, ...]
    phase_deg: tuple[float, ...]
    margin: float

    @property
    def images(self) -> int:
        """Number of images."""
        return sum(self.count)


def polish(rules: RowRules, path: Sequence[tuple[float, int]], least_margin: float = 0.0) -> Rows | None:
    """Give rows of the given counts the greatest common margin.

    Args:
        rules: what they have to satisfy.
        path: (pitch_deg, count) of the rows, lowest first; none stands higher than where C2 allows its count, and rows
            of a few images no higher than given.
        least_margin: what they have to have at least.

    Returns:
        The rows; None if they do not reach the top of the band with `least_margin`.
    """
    ladder = np.array(_LADDER) + least_margin
    pitches = _climb(rules, path, ladder)
    reaches = _reaches(rules, path[-1][1], pitches[-1])
    if not reaches[0]:
        return None
    last = int(np.nonzero(reaches)[0][-1])
    if last + 1 < len(ladder) and len(path) <= _MOST_ROWS:
        ladder = np.linspace(ladder[last], ladder[last + 1], _RUNGS + 1)[:-1]
        pitches = _climb(rules, path, ladder)
        reaches = _reaches(rules, path[-1][1], pitches[-1])
        last = int(np.nonzero(reaches)[0][-1]) if reaches.any() else 0
    chosen = pitches[:, last]
    if np.isnan(chosen).any():
        return None
    counts = tuple(count for _, count in path)
    return Rows(
        pitch_deg=tuple(chosen.tolist()),
        count=counts,
        phase_deg=_phases(rules, chosen, counts),
        margin=float(ladder[last]),
    )


def _climb(rules: RowRules, path: Sequence[tuple[float, int]], margins: FloatArray) -> FloatArray:
    """Pitches (rows, margins) of rows as high as they can be with each margin; NaN where they cannot be."""
    height = rules.camera.vfov_deg
    out = np.full((len(path), len(margins)), path[0][0])
    for i in range(1, len(path)):
        pitch, count = path[i]
        floor, ceiling = rules.zone_of(pitch, count)
        ceiling = pitch if count <= FEW else ceiling
        low = np.maximum(out[i - 1] + 0.05 * height, floor)
        high = np.minimum(np.full(len(margins), ceiling), out[i - 1] + height)
        possible = np.nonzero(low <= high + 1e-9)[0]  # not for NaN
        out[i] = np.nan
        if len(possible):
            low, high = np.minimum(low, high)[possible], high[possible]
            before = np.full(len(possible), path[i - 1][1])
            pairs = rules.pairs(out[i - 1][possible], before, np.full(len(possible), count))
            out[i, possible] = highest_pitch(
                rules.margin, pairs, low, high, wanted=margins[possible], height_deg=height
            )
    return out


def _reaches(rules: RowRules, count: int, pitch_deg: FloatArray) -> NDArray[np.bool_]:
    some = ~np.isnan(pitch_deg)
    _, high = rules.band(np.where(some, pitch_deg, 0.0), np.full(len(pitch_deg), count))
    return np.asarray(some & (high >= rules.band_deg[1]))


def _phases(rules: RowRules, pitch_deg: FloatArray, counts: tuple[int, ...]) -> tuple[float, ...]:
    """Turn each row to the best of the phases against the row below it."""
    phases = [0.0]
    if len(counts) > 1:
        n = np.array(counts)
        pairs = rules.pairs(pitch_deg[:-1], n[:-1], n[1:]).at(np.arange(len(n) - 1), pitch_deg[1:])
        best = np.argmax(rules.margin.margins(pairs, FINE).round(9), axis=1)
        recurs = 360.0 / np.lcm(n[:-1], n[1:])
        for i, choice in enumerate(best.tolist()):
            phases.append((phases[-1] + PHASES[choice] * float(recurs[i])) % (360.0 / counts[i + 1]))
    return tuple(phases)
