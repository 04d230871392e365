"""What of an image counts for ties: the part below the skyline, where there is texture (`Constraints.textured_below`).

Sky ties nothing: no feature can be matched in it. So C2 to C4 count of each image only the part below a line z = const
of its image plane, below which everything is surely under the skyline, whatever the pointing errors: the image is
judged as if it were *cropped* at that line. Overlaps are fractions of the smaller of the two cropped images, so that a
row that shows a little ground is asked for as much of that as others are of theirs. An image of which less than
`LEAST_COUNTED` counts sees as good as sky alone: it is *geometry only*, placed by its angles and by nothing else, and
C2 to C4 ask nothing of it and count nothing for it. C1 counts all images whole.

The line is found on a grid. The elevation of a point of the image plane moves by at most the angle by which the point
moves, so half a step of the grid, as an angle, is subtracted from the skyline, and so are `MARGIN_DEG`, for what is not
known of the skyline, and the largest change of an elevation by the pointing errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import Constraints, Shot, Tolerance, shot_rotations
from panoexec.planning.skyline import Skyline

MARGIN_DEG = 1.0
"""Texture counts from this far below the skyline."""

LEAST_COUNTED = 0.2
"""Images of which less than this fraction counts are geometry only."""

_STEPS = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class Texture:
    """What counts of images.

    Attributes:
        tops: (n,) the line in the image plane (z down) from which the image counts; the lower border for none of it.
        shares: (n,) fraction of the image that counts.
    """

    tops: FloatArray
    shares: FloatArray

    @property
    def counts(self) -> NDArray[np.bool_]:
        """(n,), False for images that are geometry only."""
        return np.asarray(self.shares >= LEAST_COUNTED)

    @staticmethod
    def of(camera: Camera, rotations: FloatArray, tolerance: Tolerance, skyline: Skyline | None) -> Texture | None:
        """What counts of images at rotations (n, 3, 3); None where everything does."""
        if skyline is None:
            return None
        poses = np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)
        reach = math.atan(math.hypot(camera.half_width, camera.half_height))
        moved = math.radians(tolerance.pitch_deg) + math.radians(tolerance.roll_deg) * math.sin(reach)
        step = 2 * camera.half_height / _STEPS
        limits = np.radians(_lowest_deg(poses, reach, tolerance, skyline) - MARGIN_DEG) - moved - step / 2
        tops = _tops(camera, poses, np.sin(np.clip(limits, -math.pi / 2, math.pi / 2)))
        tops[limits < -math.pi / 2] = camera.half_height
        return Texture(tops=tops, shares=(camera.half_height - tops) / (2 * camera.half_height))


def mark_geometry_only(camera: Camera, constraints: Constraints, shots: Sequence[Shot]) -> tuple[Shot, ...]:
    """The shots, marked where they are geometry only."""
    texture = Texture.of(camera, shot_rotations(shots), constraints.tolerance, constraints.textured_below)
    counts = [True] * len(shots) if texture is None else texture.counts.tolist()
    return tuple(
        shot if shot.geometry_only is not counted else replace(shot, geometry_only=not counted)
        for shot, counted in zip(shots, counts, strict=True)
    )


def _lowest_deg(poses: FloatArray, reach_rad: float, tolerance: Tolerance, skyline: Skyline) -> FloatArray:
    """The lowest skyline (n,) over the azimuths that each image may show, degrees."""
    azimuths = np.array([azimuth for azimuth, _ in skyline.points])
    elevations = np.array([elevation for _, elevation in skyline.points])
    lowest = np.full(len(poses), elevations.min())
    if len(azimuths) == 1:
        return lowest
    boresights = poses[:, :, 0]
    level = np.hypot(boresights[:, 0], boresights[:, 1])
    # all directions within this angle of the boresight
    radius = reach_rad + math.radians(tolerance.pitch_deg + tolerance.roll_deg)
    some = np.nonzero(level > math.sin(min(radius, math.pi / 2)) + 1e-9)[0]
    half = np.degrees(np.arcsin(math.sin(min(radius, math.pi / 2)) / level[some])) + tolerance.yaw_deg
    start = np.degrees(np.arctan2(boresights[some, 1], boresights[some, 0])) - half
    ends = np.stack([start, start + 2 * half])
    at_ends = np.interp(ends, azimuths, elevations, period=360.0).min(axis=0)
    inside = (azimuths - start[:, None]) % 360.0 <= 2 * half[:, None]
    lowest[some] = np.minimum(at_ends, np.where(inside, elevations, np.inf).min(axis=1))
    return lowest


def _tops(camera: Camera, poses: FloatArray, sine: FloatArray) -> FloatArray:
    """The lines (n,) below which no elevation has a larger sine than (n,)."""
    w, h = camera.half_width, camera.half_height
    down = np.linspace(-h, h, _STEPS + 1)
    up = -poses[:, 2, :, None]
    level = up[:, 0] + up[:, 2] * down
    # along a line of the image the elevation is largest at an end, or where its derivative vanishes
    squared = 1 + down**2
    across = np.clip(up[:, 1] * squared / np.where(level > 1e-9, level, 1e-9), -w, w)
    highest = np.maximum.reduce(
        [(level + up[:, 1] * y) / np.sqrt(squared + y * y) for y in (across, np.full(1, -w), np.full(1, w))]
    )
    too_high = highest > sine[:, None]
    last = np.where(too_high.any(axis=1), _STEPS + 1 - np.argmax(too_high[:, ::-1], axis=1), 0)
    return np.asarray(np.append(down, h)[last])
