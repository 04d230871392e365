"""What rows have to satisfy, judged by exact overlaps of their images and by sampled directions."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import FloatArray, direction, rotation
from panoexec.optics import Camera
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import NO_TOLERANCE, Band, Constraints, GimbalLimits, Tolerance
from panoexec.planning.search.row_constraints import Demands, Loss, RowConstraints
from panoexec.planning.search.row_spacing import NeighbourDemand
from tests.unit.planning.brute import PAPER, full_circle, unseen, with_errors

WIDE = Camera.from_fov(60.0, 47.0)
LONG = Camera.from_fov(21.76, 16.44)
STRIP = Camera.from_fov(100.0, 20.0)
"""So wide that about a pole its images are turned too far against each other."""

TINY = Camera.from_fov(3.0, 2.0)
LARGE = Tolerance(pitch_deg=1.0, roll_deg=1.0, yaw_deg=1.5)
SECTOR = Band(elevation_min_deg=-60.0, elevation_max_deg=20.0, azimuth_min_deg=-50.0, azimuth_max_deg=70.0)
overlaps = st.sampled_from([0.0, 0.1, 0.2, 0.45, 0.6])
BAND = full_circle(-90.0, 30.0)
OVERLAP = 0.2


def rules_of(
    camera: Camera = WIDE,
    *,
    overlap: float = OVERLAP,
    band: Band = BAND,
    tolerance: Tolerance = NO_TOLERANCE,
    gimbal: GimbalLimits | None = None,
    loss: Loss | None = None,
    worst_h: float = 0.0,
    worst_v: float = 0.0,
    least_count: int = 1,
) -> RowConstraints:
    constraints = Constraints(overlap_h=overlap, overlap_v=overlap, band=band, tolerance=tolerance, gimbal=gimbal)
    neighbours = NeighbourDemand(planned=overlap, worst=worst_h, tolerance=tolerance)
    demands = Demands(neighbours=neighbours, planned_v=overlap, worst_v=worst_v, least_count=least_count)
    return RowConstraints(camera, constraints, demands, loss)


@lru_cache
def plain_rules(camera: Camera, overlap: float) -> RowConstraints:
    return rules_of(camera, overlap=overlap)


@lru_cache
def strip_rules() -> RowConstraints:
    return rules_of(STRIP, gimbal=GimbalLimits(pitch_min_deg=-60.0, pitch_max_deg=30.0))


def neighbours_share(camera: Camera, pitch_deg: float, spacing_deg: float) -> float:
    return float(pairwise_overlap(camera, rotation(0.0, pitch_deg), rotation(spacing_deg, pitch_deg)))


def allowed(rules: RowConstraints, pitch_deg: float, count: int) -> bool:
    return bool(rules.allowed(np.array([pitch_deg]), np.array([count]))[0])


def fewest(rules: RowConstraints, pitch_deg: float) -> int:
    return int(rules.fewest(np.array([pitch_deg]))[0])


def row_poses(rules: RowConstraints, pitch_deg: float, count: int) -> FloatArray:
    return rotation(rules.layout.yaws_deg(pitch_deg, count, 0.0), pitch_deg)


class TestCountsThatC2Allows:
    @settings(max_examples=60, derandomize=True)
    @given(st.sampled_from([WIDE, LONG, STRIP]), overlaps, st.floats(-89, 89))
    def test_the_fewest_images_share_enough_and_one_less_do_not(
        self, camera: Camera, overlap: float, pitch_deg: float
    ) -> None:
        rules = plain_rules(camera, overlap)
        count = fewest(rules, pitch_deg)
        if camera is STRIP:
            # that it is the fewest is known for nodes of the pitch only
            assert fewest(rules, -pitch_deg) == count
            assert any(allowed(rules, pitch_deg, count + more) for more in range(4))
            return
        assert allowed(rules, pitch_deg, count)
        assert neighbours_share(camera, pitch_deg, 360.0 / count) >= overlap
        if count > 2:
            assert neighbours_share(camera, pitch_deg, 360.0 / (count - 1)) < overlap + 1e-6
            assert not allowed(rules, pitch_deg, count - 1)

    @pytest.mark.parametrize("band", [BAND, SECTOR], ids=["full circle", "sector"])
    @pytest.mark.parametrize("camera", [WIDE, LONG], ids=["wide", "long"])
    def test_a_row_is_allowed_where_its_neighbours_share_enough(self, camera: Camera, band: Band) -> None:
        rules = rules_of(camera, band=band)
        seen = set()
        for pitch in np.linspace(-88.0, 88.0, 23).tolist():
            for count in range(2, 22):
                yaws = rules.layout.yaws_deg(pitch, count, 0.0)
                share = neighbours_share(camera, pitch, float((yaws[1] - yaws[0]) % 360.0))
                if abs(share - OVERLAP) > 1e-4:
                    seen.add(share > OVERLAP)
                    assert allowed(rules, pitch, count) == (share > OVERLAP), (pitch, count, share)
        assert seen == {True, False}

    def test_images_turned_too_far_about_a_pole_are_not_a_row(self) -> None:
        rules = plain_rules(STRIP, OVERLAP)
        refused = 0
        for pitch in np.linspace(-88.0, 88.0, 45).tolist():
            for count in range(2, 16):
                share = neighbours_share(STRIP, pitch, 360.0 / count)
                fine = allowed(rules, pitch, count)
                assert not fine or share > OVERLAP - 0.01
                # ranges of pitch are told by pitches 2 degrees apart
                assert fine or share < OVERLAP + 0.02 or count < 5
                refused += not fine and neighbours_share(STRIP, pitch * 0.5, 360.0 / count) > OVERLAP
        assert refused

    def test_the_overlap_is_asked_for_whatever_the_errors(self) -> None:
        exact, sure = rules_of(tolerance=LARGE), rules_of(tolerance=LARGE, worst_h=OVERLAP)
        rng = np.random.default_rng(5)
        for pitch in (-60.0, -30.0, 0.0):
            count = fewest(sure, pitch)
            assert count >= fewest(exact, pitch)
            both = rotation([0.0, 360.0 / count], pitch)
            taken = [with_errors(both, LARGE, rng, extreme=True) for _ in range(50)]
            assert min(float(pairwise_overlap(WIDE, a, b)) for a, b in taken) >= OVERLAP
        assert any(fewest(sure, p) > fewest(exact, p) for p in np.linspace(-80.0, 0.0, 17).tolist())

    def test_one_image_is_a_row_at_a_pole_and_in_a_sector_only(self) -> None:
        closed, sector = rules_of(), rules_of(band=SECTOR)
        assert fewest(closed, -90.0) == fewest(closed, 90.0) == 1
        assert allowed(closed, -90.0, 1)
        assert allowed(closed, 90.0, 1)
        assert not allowed(closed, -85.0, 1)
        assert not allowed(closed, 0.0, 1)
        assert allowed(sector, -20.0, 1)

    @pytest.mark.parametrize("band", [BAND, SECTOR], ids=["full circle", "sector"])
    def test_no_row_has_fewer_images_than_asked_for(self, band: Band) -> None:
        assert fewest(rules_of(band=band), -75.0) < 7
        rules = rules_of(band=band, least_count=7)
        assert not allowed(rules, -75.0, 6)
        assert allowed(rules, -75.0, 7)
        assert fewest(rules, -75.0) == 7
        assert rules.zones(6) == []

    @settings(max_examples=40, derandomize=True)
    @given(st.floats(-90, 90), st.sampled_from([(0.0, 0.1), (0.1, 0.2), (0.2, 0.45)]))
    def test_more_overlap_and_flatter_rows_take_no_fewer_images(
        self, pitch_deg: float, less_more: tuple[float, float]
    ) -> None:
        rules = plain_rules(WIDE, less_more[0])
        count = fewest(rules, pitch_deg)
        assert fewest(plain_rules(WIDE, less_more[1]), pitch_deg) >= count
        assert fewest(rules, -pitch_deg) == count
        assert fewest(rules, pitch_deg * 0.8) >= count

    @pytest.mark.parametrize(
        ("camera", "ends"),
        [(WIDE, (-80.0, -10.0)), (LONG, (-20.0, 30.0)), (STRIP, (-90.0, 10.0)), (TINY, (-20.0, 25.0))],
    )
    def test_counts_between_two_pitches_hold_all_in_between(self, camera: Camera, ends: tuple[float, float]) -> None:
        rules = rules_of(camera)
        counts = rules.fewest(np.linspace(*ends, 301)[1:-1])
        least, most = rules.counts_between(*ends)
        assert least <= counts.min()
        assert most >= counts.max()

    @settings(max_examples=40, derandomize=True)
    @given(st.floats(-60, 30), st.integers(2, 12))
    def test_the_zone_of_a_pitch_holds_it_and_only_what_is_allowed(self, pitch_deg: float, count: int) -> None:
        rules = strip_rules()
        low, high = rules.zone_of(pitch_deg, count)
        assert low - 1e-9 <= pitch_deg <= high + 1e-9
        if not allowed(rules, pitch_deg, count):
            assert (low, high) == (pitch_deg, pitch_deg)
            return
        assert low >= -60.0
        assert high <= 30.0
        inside = np.linspace(low, high, 15)
        assert rules.allowed(inside, np.full(15, count)).all()
        # zones are told by pitches 2 degrees apart
        shares = [neighbours_share(STRIP, p, 360.0 / count) for p in inside.tolist()]
        assert min(shares) >= OVERLAP - 0.02

    def test_what_the_gimbal_cannot_pan_to_is_bridged_where_neighbours_can_be_so_far_apart(self) -> None:
        rules = rules_of(gimbal=GimbalLimits(yaw_min_deg=-145.0, yaw_max_deg=145.0, yaw_endless=False))
        limit = rules.blind_limit_deg
        assert 0 < limit < 90
        assert neighbours_share(WIDE, limit + 0.01, 70.0) >= OVERLAP
        assert neighbours_share(WIDE, limit - 0.01, 70.0) < OVERLAP
        for count in (9, 20):
            assert allowed(rules, -limit - 0.1, count)
            assert not allowed(rules, -limit + 0.1, count)
        assert rules_of().blind_limit_deg == pytest.approx(0.0)


class TestBand:
    @pytest.mark.parametrize("tolerance", [NO_TOLERANCE, PAPER, LARGE], ids=["exact", "paper", "large"])
    @pytest.mark.parametrize(
        ("pitch", "more"), [(-90.0, 0), (-75.0, 2), (-40.0, 0), (-40.0, 3), (0.0, 1), (25.0, 0), (80.0, 1)]
    )
    def test_what_a_row_covers_all_round_is_seen_whatever_the_errors(
        self, pitch: float, more: int, tolerance: Tolerance
    ) -> None:
        rules = rules_of(tolerance=tolerance)
        count = fewest(rules, pitch) + more
        (low,), (high,) = rules.band(np.array([pitch]), np.array([count]))
        assert low < high
        rng = np.random.default_rng(6)
        elevation = np.concatenate([rng.uniform(low, high, 2000), np.full(500, low), np.full(500, high)])
        inside = direction(elevation, rng.uniform(-180, 180, 3000))
        poses = row_poses(rules, pitch, count)
        for trial in range(6):
            taken = with_errors(poses, tolerance, rng, extreme=trial % 2 == 0)
            assert len(unseen(WIDE, taken, inside)) == 0

    @pytest.mark.parametrize(("pitch", "count"), [(-75.0, 4), (-40.0, 7), (0.0, 9), (25.0, 8)])
    def test_it_covers_no_more(self, pitch: float, count: int) -> None:
        rules = rules_of()
        (low,), (high,) = rules.band(np.array([pitch]), np.array([count]))
        poses = row_poses(rules, pitch, count)
        for end in (low - 0.1, high + 0.1):
            if -90.0 < end < 90.0:
                assert len(unseen(WIDE, poses, direction(np.full(3000, end), np.linspace(-180, 180, 3000))))

    def test_a_row_with_gaps_covers_nothing(self) -> None:
        rules = rules_of()
        (low,), (high,) = rules.band(np.zeros(1), np.array([5]))
        assert low > high

    def test_a_sectors_row_covers_the_sector(self) -> None:
        rules = rules_of(band=SECTOR)
        (low,), (high,) = rules.band(np.array([-30.0]), np.array([3]))
        azimuths = np.linspace(SECTOR.azimuth_min_deg, SECTOR.azimuth_max_deg, 2000)
        poses = row_poses(rules, -30.0, 3)
        for elevation in (low, (low + high) / 2, high):
            assert len(unseen(WIDE, poses, direction(np.full(2000, elevation), azimuths))) == 0
        assert len(unseen(WIDE, poses, direction(np.full(2000, low - 0.1), azimuths)))


class TestFirstRows:
    @pytest.mark.parametrize("tolerance", [NO_TOLERANCE, PAPER], ids=["exact", "paper"])
    @pytest.mark.parametrize("bottom", [-90.0, -50.0, 5.0])
    @pytest.mark.parametrize("camera", [WIDE, LONG], ids=["wide", "long"])
    def test_they_cover_the_lower_end_and_stand_as_high_as_they_can(
        self, camera: Camera, bottom: float, tolerance: Tolerance
    ) -> None:
        rules = rules_of(camera, band=full_circle(bottom, 60.0), tolerance=tolerance)
        pitches, counts = rules.first_rows(3)
        assert len(pitches)
        assert len(set(counts.tolist())) == len(counts)
        assert rules.allowed(pitches, counts).all()
        azimuths = np.linspace(-180, 180, 721)
        for pitch, count in zip(pitches.tolist(), counts.tolist(), strict=True):
            for elevation in (bottom, bottom + 0.5):
                assert (
                    len(unseen(camera, row_poses(rules, pitch, count), direction(np.full(721, elevation), azimuths)))
                    == 0
                )
            higher = pitch + 0.01
            covers = rules.band(np.array([higher]), np.array([count]))[0][0] <= bottom
            assert not (covers and allowed(rules, higher, count)) or higher > 90.0

    def test_they_keep_to_the_gimbals_limits(self) -> None:
        gimbal = GimbalLimits(pitch_min_deg=-70.0, pitch_max_deg=-35.0)
        rules = rules_of(band=full_circle(-50.0, 0.0), gimbal=gimbal)
        pitches, _ = rules.first_rows(2)
        assert rules.pitch_deg == (-70.0, -35.0)
        assert pitches.max() <= -35.0
        assert rules_of(band=full_circle(-50.0, 0.0)).first_rows(2)[0].max() > -35.0

    def test_there_are_none_where_the_gimbal_cannot_look_so_low(self) -> None:
        rules = rules_of(gimbal=GimbalLimits(pitch_min_deg=-30.0))
        assert len(rules.first_rows(3)[0]) == 0


class TestDemands:
    def test_pairs_have_to_share_what_is_planned_or_sure_plus_what_errors_take(self) -> None:
        def loss(pitch_deg: FloatArray) -> FloatArray:
            return np.abs(pitch_deg) / 100.0

        low, counts = np.array([-60.0, -5.0]), np.array([4, 8])
        plain = rules_of(loss=loss).pairs(low, counts, counts + 1)
        assert plain.low_demand == pytest.approx([OVERLAP, OVERLAP])
        assert plain.high_demand == pytest.approx([OVERLAP, OVERLAP])
        sure = rules_of(loss=loss, worst_v=0.17).pairs(low, counts, counts + 1)
        assert sure.low_demand == pytest.approx([0.17 + 0.6, 0.17 + 0.05])
        next_row = low + 0.85 * WIDE.vfov_deg
        assert sure.high_demand == pytest.approx(np.maximum(0.17 + np.abs(next_row) / 100, OVERLAP))
        assert rules_of(worst_v=0.3).pairs(low, counts, counts).low_demand == pytest.approx([0.3, 0.3])
        assert sure.high_count.tolist() == [5, 9]
        assert rules_of(worst_v=0.3).overlap_v == 0.3
        assert rules_of(worst_v=0.1).overlap_v == OVERLAP

    def test_another_seam_changes_nothing_else(self) -> None:
        rules = rules_of(tolerance=LARGE, worst_v=0.1)
        other = rules.with_seam(0.9)
        neighbours = replace(rules.demands.neighbours, seam=0.9)
        assert other.demands == replace(rules.demands, neighbours=neighbours)
        assert (other.band_deg, other.pitch_deg) == (rules.band_deg, rules.pitch_deg)
        assert rules.demands.neighbours.seam == 0
        assert (other.fewest(np.linspace(-60, 0, 9)) >= rules.fewest(np.linspace(-60, 0, 9))).all()
        # on the meridian between neighbours both see nine tenths of a field of view
        count = fewest(other, 0.0)
        seam = direction(np.linspace(-0.44, 0.44, 50) * WIDE.vfov_deg, 180.0 / count)
        for yaw in (0.0, 360.0 / count):
            assert len(unseen(WIDE, rotation([yaw], 0.0), seam)) == 0
        assert count > fewest(rules, 0.0)

    def test_rows_of_forty_images_are_many(self) -> None:
        assert not rules_of(LONG).many
        assert rules_of(Camera.from_fov(8.0, 6.0)).many
