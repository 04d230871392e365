"""The certificate beside a straightforward implementation by dense sampling; large plans: time, memory, growth."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Iterator, Sequence

import numpy as np

from panoexec.angles import FloatArray, direction, rotation
from panoexec.optics import Camera
from panoexec.planning.baselines.published import published_plan
from panoexec.planning.certificate.coverage import is_covered
from panoexec.planning.certificate.robust_footprint import robust_cores
from panoexec.planning.certificate.verdict import certify, certify_poses
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.model import NO_TOLERANCE, Band, Constraints, Plan, Tolerance
from tests.bench.harness import Measurement, best_time

_SAMPLE_STEP_DEG = 1.0
"""Spacing of the sampled directions. Any hole narrower than this can slip through the sampling; none through ours."""

_SPHERE_TOLERANCE = Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.1)


def measure() -> Iterator[Measurement]:
    """Scenario 2 as published (155 images), then spheres at 200 and 400 mm equivalent."""
    plan = published_plan("scenario-2-proposed")
    ours = best_time(lambda: certify(plan), repeats=7, at_least_s=2.0)
    yield Measurement(
        what=f"certificate of {len(plan.shots)} images", ours=ours, unit="s", goal="at most 0.2 s", met=ours <= 0.2
    )
    constraints = plan.constraints
    proof = best_time(
        lambda: is_covered(
            robust_cores(plan.camera, plan.rotations(), constraints.tolerance), Domain.of(constraints.band)
        ),
        repeats=7,
        at_least_s=1.0,
    )
    yield Measurement(
        what=f"proof of coverage of {len(plan.shots)} images",
        ours=proof,
        unit="s",
        peer=f"sampling every {_SAMPLE_STEP_DEG}° under the 8 extreme errors",
        theirs=best_time(lambda: sampled_coverage(plan, _SAMPLE_STEP_DEG), repeats=3),
    )
    times = {}
    for equivalent_mm in (200.0, 400.0):
        camera, rotations, rows = sphere(equivalent_mm)
        wanted = Constraints(
            overlap_h=0.15,
            overlap_v=0.15,
            band=Band(elevation_min_deg=-90.0, elevation_max_deg=90.0),
            tolerance=_SPHERE_TOLERANCE,
        )
        work = _Work(camera, wanted, rotations, rows)
        times[len(rows)] = best_time(work, repeats=2)
        yield Measurement(
            what=f"certificate of a sphere of {len(rows)} images ({equivalent_mm:g} mm equivalent)",
            ours=times[len(rows)],
            unit="s",
            goal="at most 20 s",
            met=times[len(rows)] <= 20.0,
        )
    memory = _peak_mb(work)
    yield Measurement(
        what=f"memory of the certificate of {len(rows)} images",
        ours=memory,
        unit="MB",
        goal="at most 500 MB",
        met=memory <= 500.0,
    )
    (few, fast), (many, slow) = times.items()
    growth = (slow / fast) / (many * math.log(many) / (few * math.log(few)))
    yield Measurement(
        what="growth, as a multiple of n·log n", ours=growth, unit="", goal="at most 1.5", met=growth <= 1.5
    )


class _Work:
    """One certificate, to be called again and again."""

    def __init__(self, camera: Camera, constraints: Constraints, rotations: FloatArray, rows: Sequence[int]) -> None:
        self._arguments = camera, constraints, rotations, rows

    def __call__(self) -> None:
        if not certify_poses(*self._arguments).certified:
            raise AssertionError("the sphere is meant to be certified")


def _peak_mb(work: _Work) -> float:
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


def sphere(equivalent_mm: float) -> tuple[Camera, FloatArray, list[int]]:
    """A full-frame camera, and attitudes and rows of a generous grid over the whole sphere."""
    camera = Camera(
        name=f"{equivalent_mm:g} mm",
        sensor_width_mm=36.0,
        sensor_height_mm=24.0,
        image_width_px=6000,
        image_height_px=4000,
        focal_length_mm=equivalent_mm,
    )
    steps = math.ceil(180 / (0.8 * camera.vfov_deg))
    turns, rows = [], []
    for row in range(steps + 1):
        pitch = -90 + 180 * row / steps
        count = max(3, math.ceil(360 * math.cos(math.radians(pitch)) / (0.8 * camera.hfov_deg)) + 2)
        turns.append(rotation(np.arange(count) * 360 / count, np.full(count, pitch)))
        rows += [row] * count
    return camera, np.concatenate(turns), rows


def sampled_coverage(plan: Plan, step_deg: float) -> bool:
    """Whether every direction of a grid is in an image that holds it under each extreme error: no proof, a peer."""
    band, tolerance = plan.constraints.band, plan.constraints.tolerance
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1)
    if tolerance == NO_TOLERANCE:
        signs = np.zeros((3, 1))
    elevations = np.arange(band.elevation_min_deg, band.elevation_max_deg + step_deg / 2, step_deg)
    grid = np.concatenate(
        [
            direction(e, np.arange(0.0, 360.0, step_deg / max(math.cos(math.radians(e)), step_deg / 360)))
            for e in elevations.tolist()
        ]
    )
    covered = np.zeros(len(grid), dtype=bool)
    for shot in plan.shots:
        inside = np.ones(len(grid), dtype=bool)
        for e_yaw, e_pitch, e_roll in signs.T:
            turn = rotation(
                shot.yaw_deg + e_yaw * tolerance.yaw_deg,
                shot.pitch_deg + e_pitch * tolerance.pitch_deg,
                e_roll * tolerance.roll_deg,
            )
            in_camera = grid @ turn
            depth = in_camera[:, 0]
            inside &= (depth > 0) & (np.abs(in_camera[:, 1]) <= depth * plan.camera.half_width)
            inside &= np.abs(in_camera[:, 2]) <= depth * plan.camera.half_height
        covered |= inside
    return bool(covered.all())
