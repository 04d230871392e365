"""Which photo of a card belongs to which attempt: one offset between the camera's clock and this computer's tells all.

Every photo and every attempt vote for the offset between them; the true one gets a vote of nearly every attempt. For
each promising offset the photos are aligned with the attempts in order, and the alignment is charged for what is
unlikely: a photo that is off its time, an attempt without a photo, a photo between those of the mission that belongs to
no attempt. The cheapest alignment is believed only if every other one costs clearly more.

The offset may be anything: cameras are set to other time zones, or were never set. Attempts of other missions on the
card count as votes, too: they tell two flights of the same plan apart.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from panoexec.angles import FloatArray
from panoexec.importing.card import CardPhoto

_JITTER_S: Final = 0.2
"""Standard deviation of the delay from trigger to exposure."""
_REACH_S: Final = 0.8
"""How far a photo may be off its time, beyond the resolution of its stamp."""
_MISSING: Final = 6.0
_MISSING_REJECTED: Final = 3.0
_STRANGER: Final = 4.0
_NEAR_S: Final = 60.0
"""Strangers so near to the mission's photos are charged; others are other people's business."""
MARGIN: Final = 12.0
"""By how much every other alignment must cost more: two coincidences."""
_LOCAL_WEIGHT: Final = 3.0
"""One photo that could take another one's place needs less to be told apart than two whole alignments."""
_CANDIDATES: Final = 40
_APART_S: Final = 0.75


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """A photo that an attempt took, or should have.

    Attributes:
        mission: whose attempt it is; "" for the mission that is imported.
        shot: index of the shot.
        attempt: number of the attempt.
        photo: number of the photo within the attempt.
        time_s: when, UTC by this computer's clock.
        accepted: whether the attempt is accepted.
    """

    mission: str
    shot: int
    attempt: int
    photo: int
    time_s: float
    accepted: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairing:
    """An alignment of photos and attempts.

    Attributes:
        offset_s: the camera's clock minus this computer's.
        pairs: expected photo and photo on the card, of all missions.
        cost: what speaks against it.
        margin: by how much the next best alignment costs more; infinity without one.
        rms_s: of the differences in time.
        rival: an attempt that the next best alignment gives another photo; None without one.
    """

    offset_s: float
    pairs: tuple[tuple[Expected, CardPhoto], ...]
    cost: float
    margin: float = math.inf
    rms_s: float = 0.0
    rival: tuple[Expected, CardPhoto | None] | None = None

    @property
    def is_certain(self) -> bool:
        """Whether no other alignment is nearly as good."""
        return self.margin >= MARGIN

    @property
    def of_mission(self) -> tuple[tuple[Expected, CardPhoto], ...]:
        """The pairs of the mission that is imported."""
        return tuple(pair for pair in self.pairs if not pair[0].mission)


def pair(expected: Sequence[Expected], photos: Sequence[CardPhoto]) -> Pairing | None:
    """The best alignment, with its distance to the next best; None if nothing fits.

    Args:
        expected: of all missions that may be on the card, in the order of their times.
        photos: in order.
    """
    found: list[Pairing] = []
    for offset_s in _offsets(expected, photos):
        one = _aligned(expected, photos, offset_s)
        if one.of_mission and not any(_same(one, other) for other in found):
            found.append(one)
    if not found:
        return None
    found.sort(key=lambda one: one.cost)
    best = found[0]
    margin, rival = math.inf, None
    if len(found) > 1:
        margin, rival = found[1].cost - best.cost, _difference(best, found[1])
    for local, doubt in _doubts(photos, best):
        if local < margin:
            margin, rival = local, doubt
    return Pairing(
        offset_s=best.offset_s, pairs=best.pairs, cost=best.cost, margin=margin, rms_s=_rms_s(best), rival=rival
    )


def _offsets(expected: Sequence[Expected], photos: Sequence[CardPhoto]) -> list[float]:
    """Offsets that many attempts vote for, the most promising first."""
    if not expected or not photos:
        return []
    times = np.array([one.time_s for one in expected])
    stamps = np.array([photo.taken_s for photo in photos])
    votes = np.subtract.outer(stamps, times)
    voters = np.broadcast_to(np.arange(len(times)), votes.shape).ravel()
    order = np.argsort(votes.ravel(), kind="stable")
    values, voters = votes.ravel()[order], voters[order]
    width_s = 2 * max(photo.half_s for photo in photos) + 2 * _JITTER_S
    ends = np.searchsorted(values, values + width_s, side="right")
    counts = ends - np.arange(len(values))
    out: list[float] = []
    for at in np.argsort(-counts, kind="stable"):
        middle = float(np.median(values[at : ends[at]]))
        if all(abs(middle - other) >= _APART_S for other in out):
            out.append(middle)
            if len(out) >= _CANDIDATES:
                break
    return out


def _aligned(expected: Sequence[Expected], photos: Sequence[CardPhoto], offset_s: float) -> Pairing:
    """The cheapest alignment near an offset, which is refined by what it aligns."""
    one = _align(expected, photos, offset_s)
    for _ in range(3):
        if not one.pairs:
            return one
        off = [photo.taken_s - item.time_s for item, photo in one.pairs]
        # the middle of all is the best estimate of whole seconds, the median bears outliers
        others = [_align(expected, photos, float(at)) for at in (np.median(off), (min(off) + max(off)) / 2)]
        another = min(others, key=lambda other: other.cost)
        if another.cost >= one.cost:
            break
        one = another
    return one


def _align(expected: Sequence[Expected], photos: Sequence[CardPhoto], offset_s: float) -> Pairing:
    stamps = [photo.taken_s for photo in photos]
    skips = np.concatenate([[0.0], np.cumsum([_skip_cost(item) for item in expected])])
    near: list[tuple[int, int, float]] = []
    for at, item in enumerate(expected):
        moment = item.time_s + offset_s
        first = bisect.bisect_left(stamps, moment - 1.0 - _REACH_S)
        for number in range(first, len(photos)):
            photo = photos[number]
            if photo.taken_s > moment + 1.0 + _REACH_S:
                break
            off_s = photo.taken_s - moment
            if abs(off_s) <= photo.half_s + _REACH_S:
                near.append((at, number, _off_cost(off_s, photo)))
    best, before = _chain(near, skips)
    chain: list[tuple[int, int]] = []
    at = int(np.argmin(best)) if len(best) else -1
    total = float(best[at]) if at >= 0 else float(skips[-1])
    while at >= 0:
        chain.append(near[at][:2])
        at = before[at]
    chain.reverse()
    pairs = tuple((expected[item], photos[number]) for item, number in chain)
    return Pairing(offset_s=offset_s, pairs=pairs, cost=total + _strangers(photos, [number for _, number in chain]))


def _chain(near: Sequence[tuple[int, int, float]], skips: FloatArray) -> tuple[FloatArray, list[int]]:
    """The cheapest chain of pairs, rising in attempts and photos: cost by its last pair, and the pair before each."""
    best, before = np.full(len(near), np.inf), [-1] * len(near)
    items = np.array([item for item, _, _ in near], dtype=int)
    numbers = np.array([number for _, number, _ in near], dtype=int)
    for at, (item, number, cost) in enumerate(near):
        lowest, previous = float(skips[item]), -1
        fits = (items[:at] < item) & (numbers[:at] < number)
        if fits.any():
            # a chain's cost includes that all later attempts lack a photo; here only those up to this one do
            later = skips[-1] - skips[item]
            through = np.where(fits, best[:at] - later, np.inf)
            if through.min() < lowest:
                lowest, previous = float(through.min()), int(through.argmin())
        best[at] = lowest + cost + (skips[-1] - skips[item + 1])
        before[at] = previous
    return best, before


def _skip_cost(item: Expected) -> float:
    return _MISSING if item.accepted else _MISSING_REJECTED


def _off_cost(off_s: float, photo: CardPhoto) -> float:
    """The charge for a photo that is off its time: nothing within the resolution of its stamp."""
    return (max(0.0, abs(off_s) - photo.half_s) / _JITTER_S) ** 2


def _strangers(photos: Sequence[CardPhoto], used: Sequence[int]) -> float:
    """The charge for photos among or near those used that belong to no attempt."""
    if not used:
        return 0.0
    taken = set(used)
    first, last = photos[used[0]].taken_s - _NEAR_S, photos[used[-1]].taken_s + _NEAR_S
    near = [number for number, photo in enumerate(photos) if first <= photo.taken_s <= last]
    return _STRANGER * sum(1 for number in near if number not in taken)


def _doubts(photos: Sequence[CardPhoto], best: Pairing) -> list[tuple[float, tuple[Expected, CardPhoto]]]:
    """Photos that belong to no attempt, but could take the place of one that does: by how much that would cost more."""
    used = {photo.path for _, photo in best.pairs}
    spare = [photo for photo in photos if photo.path not in used]
    out = []
    for item, photo in best.of_mission:
        moment = item.time_s + best.offset_s
        for other in spare:
            off_s = other.taken_s - moment
            if abs(off_s) <= other.half_s + _REACH_S:
                more = _off_cost(off_s, other) - _off_cost(photo.taken_s - moment, photo)
                out.append((_LOCAL_WEIGHT * more, (item, other)))
    return out


def _same(one: Pairing, other: Pairing) -> bool:
    return _by_attempt(one) == _by_attempt(other)


def _by_attempt(pairing: Pairing) -> dict[tuple[int, int, int], CardPhoto]:
    return {(item.shot, item.attempt, item.photo): photo for item, photo in pairing.of_mission}


def _difference(best: Pairing, other: Pairing) -> tuple[Expected, CardPhoto | None]:
    theirs = _by_attempt(other)
    for item, photo in best.of_mission:
        another = theirs.get((item.shot, item.attempt, item.photo))
        if another != photo:
            return item, another
    return other.of_mission[0]


def _rms_s(pairing: Pairing) -> float:
    off = [photo.taken_s - item.time_s - pairing.offset_s for item, photo in pairing.of_mission]
    return math.sqrt(sum(value * value for value in off) / len(off)) if off else 0.0
