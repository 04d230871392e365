"""Where the images of a row stand, judged by the yaws themselves and by azimuths sampled over the band."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import FloatArray, wrap_180
from panoexec.planning.model import Band, Constraints, GimbalLimits, Turning
from panoexec.planning.search.row_layout import IntArray, RowLayout, reachable_pitch

STEP_DEG = 0.25
"""Between azimuths sampled."""

EPS_DEG = 1e-6
few_examples = settings(max_examples=80, derandomize=True)

counts = st.integers(1, 25)
pans = st.tuples(st.floats(-180, -1), st.floats(1, 179))
pans_anywhere = st.tuples(st.floats(-360, 360), st.one_of(st.just(0.0), st.floats(0, 360))).map(
    lambda ends: (ends[0], ends[0] + ends[1])
)


def panning(low_deg: float, high_deg: float, turning: Turning | None = None) -> GimbalLimits:
    return GimbalLimits(yaw_min_deg=low_deg, yaw_max_deg=high_deg, yaw_endless=False, turning=turning)


def layout_of(
    azimuth_deg: tuple[float, float] = (-180.0, 180.0), gimbal: GimbalLimits | None = None, widest_deg: float = 400.0
) -> RowLayout:
    band = Band(
        elevation_min_deg=-60.0, elevation_max_deg=20.0, azimuth_min_deg=azimuth_deg[0], azimuth_max_deg=azimuth_deg[1]
    )
    constraints = Constraints(overlap_h=0.2, overlap_v=0.2, band=band, gimbal=gimbal)
    return RowLayout(constraints, lambda pitch_deg: np.full(len(pitch_deg), widest_deg))


def spacing_and_reach(layout: RowLayout, count: int) -> tuple[float, float]:
    spacing, reach = layout.spacing_and_reach(np.array([-20.0]), np.array([count]))
    return float(spacing[0]), float(reach[0])


def farthest_deg(yaws_deg: FloatArray, azimuth_deg: tuple[float, float]) -> float:
    """The largest distance of an azimuth of the band from its nearest image."""
    azimuths = np.linspace(*azimuth_deg, round((azimuth_deg[1] - azimuth_deg[0]) / STEP_DEG) + 1)
    return float(np.abs(wrap_180(azimuths[:, None] - yaws_deg)).min(axis=1).max())


def steps_deg(yaws_deg: FloatArray) -> FloatArray:
    """Yaw from each image to the next clockwise, in the row's own order."""
    return np.asarray(np.diff(yaws_deg) % 360.0)


def within_pan(yaws_deg: FloatArray, gimbal: GimbalLimits) -> bool:
    turn = (yaws_deg - gimbal.yaw_min_deg + EPS_DEG) % 360.0
    return bool(np.all(turn <= gimbal.yaw_max_deg - gimbal.yaw_min_deg + 2 * EPS_DEG))


@few_examples
@given(counts, st.floats(-400, 400))
def test_rows_that_close_are_evenly_spaced_and_turned_by_their_phase(count: int, phase_deg: float) -> None:
    layout = layout_of()
    assert layout.is_even
    yaws = layout.yaws_deg(-20.0, count, phase_deg)
    assert np.all((yaws >= -180) & (yaws < 180))
    assert yaws[0] == pytest.approx(float(wrap_180(phase_deg)), abs=EPS_DEG)
    assert steps_deg(yaws) == pytest.approx(np.full(count - 1, 360.0 / count))
    spacing, reach = spacing_and_reach(layout, count)
    assert spacing == pytest.approx(360.0 / count)
    assert reach == pytest.approx(farthest_deg(yaws, (phase_deg, phase_deg + 360.0)), abs=STEP_DEG)
    assert reach >= farthest_deg(yaws, (-180.0, 180.0)) - EPS_DEG


@few_examples
@given(counts, pans)
def test_rows_that_close_bridge_what_the_gimbal_cannot_pan_to(count: int, pan: tuple[float, float]) -> None:
    gimbal = panning(*pan)
    layout = layout_of(gimbal=gimbal)
    assert layout.closed
    assert not layout.is_even
    assert layout.blind_deg == pytest.approx(360.0 - (pan[1] - pan[0]))
    yaws = layout.yaws_deg(-20.0, count, 0.0)
    assert len(yaws) == count
    assert within_pan(yaws, gimbal)
    spacing, reach = spacing_and_reach(layout, count)
    assert reach >= farthest_deg(yaws, (-180.0, 180.0)) - EPS_DEG
    if count == 1:
        return
    around = np.append(steps_deg(yaws), (yaws[0] - yaws[-1]) % 360.0 or 360.0)
    assert spacing == pytest.approx(around.max())
    assert reach == pytest.approx(farthest_deg(yaws, (-180.0, 180.0)), abs=STEP_DEG)
    beside = float(layout.closing_spacing_deg(np.array([count]))[0])
    # the widest step that is not the one across the blind arc
    assert beside == pytest.approx(around[:-1].max() if around.argmax() == count - 1 else around.max(), abs=EPS_DEG)


def test_a_single_image_stands_in_the_middle_of_the_pan_range() -> None:
    layout = layout_of(gimbal=panning(-100.0, 40.0))
    assert layout.yaws_deg(0.0, 1, 77.0) == pytest.approx([-30.0])
    assert spacing_and_reach(layout, 1)[1] == 180.0


@few_examples
@given(counts, st.floats(-180, 180), st.floats(1, 359), st.floats(0.5, 120))
def test_the_rows_of_a_sector_stand_in_it_no_further_apart_than_allowed(
    count: int, start_deg: float, span_deg: float, widest_deg: float
) -> None:
    azimuth = start_deg, start_deg + span_deg
    layout = layout_of(azimuth, widest_deg=widest_deg)
    assert not layout.closed
    yaws = layout.yaws_deg(-20.0, count, 0.0)
    assert len(yaws) == count
    assert np.all((yaws - start_deg) % 360.0 <= span_deg + EPS_DEG)
    spacing, reach = spacing_and_reach(layout, count)
    assert spacing <= widest_deg + EPS_DEG
    assert steps_deg(yaws) == pytest.approx(np.full(count - 1, spacing), abs=EPS_DEG)
    assert reach == pytest.approx(farthest_deg(yaws, azimuth), abs=STEP_DEG)
    # no more at one end than at the other
    left, right = (yaws[0] - start_deg) % 360.0, (start_deg + span_deg - yaws[-1]) % 360.0
    assert left == pytest.approx(right, abs=EPS_DEG)


@few_examples
@given(counts, pans_anywhere, st.floats(-180, 180), st.floats(1, 359))
def test_the_rows_of_a_sector_stay_in_the_pan_range_and_their_reach_is_enough(
    count: int, pan: tuple[float, float], start_deg: float, span_deg: float
) -> None:
    gimbal, azimuth = panning(*pan), (start_deg, start_deg + span_deg)
    layout = layout_of(azimuth, gimbal)
    yaws = layout.yaws_deg(-20.0, count, 0.0)
    # what is on both sides of the blind arc may grow by two images at once
    assert count - 1 <= len(yaws) <= count
    assert within_pan(yaws, gimbal)
    if layout.blind_deg == 0 and layout.reachable:
        assert np.all((yaws - start_deg + EPS_DEG) % 360.0 <= span_deg + 2 * EPS_DEG)
    spacing, reach = spacing_and_reach(layout, count)
    if len(yaws) > 1:
        assert spacing >= steps_deg(yaws).max() - EPS_DEG
    assert reach >= farthest_deg(yaws, azimuth) - EPS_DEG


@pytest.mark.parametrize(
    ("azimuth", "pan", "blind", "ends"),
    [
        ((-90.0, 90.0), (-120.0, 120.0), 0.0, (-90.0, 90.0)),
        ((-90.0, 90.0), (-60.0, 120.0), 0.0, (-60.0, 90.0)),
        ((-90.0, 90.0), (-120.0, 70.0), 0.0, (-90.0, 70.0)),
        ((-170.0, 170.0), (-160.0, 150.0), 0.0, (-160.0, 150.0)),
        ((100.0, 260.0), (-160.0, 160.0), 40.0, (100.0, 260.0)),
        ((100.0, 260.0), (-160.0, 110.0), 90.0, (100.0, 260.0)),
        ((160.0, 260.0), (-160.0, 160.0), 0.0, (200.0, 260.0)),
        ((60.0, 200.0), (-160.0, 160.0), 0.0, (60.0, 160.0)),
    ],
    ids=["free", "left cut", "right cut", "both cut", "inside", "inside near an end", "starts blind", "ends blind"],
)
def test_the_blind_arc_cuts_off_an_end_or_lies_inside(
    azimuth: tuple[float, float], pan: tuple[float, float], blind: float, ends: tuple[float, float]
) -> None:
    layout = layout_of(azimuth, panning(*pan))
    assert layout.blind_deg == pytest.approx(blind)
    # so many images that the outer ones stand near the ends of what can be had
    yaws = layout.yaws_deg(0.0, 400, 0.0)
    turned = ends[0] - 30.0 + (yaws - ends[0] + 30.0) % 360.0
    assert (turned.min(), turned.max()) == pytest.approx(ends, abs=0.5)
    if blind:
        assert steps_deg(yaws).max() == pytest.approx(blind)
        # two images at its very ends
        assert np.abs(wrap_180(yaws - pan[1])).min() < EPS_DEG
        assert np.abs(wrap_180(yaws - pan[0])).min() < EPS_DEG


def test_a_sector_outside_the_pan_range_is_not_reachable() -> None:
    gimbal = panning(-100.0, 100.0)
    assert not layout_of((110.0, 250.0), gimbal).reachable
    assert layout_of((110.0, 265.0), gimbal).reachable
    assert layout_of((95.0, 250.0), gimbal).reachable
    assert layout_of((110.0, 250.0)).reachable


@pytest.mark.parametrize(
    ("azimuth", "pan", "nearest"),
    [
        ((21.0, 30.0), (-20.0, 20.0), 20.0),
        ((-30.0, -21.0), (-20.0, 20.0), -20.0),
        ((110.0, 240.0), (-100.0, 100.0), 100.0),
        ((120.0, 250.0), (-100.0, 100.0), -100.0),
        ((100.0, 140.0), (7.0, 7.0), 7.0),
        ((-20.0, 0.0), (0.0, 0.0), 0.0),
        ((0.0, 20.0), (0.0, 0.0), 0.0),
    ],
)
def test_where_a_whole_sector_is_blind_images_stand_at_the_nearer_end_of_the_pan_range(
    azimuth: tuple[float, float], pan: tuple[float, float], nearest: float
) -> None:
    gimbal = panning(*pan)
    layout = layout_of(azimuth, gimbal)
    assert layout.blind_deg == 0
    assert layout.yaws_deg(0.0, 1, 0.0) == pytest.approx([nearest])
    for count in (2, 3, 7):
        yaws = layout.yaws_deg(0.0, count, 0.0)
        assert len(yaws) == count
        assert within_pan(yaws, gimbal)
        assert np.abs(wrap_180(yaws - nearest)).min() < EPS_DEG
        assert len(np.unique(yaws.round(6))) == (count if pan[1] > pan[0] else 1)
        assert spacing_and_reach(layout, count)[1] >= farthest_deg(yaws, azimuth) - EPS_DEG


@pytest.mark.parametrize(("widest", "bridged"), [(39.9, False), (40.1, True)])
def test_a_row_that_may_not_bridge_the_blind_arc_reaches_nothing(widest: float, bridged: bool) -> None:
    layout = layout_of((100.0, 260.0), panning(-160.0, 160.0), widest_deg=widest)
    for count in (8, 20):
        assert (spacing_and_reach(layout, count)[1] < 180.0) == bridged
    assert spacing_and_reach(layout, 1)[1] < 180.0


@pytest.mark.parametrize(
    "gimbal", [None, panning(-180.0, 180.0), panning(-200.0, 200.0), panning(-30.0, 30.0, turning=Turning())]
)
def test_where_every_yaw_can_be_had_rows_are_free(gimbal: GimbalLimits | None) -> None:
    assert layout_of(gimbal=gimbal).is_even
    assert layout_of((0.0, 90.0), gimbal).blind_deg == 0


def test_a_full_circle_is_even_but_a_sector_never_is() -> None:
    assert layout_of((10.0, 370.0)).is_even
    assert not layout_of((0.0, 359.0)).is_even
    assert layout_of((0.0, 359.0)).span_deg == 359.0


def test_each_row_of_a_batch_is_as_it_is_alone() -> None:
    layout = layout_of((100.0, 260.0), panning(-160.0, 160.0))
    many: IntArray = np.arange(1, 9)
    spacing, reach = layout.spacing_and_reach(np.zeros(8), many)
    assert [*zip(spacing, reach, strict=True)] == [spacing_and_reach(layout, c) for c in many.tolist()]


def test_pitches_end_at_the_poles_and_at_the_gimbals_limits() -> None:
    assert reachable_pitch(None) == (-90.0, 90.0)
    assert reachable_pitch(GimbalLimits(pitch_min_deg=-120.0, pitch_max_deg=30.0)) == (-90.0, 30.0)
    assert reachable_pitch(GimbalLimits(pitch_min_deg=-45.0, pitch_max_deg=135.0)) == (-45.0, 90.0)
