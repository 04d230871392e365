"""The best spacing of neighbours in a row where pointing errors could open gaps between them.

At the widest spacing that C2 permits, the images of a row may overlap very little at their seam once the errors are
subtracted, and the next row must be low to cover the rest. A smaller spacing costs images in the row and saves rows.
The best trade-off is determined on rows at a few pitches before the search, as it is the same for the whole plan.
"""

from __future__ import annotations

import math

import numpy as np

from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_cover import CoreEdges
from panoexec.planning.search.row_steps import highest_pitch

_SEAMS = (0.0, 0.08, 0.2, 0.35, 0.5, 0.65)
_PITCHES_DEG = (-62.0, -37.0, -9.0)
_FEW_IMAGES = 14
"""If the longest rows have fewer images, the search tries all relevant counts anyway."""

_ENOUGH = 0.65
"""Rows that keep this fraction of their height at the seams need no optimisation."""

_WORTH = 0.99
_TALL_DEG = 60.0


def optimise_seam(rules: RowConstraints) -> RowConstraints:
    """The constraints with the seam demand that needs the fewest images per covered elevation."""
    height = rules.camera.vfov_deg
    even = rules.layout.closed and rules.layout.blind_deg == 0
    if rules.demands.neighbours.tolerance.is_zero or not even or height > _TALL_DEG:
        return rules
    if int(rules.fewest(np.zeros(1))[0]) <= _FEW_IMAGES:
        return rules
    pitch = np.array(_PITCHES_DEG)
    spacing = 360.0 / rules.fewest(pitch)
    edges = CoreEdges(rules.camera, rules.demands.neighbours.tolerance)
    seen_from, seen_to = edges.intervals(pitch, spacing[:, None] / 2)
    if ((seen_to - seen_from) >= _ENOUGH * height).all():
        return rules
    strip = height / 2 + math.degrees(math.atan(rules.camera.half_height * (1 - 2 * rules.overlap_v)))
    tried = [rules, *(rules.with_seam(seam) for seam in _SEAMS[1:])]
    low = np.array([each.fewest(pitch) for each in tried])
    high = np.array([each.fewest(pitch + strip) for each in tried])
    high = np.where(np.gcd(low, high) > 1, high + 1, high)
    lower = np.broadcast_to(pitch, low.shape).ravel()
    found = highest_pitch(
        rules.margin,
        rules.pairs(lower, low.ravel(), high.ravel()),
        lower + 0.02 * height,
        lower + min(height, 1.01 * strip),
        wanted=np.zeros(len(lower)),
        height_deg=height,
    )
    steps = np.where(np.isnan(found), 1e-3 * height, found - lower).reshape(low.shape)
    images = ((low / low[0]) * (strip / steps)).mean(axis=1)
    best = int(np.argmin(images))
    return tried[best] if images[best] < _WORTH * images[0] else rules
