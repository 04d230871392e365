"""Examines the photos before they are stitched: which count, what ties them, how bright they are to each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from panoexec.angles import FloatArray
from panoexec.formats.hugin_pto import ControlPoint, PtoProject
from panoexec.optics import Camera
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.matching import SEARCH_DEG, Tie
from panoexec.pictures.model import BAD, Content, PhotoToCheck, Verdicts
from panoexec.planning.model import Tolerance
from panoexec.stitching.gains import gains_of, small_colours
from panoexec.stitching.mission import StitchInput

MATCHED_PX: Final = 1200
"""Longer side at which photos are examined and matched."""
_MOST_SEARCH_DEG: Final = 4.5


@dataclass(frozen=True, slots=True, kw_only=True)
class BadPhoto:
    """A photo that does not count: shot, file and code (a verdict of `Content`), and why."""

    shot: int
    file: str
    code: str
    reason: str

    def to_json(self) -> dict[str, Any]:
        """A JSON object."""
        return {"shot": self.shot, "file": self.file, "code": self.code, "reason": self.reason}


@dataclass(frozen=True, slots=True, kw_only=True)
class Examination:
    """What the examination found.

    Attributes:
        bad: photos that do not count.
        geometry_only: names of photos that nothing ties to the others.
        connected: the photos that can be tied are one group.
        gains: factors of red, green and blue light that make a photo as bright as the others, by name.
        points: control points, pixels of the stored photos; numbers of the images in the project.
    """

    bad: tuple[BadPhoto, ...] = ()
    geometry_only: tuple[str, ...] = ()
    connected: bool = True
    gains: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    points: tuple[ControlPoint, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """A JSON object, without the control points."""
        return {
            "bad": [photo.to_json() for photo in self.bad],
            "geometry_only": list(self.geometry_only),
            "connected": self.connected,
            "gains": {name: list(gain) for name, gain in self.gains.items()},
        }


def examination_from_json(document: Mapping[str, Any]) -> Examination:
    """What `Examination.to_json` wrote."""
    return Examination(
        bad=tuple(BadPhoto(**entry) for entry in document["bad"]),
        geometry_only=tuple(document["geometry_only"]),
        connected=bool(document["connected"]),
        gains={name: (gain[0], gain[1], gain[2]) for name, gain in document["gains"].items()},
    )


def examine_photos(mission: StitchInput, progress: Callable[[float, str], None]) -> Examination:
    """Examine all usable photos of a mission.

    Args:
        mission: the input.
        progress: called with a fraction and a text.
    """
    project = mission.project
    examiner = Examiner(_stored_camera(project), longer_px=MATCHED_PX, search_deg=_search_deg(mission.tolerance))
    rotations = project.rotations()
    number_of: dict[int, int] = {}
    colours: dict[int, FloatArray] = {}
    for number, image in enumerate(project.images):
        shot, time_s = mission.taken.get(image.file_name, (number, math.nan))
        number_of[shot] = number
        content = (mission.folder / image.file_name).read_bytes()
        examiner.add(PhotoToCheck(shot=shot, rotation=rotations[number], time_s=time_s), content)
        colours[shot] = small_colours(content)
        progress((number + 1) / len(project.images), f"photo {number + 1} of {len(project.images)}")
    verdicts = examiner.verdicts(final=True)
    names = {shot: project.images[number].file_name for shot, number in number_of.items()}
    size = examiner.size_px()
    ties = {} if size is None else _good_ties(verdicts, examiner)
    at = {shot: rotations[number] for shot, number in number_of.items()}
    gains = gains_of(colours, ties, at, half_width=image_half_width(project))
    return Examination(
        bad=_bad(mission, verdicts, names),
        geometry_only=tuple(names[shot] for shot in verdicts.graph.geometry_only),
        connected=verdicts.graph.connected,
        gains={names[shot]: gain for shot, gain in gains.items()},
        points=() if size is None else _points(ties, number_of, project, size),
    )


def _stored_camera(project: PtoProject) -> Camera:
    """The camera whose images are the pixels as stored."""
    image = project.images[0]
    return Camera(
        name="stored",
        sensor_width_mm=float(image.width_px),
        sensor_height_mm=float(image.height_px),
        image_width_px=image.width_px,
        image_height_px=image.height_px,
        focal_length_mm=project.focal_length_px,
    )


def image_half_width(project: PtoProject) -> float:
    """Tangent of half the field of view across the stored width."""
    return project.images[0].width_px / (2 * project.focal_length_px)


def _search_deg(tolerance: Tolerance) -> float:
    """Four standard deviations of the difference of two attitudes whose errors are the tolerances."""
    worst = max(tolerance.pitch_deg, tolerance.roll_deg, tolerance.yaw_deg)
    return min(max(SEARCH_DEG, 4 * math.sqrt(2) * worst), _MOST_SEARCH_DEG)


def _bad(mission: StitchInput, verdicts: Verdicts, names: Mapping[int, str]) -> tuple[BadPhoto, ...]:
    found = [
        BadPhoto(shot=judged.shot, file=names[judged.shot], code=judged.verdict.value, reason=judged.reason)
        for judged in verdicts.photos.values()
        if judged.verdict in BAD
    ]
    found += [
        BadPhoto(shot=mission.taken[name][0], file=name, code=Content.UNREADABLE.value, reason=reason)
        for name, reason in mission.left_out.items()
        if name in mission.taken and not reason.startswith("is missing")
    ]
    return tuple(sorted(found, key=lambda photo: photo.shot))


def _good_ties(verdicts: Verdicts, examiner: Examiner) -> dict[tuple[int, int], Tie]:
    return {(a, b): examiner.ties[a, b] for a, b, _ in verdicts.graph.edges}


def _points(
    ties: Mapping[tuple[int, int], Tie], number_of: Mapping[int, int], project: PtoProject, size: tuple[int, int]
) -> tuple[ControlPoint, ...]:
    image = project.images[0]
    across, down = image.width_px / size[0], image.height_px / size[1]
    scale = np.array([across, down, across, down])
    points = []
    for (a, b), found in ties.items():
        for x1, y1, x2, y2 in ((found.pixels + 0.5) * scale - 0.5).tolist():
            points.append(ControlPoint(first=number_of[a], second=number_of[b], x1=x1, y1=y1, x2=x2, y2=y2))
    return tuple(points)


def without(project: PtoProject, names: frozenset[str]) -> PtoProject:
    """A project without some of its images, and without their control points."""
    kept = [number for number, image in enumerate(project.images) if image.file_name not in names]
    new = {number: place for place, number in enumerate(kept)}
    points = tuple(
        ControlPoint(first=new[p.first], second=new[p.second], x1=p.x1, y1=p.y1, x2=p.x2, y2=p.y2)
        for p in project.control_points
        if p.first in new and p.second in new
    )
    return replace(project, images=tuple(project.images[number] for number in kept), control_points=points)


def examination_path(work: Path) -> Path:
    """Where the result of the examination is kept."""
    return work / "content.json"
