"""The adjustment of all ties finds the odd attitude, and the graph its bridges."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.pictures.attitudes import TieEquation, bridges, connected_groups, corrections


def ring_of(errors: np.ndarray, noise_deg: float, seed: int) -> list[TieEquation]:
    """Ties of neighbours and of neighbours but one in a closed ring."""
    rng = np.random.default_rng(seed)
    count = len(errors)
    return [
        TieEquation(
            first=k, second=(k + step) % count,
            turn_deg=errors[(k + step) % count] - errors[k] + rng.normal(0, noise_deg, 3), sigma_deg=0.02,
        )
        for k in range(count)
        for step in (1, 2)
    ]  # fmt: skip


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), liar=st.integers(0, 11))
def test_a_lie_of_one_degree_about_any_axis_is_found_and_only_it(seed: int, liar: int) -> None:
    rng = np.random.default_rng(seed)
    times = 2.0 * np.arange(12)
    errors = rng.normal(0, 0.03, (12, 3))
    errors[:, 2] += 0.667 * np.sin(rng.uniform(0, 6.28) + 2 * np.pi * times / 90)
    axis = rng.normal(size=3)
    errors[liar] += axis / np.linalg.norm(axis)
    found = corrections(times.tolist(), ring_of(errors, 0.02, seed))
    assert int(np.argmax(found.odd_deg)) == liar
    assert found.odd_deg[liar] > 0.4
    assert np.sort(found.odd_deg)[-2] < 0.4


def test_a_drifting_heading_is_no_lie() -> None:
    times = 2.0 * np.arange(30)
    errors = np.zeros((30, 3))
    errors[:, 2] = 0.667 * np.sin(2 * np.pi * times / 90)
    found = corrections(times.tolist(), ring_of(errors, 0.01, 1))
    assert found.odd_deg.max() < 0.2


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    pitch=st.floats(-1, 1),
    roll=st.floats(-1, 1),
    liar=st.one_of(st.none(), st.integers(0, 11)),
)
def test_what_all_photos_share_about_the_gimbals_axes_is_its_bias(
    seed: int, pitch: float, roll: float, liar: int | None
) -> None:
    rng = np.random.default_rng(seed)
    yaw = np.radians(30.0 * np.arange(12))
    right = np.stack([-np.sin(yaw), np.cos(yaw), 0 * yaw], axis=1)
    ahead = np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1)
    axes = np.stack([right, ahead], axis=1)
    errors = pitch * right + roll * ahead + rng.normal(0, 0.02, (12, 3))
    if liar is not None:
        errors[liar] += [0.8, -0.6, 0.0]
    found = corrections((2.0 * np.arange(12)).tolist(), ring_of(errors, 0.02, seed), gimbal_axes=axes)
    assert np.allclose(found.bias_deg, (pitch, roll), atol=0.12 if liar is None else 0.3)
    odd = {int(k) for k in np.flatnonzero(found.odd_deg > 0.4)}
    assert odd == (set() if liar is None else {liar})


def test_too_few_photos_tell_no_bias() -> None:
    errors = np.tile([0.5, 0.0, 0.0], (3, 1))
    axes = np.tile(np.eye(3)[:2], (3, 1, 1))
    assert corrections([0.0, 2.0, 4.0], ring_of(errors, 0.01, 1), gimbal_axes=axes).bias_deg == (0.0, 0.0)


def test_without_photos_or_ties_nothing_is_corrected() -> None:
    assert corrections([], []).error_deg.shape == (0, 3)
    alone = corrections([0.0, float("nan"), 2.0], [])
    assert np.all(alone.error_deg == 0)
    assert np.all(alone.odd_deg == 0)


@given(edges=st.sets(st.tuples(st.integers(0, 7), st.integers(0, 7)).filter(lambda e: e[0] < e[1])))
def test_bridges_are_the_edges_whose_loss_makes_more_groups(edges: set[tuple[int, int]]) -> None:
    listed = sorted(edges)
    groups = len(connected_groups(8, listed))
    assert bridges(8, listed) == [
        edge for edge in listed if len(connected_groups(8, [other for other in listed if other != edge])) > groups
    ]
