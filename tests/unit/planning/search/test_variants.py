"""The demands tried one after the other, and what errors take from overlaps, judged by exact overlaps."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.adjacency import MUTUAL_OVERLAP
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import NO_TOLERANCE, Band, Certificate, Constraints, Tolerance
from panoexec.planning.search import planner, verdicts
from panoexec.planning.search.proposal import verdict
from panoexec.planning.search.row_constraints import Demands, Loss
from panoexec.planning.search.variants import Variant, can_tie, variants, worst_loss
from tests.unit.planning.brute import PAPER, full_circle, with_errors

WIDE = Camera.from_fov(60.0, 47.0)
LONG = Camera.from_fov(21.76, 16.44)
LARGE = Tolerance(pitch_deg=0.6, roll_deg=0.6, yaw_deg=1.0)
FULL = full_circle(-90.0, 30.0)
SECTOR = Band(elevation_min_deg=-60.0, elevation_max_deg=20.0, azimuth_min_deg=-50.0, azimuth_max_deg=70.0)


def asked(
    band: Band = FULL,
    *,
    overlap: tuple[float, float] = (0.1, 0.2),
    tolerance: Tolerance = LARGE,
    sure: bool = False,
) -> Constraints:
    return Constraints(
        overlap_h=overlap[0],
        overlap_v=overlap[1],
        band=band,
        tolerance=tolerance,
        guarantee="all" if sure else "coverage",
    )


def tried(constraints: Constraints, camera: Camera = WIDE) -> list[Variant]:
    return list(variants(camera, constraints))


def figures(demands: Demands) -> tuple[float, ...]:
    n = demands.neighbours
    return (
        *(n.planned, n.worst, n.second, n.seam),
        *(demands.planned_v, demands.worst_v, demands.least_count, demands.least_rows),
    )


every_request = pytest.mark.parametrize(
    "constraints",
    [
        asked(band, overlap=o, sure=sure)
        for band in (FULL, SECTOR)
        for o in ((0.0, 0.0), (0.3, 0.1))
        for sure in (False, True)
    ],
    ids=lambda c: f"{'full' if c.band is FULL else 'sector'} {c.overlap_h:g} {c.guarantee}",
)


class TestVariants:
    @every_request
    def test_the_first_asks_for_what_the_request_says_and_all_others_for_more(self, constraints: Constraints) -> None:
        first, *others = tried(constraints)
        sure = constraints.guarantee == "all"
        h, v = constraints.overlap_h, constraints.overlap_v
        assert figures(first.demands) == (h, h if sure else 0.0, 0.0, 0.0, v, v if sure else 0.0, 1, 1)
        assert first.group == 0
        for other in others:
            pairs = list(zip(figures(other.demands), figures(first.demands), strict=True))
            assert all(more >= least for more, least in pairs)
            assert other.demands.neighbours.tolerance == constraints.tolerance

    @every_request
    def test_groups_ask_for_ever_more(self, constraints: Constraints) -> None:
        found = tried(constraints)
        groups = [variant.group for variant in found]
        assert groups == sorted(groups)
        assert groups[:2] == [0, 1]
        assert found[1].demands.neighbours.worst >= MUTUAL_OVERLAP
        between = [variant.demands.worst_v for variant in found if variant.group > 2]
        assert all(a < b for a, b in itertools.pairwise(between))
        assert all(v.demands.neighbours.worst > MUTUAL_OVERLAP for v in found if v.group > 2)

    @every_request
    def test_only_over_a_sector_more_is_asked_against_chains(self, constraints: Constraints) -> None:
        chains = [variant.demands for variant in tried(constraints) if variant.group == 2]
        if constraints.band is FULL:
            assert chains == []
            return
        assert any(d.least_count == 2 and d.least_rows == 1 for d in chains)
        assert any(d.least_rows == 2 for d in chains)
        # two apart in a row, or rows two apart, share what makes an edge
        assert any(d.neighbours.second > MUTUAL_OVERLAP for d in chains)
        assert any(d.worst_v > MUTUAL_OVERLAP and d.least_rows == 3 for d in chains)
        assert len(chains) == len({figures(d) for d in chains})

    def test_no_step_between_rows_asks_for_less_than_the_request(self) -> None:
        assert len([v for v in tried(asked(sure=True, overlap=(0.1, 0.0))) if v.group > 2]) == 4
        some = [v.demands.worst_v for v in tried(asked(sure=True, overlap=(0.1, 0.12))) if v.group > 2]
        assert len(some) == 2
        assert min(some) > 0.12
        assert [v for v in tried(asked(sure=True, overlap=(0.1, 0.5))) if v.group > 2] == []

    def test_perfect_pointing_takes_nothing(self) -> None:
        assert all(variant.loss is None for variant in tried(asked(tolerance=NO_TOLERANCE)))
        assert all(variant.loss is not None for variant in tried(asked()))
        for tau in ("pitch_deg", "roll_deg", "yaw_deg"):
            assert tried(asked(tolerance=replace(NO_TOLERANCE, **{tau: 0.5})))[0].loss is not None

    @pytest.mark.parametrize("camera", [WIDE, LONG, Camera.from_fov(30.0, 90.0)], ids=["wide", "long", "tall"])
    def test_rows_two_apart_in_a_chain_share_just_what_makes_an_edge(self, camera: Camera) -> None:
        constraints = asked(SECTOR, overlap=(0.0, 0.0), tolerance=NO_TOLERANCE)
        (overlap,) = {v.demands.planned_v for v in tried(constraints, camera)} - {0.0}
        steps = np.linspace(0.1, 0.9, 4001) * camera.vfov_deg
        # images above each other, of which neighbours share at least that
        shared = pairwise_overlap(camera, rotation(0.0, 0.0), rotation(np.zeros(4001), steps))
        step = float(steps[shared >= overlap].max())
        twice = float(pairwise_overlap(camera, rotation(0.0, 0.0), rotation(0.0, 2 * step)))
        # just that, but for what an image plane stretches towards its edges
        assert MUTUAL_OVERLAP < twice < MUTUAL_OVERLAP + (0.02 if camera is LONG else 0.12)


def rows_about(camera: Camera, pitch_deg: float, step_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """An image, and so many images of the row a step higher that it sees no others."""
    other = pitch_deg + step_deg
    spacing = min(0.8 * camera.hfov_deg / max(math.cos(math.radians(other)), 0.05), 120.0)
    count = min(7, int(360 // spacing))
    yaws = (np.arange(count) - (count - 1) / 2) * spacing
    return rotation([0.0], pitch_deg), rotation(yaws, other)


@lru_cache
def loss_of(camera: Camera, tolerance: Tolerance) -> Loss:
    return worst_loss(camera, asked(tolerance=tolerance))


class TestWorstLoss:
    @pytest.mark.parametrize("tolerance", [PAPER, LARGE], ids=["paper", "large"])
    @pytest.mark.parametrize("camera", [WIDE, LONG], ids=["wide", "long"])
    @pytest.mark.parametrize("pitch", [-60.0, -40.0, -20.0, 0.0])
    def test_errors_take_no_more_from_rows_at_their_usual_distance(
        self, camera: Camera, pitch: float, tolerance: Tolerance
    ) -> None:
        loss = float(loss_of(camera, tolerance)(np.array([pitch]))[0])
        # rows that share about what is asked for
        image, row = rows_about(camera, pitch, 0.75 * camera.vfov_deg)
        planned = float(union_overlap(camera, image, row[None])[0])
        rng = np.random.default_rng(9)
        both = np.concatenate([image, row])
        taken = np.array([with_errors(both, tolerance, rng, extreme=True) for _ in range(60)])
        assert planned - union_overlap(camera, taken[:, 0], taken[:, 1:]).min() <= loss + 1e-3
        # all images of the row towards the same side
        t = tolerance.pitch_deg
        apart = union_overlap(camera, image @ rotation(0.0, -t), (row @ rotation(0.0, t))[None])
        assert 1e-4 < planned - float(apart[0]) <= loss + 1e-3

    def test_it_is_the_same_above_and_below_the_horizon_and_grows_with_the_tolerance(self) -> None:
        pitches = np.linspace(-90.0, 90.0, 13)
        small, large = (loss_of(WIDE, t)(pitches) for t in (PAPER, LARGE))
        assert small == pytest.approx(small[::-1])
        assert large == pytest.approx(large[::-1])
        assert (small > 0).all()
        assert (large > 1.5 * small).all()
        assert (large < 0.3).all()

    def test_a_taller_image_loses_a_smaller_part(self) -> None:
        at = np.array([-30.0, 0.0])
        pitch_only = Tolerance(pitch_deg=0.6, roll_deg=0.0, yaw_deg=0.0)
        long, wide = loss_of(LONG, pitch_only)(at), loss_of(WIDE, pitch_only)(at)
        assert (long > 1.5 * wide).all()
        # both images are off by as much as they may be, towards each other's far side
        assert wide == pytest.approx(2 * 0.6 / WIDE.vfov_deg, rel=0.35)


TELE = Camera.from_fov(5.153, 3.437)
POINTING = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7)


class TestLongLenses:
    def test_the_first_demands_are_not_searched_where_their_rows_cannot_tie(self) -> None:
        for overlap, tolerance, ties in ((0.15, POINTING, False), (0.3, POINTING, True), (0.15, NO_TOLERANCE, True)):
            constraints = asked(full_circle(-90.0, 90.0), overlap=(overlap, overlap), tolerance=tolerance)
            first, second = itertools.islice(variants(TELE, constraints), 2)
            assert can_tie(TELE, constraints, first.demands) == ties
            assert can_tie(TELE, constraints, second.demands)

    @pytest.mark.parametrize("pitch", [-70.0, -45.0, -20.0, 0.0])
    def test_images_of_adjacent_rows_that_face_each_other_have_an_edge(self, pitch: float) -> None:
        constraints = asked(full_circle(-90.0, 90.0), overlap=(0.15, 0.15), tolerance=POINTING)
        second = list(itertools.islice(variants(TELE, constraints), 2))[1]
        assert second.loss is not None
        needed = max(0.15, second.demands.worst_v + float(second.loss(np.array([pitch]))[0]))
        assert needed < 0.2
        # the highest row with which an image shares so much
        for step in np.linspace(1.0, 0.5, 101) * TELE.vfov_deg:
            image, row = rows_about(TELE, pitch, float(step))
            if union_overlap(TELE, image, row[None])[0] >= needed:
                break
        facing = np.concatenate([image, rotation([0.0], pitch + step)])
        rng = np.random.default_rng(4)
        taken = np.array([with_errors(facing, POINTING, rng, extreme=True) for _ in range(200)])
        assert pairwise_overlap(TELE, taken[:, 0], taken[:, 1]).min() >= MUTUAL_OVERLAP
        assert pairwise_overlap(TELE, taken[:, 1], taken[:, 0]).min() >= MUTUAL_OVERLAP

    def test_rows_of_equally_many_images_are_tied_by_the_first_plan_that_is_proposed(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        judged: list[Certificate] = []

        def judge(*asked: Any, **options: Any) -> Certificate:
            judged.append(verdict(*asked, **options))
            return judged[-1]

        monkeypatch.setattr(verdicts, "verdict", judge)
        monkeypatch.setattr(planner, "_MANY_IMAGES", 1)  # no search for fewer images afterwards
        constraints = asked(full_circle(-6.0, 6.0), overlap=(0.15, 0.15), tolerance=POINTING)
        plan = planner.plan_certified(TELE, constraints)
        counts = [len([shot for shot in plan.shots if shot.row == row]) for row in {s.row for s in plan.shots}]
        assert len(counts) > len(set(counts))
        assert judged[0].certified
        assert plan.certificate is not None
        assert plan.certificate.two_edge_connected
