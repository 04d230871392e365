"""Independent judges for the certificate: the definitions by random directions and random pointing errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import elevation_azimuth, rotation, yaw_pitch_roll
from panoexec.optics import Camera
from panoexec.planning.model import AngleBox, Band, Tolerance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PAPER = Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.667)
SCENARIO_2 = Camera.from_fov(21.76, 16.44)


def full_circle(low_deg: float, high_deg: float) -> Band:
    """A band all round."""
    return Band(elevation_min_deg=low_deg, elevation_max_deg=high_deg)


def even_rows(rows: Sequence[tuple[float, int]], phases_deg: Sequence[float] | None = None) -> tuple[Array, list[int]]:
    """Attitudes and row numbers of rows (pitch, count) of evenly spaced images."""
    phases = phases_deg or [0.0] * len(rows)
    turns = [rotation(p + np.arange(n) * 360.0 / n, np.full(n, t)) for (t, n), p in zip(rows, phases, strict=True)]
    return np.concatenate(turns), [k for k, (_, n) in enumerate(rows) for _ in range(n)]


def enough_rows(camera: Camera, overlap: float, top_deg: float) -> list[tuple[float, int]]:
    """Rows from a nadir image up that a careful person would shoot; not meant to be few."""
    rows, pitch = [(-90.0, 1)], -90.0
    step = camera.vfov_deg * (1 - overlap)
    while pitch + camera.vfov_deg / 2 < top_deg and pitch < 90.0:
        pitch = min(pitch + step, 90.0)
        # the side turned to the horizon needs the most images
        nearest = min(abs(pitch), max(abs(pitch) - camera.vfov_deg / 2, 0.0))
        rows.append(
            (pitch, max(3, int(np.ceil(360 * np.cos(np.radians(nearest)) / (camera.hfov_deg * (1 - overlap))))))
        )
    return rows


def random_directions(count: int, rng: np.random.Generator) -> Array:
    """Unit vectors, evenly over the sphere."""
    v = rng.normal(size=(count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def in_domain(directions: Array, band: Band, masks: Sequence[AngleBox] = ()) -> Mask:
    """Which directions have to be covered, by the definition of bands and masks."""
    elevation = np.degrees(np.arcsin(np.clip(-directions[:, 2], -1, 1)))
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))

    def inside(box: Band | AngleBox) -> Mask:
        turn = (azimuth - box.azimuth_min_deg) % 360.0
        return np.asarray(
            (elevation >= box.elevation_min_deg)
            & (elevation <= box.elevation_max_deg)
            & (turn <= box.azimuth_max_deg - box.azimuth_min_deg)
        )

    wanted = inside(band)
    for mask in masks:
        wanted &= ~inside(mask)
    return wanted


def with_errors(attitudes: Array, tolerance: Tolerance, rng: np.random.Generator, *, extreme: bool) -> Array:
    """The images as taken: each axis of each image off by up to its tolerance, or by all of it, either way."""
    yaw, pitch, roll = yaw_pitch_roll(attitudes)
    share = rng.uniform(-1, 1, (3, len(yaw)))
    if extreme:
        share = np.where(share < 0, -1.0, 1.0)
    return rotation(
        yaw + share[0] * tolerance.yaw_deg, pitch + share[1] * tolerance.pitch_deg, roll + share[2] * tolerance.roll_deg
    )


def unseen(camera: Camera, attitudes: Array, directions: Array) -> Array:
    """Those directions that no image has in its rectangle, by the pinhole equation."""
    left = directions
    for turn in attitudes:
        in_camera = left @ turn
        depth = in_camera[:, 0]
        seen = (depth > 0) & (np.abs(in_camera[:, 1]) <= depth * camera.half_width)
        seen &= np.abs(in_camera[:, 2]) <= depth * camera.half_height
        left = left[~seen]
    return left


def pinwheel(centre: Array, camera: Camera, width_deg: float) -> Array:
    """Four images around a direction that leave a square of that width between them (overlap if it is negative).

    Args:
        centre: the attitude (3, 3) whose boresight is the middle of the hole.
        camera: the camera.
        width_deg: of the hole.

    Returns:
        (4, 3, 3): above, below, right, left.
    """
    up = (camera.vfov_deg + width_deg) / 2
    aside = (camera.hfov_deg + width_deg) / 2
    return centre @ rotation([0.0, 0.0, aside, -aside], [up, -up, 0.0, 0.0])


def sector_about(attitude: Array, half_deg: float) -> Band:
    """The box of elevations and azimuths about a boresight."""
    elevation, azimuth = elevation_azimuth(attitude[:, 0])
    return Band(
        elevation_min_deg=max(float(elevation) - half_deg, -90.0),
        elevation_max_deg=min(float(elevation) + half_deg, 90.0),
        azimuth_min_deg=float(azimuth) - half_deg,
        azimuth_max_deg=float(azimuth) + half_deg,
    )
