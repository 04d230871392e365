"""Seeded requests to the planner, as people might make them and as nobody would: the survey and its tests draw them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from panoexec.inputs.camera_profiles import load_profile
from panoexec.lens.distortion import Distortion
from panoexec.optics import Camera
from panoexec.planning.model import NO_TOLERANCE, AngleBox, Band, Constraints, GimbalLimits, Tolerance
from panoexec.planning.skyline import Skyline

SURVEY = 500
"""Requests of the survey: the seeds 0 to 499."""

_MOST_IMAGES = 1200
"""Requests that would need more images, about, are drawn again: each would take as long as many others."""

_ASPECTS = (4 / 3, 4 / 3, 3 / 2, 3 / 2, 16 / 9, 3 / 4, 2 / 3, 1.0)
_OVERLAPS = (0.0, 0.05, 0.1, 0.15, 0.15, 0.2, 0.3, 0.4)
_PAPER = Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.667)
_DEFAULT = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7)


_PROFILES = ("dji-x5s-15mm", "dji-x5s-45mm", "sony-a6000-35mm")


def request_of(seed: int) -> tuple[Camera, Constraints]:
    """The request of a seed."""
    rng = np.random.default_rng([1906, seed])
    while True:
        camera, constraints = _drawn(rng)
        if expected_images(camera, constraints) <= _MOST_IMAGES:
            break
    # drawn apart, so that the other requests remain what they were
    rng = np.random.default_rng([1907, seed])
    if rng.random() < 0.15:
        calibrated = _calibrated(rng)
        if expected_images(calibrated, constraints) <= _MOST_IMAGES:
            camera = calibrated
    if rng.random() < 0.15:
        constraints = replace(constraints, textured_below=_skyline(rng))
    return camera, constraints


def expected_images(camera: Camera, constraints: Constraints) -> float:
    """Solid angle over what an image adds: how long a search will about take."""
    band = constraints.band
    height = math.sin(math.radians(band.elevation_max_deg)) - math.sin(math.radians(band.elevation_min_deg))
    zone = math.radians(min(band.azimuth_span_deg, 360.0)) * height
    return zone / (camera.solid_angle_sr * (1 - constraints.overlap_h) * (1 - constraints.overlap_v))


def stricter(constraints: Constraints) -> list[tuple[str, Constraints]]:
    """Slightly stricter requests, each with its name: what satisfies one of them satisfies the request too.

    With a skyline larger errors are not among them: less of each image counts, and overlaps are shares of that.
    """
    siblings = [
        (f"overlap +{more:g}", replace(constraints, overlap_h=h, overlap_v=v))
        for more in (0.005, 0.01, 0.02, 0.03, 0.05)
        if (h := constraints.overlap_h + more) < 1 and (v := constraints.overlap_v + more) < 1
    ]
    band, tolerance = constraints.band, constraints.tolerance
    wider = replace(
        band,
        elevation_min_deg=max(band.elevation_min_deg - 1.0, -90.0),
        elevation_max_deg=min(band.elevation_max_deg + 1.0, 90.0),
    )
    if wider != band:
        siblings.append(("band +1°", replace(constraints, band=wider)))
    if not tolerance.is_zero and constraints.textured_below is None:
        more_error = Tolerance(
            pitch_deg=1.1 * tolerance.pitch_deg, roll_deg=1.1 * tolerance.roll_deg, yaw_deg=1.1 * tolerance.yaw_deg
        )
        siblings.append(("tolerance +10 %", replace(constraints, tolerance=more_error)))
    return siblings


def _drawn(rng: np.random.Generator) -> tuple[Camera, Constraints]:
    overlap_h, overlap_v = _overlaps(rng)
    constraints = Constraints(
        overlap_h=overlap_h,
        overlap_v=overlap_v,
        band=_band(rng),
        tolerance=_tolerance(rng),
        guarantee="all" if rng.random() < 0.25 else "coverage",
    )
    if rng.random() < 0.12:
        constraints = replace(constraints, gimbal=_gimbal(rng))
    if rng.random() < 0.1:
        constraints = replace(constraints, masks=(_mask(rng, constraints.band),))
    return _camera(rng), constraints


def _camera(rng: np.random.Generator) -> Camera:
    hfov_deg = float(np.exp(rng.uniform(math.log(8.0), math.log(110.0))))
    aspect = float(rng.choice(_ASPECTS)) if rng.random() < 0.85 else float(rng.uniform(0.35, 3.0))
    vfov_deg = 2 * math.degrees(math.atan(math.tan(math.radians(hfov_deg) / 2) / aspect))
    return Camera.from_fov(round(hfov_deg, 2), min(max(round(vfov_deg, 2), 6.0), 120.0))


def _calibrated(rng: np.random.Generator) -> Camera:
    """A profile with its calibrated focal length; every other one distorts, beside its middle and within a margin."""
    camera = load_profile(str(rng.choice(_PROFILES))).camera
    if rng.random() < 0.5:
        return camera
    k1, p1, p2 = rng.uniform(-0.1, 0.06), *rng.uniform(-0.001, 0.001, 2)
    beside = rng.uniform(-0.01, 0.01, 2)
    return replace(
        camera,
        distortion=Distortion(k1=round(float(k1), 4), p1=round(float(p1), 5), p2=round(float(p2), 5)),
        principal_point_px=(
            round(camera.image_width_px * float(0.5 + beside[0]), 1),
            round(camera.image_height_px * float(0.5 + beside[1]), 1),
        ),
        fov_margin=float(rng.choice([0.0, 0.004, 0.01])),
    )


def _skyline(rng: np.random.Generator) -> Skyline:
    if rng.random() < 0.6:
        return Skyline.level(round(float(rng.uniform(-15.0, 40.0)), 1))
    azimuths = sorted(rng.choice(np.arange(-180.0, 180.0), int(rng.integers(2, 9)), replace=False).tolist())
    return Skyline(tuple((azimuth, round(float(rng.uniform(-10.0, 45.0)), 1)) for azimuth in azimuths))


def _overlaps(rng: np.random.Generator) -> tuple[float, float]:
    if rng.random() < 0.7:
        overlap = float(rng.choice(_OVERLAPS))
        return overlap, overlap
    across, upwards = rng.uniform(0.0, 0.55, 2).round(3).tolist()
    return across, upwards


def _band(rng: np.random.Generator) -> Band:
    kind = rng.choice(
        ["sphere", "from nadir", "band", "sector", "narrow", "column"], p=[0.14, 0.26, 0.2, 0.22, 0.1, 0.08]
    )
    low, high = sorted(rng.uniform(-90.0, 90.0, 2).round(1).tolist())
    if high - low < 2.0:
        low, high = max(low - 1.0, -90.0), min(high + 1.0, 90.0)
    if kind == "sphere":
        return Band(elevation_min_deg=-90.0, elevation_max_deg=90.0)
    if kind == "from nadir":
        return Band(elevation_min_deg=-90.0, elevation_max_deg=round(float(rng.uniform(-60.0, 80.0)), 1))
    if kind == "band":
        return Band(elevation_min_deg=low, elevation_max_deg=high)
    width = {"sector": rng.uniform(20.0, 330.0), "narrow": rng.uniform(20.0, 330.0), "column": rng.uniform(1.0, 15.0)}
    if kind == "narrow":
        middle, half = rng.uniform(-50.0, 40.0), rng.uniform(1.0, 8.0)
        low, high = round(float(middle - half), 1), round(float(middle + half), 1)
    start = round(float(rng.uniform(-180.0, 180.0)), 1)
    return Band(
        elevation_min_deg=low,
        elevation_max_deg=high,
        azimuth_min_deg=start,
        azimuth_max_deg=round(start + float(width[str(kind)]), 1),
    )


def _tolerance(rng: np.random.Generator) -> Tolerance:
    kind = rng.random()
    if kind < 0.25:
        return NO_TOLERANCE
    if kind < 0.7:
        return _PAPER if kind < 0.4 else _DEFAULT
    pitch, roll, yaw = rng.uniform(0.0, 2.0, 3).round(2).tolist()
    return Tolerance(pitch_deg=pitch, roll_deg=roll, yaw_deg=yaw)


def _gimbal(rng: np.random.Generator) -> GimbalLimits:
    limits = GimbalLimits(pitch_max_deg=float(rng.choice([20.0, 30.0, 45.0])))
    if rng.random() < 0.5:
        pan = float(rng.choice([150.0, 165.0, 175.0]))
        return replace(limits, yaw_min_deg=-pan, yaw_max_deg=pan, yaw_endless=False)
    return limits


def _mask(rng: np.random.Generator, band: Band) -> AngleBox:
    low, high = sorted(rng.uniform(band.elevation_min_deg, band.elevation_max_deg, 2).round(1).tolist())
    start = round(float(rng.uniform(-180.0, 180.0)), 1)
    return AngleBox(
        elevation_min_deg=low,
        elevation_max_deg=min(high + 1.0, 90.0),
        azimuth_min_deg=start,
        azimuth_max_deg=round(start + float(rng.uniform(10.0, 120.0)), 1),
    )
