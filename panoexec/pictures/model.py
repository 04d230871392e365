"""Verdicts on photos."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import numpy as np

from panoexec.angles import FloatArray


class Content(StrEnum):
    """What the content of a photo proves."""

    OK = "ok"
    """Readable, exposed, sharp, and tied to its neighbours where its attitude says it is."""
    GEOMETRY_ONLY = "geometry_only"
    """Nothing in its overlaps can be tied (sky, water, fog): its measured attitude alone says where it is."""
    UNREADABLE = "unreadable"
    """Not readable to its last byte, or of another size than the others."""
    EXPOSURE = "exposure"
    """Black, white, or some stops off its neighbours."""
    BLURRED = "blurred"
    """Less sharp than its neighbours where they overlap."""
    UNTIED = "untied"
    """It and its neighbours show texture in their overlaps, but nothing in common."""
    CONTRADICTS = "contradicts"
    """It is tied elsewhere than its attitude says, or shows something else than all its neighbours."""
    UNCHECKED = "unchecked"
    """It did not reach this computer, or was not examined."""


LEAST_TIED: Final = 6
"""Fewer tied photos tell nothing about the others' attitudes."""
_EXPECTED_BOUND_DEG: Final = 2.2
"""Three times tilts of 0.08° and a heading of 0.7° (`panoexec.pictures.attitudes.AttitudeErrors`)."""
_LEAST_BOUND_DEG: Final = 0.05
BAD = frozenset({Content.UNREADABLE, Content.EXPOSURE, Content.BLURRED, Content.UNTIED, Content.CONTRADICTS})
"""Verdicts with which a photo does not count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TieLine:
    """One tie of a photo.

    Attributes:
        shot: the other photo's.
        points: how many corners agree.
        angle_deg: by how much the two measured attitudes contradict the content.
        parallax_deg: by how much the ground is displaced because they were taken from different places; 0 where a
            rotation explains it all.
    """

    shot: int
    points: int
    angle_deg: float
    parallax_deg: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The verdict on one photo.

    Attributes:
        shot: its number.
        verdict: see `Content`.
        reason: in words; "" for a good photo.
        settled: no photo that is still to come can change the verdict: all planned neighbours are there, or the fault
            is the photo's own.
        sharpness: fine detail relative to its neighbours (median), NaN where there is none.
        stops: brightness relative to its neighbours (median), stops, NaN without neighbours.
        odd_deg: by how much its measured attitude is wrong beyond what attitudes usually are.
        error_deg: (3,) measured minus estimated attitude, world frame (north, east, down), degrees.
        ties: to its neighbours.
    """

    shot: int
    verdict: Content
    reason: str = ""
    settled: bool = True
    sharpness: float = float("nan")
    stops: float = float("nan")
    odd_deg: float = 0.0
    error_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ties: tuple[TieLine, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TieGraph:
    """The tie graph of all photos.

    Attributes:
        photos: shots that were examined and are good.
        edges: (shot, shot, points) of agreeing ties.
        groups: shots connected with each other by ties, the largest group first.
        bridges: ties without which a group falls apart.
        geometry_only: shots that hang on their measured attitude alone.
    """

    photos: tuple[int, ...] = ()
    edges: tuple[tuple[int, int, int], ...] = ()
    groups: tuple[tuple[int, ...], ...] = ()
    bridges: tuple[tuple[int, int], ...] = ()
    geometry_only: tuple[int, ...] = ()

    @property
    def connected(self) -> bool:
        """Whether all photos that can be tied are tied to each other."""
        return sum(1 for group in self.groups if len(group) > 1 or group[0] not in self.geometry_only) <= 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdicts:
    """All verdicts, and the tie graph of the good photos."""

    photos: dict[int, Judgement] = field(default_factory=dict)
    graph: TieGraph = field(default_factory=TieGraph)

    @property
    def geometry_bound_deg(self) -> float:
        """Bound (three standard deviations) of the attitude error of a photo that hangs on its measured attitude.

        From how far the measured attitudes of the tied photos are from those that their content implies, the heading
        relative to theirs; with fewer than `LEAST_TIED` of them, from what attitudes are expected to err.
        """
        errors = np.array([one.error_deg for one in self.photos.values() if one.verdict is Content.OK and one.ties])
        if len(errors) < LEAST_TIED:
            return _EXPECTED_BOUND_DEG
        errors[:, 2] -= errors[:, 2].mean()
        return max(_LEAST_BOUND_DEG, 3 * float(np.sqrt((errors**2).sum(axis=1).mean())))

    @property
    def bad(self) -> list[Judgement]:
        """Photos that do not count."""
        return [found for found in self.photos.values() if found.verdict in BAD]


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgePose:
    """A shot that may tie two photos which share too little (`panoexec.pictures.bridging`).

    Attributes:
        between: the shots of the two photos.
        pitch_deg, yaw_deg: halfway between them, plan frame.
        corners: how many unmistakable corners it would show, of the photo of which it would show fewer.
    """

    between: tuple[int, int]
    pitch_deg: float
    yaw_deg: float
    corners: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoToCheck:
    """A photo and what is known of it.

    Attributes:
        shot: its number.
        rotation: (3, 3) measured attitude, camera to plan frame.
        time_s: when it was taken, on any clock; NaN if unknown.
        place: where, plan frame (north or the plan's yaw 0, right of it, down), heights above the ground from one
            point of the mission; None if unknown.
    """

    shot: int
    rotation: FloatArray
    time_s: float = float("nan")
    place: FloatArray | None = None
