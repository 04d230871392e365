"""Bands, sectors and masks: membership, arcs that leave the domain, borders."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.errors import PlanningError
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.model import AngleBox, Band
from tests.unit.planning.brute import full_circle, in_domain, random_directions

Limits = tuple[float, float, float, float]
B = TypeVar("B", Band, AngleBox)

_LIMITS = st.sampled_from([-90.0, -60.0, -30.0, 0.0, 17.3, 45.0, 90.0])


@st.composite
def boxes(draw: st.DrawFn) -> Limits:
    low, high = sorted(draw(st.lists(_LIMITS, min_size=2, max_size=2, unique=True)))
    start = draw(st.one_of(st.sampled_from([-180.0, -90.0, 0.0, 170.0]), st.floats(-180.0, 180.0)))
    width = draw(st.one_of(st.sampled_from([90.0, 180.0, 270.0, 360.0]), st.floats(1.0, 360.0)))
    return low, high, start, start + width


def box(limits: Limits, kind: type[B]) -> B:
    low, high, start, stop = limits
    return kind(elevation_min_deg=low, elevation_max_deg=high, azimuth_min_deg=start, azimuth_max_deg=stop)


@settings(max_examples=60, deadline=None)
@given(limits=boxes(), masks=st.lists(boxes(), max_size=3))
def test_membership_and_solid_angle_are_those_of_the_definition(limits: Limits, masks: list[Limits]) -> None:
    band, hidden = box(limits, Band), tuple(box(m, AngleBox) for m in masks)
    domain = Domain.of(band, hidden)
    v = random_directions(4000, np.random.default_rng(1))
    wanted = in_domain(v, band, hidden)
    assert np.array_equal(domain.contains(v), wanted)
    share = domain.solid_angle_sr / (4 * np.pi)
    assert wanted.mean() == pytest.approx(share, abs=5 * np.sqrt(share * (1 - share) / 4000) + 1e-3)
    centres = domain.cell_centres()
    assert domain.contains(centres).all()
    assert len(centres) == domain.inside.sum()


@settings(max_examples=60, deadline=None)
@given(limits=boxes(), masks=st.lists(boxes(), max_size=3), seed=st.integers(0, 1000))
def test_arcs_leave_the_domain_exactly_where_their_points_do(limits: Limits, masks: list[Limits], seed: int) -> None:
    band, hidden = box(limits, Band), tuple(box(m, AngleBox) for m in masks)
    domain = Domain.of(band, hidden)
    rng = np.random.default_rng(seed)
    starts, ends = random_directions(30, rng), random_directions(30, rng)
    low, high = domain.outside_intervals(starts, ends)
    s = rng.uniform(0.0, 1.0, (30, 50))
    points = (1 - s[..., None]) * starts[:, None] + s[..., None] * ends[:, None]
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    outside = np.any((low[:, None] < s[..., None]) & (s[..., None] < high[:, None]), axis=2)
    assert np.array_equal(outside.reshape(-1), ~in_domain(points.reshape(-1, 3), band, hidden))


def test_masks_that_touch_leave_no_slit() -> None:
    quarters = [
        AngleBox(elevation_min_deg=0.0, elevation_max_deg=90.0, azimuth_min_deg=a, azimuth_max_deg=a + 90.0)
        for a in (0.0, 90.0, 180.0, 270.0)
    ]
    domain = Domain.of(full_circle(-90.0, 90.0), tuple(quarters))
    assert domain.solid_angle_sr == pytest.approx(2 * np.pi)
    # a meridian arc from 10° up over the zenith and down: nothing of it is to be covered
    start, end = np.array([[0.5, 0.0, -0.5]]), np.array([[-0.5, 0.0, -0.5]])
    low, high = domain.outside_intervals(start / np.sqrt(0.5), end / np.sqrt(0.5))
    assert np.any((low <= 0) & (high >= 1))


def test_a_box_over_a_pole_and_one_beside_it() -> None:
    cap = AngleBox(elevation_min_deg=-90.0, elevation_max_deg=-70.0, azimuth_min_deg=-180.0, azimuth_max_deg=180.0)
    domain = Domain.of(full_circle(-90.0, 0.0), (cap,))
    assert domain.solid_angle_sr == pytest.approx(2 * np.pi * np.sin(np.radians(70.0)))
    assert not domain.contains(np.array([[0.0, 0.0, 1.0]]))[0]


@pytest.mark.parametrize(
    ("band", "words"),
    [
        (Band(elevation_min_deg=10.0, elevation_max_deg=10.0), ("elevation 10 to 10", "no height")),
        (
            Band(elevation_min_deg=0.0, elevation_max_deg=10.0, azimuth_min_deg=5.0, azimuth_max_deg=5.0),
            ("azimuth 5 to 5", "no width"),
        ),
    ],
)
def test_empty_bands_are_rejected(band: Band, words: tuple[str, ...]) -> None:
    with pytest.raises(PlanningError) as caught:
        Domain.of(band)
    assert all(word in str(caught.value) for word in words)


def test_borders_of_a_sector_close() -> None:
    domain = Domain.of(
        Band(elevation_min_deg=-20.0, elevation_max_deg=30.0, azimuth_min_deg=170.0, azimuth_max_deg=190.0)
    )
    borders = sorted((b.is_parallel, b.at_deg % 360.0, b.from_deg, b.to_deg, b.inner) for b in domain.borders())
    assert borders == [
        (False, 170.0, -20.0, 30.0, 1),
        (False, 190.0, -20.0, 30.0, -1),
        (True, 30.0, 170.0, 190.0, -1),
        (True, 340.0, 170.0, 190.0, 1),
    ]
