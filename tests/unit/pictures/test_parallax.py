"""Photos taken from different places tie as such; a wrong attitude is no parallax, and parallax no wrong attitude."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import FloatArray, rotation
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.model import BAD, Content, PhotoToCheck, Verdicts
from panoexec.pictures.parallax import ground_consensus, ground_matrix
from panoexec.pictures.rotations import rotation_of_vector
from panoexec.planning.model import Plan
from tests.support.photo_sets import PhotoSet, photo_set
from tests.unit.pictures.conftest import SCENE
from tests.unit.pictures.test_examiner import true_turn

FOCAL_PX = 800.0
Shift = tuple[float, float, float]


def examine(photos: PhotoSet, places: dict[int, Shift] | None = None) -> tuple[Examiner, Verdicts]:
    examiner = Examiner(photos.camera)
    for number, photo in enumerate(photos.photos):
        place = None if places is None else np.array(places.get(number, (0.0, 0.0, 0.0)))
        told = PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s, place=place)
        examiner.add(told, photo.content)
    return examiner, examiner.verdicts(final=True)


@given(
    pitch=st.floats(-90, -10),
    turn=st.tuples(*[st.floats(-0.006, 0.006)] * 3),
    shift=st.tuples(*[st.floats(-0.02, 0.02)] * 3),
    seed=st.integers(0, 1000),
)
def test_rotation_and_shift_are_found_from_exactly_displaced_ground(
    pitch: float, turn: tuple[float, float, float], shift: Shift, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    looked = rotation(rng.uniform(-180, 180), pitch)
    places = rng.uniform(-1, 1, (40, 2)) * [400, 300]
    rays = np.concatenate([np.ones((40, 1)), places / FOCAL_PX], axis=1)
    down = np.maximum(rays @ looked[2], 0.0)
    moved_rays = (rays - down[:, None] * (looked.T @ np.array(shift))) @ rotation_of_vector(np.array(turn)).T
    moved = FOCAL_PX * moved_rays[:, 1:] / moved_rays[:, :1] - places
    wild = rng.permutation(40)[:12]
    moved[wild] += rng.uniform(20, 60, (12, 2))
    fit = ground_consensus(ground_matrix(places, FOCAL_PX, looked), moved, tolerance_px=2.5)
    assert fit is not None
    assert set(np.flatnonzero(fit.inliers)).isdisjoint(wild)
    assert fit.inliers.sum() >= 24
    assert fit.rms_px < 1.2, "linear in turns of a third of a degree and shifts of two hundredths"


def test_too_few_points_are_no_evidence() -> None:
    assert ground_consensus(np.zeros((5, 2, 6)), np.zeros((5, 2)), tolerance_px=1.0) is None


@pytest.mark.parametrize(("shot", "shift"), [(10, (-0.01, 0.015, 0.01)), (3, (0.0, 0.03, 0.0))])
def test_a_photo_from_elsewhere_is_told_and_counts(two_rows: Plan, shot: int, shift: Shift) -> None:
    photos = photo_set(two_rows, seed=1, shifts={shot: shift}, **SCENE)
    examiner, verdicts = examine(photos)
    assert not verdicts.bad, [found.reason for found in verdicts.bad]
    apart = {pair for pair, tie in examiner.ties.items() if tie.parallax_deg > 0}
    assert apart
    assert all(shot in pair for pair in apart), "only the ties of the photo that was moved"
    for a, b in apart:
        tie, one, other = examiner.ties[a, b], photos.photos[a], photos.photos[b]
        turn = true_turn(one.measured, other.measured, one.truth, other.truth)
        assert np.linalg.norm(turn - tie.turn_world_deg) < 0.1 + 4 * tie.sigma_deg
        # displacement by height, less where the ground is farther
        assert tie.parallax_deg < np.degrees(np.linalg.norm(shift)) * 1.7
    assert "parallax: taken from elsewhere than shot" in verdicts.photos[shot].reason


def test_recorded_positions_say_where_to_search(two_rows: Plan) -> None:
    shifts: dict[int, Shift] = {10: (0.07, -0.02, 0.0)}
    photos = photo_set(two_rows, seed=1, shifts=shifts, **SCENE)
    _, blind = examine(photos)
    assert blind.photos[10].verdict in BAD, "4° apart nothing is searched without them"
    near: dict[int, Shift] = {10: (0.062, -0.026, 0.004)}
    _, told = examine(photos, near)
    assert told.photos[10].verdict is Content.OK
    assert "parallax" in told.photos[10].reason


def test_a_lie_about_the_attitude_is_no_parallax(two_rows: Plan) -> None:
    shot = 10
    photos = photo_set(two_rows, seed=2, faults={shot: "attitude-lie=1"}, **SCENE)
    places: dict[int, Shift] = {k: (0.01 * (-1) ** k, 0.0, 0.0) for k in range(14)}
    examiner, verdicts = examine(photos, places)
    assert [found.shot for found in verdicts.bad] == [shot]
    assert verdicts.photos[shot].verdict is Content.CONTRADICTS
    assert all(tie.parallax_deg == 0 for tie in examiner.ties.values())


def test_a_hover_that_wanders_leaves_no_contradiction(two_rows: Plan) -> None:
    """Half a metre rms at 30 m in every photo: no rotation fits any pair, and yet nothing is false."""
    rng = np.random.default_rng(5)
    wander: FloatArray = rng.normal(0, 0.5 / 30, (14, 3)) * [1, 1, 0.5]
    shifts: dict[int, Shift] = {number: (row[0], row[1], row[2]) for number, row in enumerate(wander)}
    _, verdicts = examine(photo_set(two_rows, seed=1, shifts=shifts, **SCENE), shifts)
    assert not verdicts.bad, [found.reason for found in verdicts.bad]
    assert verdicts.graph.connected
