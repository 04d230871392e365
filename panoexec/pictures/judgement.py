"""Judges all photos of a mission together: which are bad, and which of two that contradict each other is the odd one.

The rules, in this order; a photo that one of them condemns is no evidence for the next ones:

1. A photo is `unreadable` by itself, and black or white (`exposure`) by itself.
2. It is `exposure` if it is some stops off the median of its neighbours, and `blurred` if it has much less fine detail
   than they have where they overlap. The worst one goes first, and the others are judged again without it.
3. It `contradicts` if it is another photo's picture; if the adjustment of all ties (`attitudes`) moves it farther than
   attitudes are usually wrong; or if neighbours that are tied themselves show unmistakable things which it does not.
4. It is `untied` if it and a neighbour show unmistakable things, but nothing in common, and nothing tells who is wrong.
5. What is left is `ok` with a tie, `geometry_only` without.

Evidence against many photos at once is evidence against the assignment of files to shots: then every photo that takes
part in a contradiction is named, instead of the fewest that would explain it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from panoexec.angles import FloatArray
from panoexec.pictures.attitudes import AttitudeErrors, TieEquation, bridges, connected_groups, corrections
from panoexec.pictures.matching import Tie
from panoexec.pictures.model import BAD, Content, Judgement, TieGraph, TieLine, Verdicts

Pair = tuple[int, int]

_SURELY_BLURRED: Final = math.log(2.5)
"""Ratio of fine detail, natural logarithm, of two photos that may show different things."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What is still a good photo.

    Attributes:
        stops: largest difference of exposure from the median of the neighbours.
        sharpness: least fine detail relative to the median of the neighbours.
        odd_deg: largest error of a measured attitude beyond that of all attitudes.
        distinct: so many unmistakable corners in both photos must lead to a tie.
        many_frac: share of photos from which the assignment of files is doubted as a whole.
        attitudes: errors of measured attitudes.
    """

    stops: float = 1.6
    sharpness: float = 0.85
    odd_deg: float = 0.4
    distinct: int = 14
    many_frac: float = 0.25
    attitudes: AttitudeErrors = field(default_factory=AttitudeErrors)


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """A photo as the judge sees it.

    Attributes:
        shot: its number.
        time_s: when it was taken.
        rotation: (3, 3) measured attitude, camera to world.
        problem: what is wrong with the photo by itself, and why; None if nothing.
        same_as: another shot whose picture is exactly this one, None if there is none.
        expected: shots that overlap it as planned.
    """

    shot: int
    time_s: float
    rotation: FloatArray
    problem: tuple[Content, str] | None = None
    same_as: int | None = None
    expected: frozenset[int] = frozenset()


class _Judge:
    def __init__(self, subjects: Sequence[Subject], ties: Mapping[Pair, Tie], limits: Limits, *, final: bool) -> None:
        self._subjects = {subject.shot: subject for subject in subjects}
        self._limits = limits
        self._final = final
        self._found: dict[int, tuple[Content, str, bool]] = {}
        self._pairs = {pair: tie for pair, tie in ties.items() if set(pair) <= set(self._subjects)}
        self._neighbours: dict[int, list[int]] = defaultdict(list)
        for a, b in self._pairs:
            self._neighbours[a].append(b)
            self._neighbours[b].append(a)
        self._sharpness: dict[int, float] = {}
        self._stops: dict[int, float] = {}

    def _tie(self, a: int, b: int) -> Tie:
        return self._pairs[min(a, b), max(a, b)]

    def _good(self, shot: int) -> bool:
        return shot not in self._found

    def _complete(self, shot: int) -> bool:
        """Whether no photo is to come that overlaps this one."""
        return self._final or self._subjects[shot].expected <= set(self._subjects)

    def run(self) -> Verdicts:
        for shot, subject in sorted(self._subjects.items()):
            if subject.problem is not None:
                self._found[shot] = (*subject.problem, True)
            elif subject.same_as is not None:
                self._found[shot] = (Content.CONTRADICTS, f"it is the same picture as shot {subject.same_as}", True)
        self._stops = self._relative(self._stops_of, lambda value: abs(value) > self._limits.stops, self._off)
        self._sharpness = self._relative(self._sharpness_of, lambda v: v < self._limits.sharpness, self._smeared)
        error, odd, dropped = self._attitudes()
        self._conflicts(dropped)
        return self._verdicts(error, odd, dropped)

    # --- exposure and sharpness

    def _stops_of(self, a: int, b: int) -> float:
        value = self._tie(a, b).comparison.stops
        return value if a < b else -value

    def _sharpness_of(self, a: int, b: int) -> float:
        tie = self._tie(a, b)
        value = tie.comparison.sharpness
        # of different things, only a ratio that no things have tells anything
        if not tie.tied and not (value > 0 and abs(math.log(value)) >= _SURELY_BLURRED):
            return math.nan
        return value if a < b else (1 / value if value > 0 else math.nan)

    @staticmethod
    def _off(value: float) -> tuple[Content, str]:
        word = "darker" if value < 0 else "brighter"
        return Content.EXPOSURE, f"{abs(value):.1f} stops {word} than its neighbours where they overlap"

    @staticmethod
    def _smeared(value: float) -> tuple[Content, str]:
        return (
            Content.BLURRED,
            f"has {100 * value:.0f} % of the fine detail that its neighbours show where they overlap",
        )

    def _relative(
        self,
        measure: Callable[[int, int], float],
        is_bad: Callable[[float], bool],
        say: Callable[[float], tuple[Content, str]],
    ) -> dict[int, float]:
        """Condemn the worst photo by the median against its good neighbours, until none is bad."""
        while True:
            values: dict[int, float] = {}
            counts: dict[int, int] = {}
            for shot in self._subjects:
                if not self._good(shot):
                    continue
                others = [other for other in self._neighbours[shot] if self._good(other)]
                # where the content is the same; without any tie, wherever they should overlap
                same = [other for other in others if self._tie(shot, other).tied] or others
                found = [value for other in same if math.isfinite(value := measure(shot, other))]
                if found:
                    values[shot], counts[shot] = float(np.median(found)), len(found)
            # with one neighbour alone, nothing tells which of the two it is before all of them are there
            bad = [
                shot for shot, value in values.items() if is_bad(value) and (counts[shot] > 1 or self._complete(shot))
            ]
            if not bad:
                return values
            worst = max(
                bad,
                key=lambda shot: (
                    abs(math.log(max(values[shot], 1e-6))) if values[shot] > 0 else abs(values[shot]),
                    shot,
                ),
            )
            self._found[worst] = (*say(values[worst]), True)

    # --- attitudes

    def _attitudes(self) -> tuple[dict[int, np.ndarray], dict[int, float], set[Pair]]:
        """Errors of the measured attitudes; condemns odd ones. Also the ties that contradict all the others."""
        dropped: set[Pair] = set()
        while True:
            shots = [shot for shot in sorted(self._subjects) if self._good(shot)]
            place = {shot: number for number, shot in enumerate(shots)}
            tied = [
                pair
                for pair, tie in self._pairs.items()
                if tie.tied and pair not in dropped and pair[0] in place and pair[1] in place
            ]
            equations = [
                TieEquation(
                    first=place[a], second=place[b],
                    turn_deg=self._pairs[a, b].turn_world_deg, sigma_deg=self._pairs[a, b].sigma_deg,
                )
                for a, b in tied
            ]  # fmt: skip
            times = [self._subjects[shot].time_s for shot in shots]
            axes = _gimbal_axes([self._subjects[shot].rotation for shot in shots])
            result = corrections(times, equations, self._limits.attitudes, gimbal_axes=axes)
            error = {shot: result.error_deg[number] for shot, number in place.items()}
            odd = {shot: float(result.odd_deg[number]) for shot, number in place.items()}
            wrong = [
                (residual / self._pairs[pair].points, pair)
                for pair, residual in zip(tied, result.tie_deg, strict=True)
                if residual > 0.25 + 4 * self._pairs[pair].sigma_deg
            ]
            if wrong:
                dropped.add(max(wrong)[1])
                continue
            degree: dict[int, int] = defaultdict(int)
            for a, b in tied:
                degree[a] += 1
                degree[b] += 1
            # where all attitudes are poor (assumed after a slew, not measured), a poor one is not odd
            limit = max(self._limits.odd_deg, 8 * float(np.median([odd[shot] for shot in degree]))) if degree else 0.0
            bad = [shot for shot, value in odd.items() if value > limit and (degree[shot] > 1 or self._complete(shot))]
            if not bad:
                return error, odd, dropped
            worst = max(bad, key=lambda shot: odd[shot])
            text = f"its content is {odd[worst]:.1f}° from where its measured attitude puts it ({degree[worst]} ties)"
            self._found[worst] = (Content.CONTRADICTS, text, True)

    # --- what should be tied and is not

    def _conflicts(self, dropped: set[Pair]) -> None:
        conflicting = {pair for pair in self._pairs if self._is_conflict(pair, dropped)}
        involved = {shot for pair in conflicting for shot in pair if self._good(shot)}
        before = set(self._found)
        while self._condemn_one(conflicting):
            pass
        condemned = set(self._found) - before
        textured = {shot for pair, tie in self._pairs.items() if tie.textured for shot in pair}
        if len(condemned) < max(4, self._limits.many_frac * len(textured)):
            return
        for shot in sorted(involved - condemned):
            if self._good(shot):
                text = "contradicts other photos; so many do that the files may belong to other shots"
                self._found[shot] = (Content.CONTRADICTS, text, self._final)

    def _is_conflict(self, pair: Pair, dropped: set[Pair]) -> bool:
        tie = self._pairs[pair]
        return pair in dropped or (not tie.tied and tie.textured and tie.distinct >= self._limits.distinct)

    def _condemn_one(self, conflicting: set[Pair]) -> bool:
        """Condemn the photo with the largest share of conflicts among its neighbours, if it is at least half."""
        against: dict[int, list[int]] = defaultdict(list)
        agree: dict[int, int] = defaultdict(int)
        for (a, b), tie in self._pairs.items():
            if not (self._good(a) and self._good(b)):
                continue
            if (a, b) in conflicting:
                against[a].append(b)
                against[b].append(a)
            elif tie.tied:
                agree[a] += 1
                agree[b] += 1
        share = {shot: len(others) / (len(others) + agree[shot]) for shot, others in against.items()}
        odd = [shot for shot, others in against.items() if share[shot] >= 0.5 and (len(others) > 1 or agree[shot] == 0)]
        if not odd:
            return False
        worst = max(odd, key=lambda shot: (share[shot], len(against[shot]), shot))
        proven = [other for other in against[worst] if agree[other]]
        settled = len(proven) > 1 or self._complete(worst)
        names = ", ".join(map(str, sorted(against[worst])))
        if len(proven) > 1 or (proven and agree[worst] == 0 and len(against[worst]) == 1 and settled):
            text = f"shows something else than its neighbours (shot {names}) where they overlap"
            self._found[worst] = (Content.CONTRADICTS, text, settled)
        else:
            text = f"shows texture where it overlaps shot {names}, but nothing in common"
            self._found[worst] = (Content.UNTIED, text, settled)
        return True

    # --- the result

    def _verdicts(self, error: dict[int, np.ndarray], odd: dict[int, float], dropped: set[Pair]) -> Verdicts:
        photos: dict[int, Judgement] = {}
        agreeing: list[tuple[int, int, int]] = []
        lines: dict[int, list[TieLine]] = defaultdict(list)
        for (a, b), tie in sorted(self._pairs.items()):
            if not tie.tied:
                continue
            angle, parallax = round(tie.angle_deg, 4), round(tie.parallax_deg, 3)
            lines[a].append(TieLine(shot=b, points=tie.points, angle_deg=angle, parallax_deg=parallax))
            lines[b].append(TieLine(shot=a, points=tie.points, angle_deg=angle, parallax_deg=parallax))
            if self._good(a) and self._good(b) and (a, b) not in dropped:
                agreeing.append((a, b, tie.points))
        tied = {shot for a, b, _ in agreeing for shot in (a, b)}
        for shot in sorted(self._subjects):
            if shot in self._found:
                verdict, reason, settled = self._found[shot]
            else:
                settled = self._complete(shot)
                verdict = Content.OK if shot in tied else Content.GEOMETRY_ONLY
                reason = (
                    _parallax(lines[shot])
                    if shot in tied
                    else "nothing in its overlaps can be tied; its measured attitude alone counts"
                )
            turn = error.get(shot, np.zeros(3))
            photos[shot] = Judgement(
                shot=shot,
                verdict=verdict,
                reason=reason,
                settled=settled,
                sharpness=self._sharpness.get(shot, math.nan),
                stops=self._stops.get(shot, math.nan),
                odd_deg=odd.get(shot, 0.0),
                error_deg=(float(turn[0]), float(turn[1]), float(turn[2])),
                ties=tuple(lines[shot]),
            )
        return Verdicts(photos=photos, graph=_graph(photos, agreeing))


def _parallax(lines: Sequence[TieLine]) -> str:
    """Words for a good photo that was taken from elsewhere than most of its neighbours; "" for others."""
    apart = [line for line in lines if line.parallax_deg > 0]
    if 2 * len(apart) <= len(lines):
        return ""
    names = ", ".join(str(line.shot) for line in apart)
    worst = max(line.parallax_deg for line in apart)
    return f"parallax: taken from elsewhere than shot {names}, the ground is displaced by up to {worst:.1f}°"


def _gimbal_axes(rotations: Sequence[FloatArray]) -> FloatArray:
    """The axes (n, 2, 3) about which the gimbal pitches and rolls, in the order yaw, roll, pitch: world frame."""
    looked = np.array(rotations).reshape(-1, 3, 3)
    # its pitch axis points to the right of the image, its roll axis lies level under the boresight
    right = looked[:, :, 1]
    level = np.stack([right[:, 1], -right[:, 0], np.zeros(len(looked))], axis=1)
    return np.stack([right, level / np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-9)], axis=1)


def _graph(photos: Mapping[int, Judgement], edges: Sequence[tuple[int, int, int]]) -> TieGraph:
    good = [shot for shot, found in sorted(photos.items()) if found.verdict not in BAD]
    place = {shot: number for number, shot in enumerate(good)}
    pairs = [(place[a], place[b]) for a, b, _ in edges]
    return TieGraph(
        photos=tuple(good),
        edges=tuple(edges),
        groups=tuple(tuple(good[k] for k in group) for group in connected_groups(len(good), pairs)),
        bridges=tuple((good[a], good[b]) for a, b in bridges(len(good), pairs)),
        geometry_only=tuple(shot for shot in good if photos[shot].verdict is Content.GEOMETRY_ONLY),
    )


def judge(
    subjects: Sequence[Subject], ties: Mapping[Pair, Tie], limits: Limits | None = None, *, final: bool = True
) -> Verdicts:
    """Judge photos.

    Args:
        subjects: the photos.
        ties: of pairs of shots, the lower number first; the first of a pair is the first of its `Tie`.
        limits: what is a good photo.
        final: whether no more photos are to come.
    """
    return _Judge(subjects, ties, limits or Limits(), final=final).run()
