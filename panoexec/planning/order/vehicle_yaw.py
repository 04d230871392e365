"""The headings from which the gimbal reaches given yaws, and an order of shots with few turns of the vehicle.

A gimbal that pans from `lo` to `hi` degrees relative to the nose reaches the yaw ψ from every heading in
[ψ - hi, ψ - lo]; a gimbal without pan axis only from ψ. Consecutive shots can be taken from one heading if their
intervals have a common point; always taking the longest such run (greedily) minimises the number of turns of an order.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray, wrap_180
from panoexec.planning.model import GimbalLimits

NO_TURN_DEG = 0.01
"""Headings closer than this (degrees) count as equal."""
_MARGIN_MOST_FRAC = 0.25
"""Upper limit of the margin at each end, as a fraction of the pan range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PanReach:
    """Yaws that the gimbal reaches relative to the nose: up to `half_deg` to either side of `centre_deg`, clockwise."""

    centre_deg: float
    half_deg: float

    @classmethod
    def of(cls, limits: GimbalLimits) -> PanReach:
        """The usable pan range: all of it minus the margins; half a turn or more to each side reaches every yaw."""
        if limits.yaw_endless:
            return cls(centre_deg=0.0, half_deg=180.0)
        width = limits.yaw_max_deg - limits.yaw_min_deg
        margin = 0.0 if limits.turning is None else min(limits.turning.margin_deg, _MARGIN_MOST_FRAC * width)
        return cls(centre_deg=(limits.yaw_min_deg + limits.yaw_max_deg) / 2, half_deg=min(width / 2 - margin, 180.0))

    def has(self, yaw_deg: float, heading_deg: float) -> bool:
        """Whether a yaw can be reached from a heading."""
        return abs(float(wrap_180(yaw_deg - self.centre_deg - heading_deg))) <= self.half_deg + NO_TURN_DEG


def heading_for(yaws_deg: Iterable[float], heading_deg: float, reach: PanReach) -> float:
    """The heading for the next shots: unchanged if it reaches the first, else the nearest one that reaches most shots.

    Args:
        yaws_deg: yaws of the next shots, in order, as many as should be considered.
        heading_deg: current heading, in the same frame.
        reach: of the gimbal.

    Returns:
        Degrees, [-180, 180); `heading_deg` itself if no turn is needed.
    """
    coming = iter(yaws_deg)
    first = next(coming)
    if reach.has(first, heading_deg):
        return heading_deg
    middle = first - reach.centre_deg
    arcs = [(-reach.half_deg, reach.half_deg)]  # headings that reach all shots so far, relative to `middle`
    for yaw in coming:
        offset = float(wrap_180(yaw - first))
        common = [
            (max(low, offset + turn - reach.half_deg), min(high, offset + turn + reach.half_deg))
            for low, high in arcs
            for turn in (-360.0, 0.0, 360.0)
        ]
        left = [(low, max(low, high)) for low, high in common if low <= high + NO_TURN_DEG]
        if not left:
            break
        arcs = left
    here = float(wrap_180(heading_deg - middle))
    ways = [min(max(at, low), high) - at for low, high in arcs for at in (here - 360.0, here, here + 360.0)]
    return float(wrap_180(heading_deg + min(ways, key=abs)))


def headings_deg(yaws_deg: ArrayLike, limits: GimbalLimits) -> FloatArray:
    """The heading (n,) for each shot of an order; the first one is free."""
    yaws = np.asarray(yaws_deg, dtype=np.float64)
    reach = PanReach.of(limits)
    out = np.empty(len(yaws))
    # start opposite the first shot, so that `heading_for` turns to the heading that reaches most shots
    heading = float(yaws[0]) - reach.centre_deg + 180.0 if len(yaws) else 0.0
    for number in range(len(yaws)):
        heading = out[number] = heading_for((float(yaw) for yaw in yaws[number:]), heading, reach)
    return out


def heading_groups(yaws_deg: Sequence[float] | FloatArray, reach: PanReach) -> list[NDArray[np.intp]]:
    """Groups of shots that are taken from one heading each: as few groups as possible, one turn around.

    Args:
        yaws_deg: yaws of the shots (n,).
        reach: of the gimbal.

    Returns:
        Indices into `yaws_deg`, in groups, clockwise from group to group and within one.
    """
    yaws = np.asarray(yaws_deg, dtype=np.float64) % 360.0
    order = np.argsort(yaws, kind="stable")
    ordered = yaws[order]
    n = len(ordered)
    if n == 0:
        return []
    gaps = np.diff(np.append(ordered, ordered[0] + 360.0))
    width = 2 * reach.half_deg + NO_TURN_DEG
    # an optimal division starts somewhere within the first group of any division; the largest gap breaks ties
    first = (int(np.argmax(gaps)) + 1) % n
    most = len(_cuts(np.roll(ordered, -first), width)[0])
    best: list[NDArray[np.intp]] | None = None
    for begin in range(first, first + most):
        turn = np.roll(np.arange(n), -(begin % n))
        groups = _cuts(ordered[turn], width)
        if best is None or len(groups) < len(best):
            best = [order[turn[group]] for group in groups]
    assert best is not None
    return best


def _cuts(yaws: FloatArray, width_deg: float) -> list[NDArray[np.intp]]:
    """Split a clockwise sequence of yaws into groups no wider than `width_deg`."""
    along = (yaws - yaws[0]) % 360.0
    along[np.cumsum(np.diff(along, prepend=0.0) < 0) > 0] += 360.0  # past the first yaw again: one whole turn more
    out, begin = [], 0
    while begin < len(along):
        end = int(np.searchsorted(along, along[begin] + width_deg, side="right"))
        out.append(np.arange(begin, end))
        begin = end
    return out
