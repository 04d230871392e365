"""The order of the shots: a short open path through all poses, minimising the time that gimbal and camera need.

The time between two shots is the longer of slew (both axes simultaneously, with rates and accelerations) plus settling
plus exposure, and the camera's interval: a slew that fits into the interval costs nothing. Ties are broken by the
smaller total rotation. The path is improved by 2-opt and Or-opt moves among near poses until no move helps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, direction, wrap_180
from panoexec.planning.model import GimbalLimits, Shot, Timing
from panoexec.planning.order.duration import shot_times_s, slew_times_s, yaw_travel_deg
from panoexec.planning.order.vehicle_yaw import PanReach, heading_groups

Order: TypeAlias = Literal["fastest", "rows", "columns", "nadir-first", "sky-first"]
ORDERS: Final[tuple[Order, ...]] = get_args(Order)
Pose: TypeAlias = tuple[float, float]
"""Pitch and yaw, degrees."""
Indices: TypeAlias = NDArray[np.intp]

_NEAR = 10
"""Number of near poses that are tried as neighbours of a pose."""
_AT_A_TIME = 1 << 20
"""Pairs of poses compared at a time: limits the memory."""
_MANY = 500
"""From this number of shots only the best start is improved, for a limited number of rounds."""
_TURN_WEIGHT_S = 1e-4
"""Cost in seconds of a degree of rotation: it breaks ties of time but never outweighs time."""


def order_shots(
    shots: Sequence[Shot],
    limits: GimbalLimits,
    timing: Timing,
    *,
    order: Order = "fastest",
    start: Pose | None = None,
) -> tuple[Shot, ...]:
    """The shots in shooting order, with new indices.

    Args:
        shots: in any order; `Shot.row` gives the rows.
        limits: rates, accelerations, and whether the pan axis is continuous.
        timing: settle time, exposure, camera interval.
        order: `fastest` (if the vehicle must yaw: one turn around, with as few headings as possible); `rows`: row by
            row, from the end that is faster; `columns`; `nadir-first` and `sky-first`: row by row from that end.
        start: pitch and yaw of the gimbal before the first slew; None: any.
    """
    if len(shots) < 2:
        return tuple(replace(shot, index=0) for shot in shots)
    cost = _Cost.of(shots, limits, timing, start)
    if order == "fastest" and limits.turning is not None and not limits.yaw_endless:
        return tuple(replace(shots[i], index=n) for n, i in enumerate(_by_heading(shots, limits, timing, start)))
    match order:
        case "columns":
            path = _columns(shots, cost)
        case "nadir-first":
            path = _serpentine(shots, cost, upwards=True)
        case "sky-first":
            path = _serpentine(shots, cost, upwards=False)
        case _:
            path = _fastest(shots, cost) if order == "fastest" else min(_both_ways(shots, cost), key=cost.total)
    return tuple(replace(shots[int(i)], index=n) for n, i in enumerate(path))


def _both_ways(shots: Sequence[Shot], cost: _Cost) -> list[Indices]:
    return [_serpentine(shots, cost, upwards=up) for up in (True, False)]


def _fastest(shots: Sequence[Shot], cost: _Cost) -> Indices:
    if len(shots) < 2:
        return np.arange(len(shots))
    starts = [*_both_ways(shots, cost), _columns(shots, cost)]
    starts.sort(key=cost.total)
    return min((_improved(path, cost) for path in starts[: 1 if len(shots) > _MANY else None]), key=cost.total)


def _by_heading(shots: Sequence[Shot], limits: GimbalLimits, timing: Timing, start: Pose | None) -> list[int]:
    """From heading to heading, one turn around; at each heading its reachable shots in the fastest order."""
    groups = heading_groups([shot.yaw_deg for shot in shots], PanReach.of(limits))
    still = replace(limits, turning=None, yaw_endless=False)  # the gimbal alone, between its stops
    path: list[int] = []
    for group in groups:
        # yaws relative to the middle of the group, where no stop is crossed
        middle = shots[group[0]].yaw_deg + (shots[group[-1]].yaw_deg - shots[group[0]].yaw_deg) % 360.0 / 2
        local = [replace(shots[i], index=0, yaw_deg=float(wrap_180(shots[i].yaw_deg - middle))) for i in group]
        before = start if not path else (shots[path[-1]].pitch_deg, float(wrap_180(shots[path[-1]].yaw_deg - middle)))
        cost = _Cost.of(local, still, timing, before)
        path += [int(group[i]) for i in _fastest(local, cost)]
    return path


@dataclass(frozen=True, slots=True, eq=False)
class _Cost:
    """Cost between poses (by index): time, plus a small weight on rotation."""

    pitch: FloatArray
    yaw: FloatArray
    limits: GimbalLimits
    timing: Timing
    start: Pose | None

    @classmethod
    def of(cls, shots: Sequence[Shot], limits: GimbalLimits, timing: Timing, start: Pose | None) -> _Cost:
        pitch = np.array([shot.pitch_deg for shot in shots])
        yaw = np.array([shot.yaw_deg for shot in shots])
        return cls(pitch, yaw, limits, timing, start)

    def between(self, a: Indices | int, b: Indices | int) -> FloatArray:
        """Cost from poses `a` to poses `b`; the arguments broadcast."""
        return self._hop(self.pitch[a], self.yaw[a], self.pitch[b], self.yaw[b])

    def entry(self, b: Indices | int) -> FloatArray:
        """Cost from the gimbal's start pose; 0 if it may be any."""
        if self.start is None:
            return np.zeros(np.shape(b))
        return self._hop(np.asarray(self.start[0]), np.asarray(self.start[1]), self.pitch[b], self.yaw[b])

    def total(self, path: Indices) -> float:
        """Cost of a whole path."""
        return float(self.between(path[:-1], path[1:]).sum() + self.entry(int(path[0])))

    def _hop(self, p0: FloatArray, y0: FloatArray, p1: FloatArray, y1: FloatArray) -> FloatArray:
        slews = slew_times_s(self.limits, p0, y0, p1, y1)
        turned = np.abs(p1 - p0) + np.abs(yaw_travel_deg(self.limits, y0, y1))
        return shot_times_s(self.timing, slews) + _TURN_WEIGHT_S * turned


def _serpentine(shots: Sequence[Shot], cost: _Cost, *, upwards: bool) -> Indices:
    """Row by row; each row is entered at the cheapest pose and left next to it."""
    rows: dict[int, list[int]] = {}
    for i, shot in enumerate(shots):
        rows.setdefault(shot.row, []).append(i)
    ordered = sorted(rows.values(), key=lambda row: float(cost.pitch[row].mean()), reverse=not upwards)
    path: list[Indices] = []
    last: int | None = None
    for members in ordered:
        row = np.array(members)[np.argsort(cost.yaw[members], kind="stable")]
        path.append(_entered(row, cost, last))
        last = int(path[-1][-1])
    return np.concatenate(path)


def _entered(row: Indices, cost: _Cost, last: int | None) -> Indices:
    """The cheapest path through one row (sorted by yaw) from the previous pose."""
    n = len(row)
    # a continuous pan axis may start anywhere in the row, one with stops only at the ends
    cuts = np.arange(n) if cost.limits.all_round else np.array([0])
    hops = cost.between(row, np.roll(row, -1))
    inside = hops.sum() - hops[cuts - 1]
    best: tuple[float, Indices] | None = None
    for direction_ in (1, -1):
        firsts = row[cuts] if direction_ == 1 else row[cuts - 1]
        entries = cost.entry(firsts) if last is None else cost.between(last, firsts)
        k = int(np.argmin(entries + inside))
        way = np.roll(row, -int(cuts[k]))[::direction_]
        value = float(entries[k] + inside[k])
        if best is None or value < best[0] - 1e-12:
            best = (value, way)
    assert best is not None
    return best[1]


def _columns(shots: Sequence[Shot], cost: _Cost) -> Indices:
    """Column by column, each as wide as the spacing of the row with the most images, alternating up and down."""
    per_row: dict[int, int] = {}
    for shot in shots:
        per_row[shot.row] = per_row.get(shot.row, 0) + 1
    low, high = float(cost.yaw.min()), float(cost.yaw.max())
    columns = max(per_row.values())
    width = max((high - low) / columns, 1e-9)
    column = np.minimum(((cost.yaw - low) / width).astype(int), columns - 1)
    signed = np.where(column % 2 == 0, cost.pitch, -cost.pitch)
    return np.lexsort((cost.yaw, signed, column))


def _improved(path: Indices, cost: _Cost) -> Indices:
    """2-opt and Or-opt among near poses until no move helps; the result is never worse than the input."""
    near = _near(cost)
    worth = 1e-4 if len(path) > _MANY else 1e-9
    for _ in range(60):
        before = cost.total(path)
        path = _two_opt(path, cost, near)
        path = _or_opt(path, cost, near)
        if cost.total(path) > before * (1 - worth):
            break
    return path


def _near(cost: _Cost) -> Indices:
    """The near poses (n, k) of each pose, by direction; computed in blocks to limit memory."""
    rays = direction(cost.pitch, cost.yaw)
    n = len(rays)
    k = min(_NEAR, n - 1)
    out = np.empty((n, k), dtype=np.intp)
    block = max(1, _AT_A_TIME // n)
    for begin in range(0, n, block):
        some = slice(begin, min(begin + block, n))
        closeness = rays[some] @ rays.T
        closeness[np.arange(some.stop - some.start), np.arange(some.start, some.stop)] = -2.0
        out[some] = np.argpartition(-closeness, k - 1, axis=1)[:, :k]
    return out


def _two_opt(path: Indices, cost: _Cost, near: Indices) -> Indices:
    """Reverse the segments of the path that save most; several disjoint segments at a time."""

    def gains(position: Indices) -> tuple[FloatArray, Indices, Indices]:
        # edges (a, b) and (c, d) become (a, c) and (b, d), where b follows a and d follows c; -1 means no successor
        first, second = np.repeat(position[path], near.shape[1]), position[near[path]].reshape(-1)
        first, second = np.minimum(first, second), np.maximum(first, second)
        after, last = first + 1, second + 1
        has_end = last < len(path)
        end = path[np.where(has_end, last, 0)]
        a, b, c = path[first], path[after], path[second]
        saved = cost.between(a, b) - cost.between(a, c)
        saved += np.where(has_end, cost.between(c, end) - cost.between(b, end), 0.0)
        return np.where(second > after, saved, 0.0), after, second

    return _apply(path, gains, lambda p, i, j: np.concatenate([p[:i], p[i : j + 1][::-1], p[j + 1 :]]))


def _or_opt(path: Indices, cost: _Cost, near: Indices) -> Indices:
    """Move a pose next to a near one where that saves."""

    def gains(position: Indices) -> tuple[FloatArray, Indices, Indices]:
        n = len(path)
        i = np.repeat(position[path], near.shape[1])
        j = position[near[path]].reshape(-1)
        pose = path[i]
        has_before, has_after = i > 0, i < n - 1
        before, after = path[np.maximum(i - 1, 0)], path[np.minimum(i + 1, n - 1)]
        removed = np.where(has_before, cost.between(before, pose), cost.entry(pose) - cost.entry(after))
        removed += np.where(has_after, cost.between(pose, after), 0.0)
        removed -= np.where(has_before & has_after, cost.between(before, after), 0.0)
        # insert between j and its successor
        follower_exists = j < n - 1
        follower = path[np.minimum(j + 1, n - 1)]
        added = cost.between(path[j], pose)
        added += np.where(follower_exists, cost.between(pose, follower) - cost.between(path[j], follower), 0.0)
        useful = (j != i) & (j + 1 != i)
        return np.where(useful, removed - added, 0.0), i, j

    def move(p: Indices, i: int, j: int) -> Indices:
        rest = np.delete(p, i)
        return np.insert(rest, j + 1 if j < i else j, p[i])

    return _apply(path, gains, move)


def _apply(
    path: Indices,
    gains: Callable[[Indices], tuple[FloatArray, Indices, Indices]],
    change: Callable[[Indices, int, int], Indices],
) -> Indices:
    """Apply the best moves whose segments of the path are disjoint."""
    position = np.empty_like(path)
    position[path] = np.arange(len(path))
    saved, first, second = gains(position)
    low, high = np.minimum(first, second) - 1, np.maximum(first, second) + 1
    taken = np.zeros(len(path) + 2, dtype=np.bool_)
    for move in np.argsort(-saved, kind="stable"):
        if saved[move] <= 1e-9:
            break
        # a move within a segment does not change positions outside it, so disjoint segments can all be changed
        if not taken[low[move] + 1 : high[move] + 2].any():
            taken[low[move] + 1 : high[move] + 2] = True
            path = change(path, int(first[move]), int(second[move]))
    return path
