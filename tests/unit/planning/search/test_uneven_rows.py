"""Rows that lack a little are made to hold image by image; what results is judged by the certificate."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.verdict import certify_poses
from panoexec.planning.model import AngleBox, Band, Constraints, GimbalLimits, Shot
from panoexec.planning.search import pose_fit
from panoexec.planning.search.budget import BudgetSpentError, SearchBudget
from panoexec.planning.search.pose_fit import Poses, fit_poses
from panoexec.planning.search.uneven_rows import uneven_rows
from panoexec.planning.skyline import Skyline

CAMERA = Camera.from_fov(56.2, 42.7)
SPHERE = Constraints(overlap_h=0.3, overlap_v=0.3, band=Band(elevation_min_deg=-90.0, elevation_max_deg=90.0))
BAND = replace(SPHERE, band=Band(elevation_min_deg=-25.0, elevation_max_deg=25.0))


def even(rows: list[tuple[float, int, float]]) -> Poses:
    """Rows of (pitch, count, phase)."""
    return Poses(
        np.concatenate([phase + np.arange(count) * 360.0 / count for _, count, phase in rows]),
        np.concatenate([np.full(count, pitch) for pitch, count, _ in rows]),
        np.concatenate([np.full(count, k) for k, (_, count, _) in enumerate(rows)]),
    )


def proposals(constraints: Constraints, images: int, *, enough: int = 1) -> list[tuple[Shot, ...]]:
    return list(uneven_rows(CAMERA, constraints, lambda: images, enough=enough, budget=SearchBudget()))


def certified(constraints: Constraints, poses: Poses) -> bool:
    turns = rotation(poses.yaw_deg, poses.pitch_deg)
    return certify_poses(CAMERA, constraints, turns, poses.rows.tolist(), explain=False).certified


def test_a_sphere_gets_an_image_less_than_even_rows_have() -> None:
    found = proposals(SPHERE, 39)
    assert found
    assert min(len(shots) for shots in found) == 38
    shots = found[0]
    turns = rotation([shot.yaw_deg for shot in shots], [shot.pitch_deg for shot in shots])
    assert certify_poses(CAMERA, SPHERE, turns, [shot.row for shot in shots]).certified
    per_row = [{shot.pitch_deg for shot in shots if shot.row == row} for row in range(shots[-1].row + 1)]
    assert any(len(pitches) > 1 for pitches in per_row)
    assert all(max(pitches) - min(pitches) < 6.0 for pitches in per_row)
    assert all(max(low) < min(high) for low, high in itertools.pairwise(per_row))


@pytest.mark.parametrize(
    "change",
    [
        {"guarantee": "all"},
        {"overlap_h": 0.04},
        {"textured_below": Skyline.level(10.0)},
        {"masks": (AngleBox(elevation_min_deg=0, elevation_max_deg=10, azimuth_min_deg=0, azimuth_max_deg=20),)},
        {"band": replace(SPHERE.band, azimuth_max_deg=100.0)},
        {"gimbal": GimbalLimits(yaw_min_deg=-170.0, yaw_max_deg=170.0, yaw_endless=False)},
    ],
    ids=["all errors", "little overlap", "sky", "mask", "sector", "pan range"],
)
def test_there_are_none_beyond_what_it_is_for(change: dict[str, object]) -> None:
    assert proposals(replace(SPHERE, **change), 39) == []  # type: ignore[arg-type]


def test_nothing_below_what_is_enough_is_looked_for() -> None:
    assert proposals(SPHERE, 39, enough=39) == []


def test_rows_that_are_a_little_too_far_apart_are_moved_until_they_hold() -> None:
    start = even([(-13.5, 10, 0.0), (17.5, 10, 9.0)])
    assert not certified(BAND, start)
    found = fit_poses(CAMERA, BAND, start, pitch_deg=(-90.0, 90.0), steps=20, budget=SearchBudget())
    assert found is not None
    assert certified(BAND, found)


def test_the_gimbals_limits_are_kept_and_what_cannot_hold_is_given_up() -> None:
    start = even([(-13.5, 10, 0.0), (17.5, 10, 9.0)])
    within = fit_poses(CAMERA, BAND, start, pitch_deg=(-90.0, 17.0), steps=20, budget=SearchBudget())
    assert within is not None
    assert within.pitch_deg.max() <= 17.0
    too_few = even([(-13.5, 7, 0.0), (17.5, 7, 9.0)])
    assert fit_poses(CAMERA, BAND, too_few, pitch_deg=(-90.0, 90.0), steps=20, budget=SearchBudget()) is None


def test_the_budget_ends_it() -> None:
    with pytest.raises(BudgetSpentError):
        fit_poses(
            CAMERA,
            BAND,
            even([(-20.0, 10, 0.0), (25.0, 10, 9.0)]),
            pitch_deg=(-90, 90),
            steps=20,
            budget=SearchBudget(0.0),
        )


@pytest.mark.parametrize("top_deg", [90.0, 30.0])
def test_derivatives_tell_what_a_small_step_changes(top_deg: float) -> None:
    constraints = replace(SPHERE, band=replace(SPHERE.band, elevation_max_deg=top_deg))
    start = even([(-73.0, 3, 10.0), (-44.5, 7, 0.0), (-15.0, 9, 5.0), (15.3, 9, 3.0), (45.3, 7, 20.0)])
    fit = pose_fit._Fit(CAMERA, constraints, start.rows)
    rng = np.random.default_rng(2)
    x = np.concatenate([start.yaw_deg, start.pitch_deg]) + rng.normal(0.0, 0.5, 2 * len(start.rows))
    step = rng.normal(0.0, 0.01, len(x))
    here, there = fit.conditions(x), fit.conditions(x + step)
    assert len(here.surplus) == len(there.surplus)
    error = there.surplus - here.surplus - here.by_pose @ step
    assert np.abs(there.surplus - here.surplus).max() > 1e-4
    assert np.quantile(np.abs(error), 0.98) < 2e-6
