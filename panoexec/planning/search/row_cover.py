"""Guaranteed coverage of a row of images on every meridian: the search's fast approximation of C1.

On the meridian at azimuth φ from an image's own, each of its edge planes with normal n contains the directions with
n_x·cos φ + n_y·sin φ ≥ n_z·tan e: an interval of elevations e. The intersection over the corners of the box of pointing
errors, and over yaw errors of 0, is the guaranteed coverage of the image, up to the square of the tolerances (for which
an allowance is subtracted). A row of evenly spaced images covers on each meridian the union over the nearest images.

The certificate proves coverage by another method (`planning.certificate.coverage`); this one only guides the search.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera
from panoexec.planning.geometry.footprint import edge_normals
from panoexec.planning.model import Tolerance

ROUNDING_DEG = 1e-5
"""Subtracted at both ends of every interval: the certificate does not accept images that merely touch."""

_LEVEL = 1e-12

_AT_A_TIME = 1 << 15
"""Pairs of a half-space and a meridian processed at a time, so that they fit the processor's cache."""


class CoreEdges:
    """The edge planes of images at the corners of the error box.

    Attributes:
        allowance_deg: subtracted at both ends of every interval of elevations.
    """

    def __init__(self, camera: Camera, tolerance: Tolerance) -> None:
        self._normals = edge_normals(camera)
        yaws = (-tolerance.yaw_deg, 0.0, tolerance.yaw_deg) if tolerance.yaw_deg else (0.0,)
        rolls = (-tolerance.roll_deg, tolerance.roll_deg) if tolerance.roll_deg else (0.0,)
        pitches = (-tolerance.pitch_deg, tolerance.pitch_deg) if tolerance.pitch_deg else (0.0,)
        self._tilts = np.array(pitches)
        turns = np.array(list(itertools.product(yaws, rolls)))
        self._turns = None if len(turns) == 1 else np.swapaxes(rotation(turns[:, 0], 0.0, turns[:, 1]), -1, -2)
        radians = np.radians([tolerance.yaw_deg, tolerance.roll_deg, tolerance.pitch_deg])
        self.allowance_deg = ROUNDING_DEG + float(np.degrees((radians**2).sum() / 2))

    def planes(self, pitch_deg: ArrayLike) -> FloatArray:
        """World normals (..., k, 3) of the edge planes of images at yaw 0 and the given pitch (...)."""
        tilted = np.radians(np.asarray(pitch_deg, dtype=np.float64)[..., None] + self._tilts)[..., None]
        sine, cosine = np.sin(tilted), np.cos(tilted)
        x, y, z = self._normals.T
        planes = np.empty((*tilted.shape[:-1], len(x), 3))
        planes[..., 0] = cosine * x + sine * z
        planes[..., 1] = y
        planes[..., 2] = cosine * z - sine * x
        # of each image, those of all tilts: (..., 1, planes, 3)
        planes = planes.reshape(*tilted.shape[:-2], 1, len(self._tilts) * len(x), 3)
        if self._turns is not None:
            planes = planes @ self._turns
        return np.asarray(planes.reshape(*planes.shape[:-3], planes.shape[-3] * planes.shape[-2], 3))

    def intervals(self, pitch_deg: ArrayLike, azimuth_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Elevations on meridians that images cover for every error.

        Args:
            pitch_deg: (...), of images at yaw 0.
            azimuth_deg: (..., m) azimuths of meridians for each image.

        Returns:
            Lowest and highest elevation, each (..., m), degrees; lowest > highest where nothing is covered. A pole is
            returned as exactly ±90.
        """
        return meridian_intervals(self.planes(pitch_deg), azimuth_deg, self.allowance_deg)


def meridian_intervals(
    planes: FloatArray, azimuth_deg: ArrayLike, allowance_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Intervals (..., m) of elevations on meridians (..., m) inside half-spaces (..., k, 3), see the module."""
    azimuth_deg = np.asarray(azimuth_deg, dtype=np.float64)
    step = max(1, _AT_A_TIME // (planes.shape[-2] * azimuth_deg.shape[-1]))
    if planes.ndim != 3 or len(planes) <= step:
        return _intervals(planes, azimuth_deg, allowance_deg)
    parts = [
        _intervals(planes[s], azimuth_deg[s], allowance_deg)
        for s in (slice(start, start + step) for start in range(0, len(planes), step))
    ]
    return np.concatenate([low for low, _ in parts]), np.concatenate([high for _, high in parts])


def _intervals(planes: FloatArray, azimuth_deg: FloatArray, allowance_deg: float) -> tuple[FloatArray, FloatArray]:
    azimuth = np.radians(azimuth_deg)[..., None, :]
    steep = planes[..., 2]
    level = np.abs(steep) <= _LEVEL
    scaled = planes[..., :2] / np.where(level, 1.0, steep)[..., None]
    slope = scaled[..., 0, None] * np.cos(azimuth)
    slope += scaled[..., 1, None] * np.sin(azimuth)
    upper = slope + np.where(steep > _LEVEL, 0.0, np.inf)[..., None]
    if level.any():
        upper[level[..., None] & (slope < 0)] = -np.inf
    lower = slope - np.where(steep < -_LEVEL, 0.0, np.inf)[..., None]
    high = np.degrees(np.arctan(upper.min(axis=-2)))
    low = np.degrees(np.arctan(lower.max(axis=-2)))
    # a pole is covered if it is deep enough inside all edge planes; the interval then includes it
    deep = np.sin(np.radians(allowance_deg))
    nadir, zenith = planes[..., 2].min(axis=-1)[..., None] >= deep, planes[..., 2].max(axis=-1)[..., None] <= -deep
    return np.where((low <= -90.0) & nadir, low, low + allowance_deg), np.where(
        (high >= 90.0) & zenith, high, high - allowance_deg
    )


class RowCover:
    """Coverage of rows at all azimuths for any phase, and on each meridian."""

    def __init__(self, camera: Camera, tolerance: Tolerance) -> None:
        self.edges = CoreEdges(camera, tolerance)
        self._dense_deg = camera.hfov_deg / 2
        """Below this spacing second neighbours overlap and may cover more than the nearest image does."""

    def band(self, pitch_deg: ArrayLike, spacing_deg: ArrayLike, reach_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Elevations that rows cover at every azimuth, for every error.

        Args:
            pitch_deg: (k,).
            spacing_deg: (k,) yaw between neighbours.
            reach_deg: (k,) largest azimuth from the nearest image's own: at least half the spacing.

        Returns:
            Lowest and highest, each (k,); empty (lowest > highest) where gaps remain.
        """
        pitch, reach = np.asarray(pitch_deg, np.float64), np.asarray(reach_deg, np.float64)
        azimuths = reach[..., None] * np.linspace(0.0, 1.0, 7)
        low, high = self.row_intervals(pitch, np.asarray(spacing_deg, np.float64), azimuths)
        return low.max(axis=-1), high.min(axis=-1)

    def row_intervals(
        self, pitch_deg: FloatArray, spacing_deg: FloatArray, azimuth_deg: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Elevations that rows cover on meridians near one of their images.

        The intervals of the neighbours are added as far as they overlap the interval of the image at yaw 0.

        Args:
            pitch_deg: (...).
            spacing_deg: (...), 0 where there are no neighbours.
            azimuth_deg: (..., m) from the image at yaw 0.

        Returns:
            Lowest and highest, each (..., m).
        """
        planes = self.edges.planes(pitch_deg)
        low, high = meridian_intervals(planes, azimuth_deg, self.edges.allowance_deg)
        if not np.any((spacing_deg > 0) & (spacing_deg < self._dense_deg)):
            return low, high
        for side in (-1.0, 1.0):
            shifted = azimuth_deg + side * spacing_deg[..., None]
            near_low, near_high = meridian_intervals(planes, shifted, self.edges.allowance_deg)
            joined = (near_low <= near_high) & (low <= high) & (near_low <= high) & (near_high >= low)
            low = np.where(joined, np.minimum(low, near_low), low)
            high = np.where(joined, np.maximum(high, near_high), high)
        return low, high
