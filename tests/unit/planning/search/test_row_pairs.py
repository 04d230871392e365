"""Two rows that follow each other, judged by exact overlaps of all their images and by sampled directions."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import FloatArray, direction, rotation
from panoexec.optics import Camera
from panoexec.planning.geometry.overlap import union_overlap
from panoexec.planning.model import NO_TOLERANCE, Band, Constraints, GimbalLimits, Tolerance
from panoexec.planning.search.row_cover import RowCover
from panoexec.planning.search.row_layout import RowLayout
from panoexec.planning.search.row_pairs import COARSE, FINE, PHASES, PairMargin, Pairs, Resolution
from tests.unit.planning.brute import full_circle, unseen, with_errors

WIDE = Camera.from_fov(60.0, 47.0)
LONG = Camera.from_fov(21.76, 16.44)
LARGE = Tolerance(pitch_deg=0.6, roll_deg=0.6, yaw_deg=1.0)
SECTOR = Band(elevation_min_deg=-60.0, elevation_max_deg=20.0, azimuth_min_deg=-50.0, azimuth_max_deg=70.0)
FULL = full_circle(-90.0, 30.0)
BLIND = GimbalLimits(yaw_min_deg=-160.0, yaw_max_deg=160.0, yaw_endless=False)

Rows = tuple[float, int, float, int]
"""Pitch and count of the lower row and of the higher one."""


def layout_of(band: Band = FULL, gimbal: GimbalLimits | None = None, widest_deg: float = 50.0) -> RowLayout:
    constraints = Constraints(overlap_h=0.1, overlap_v=0.1, band=band, gimbal=gimbal)
    return RowLayout(constraints, lambda pitch_deg: np.full(len(pitch_deg), widest_deg))


def margin_of(camera: Camera, layout: RowLayout, tolerance: Tolerance = NO_TOLERANCE) -> PairMargin:
    return PairMargin(camera, layout, RowCover(camera, tolerance))


def pairs_of(*rows: Rows, demand: tuple[float, float] = (0.0, 0.0)) -> Pairs:
    low_deg, low_count, high_deg, high_count = (np.array(column) for column in zip(*rows, strict=True))
    return Pairs(
        low_deg=low_deg,
        low_count=low_count,
        high_deg=high_deg,
        high_count=high_count,
        low_demand=np.full(len(rows), demand[0]),
        high_demand=np.full(len(rows), demand[1]),
    )


def poses(layout: RowLayout, rows: Rows, phase: float) -> tuple[FloatArray, FloatArray]:
    """The images of both rows, the higher one turned by a phase in units of what makes the same picture again."""
    low_deg, low_count, high_deg, high_count = rows
    turn = phase * 360.0 / math.lcm(low_count, high_count)
    return (
        rotation(layout.yaws_deg(low_deg, low_count, 0.0), low_deg),
        rotation(layout.yaws_deg(high_deg, high_count, turn), high_deg),
    )


def least_shared(camera: Camera, low: FloatArray, high: FloatArray) -> tuple[float, float]:
    """The least that an image of either row shares with the whole other row, exactly."""
    by_low = union_overlap(camera, low, np.broadcast_to(high, (len(low), *high.shape)))
    by_high = union_overlap(camera, high, np.broadcast_to(low, (len(high), *low.shape)))
    return float(by_low.min()), float(by_high.min())


CLOSED_ROWS: list[tuple[Camera, Rows]] = [
    (WIDE, (-40.0, 7, -5.0, 8)),
    (WIDE, (-40.0, 8, -5.0, 8)),
    (WIDE, (-40.0, 6, -5.0, 9)),
    (WIDE, (-75.0, 4, -40.0, 8)),
    (WIDE, (-90.0, 1, -55.0, 6)),
    (WIDE, (50.0, 5, 90.0, 1)),
    (WIDE, (20.0, 9, 55.0, 6)),
    (LONG, (-20.0, 20, -8.0, 21)),
    (LONG, (-30.0, 18, -18.0, 20)),
    (LONG, (-2.0, 20, 11.0, 20)),
]


class TestShared:
    @pytest.mark.parametrize(("camera", "rows"), CLOSED_ROWS)
    def test_the_least_overlap_of_any_image_with_the_other_row_is_found(self, camera: Camera, rows: Rows) -> None:
        layout = layout_of()
        margin = margin_of(camera, layout)
        exact = [least_shared(camera, *poses(layout, rows, phase)) for phase in PHASES]
        for demand in ((0.0, 1.0), (1.0, 0.0), (0.2, 0.3)):
            # a large demand on one row leaves only that one to be looked at
            found = margin.overlap_margins(pairs_of(rows, demand=demand), FINE)[0]
            wanted = [min(low - demand[0], high - demand[1]) for low, high in exact]
            # about a pole it is found less closely
            assert found == pytest.approx(wanted, abs=0.008 if 1 in (rows[1], rows[3]) else 0.003)
            assert margin.overlap_margins(pairs_of(rows, demand=demand), COARSE)[0] == pytest.approx(wanted, abs=0.04)

    def test_turning_equal_rows_against_each_other_matters(self) -> None:
        found = margin_of(WIDE, layout_of()).overlap_margins(pairs_of((-40.0, 7, -5.0, 7), (-40.0, 7, -5.0, 8)), FINE)
        assert np.ptp(found[0]) > 0.006
        assert np.ptp(found[1]) < np.ptp(found[0]) / 5

    @pytest.mark.parametrize(
        ("band", "gimbal"), [(SECTOR, None), (FULL, BLIND)], ids=["sector", "around the blind arc"]
    )
    @pytest.mark.parametrize("rows", [(-40.0, 10, -5.0, 9), (-40.0, 9, -10.0, 9), (-50.0, 10, -15.0, 12)])
    def test_rows_that_cannot_turn_are_looked_at_as_they_stand(
        self, band: Band, gimbal: GimbalLimits | None, rows: Rows
    ) -> None:
        layout = layout_of(band, gimbal)
        low, high = least_shared(WIDE, *poses(layout, rows, 0.0))
        for demand in ((0.0, 1.0), (1.0, 0.0), (0.1, 0.2)):
            found = margin_of(WIDE, layout).overlap_margins(pairs_of(rows, demand=demand), FINE)[0]
            wanted = min(low - demand[0], high - demand[1])
            assert len(set(found.tolist())) == 1
            assert found[0] <= wanted + 0.003
            # around a blind arc the worst position counts, whether it occurs or not
            assert found[0] >= wanted - (0.3 if layout.closed else 0.003)

    @pytest.mark.parametrize("rows", [(-30.0, 1, 0.0, 1), (-30.0, 1, 0.0, 3), (-30.0, 2, 5.0, 1)])
    def test_single_images_of_a_sector(self, rows: Rows) -> None:
        layout = layout_of(SECTOR)
        exact = min(least_shared(WIDE, *poses(layout, rows, 0.0)))
        assert margin_of(WIDE, layout).overlap_margins(pairs_of(rows), FINE)[0] == pytest.approx([exact] * 3, abs=0.002)


class TestClosed:
    @pytest.mark.parametrize("tolerance", [NO_TOLERANCE, LARGE], ids=["exact", "large"])
    @pytest.mark.parametrize(("camera", "rows"), CLOSED_ROWS)
    @pytest.mark.parametrize("phase", range(3))
    def test_rows_that_close_leave_nothing_between_them_unseen(
        self, camera: Camera, rows: Rows, tolerance: Tolerance, phase: int
    ) -> None:
        """Pushed apart until they just close, and then a little further."""
        layout = layout_of()
        margin = margin_of(camera, layout, tolerance)
        low_deg, low_count, high_deg, high_count = rows
        tried = np.clip(np.arange(high_deg - 0.4 * camera.vfov_deg, high_deg + 0.6 * camera.vfov_deg, 0.25), -90, 90)
        closed = margin.coverage_margins(
            pairs_of(*((low_deg, low_count, h, high_count) for h in tried.tolist())), FINE
        )[:, phase]
        fits = np.nonzero(closed > 0)[0]
        if not len(fits):
            # the rows have gaps of their own with such tolerances
            assert not tolerance.is_zero
            return
        rng = np.random.default_rng(8)
        highest = float(tried[fits[-1]])
        between = direction(rng.uniform(low_deg, highest, 6000), rng.uniform(-180, 180, 6000))
        images = np.concatenate(poses(layout, (low_deg, low_count, highest, high_count), PHASES[phase]))
        for _ in range(3):
            assert len(unseen(camera, with_errors(images, tolerance, rng, extreme=True), between)) == 0

    def test_rows_too_far_apart_leave_something(self) -> None:
        layout = layout_of()
        margin = margin_of(WIDE, layout)
        gaps = 0
        for high in np.arange(-5.0, 20.0, 1.5).tolist():
            rows = (-40.0, 7, high, 8)
            closed = margin.coverage_margins(pairs_of(rows), FINE)[0]
            for phase, value in zip(PHASES, closed.tolist(), strict=True):
                between = direction(
                    np.repeat(np.linspace(-40.0, high, 150), 720), np.tile(np.linspace(-180, 180, 720), 150)
                )
                missed = len(unseen(WIDE, np.concatenate(poses(layout, rows, phase)), between))
                # a narrow gap may lie between the directions
                if value > 0 or value < -0.02:
                    assert (missed == 0) == (value > 0), (high, phase, value)
                    gaps += missed > 0
            if closed.max() < -0.04:
                break
        assert gaps

    def test_a_row_with_gaps_of_its_own_never_closes(self) -> None:
        margin = margin_of(WIDE, layout_of())
        for rows in ((-5.0, 5, 20.0, 12), (-30.0, 12, -5.0, 5), (-5.0, 4, 0.0, 4)):
            assert margin.coverage_margins(pairs_of(rows), FINE)[0].max() == -1.0

    def test_tolerances_take_from_it(self) -> None:
        pairs = pairs_of((-40.0, 8, -8.0, 9), (-70.0, 5, -40.0, 8))
        exact, large = (margin_of(WIDE, layout_of(), t).coverage_margins(pairs, FINE) for t in (NO_TOLERANCE, LARGE))
        assert (large < exact - 0.02).all()

    def test_a_sectors_rows_close(self) -> None:
        layout = layout_of(SECTOR)
        margin = margin_of(WIDE, layout)
        found = margin.coverage_margins(pairs_of((-40.0, 4, -5.0, 4), (-40.0, 4, 30.0, 4)), FINE)
        assert found[0].min() > 0 > found[1].max()
        azimuths = np.linspace(SECTOR.azimuth_min_deg, SECTOR.azimuth_max_deg, 721)
        between = direction(np.repeat(np.linspace(-40.0, -5.0, 80), 721), np.tile(azimuths, 80))
        assert len(unseen(WIDE, np.concatenate(poses(layout, (-40.0, 4, -5.0, 4), 0.0)), between)) == 0


row_pairs = st.tuples(st.floats(-85, 40), st.integers(4, 14), st.floats(8, 45), st.integers(4, 14)).map(
    lambda r: (r[0], r[1], r[0] + r[2], r[3])
)


class TestMargins:
    @settings(max_examples=40, derandomize=True)
    @given(row_pairs)
    def test_upside_down_they_are_the_same(self, rows: Rows) -> None:
        margin = margin_of(WIDE, layout_of())
        low_deg, low_count, high_deg, high_count = rows
        here = margin.margins(pairs_of(rows, demand=(0.1, 0.3)), FINE)
        there = margin.margins(pairs_of((-high_deg, high_count, -low_deg, low_count), demand=(0.3, 0.1)), FINE)
        assert there == pytest.approx(here, abs=1e-3)

    @settings(max_examples=40, derandomize=True)
    @given(row_pairs, st.floats(0, 0.5), st.floats(0, 0.5))
    def test_they_are_the_less_of_coverage_and_of_overlap_less_the_demand(
        self, rows: Rows, low: float, high: float
    ) -> None:
        margin = margin_of(WIDE, layout_of())
        asked = pairs_of(rows, demand=(low, high))
        shared, closed = margin.overlap_margins(asked, FINE), margin.coverage_margins(asked, FINE)
        assert margin.margins(asked, FINE) == pytest.approx(np.minimum(shared, closed))
        free = margin.overlap_margins(pairs_of(rows), FINE)
        assert (shared <= free - min(low, high) + 1e-9).all()
        assert (shared >= free - max(low, high) - 1e-9).all()

    @pytest.mark.parametrize("grain", [COARSE, FINE], ids=["coarse", "fine"])
    @pytest.mark.parametrize("band", [FULL, SECTOR], ids=["full circle", "sector"])
    def test_each_pair_of_a_batch_is_as_it_is_alone(self, grain: Resolution, band: Band) -> None:
        rows = [r for camera, r in CLOSED_ROWS if camera is WIDE and (band is FULL or 1 not in (r[1], r[3]))]
        margin = margin_of(WIDE, layout_of(band))
        alone = np.array([margin.overlap_margins(pairs_of(r), grain)[0] for r in rows])
        # one row about a pole makes the others of its batch be looked at in more positions
        assert margin.overlap_margins(pairs_of(*rows), grain) == pytest.approx(alone, abs=2e-3)
        # and one of close neighbours makes those of the others count too
        alone = np.array([margin.coverage_margins(pairs_of(r), grain)[0] for r in rows])
        assert (margin.coverage_margins(pairs_of(*rows), grain) >= alone - 1e-9).all()

    def test_rows_further_apart_share_less(self) -> None:
        margin = margin_of(WIDE, layout_of())
        found = margin.overlap_margins(pairs_of(*((-40.0, 7, h, 8) for h in np.arange(-30.0, 5.0, 2.5).tolist())), FINE)
        assert (np.diff(found, axis=0) < 0).all()


def test_some_of_the_pairs_with_other_higher_rows() -> None:
    pairs = pairs_of((-60.0, 4, -30.0, 7), (-30.0, 7, 0.0, 8), (0.0, 8, 30.0, 6), demand=(0.1, 0.2))
    assert len(pairs) == 3
    some = pairs.at(np.array([2, 0]), np.array([28.0, -33.0]))
    assert len(some) == 2
    assert some.high_deg.tolist() == [28.0, -33.0]
    for field in fields(Pairs):
        if field.name != "high_deg":
            assert getattr(some, field.name).tolist() == getattr(pairs, field.name)[[2, 0]].tolist()
