"""Parallax: the seam error that two photos taken from different places leave on the ground, predicted in pixels.

Directions on flat ground at the vehicle's height below it are displaced, in angle, by the part of the displacement
that is across the line of sight, divided by the distance along it. At the nadir that is displacement by height; towards
the horizon it vanishes. The pair's error is its largest value where the two photos overlap below the horizon, in pixels
of the photo at its centre. The aligner hides some of it by turning the photos; what is near or high shows more.

Heights are above the place of take-off, as the autopilot reports them. On a slope, the ground may be nearer.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from panoexec.angles import FloatArray, rotation, rotation_from_quaternion
from panoexec.mission.context import MissionContext
from panoexec.mission.guards import EARTH_RADIUS_M
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import AttemptRecord, ShotRecord
from panoexec.optics import Camera

LEAST_HEIGHT_M: Final = 2.0
"""Lower down nothing is predicted: the vehicle stands on the ground, or its height is wrong."""
_SAMPLES: Final = 9
"""Directions along each side of a photo at which the error is computed."""
_TOLD_FRAC: Final = 0.03
"""Share of the longer side from which a seam error is told although there is no limit for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a photo was taken from, and where it looked.

    Attributes:
        rotation: (3, 3) camera to plan frame.
        position: latitude and longitude, degrees, and altitude above sea level, metres.
        height_m: above the ground.
    """

    rotation: FloatArray
    position: tuple[float, float, float]
    height_m: float


def place_of(shot: ShotRecord, exposed: ev.ShotExposed | None) -> Place | None:
    """The place of an exposure; None if its position or height is unknown."""
    if exposed is None or not exposed.height_m >= LEAST_HEIGHT_M:
        return None
    position = (exposed.latitude_deg, exposed.longitude_deg, exposed.altitude_m)
    if not all(map(math.isfinite, position)):
        return None
    looked = (
        rotation(shot.shot.yaw_deg, shot.shot.pitch_deg)
        if exposed.measured is None
        else rotation_from_quaternion(exposed.measured.q_wxyz)
    )
    return Place(rotation=looked, position=position, height_m=exposed.height_m)


class SeamErrors:
    """Predicts seam errors for one camera.

    Args:
        camera: its field of view and focal length.
        reference_yaw_north_deg: direction of the plan's yaw 0; NaN counts as north.
    """

    def __init__(self, camera: Camera, reference_yaw_north_deg: float) -> None:
        self._camera = camera
        self._reference_yaw_north_deg = reference_yaw_north_deg
        side = np.linspace(-1, 1, _SAMPLES)
        y, z = np.meshgrid(side * camera.half_width, side * camera.half_height)
        self._rays = np.stack([np.ones(y.size), y.ravel(), z.ravel()], axis=1)
        self._rays /= np.linalg.norm(self._rays, axis=1, keepdims=True)

    def error_px(self, one: Place, other: Place) -> float:
        """The seam error of two photos; 0 if they do not overlap on the ground."""
        return max(self._seen(one, other), self._seen(other, one))

    def _seen(self, one: Place, other: Place) -> float:
        camera = self._camera
        rays = self._rays @ one.rotation.T
        inside = rays @ other.rotation
        depth = inside[:, 0]
        shared = (
            (depth > 0)
            & (np.abs(inside[:, 1]) <= camera.half_width * depth)
            & (np.abs(inside[:, 2]) <= camera.half_height * depth)
            & (rays[:, 2] > 0)
        )
        if not shared.any():
            return 0.0
        ground = rays[shared]
        moved = moved_m(one.position, other.position, self._reference_yaw_north_deg)
        moved /= 0.5 * (one.height_m + other.height_m)
        across = moved - (ground @ moved)[:, None] * ground
        return float((np.linalg.norm(across, axis=1) * ground[:, 2]).max() * camera.focal_length_px)


def moved_m(
    start: tuple[float, float, float], end: tuple[float, float, float], reference_yaw_north_deg: float
) -> FloatArray:
    """Displacement between positions, metres, in the plan's frame: towards its yaw 0, right of it, down.

    Args:
        start: latitude and longitude, degrees, and altitude, metres.
        end: likewise.
        reference_yaw_north_deg: direction of the plan's yaw 0; NaN counts as north.
    """
    north = math.radians(end[0] - start[0]) * EARTH_RADIUS_M
    east = math.radians(end[1] - start[1]) * EARTH_RADIUS_M * math.cos(math.radians(start[0]))
    angle = math.radians(0.0 if math.isnan(reference_yaw_north_deg) else reference_yaw_north_deg)
    ahead = math.cos(angle) * north + math.sin(angle) * east
    right = -math.sin(angle) * north + math.cos(angle) * east
    return np.array([ahead, right, start[2] - end[2]])


class SeamTable:
    """The predicted seam errors of all pairs of accepted photos that overlap; updated with the record.

    Args:
        camera: of the plan.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._attempts: dict[int, int] = {}
        self._places: dict[int, Place] = {}
        self._pairs: dict[tuple[int, int], float] = {}
        # boresights of photos that overlap are no farther apart
        self._reach = math.cos(min(math.pi, 2 * math.atan(math.hypot(camera.half_width, camera.half_height))))

    def pairs(self, record: MissionRecord) -> Mapping[tuple[int, int], float]:
        """The errors in pixels by shots, the lower one first."""
        accepted = {index: attempt for index, shot in record.shots.items() if (attempt := shot.accepted) is not None}
        numbers = {index: attempt.number for index, attempt in accepted.items()}
        changed = {index for index in numbers.keys() | self._attempts.keys()
                   if numbers.get(index) != self._attempts.get(index)}  # fmt: skip
        for index in changed:
            self._places.pop(index, None)
        self._pairs = {pair: error for pair, error in self._pairs.items() if not changed & set(pair)}
        errors = SeamErrors(self._camera, record.reference_yaw_north_deg)
        for index in sorted(changed & numbers.keys()):
            place = place_of(record.shots[index], accepted[index].exposed)
            if place is None:
                continue
            for other, error in self._against(errors, place):
                self._pairs[min(index, other), max(index, other)] = error
            self._places[index] = place
        self._attempts = numbers
        return self._pairs

    def worst(self, record: MissionRecord, place: Place, *, but: int) -> tuple[float, int] | None:
        """The largest error of a photo with an accepted one, and that one's shot; None without any overlap.

        Args:
            record: of the mission.
            place: of the photo.
            but: shot that does not count: the photo's own.
        """
        self.pairs(record)
        errors = SeamErrors(self._camera, record.reference_yaw_north_deg)
        found = [(error, other) for other, error in self._against(errors, place) if other != but]
        return max(found, default=None)

    def _against(self, errors: SeamErrors, place: Place) -> Iterable[tuple[int, float]]:
        axis = place.rotation[:, 0]
        for other, there in self._places.items():
            if float(axis @ there.rotation[:, 0]) >= self._reach and (error := errors.error_px(place, there)) > 0:
                yield other, error


class ParallaxWatch:
    """Judges photos by their seam errors while a mission flies.

    Args:
        context: the mission.
    """

    def __init__(self, context: MissionContext) -> None:
        self._context = context
        self._table = SeamTable(context.plan.camera)
        self._told = False

    def problem(self, shot: int, exposed: ev.ShotExposed) -> str:
        """Why an exposure breaks the limit, "" if it does not or nothing is known."""
        limit_px = self._context.settings.guards.parallax_px
        worst = self._worst(shot, exposed) if limit_px > 0 else None
        if worst is None or worst[0] <= limit_px:
            return ""
        return f"a seam of {worst[0]:.0f} px with shot {worst[1]} is expected from the drift (at most {limit_px:g} px)"

    def accepted(self, shot: int, attempt: AttemptRecord) -> None:
        """Warn once where there is no limit."""
        camera = self._context.plan.camera
        if self._told or self._context.settings.guards.parallax_px > 0 or attempt.exposed is None:
            return
        worst = self._worst(shot, attempt.exposed)
        if worst is None or worst[0] <= _TOLD_FRAC * max(camera.image_width_px, camera.image_height_px):
            return
        self._told = True
        text = f"drift: a seam of {worst[0]:.0f} px is expected between shots {worst[1]} and {shot}"
        self._context.recorder.emit(ev.Warned(code="parallax", text=text))

    def _worst(self, shot: int, exposed: ev.ShotExposed) -> tuple[float, int] | None:
        record = self._context.record
        place = place_of(record.shots[shot], exposed)
        return None if place is None else self._table.worst(record, place, but=shot)
