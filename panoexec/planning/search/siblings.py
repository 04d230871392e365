"""Slightly stricter requests, whose plans satisfy the request itself.

The rows that a search proposes depend on its demands in steps: a little more overlap, and rows of other counts result,
which may be fewer in all, or satisfy C4 where those of the request did not. So after the request itself its *siblings*
are searched, always the same ones in the same order. What they propose is certified for the request.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from panoexec.planning.model import Constraints, Tolerance

_MORE_OVERLAP = ((0.01, 0.0), (0.005, 0.005), (0.02, 0.02), (0.0, 0.01), (0.04, 0.04), (0.01, 0.01), (0.03, 0.03))
_MUCH_OVERLAP = ((0.05, 0.05), (0.07, 0.07), (0.1, 0.1), (0.15, 0.15))
_MORE_BAND_DEG = 1.0
_MORE_ERROR = 1.1
_MOST_OVERLAP = 0.95


def siblings(constraints: Constraints) -> Iterator[Constraints]:
    """The stricter requests, in the order in which they are tried."""
    yield from _overlapping_more(constraints, _MORE_OVERLAP)
    tolerance, band = constraints.tolerance, constraints.band
    if not tolerance.is_zero:
        larger = (_MORE_ERROR * t for t in (tolerance.pitch_deg, tolerance.roll_deg, tolerance.yaw_deg))
        pitch, roll, yaw = (min(t, 89.0) for t in larger)
        yield replace(constraints, tolerance=Tolerance(pitch_deg=pitch, roll_deg=roll, yaw_deg=yaw))
    wider = replace(
        band,
        elevation_min_deg=max(band.elevation_min_deg - _MORE_BAND_DEG, -90.0),
        elevation_max_deg=min(band.elevation_max_deg + _MORE_BAND_DEG, 90.0),
    )
    if wider != band:
        yield replace(constraints, band=wider)
    yield from _overlapping_more(constraints, _MUCH_OVERLAP)


def _overlapping_more(constraints: Constraints, steps: tuple[tuple[float, float], ...]) -> Iterator[Constraints]:
    for more_h, more_v in steps:
        overlap_h, overlap_v = constraints.overlap_h + more_h, constraints.overlap_v + more_v
        if max(overlap_h, overlap_v) < _MOST_OVERLAP:
            yield replace(constraints, overlap_h=overlap_h, overlap_v=overlap_v)
