"""Exact overlap beside the paper's ray casting at the paper's own resolution, w = ψ_h / 0.017°; same numpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.baselines.paper import pan_step_deg, plan_paper, tilt_step_deg
from panoexec.planning.baselines.published import A6000_35MM, X5S_15MM, X5S_45MM
from panoexec.planning.baselines.raycast import paper_grid, raycast_overlap
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import Band, Constraints
from tests.bench.harness import Measurement, best_time

_PAIRS = 20_000
_PRECISION_DEG = 0.1


def measure() -> Iterator[Measurement]:
    """One pair, many pairs, and the paper's whole planning with either."""
    for camera in (X5S_15MM, X5S_45MM, A6000_35MM):
        yield from _overlap(camera)
    yield _planning(X5S_45MM, 30.0)


def _overlap(camera: Camera) -> Iterator[Measurement]:
    a, b = rotation(0.0, -30.0), rotation(0.4 * camera.hfov_deg, -30.0 - 0.4 * camera.vfov_deg)
    width, height = paper_grid(camera)
    peer = f"ray casting of {width} × {height}"
    rays = best_time(lambda: raycast_overlap(camera, a, b), repeats=3)
    one = best_time(lambda: pairwise_overlap(camera, a, b), repeats=50, at_least_s=0.2)
    yield Measurement(
        what=f"{camera.name}, overlap of one pair",
        ours=one,
        unit="s",
        peer=peer,
        theirs=rays,
        goal="1000 times faster",
        met=rays / one >= 1000,
    )
    rng = np.random.default_rng(1)
    spread = camera.hfov_deg
    left = rotation(*rng.uniform(-spread, spread, (2, _PAIRS)))
    right = rotation(*rng.uniform(-spread, spread, (2, _PAIRS)))
    many = best_time(lambda: pairwise_overlap(camera, left, right), repeats=3) / _PAIRS
    yield Measurement(
        what=f"{camera.name}, overlap of a pair among {_PAIRS}",
        ours=many,
        unit="s",
        peer=peer,
        theirs=rays,
        goal="1000 times faster",
        met=rays / many >= 1000,
    )


def _planning(camera: Camera, top_deg: float) -> Measurement:
    """Algorithms 1 and 2: the steps that the plan needs, by bisection on either overlap to 0.1°."""
    band = Band(elevation_min_deg=-90.0, elevation_max_deg=top_deg)
    constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=band)
    plan = plan_paper(camera, constraints)
    pitches = [pitch for pitch, shots in plan.rows() if len(shots) > 1]

    def exact() -> None:
        tilt_step_deg(camera, 0.15)
        for pitch in pitches:
            pan_step_deg(camera, pitch, 0.15)

    def by_rays() -> None:
        _bisect(lambda t: raycast_overlap(camera, rotation(0.0, 0.0), rotation(0.0, t)), camera.vfov_deg)
        for pitch in pitches:
            fixed = rotation(0.0, pitch)
            _bisect(lambda t: raycast_overlap(camera, fixed, rotation(t, pitch)), 180.0)  # noqa: B023

    return Measurement(
        what=f"{camera.name}, steps of Algorithms 1 and 2 for {len(pitches)} rows (to 1e-9°)",
        ours=best_time(exact),
        unit="s",
        peer=f"ray casting and bisection (to {_PRECISION_DEG}°)",
        theirs=best_time(by_rays, repeats=1),
    )


def _bisect(overlap: Callable[[float], float], up_to_deg: float) -> float:
    low, high = 0.0, up_to_deg
    while high - low > _PRECISION_DEG:
        middle = (low + high) / 2
        low, high = (middle, high) if overlap(middle) >= 0.15 else (low, middle)
    return low
