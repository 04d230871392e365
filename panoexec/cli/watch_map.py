"""The map that `watch` shows: its plan, its size, and the mark of each shot."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from panoexec.cli.sphere_map import MARKS, Mark, SphereMap, size_for
from panoexec.errors import InputFileError
from panoexec.inputs.plan_file import PlanFile, plan_from_data
from panoexec.mission.log.shot_marks import marks_from_text
from panoexec.optics import Camera

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


def plan_of(document: Any) -> PlanFile | None:
    """The plan in a published document; None if it is empty (no mission) or not a valid plan."""
    try:
        return plan_from_data(document, source="plan")
    except InputFileError:
        return None


def sphere_for(camera: Camera, before: SphereMap | None, room: tuple[int, int], *, beside: int) -> SphereMap | None:
    """What draws the map in the room that there is.

    Args:
        camera: of the images.
        before: what drew it last, of the same camera.
        room: columns and lines of the terminal.
        beside: lines that are needed for something else.

    Returns:
        None without room.
    """
    size = size_for(*room, beside=beside)
    if size is None:
        return None
    return before if before is not None and before.size == size else SphereMap(camera, width=size[0], height=size[1])


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
