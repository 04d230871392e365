"""The map that `watch` shows: its plan, its size, and the mark of each shot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from panoexec.cli.sphere_map import MARKS, Mark, SphereMap, size_for
from panoexec.mission.log.mark_text import marks_from_text

_VIEWS: Final = ("hfov_deg", "vfov_deg")
_MARKS: Final = {
    "slewing": Mark.CURRENT,
    "taken": Mark.CURRENT,
    "accepted": Mark.DONE,
    "again": Mark.AGAIN,
    "rejected": Mark.AGAIN,
    "interrupted": Mark.AGAIN,
    "missed": Mark.MISSING,
    "skipped": Mark.MISSING,
}
"""Of a shot, by the verdict on its last attempt."""


@dataclass(frozen=True, slots=True)
class PlannedShot:
    """A shot of a published plan."""

    index: int
    pitch_deg: float
    yaw_deg: float


@dataclass(frozen=True, slots=True)
class MapPlan:
    """What the map needs of a published plan.

    Attributes:
        half_width: half an image's width in the ideal image plane at distance 1.
        half_height: half its height, likewise.
        shots: in shooting order.
    """

    half_width: float
    half_height: float
    shots: tuple[PlannedShot, ...]


def plan_of(document: Any) -> MapPlan | None:
    """What the map needs of a published plan.

    The daemon, which publishes it, has validated it; the plan-file reader would be loaded for half a second here.

    Returns:
        None if the document is empty (no mission), has no field of view, or is no plan.
    """
    try:
        camera = document["camera"]
        half_width, half_height = (math.tan(math.radians(_number(camera[key], 0, 180)) / 2) for key in _VIEWS)
        shots = tuple(
            PlannedShot(int(shot.get("index", place)), _number(shot["pitch_deg"], -90, 90), _number(shot["yaw_deg"]))
            for place, shot in enumerate(document["shots"])
        )
    except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
        return None
    return MapPlan(half_width, half_height, shots) if shots else None


def _number(value: object, least: float = -math.inf, most: float = math.inf) -> float:
    """A finite number within limits, else a ValueError."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(value)
    if not least <= value <= most:
        raise ValueError(value)
    return float(value)


def sphere_for(plan: MapPlan, before: SphereMap | None, room: tuple[int, int], *, beside: int) -> SphereMap | None:
    """What draws the map in the room that there is.

    Args:
        plan: whose images it shows.
        before: what drew it last, of the same plan.
        room: columns and lines of the terminal.
        beside: lines that are needed for something else.

    Returns:
        None without room.
    """
    size = size_for(*room, beside=beside)
    if size is None:
        return None
    if before is not None and before.size == size:
        return before
    return SphereMap(plan.half_width, plan.half_height, width=size[0], height=size[1])


def marks_of(state: Mapping[str, Any], attempts: Iterable[tuple[tuple[int, int], str]]) -> dict[int, Mark]:
    """The mark of each shot: from the state if it lists the shots, else from attempts.

    Args:
        state: as published.
        attempts: shot, number and verdict of each attempt, in order.
    """
    total, text = state.get("shots_total"), state.get("shots")
    if isinstance(total, int) and isinstance(text, str) and (told := marks_from_text(text, count=total)):
        return {index: MARKS[standing] for index, standing in enumerate(told)}
    out: dict[int, Mark] = {}
    for (shot, number), verdict in attempts:
        again = out.get(shot) in (Mark.DONE, Mark.RETAKEN)  # the earlier photo counts until a new one is accepted
        mark = _MARKS.get(verdict, Mark.PENDING)
        if mark is Mark.DONE and number > 1:
            mark = Mark.RETAKEN
        if not (again and mark in (Mark.AGAIN, Mark.PENDING)):
            out[shot] = mark
    return out
