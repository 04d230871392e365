"""Ranges of azimuths: one representation, whatever the notation and the rounding."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.azimuths import azimuth_range, span_of
from panoexec.errors import PlanningError
from panoexec.inputs.plan_options import ConstraintsModel, ToleranceModel
from panoexec.planning.baselines.published import X5S_15MM
from panoexec.planning.certificate.adjacency import Rows
from panoexec.planning.model import AngleBox, Band, Constraints, Tolerance
from panoexec.planning.request import check_request
from panoexec.planning.search.planner import plan_certified

STARTS = range(-3600, 3601)
"""In tenths of a degree."""


def test_every_full_circle_of_one_decimal_is_one() -> None:
    for tenths in STARTS:
        for end in (tenths / 10 + 360.0, (tenths + 3600) / 10, round(tenths / 10 + 360, 1)):
            band = Band(elevation_min_deg=-90, elevation_max_deg=0, azimuth_min_deg=tenths / 10, azimuth_max_deg=end)
            assert band.azimuth_span_deg == 360.0
            assert band.is_full_circle
            assert -180.0 <= band.azimuth_min_deg < 180.0


@pytest.mark.parametrize("width", [1, 200, 1799, 1800, 1801, 3000, 3599])
def test_every_notation_of_a_sector_is_the_same_range(width: int) -> None:
    for tenths in range(-1800, 1800):
        expected = azimuth_range(tenths / 10, (tenths + width) / 10)
        assert expected == (tenths / 10, (tenths + width) / 10)
        wrapped = (tenths + width + 1800) % 3600 - 1800
        for first, last in (
            (tenths, wrapped),
            (tenths, wrapped + 3600 if wrapped < 0 else wrapped),
            (tenths + 3600, tenths + width + 3600),
            (tenths - 3600, tenths - 3600 + width),
            (tenths + 3600, wrapped),
        ):
            if last - first <= 3600 and max(abs(first), abs(last)) <= 7200:
                assert azimuth_range(first / 10, last / 10) == expected
        assert span_of(*expected) == pytest.approx(width / 10, abs=1e-9)


@given(first=st.floats(-720, 720), last=st.floats(-720, 720))
def test_a_range_is_refused_or_canonical_and_canonical_ones_stay(first: float, last: float) -> None:
    try:
        start, end = azimuth_range(first, last)
    except ValueError:
        return
    assert -180.0 <= start < 180.0
    assert 0 < span_of(start, end) <= 360.0
    assert azimuth_range(start, end) == (start, end)
    for given_deg, kept_deg in ((first, start), (last, end)):
        turned = math.remainder(given_deg - kept_deg, 360.0)
        assert abs(turned) < 1e-8


@pytest.mark.parametrize(
    ("first", "last", "why"),
    [
        (-200, 200, "400° wide: at most 360°"),
        (30, 30, "is empty"),
        (30, -330, "is empty"),
        (0, 900, "from -720 to 720"),
        (math.nan, 0, "from -720 to 720"),
    ],
)
def test_what_is_no_range_is_refused_everywhere(first: float, last: float, why: str) -> None:
    band = Band(elevation_min_deg=-90, elevation_max_deg=0, azimuth_min_deg=first, azimuth_max_deg=last)
    with pytest.raises(PlanningError, match=why):
        check_request(X5S_15MM, Constraints(overlap_h=0.1, overlap_v=0.1, band=band))
    mask = AngleBox(elevation_min_deg=-90, elevation_max_deg=0, azimuth_min_deg=first, azimuth_max_deg=last)
    whole = Band(elevation_min_deg=-90, elevation_max_deg=10)
    with pytest.raises(PlanningError, match=rf"mask azimuth .*{why}"):
        check_request(X5S_15MM, Constraints(overlap_h=0.1, overlap_v=0.1, band=whole, masks=(mask,)))
    if math.isfinite(first):
        with pytest.raises(ValueError, match=r"azimuth_deg"):
            ConstraintsModel(
                overlap_h=0.1,
                overlap_v=0.1,
                elevation_deg=(-90.0, 0.0),
                azimuth_deg=(float(first), float(last)),
                tolerance_deg=ToleranceModel(pitch=0.0, roll=0.0, yaw=0.0),
            )


def test_a_circle_that_rounds_below_360_keeps_its_closing_pair() -> None:
    tolerance = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7)
    plans = [
        plan_certified(
            X5S_15MM,
            Constraints(
                overlap_h=0.15,
                overlap_v=0.15,
                band=Band(elevation_min_deg=-40, elevation_max_deg=20, azimuth_min_deg=first, azimuth_max_deg=last),
                tolerance=tolerance,
            ),
        )
        for first, last in ((-180.0, 180.0), (163.2, 523.2), (131.6, 491.6))
    ]
    for plan in plans:
        assert plan.certificate is not None
        assert plan.certificate.certified
        assert len(plan.shots) == len(plans[0].shots)
        rows = Rows.of([shot.row for shot in plan.shots], plan.rotations(), plan.constraints.band)
        first, _ = rows.neighbours(plan.constraints.band.is_full_circle)
        assert len(first) == len(plan.shots)
