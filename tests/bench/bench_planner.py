"""The certified planner: images, seconds and memory for the cases that it has to reach, and for a very long lens."""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Iterator

from panoexec.inputs.camera_profiles import load_profile
from panoexec.optics import Camera
from panoexec.planning.model import NO_TOLERANCE, Band, Constraints, Tolerance
from panoexec.planning.search.planner import plan_certified
from tests.bench.harness import Measurement

_LENSES = ((67, 30.9, 20.64), (133, 15.45, 10.32), (200, 10.3, 6.88), (400, 5.15, 3.44), (600, 3.433, 2.293))
"""Equivalent focal length, mm, and field of view, degrees."""
_GOALS_S = {400: 3.0, 600: 8.0}

_PAPER = Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.667)


def measure() -> Iterator[Measurement]:
    """Images against the goals, planning and certifying Scenario 2, spheres with lenses up to 600 mm equivalent."""
    cases = (
        ("scenario 1", load_profile("dji-x5s-15mm").camera.with_lens("nominal"), 0.15, 50.5, _PAPER, 21),
        ("scenario 2", load_profile("dji-x5s-45mm").camera.with_lens("nominal"), 0.15, 37.7, _PAPER, 138),
        ("scenario 3", load_profile("sony-a6000-35mm").camera.with_lens("nominal"), 0.15, 12.2, _PAPER, 40),
        ("whole sphere, 54.0 x 39.8 deg", Camera.from_fov(54.0, 39.8), 0.30, 90.0, NO_TOLERANCE, 44),
    )
    for name, camera, overlap, top_deg, tolerance, goal in cases:
        constraints = _constraints(overlap, top_deg, tolerance)
        images, seconds = _planned(camera, constraints)
        yield Measurement(
            what=f"{name}: certified plan", ours=images, unit="images", goal=f"at most {goal}", met=images <= goal
        )
        if name == "scenario 2":
            yield Measurement(
                what=f"{name}: planning and certifying", ours=seconds, unit="s", goal="at most 1 s", met=seconds <= 1.0
            )
    yield from _long_lenses()


def _long_lenses() -> Iterator[Measurement]:
    """Whole spheres with ever longer lenses: what an image more costs must hardly grow."""
    first: tuple[int, float] | None = None
    for equivalent_mm, hfov_deg, vfov_deg in _LENSES:
        images, seconds = _planned(Camera.from_fov(hfov_deg, vfov_deg), _constraints(0.15, 90.0, NO_TOLERANCE))
        what = f"sphere at {equivalent_mm:g} mm equivalent, {images} images"
        goal_s = _GOALS_S.get(equivalent_mm)
        yield Measurement(
            what=f"{what}: planning and certifying",
            ours=seconds,
            unit="s",
            goal=f"at most {goal_s:g} s" if goal_s else "",
            met=seconds <= goal_s if goal_s else None,
        )
        if first is None:
            first = images, seconds
            continue
        growth = seconds / first[1] / (images * math.log(images) / (first[0] * math.log(first[0])))
        yield Measurement(
            what=f"{what}: growth from {first[0]} images, as a multiple of n·log n",
            ours=growth,
            unit="",
            goal="at most 1.5",
            met=growth <= 1.5,
        )
    # of this process since it began, Python and numpy included
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    yield Measurement(what="memory for these", ours=megabytes, unit="MB", goal="at most 150 MB", met=megabytes <= 150)


def _constraints(overlap: float, top_deg: float, tolerance: Tolerance) -> Constraints:
    band = Band(elevation_min_deg=-90.0, elevation_max_deg=top_deg)
    return Constraints(overlap_h=overlap, overlap_v=overlap, band=band, tolerance=tolerance)


def _planned(camera: Camera, constraints: Constraints) -> tuple[int, float]:
    """Images, and seconds of one core."""
    began = time.process_time()
    plan = plan_certified(camera, constraints)
    seconds = time.process_time() - began
    if plan.certificate is None or not plan.certificate.certified:
        raise AssertionError(f"{camera.name}: not certified")
    return len(plan.shots), seconds
