"""Neighbours, adjacent rows and the overlap graph."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import rotation
from panoexec.planning.certificate.adjacency import Rows, SparseGraph, connection, separated_by_mask
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.model import AngleBox, Band
from tests.unit.planning.brute import full_circle

SECTOR = Band(elevation_min_deg=-30.0, elevation_max_deg=30.0, azimuth_min_deg=140.0, azimuth_max_deg=230.0)


def parts(count: int, edges: list[tuple[int, int]]) -> int:
    """Connected parts, by flooding."""
    left, found = set(range(count)), 0
    while left:
        found += 1
        wave = {left.pop()}
        while wave:
            wave = {b for a, b in (*edges, *((b, a) for a, b in edges)) if a in wave and b in left}
            left -= wave
    return found


@settings(max_examples=200, deadline=None)
@given(
    count=st.integers(1, 9),
    edges=st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=16, unique_by=frozenset),
)
def test_bridges_are_the_edges_whose_loss_disconnects(count: int, edges: list[tuple[int, int]]) -> None:
    edges = [(a, b) for a, b in edges if a < count and b < count and a != b]
    ends = np.array([a for a, _ in edges], dtype=np.intp), np.array([b for _, b in edges], dtype=np.intp)
    found = connection(count, *ends)
    # what a graph keeps of its edges says the same
    sparse = SparseGraph(count)
    for some in (slice(0, 3), slice(3, None)):
        sparse.add(ends[0][some], ends[1][some])
    assert sparse.connection() == found
    whole = parts(count, edges)
    bridges = sorted((min(e), max(e)) for e in edges if parts(count, [f for f in edges if f != e]) > whole)
    assert found.parts == whole
    assert list(found.bridges) == bridges
    assert found.connected == (whole == 1)
    assert found.two_edge_connected == (whole == 1 and not bridges)


def test_a_long_chain_needs_no_recursion() -> None:
    n = 20_000
    chain = connection(n, np.arange(n - 1), np.arange(1, n))
    assert len(chain.bridges) == n - 1
    ring = connection(n, np.arange(n), np.roll(np.arange(n), -1))
    assert ring.two_edge_connected


@pytest.mark.parametrize(("count", "connected", "twice"), [(1, True, True), (2, True, False), (3, True, False)])
def test_connectivity_of_small_plans(count: int, connected: bool, twice: bool) -> None:
    """One image has nothing to lose; two hang on one edge; a chain of three hangs on two."""
    chain = connection(count, np.arange(count - 1), np.arange(1, count))
    assert (chain.connected, chain.two_edge_connected) == (connected, twice)


def test_three_mutually_overlapping_images_are_two_edge_connected() -> None:
    assert connection(3, np.array([0, 1, 0]), np.array([1, 2, 2])).two_edge_connected


def pairs(found: tuple[np.ndarray, np.ndarray]) -> set[frozenset[int]]:
    return {frozenset((int(a), int(b))) for a, b in zip(*found, strict=True)}


def test_neighbours_follow_the_yaw_whatever_the_shooting_order() -> None:
    yaws = np.array([90.0, -180.0, 0.0, -90.0])
    rows = Rows.of([0] * 4, rotation(yaws, np.zeros(4)), full_circle(-10.0, 10.0))
    assert pairs(rows.neighbours(closed=True)) == {frozenset(p) for p in ((2, 0), (0, 1), (1, 3), (3, 2))}


def test_a_sector_around_the_back_is_not_closed() -> None:
    yaws = np.array([-150.0, 150.0, 180.0])
    rows = Rows.of([7] * 3, rotation(yaws, np.zeros(3)), SECTOR)
    assert pairs(rows.neighbours(closed=False)) == {frozenset((1, 2)), frozenset((2, 0))}


def test_rows_of_one_two_and_three() -> None:
    yaws = np.array([0.0, 0.0, 180.0, 0.0, 120.0, -120.0])
    rows = Rows.of([0, 1, 1, 5, 5, 5], rotation(yaws, np.zeros(6)), full_circle(-90.0, 0.0))
    assert pairs(rows.neighbours(closed=True)) == {
        frozenset(p) for p in ((1, 2), *itertools.combinations((3, 4, 5), 2))
    }
    assert rows.row_of.tolist() == [0, 1, 1, 2, 2, 2]


def test_partners_are_of_the_next_row_number_that_occurs() -> None:
    rows = Rows.of([0, 3, 3, 9], rotation(np.zeros(4), np.zeros(4)), full_circle(-10.0, 10.0))
    first, second = np.array([(a, b) for a in range(4) for b in range(4) if a != b]).T

    def listed(step: int) -> dict[int, set[int]]:
        images, partners, present = rows.partners(first, second, step)
        return {int(i): set(p[h].tolist()) for i, p, h in zip(images, partners, present, strict=True)}

    assert listed(1) == {0: {1, 2}, 1: {3}, 2: {3}}
    assert listed(-1) == {1: {0}, 2: {0}, 3: {1, 2}}


def test_image_without_overlap_in_the_next_row_is_still_listed() -> None:
    rows = Rows.of([0, 1], rotation(np.zeros(2), np.zeros(2)), full_circle(-10.0, 10.0))
    nobody = np.empty(0, dtype=np.intp)
    images, _, present = rows.partners(nobody, nobody, 1)
    assert images.tolist() == [0]
    assert not present.any()


@pytest.mark.parametrize(
    ("from_deg", "to_deg", "apart"), [(30.0, 50.0, True), (25.0, 50.0, False), (30.0, 62.0, False), (-10.0, 0.0, False)]
)
def test_mask_separates_images_only_if_it_covers_everything_between(
    from_deg: float, to_deg: float, apart: bool
) -> None:
    mask = AngleBox(elevation_min_deg=-20.0, elevation_max_deg=0.0, azimuth_min_deg=28.0, azimuth_max_deg=60.0)
    domain = Domain.of(full_circle(-90.0, 30.0), (mask,))
    assert separated_by_mask(domain, -10.0, from_deg, to_deg) == apart
    assert not separated_by_mask(domain, 10.0, from_deg, to_deg)
