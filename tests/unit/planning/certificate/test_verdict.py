"""The whole certificate: C1 to C4, thresholds, failure messages, and the published plans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.baselines.published import PUBLISHED, published_plan
from panoexec.planning.certificate.adjacency import connection
from panoexec.planning.certificate.verdict import certify, certify_poses
from panoexec.planning.certificate.worst_overlap import ErrorCorners, overlaps_at_least, worst_pair_overlaps
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import (
    NO_TOLERANCE,
    AngleBox,
    Band,
    Constraints,
    Guarantee,
    Plan,
    Shot,
    Tolerance,
)
from tests.unit.planning.brute import (
    PAPER,
    SCENARIO_2,
    Array,
    enough_rows,
    even_rows,
    full_circle,
    in_domain,
    random_directions,
    unseen,
    with_errors,
)

WIDE = Camera.from_fov(60.0, 47.0)


def demand(
    band: Band,
    overlap: float = 0.15,
    tolerance: Tolerance = NO_TOLERANCE,
    guarantee: Guarantee = "coverage",
    masks: tuple[AngleBox, ...] = (),
) -> Constraints:
    return Constraints(
        overlap_h=overlap, overlap_v=overlap, band=band, tolerance=tolerance, guarantee=guarantee, masks=masks
    )


def holds_whatever_is_lost(camera: Camera, taken: Array) -> bool:
    """C4 for one set of images as taken, by the definition."""
    a, b = np.triu_indices(len(taken), 1)
    mutual = np.minimum(pairwise_overlap(camera, taken[a], taken[b]), pairwise_overlap(camera, taken[b], taken[a]))
    return connection(len(taken), a[mutual >= 0.05], b[mutual >= 0.05]).two_edge_connected


@pytest.mark.parametrize(
    ("name", "certified", "conditions"),
    [
        ("scenario-1-proposed", False, {"C1"}),
        ("scenario-1-hdrpano", True, set()),
        ("scenario-2-proposed", False, {"C2"}),
        ("scenario-2-hdrpano", False, {"C1", "C2"}),
        ("scenario-3-proposed", True, set()),
    ],
)
def test_the_published_plans_get_their_verdicts(name: str, certified: bool, conditions: set[str]) -> None:
    certificate = certify(published_plan(name))
    assert certificate.certified is certified
    assert certificate.images == PUBLISHED[name].images
    assert {line.split(":")[0] for line in certificate.failures} == conditions


def test_the_published_plan_of_scenario_1_loses_only_the_rim_of_its_band() -> None:
    """At the planned poses its top row reaches the band's end all round, with errors it does not quite."""
    plan = published_plan("scenario-1-proposed")
    holes = certify(plan).holes
    assert len(holes) == 7
    assert all(50.4 < hole.elevation_deg < 50.5 for hole in holes)
    assert certify(replace(plan, constraints=replace(plan.constraints, tolerance=NO_TOLERANCE))).certified


def test_hdrpanos_hole_in_scenario_2_is_located_at_the_planned_poses() -> None:
    plan = published_plan("scenario-2-hdrpano")
    certificate = certify(replace(plan, constraints=replace(plan.constraints, tolerance=NO_TOLERANCE)))
    assert certificate.uncovered_fraction > 0
    assert all(-74.6 < hole.elevation_deg < -73.2 for hole in certificate.holes)
    assert "elevation -73.9" in certificate.failures[0]
    # the largest one is there for anyone to see
    rng = np.random.default_rng(1)
    largest = certificate.holes[0]
    near = rotation(
        largest.azimuth_deg + rng.uniform(-2, 2, 5000), largest.elevation_deg + rng.uniform(-0.8, 0.8, 5000)
    )[:, :, 0]
    bare = unseen(plan.camera, plan.rotations(), near)
    assert len(bare)
    elevations = np.degrees(np.arcsin(-bare[:, 2]))
    assert -74.6 < elevations.min() < elevations.max() < -73.2


def test_scenario_2_breaks_its_own_fifteen_per_cent_where_the_notes_say() -> None:
    plan = published_plan("scenario-2-proposed")
    certificate = certify(plan)
    assert certificate.min_overlap_h == pytest.approx(0.1215, abs=1e-4)
    assert certificate.min_overlap_h is not None
    assert certificate.weakest_h is not None
    assert {plan.shots[i].pitch_deg for i in certificate.weakest_h} == {-32.0}
    assert certificate.worst_overlap_h is not None
    assert 0.05 < certificate.worst_overlap_h < certificate.min_overlap_h


def test_a_single_image_is_a_panorama() -> None:
    band = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=-8.0, azimuth_max_deg=8.0)
    certificate = certify_poses(SCENARIO_2, demand(band, tolerance=PAPER), rotation([0.0], [0.0]), [0])
    assert certificate.certified
    assert (certificate.min_overlap_h, certificate.min_overlap_v) == (None, None)
    assert (certificate.worst_overlap_h, certificate.worst_overlap_v) == (None, None)
    assert (certificate.weakest_h, certificate.weakest_v) == (None, None)


def test_two_images_depend_on_one_edge() -> None:
    band = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=-15.0, azimuth_max_deg=15.0)
    certificate = certify_poses(SCENARIO_2, demand(band), rotation([-8.0, 8.0], [0.0, 0.0]), [0, 0])
    assert certificate.connected
    assert not certificate.two_edge_connected
    assert not certificate.certified
    assert certificate.bridges == ((0, 1),)
    assert certificate.failures == ("C4: the graph depends on a single edge (bridge): images 0 and 1",)


def test_chain_is_certified_if_images_two_apart_overlap_too() -> None:
    band = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=-20.0, azimuth_max_deg=20.0)
    loose = np.arange(-14.0, 15.0, 14.0)
    tight = np.arange(-15.0, 15.1, 10.0)
    for yaws, certified in ((loose, False), (tight, True)):
        row = rotation(yaws, np.zeros(len(yaws)))
        assert certify_poses(SCENARIO_2, demand(band), row, [0] * len(yaws)).certified is certified


def test_without_images_nothing_is_certified() -> None:
    certificate = certify_poses(SCENARIO_2, demand(full_circle(-10.0, 10.0)), np.empty((0, 3, 3)), [])
    assert not certificate.certified
    assert certificate.uncovered_fraction == pytest.approx(1.0)
    assert certificate.images == 0


def test_thresholds_are_met_to_rounding_and_not_below() -> None:
    attitudes, rows = even_rows([(-20.0, 20), (-7.0, 21)])
    band = full_circle(-25.0, 0.0)
    certificate = certify_poses(SCENARIO_2, demand(band, overlap=0.0), attitudes, rows)
    h, v = certificate.min_overlap_h, certificate.min_overlap_v
    assert h is not None
    assert v is not None
    for change, fails in ((0.0, set()), (5e-10, set()), (2e-9, {"C2", "C3"})):
        asked = replace(demand(band), overlap_h=h + change, overlap_v=v + change)
        verdict = certify_poses(SCENARIO_2, asked, attitudes, rows)
        assert {line.split(":")[0] for line in verdict.failures} == fails
        assert verdict.certified is not bool(fails)


def test_the_guarantee_all_asks_for_the_worst_case() -> None:
    attitudes, rows = even_rows([(-20.0, 20), (-7.0, 21)])
    plain = certify_poses(SCENARIO_2, demand(full_circle(-25.0, 0.0), tolerance=PAPER), attitudes, rows)
    assert plain.certified
    assert plain.worst_overlap_h is not None
    assert plain.min_overlap_h is not None
    assert plain.worst_overlap_h < 0.17 < plain.min_overlap_h
    asked = demand(full_circle(-25.0, 0.0), 0.17, tolerance=PAPER, guarantee="all")
    strict = certify_poses(SCENARIO_2, asked, attitudes, rows)
    assert not strict.certified
    assert "with the worst pointing errors" in strict.failures[0]
    met = replace(asked, overlap_h=plain.worst_overlap_h)
    assert certify_poses(SCENARIO_2, met, attitudes, rows).certified


def test_the_closing_pair_of_a_full_circle_counts_and_that_of_a_sector_does_not() -> None:
    yaws = np.arange(0.0, 340.0, 16.0)  # the last to the first: 24°, more than an image is wide
    row, rows = rotation(yaws, np.zeros(len(yaws))), [0] * len(yaws)
    all_round = certify_poses(SCENARIO_2, demand(full_circle(-5.0, 5.0), overlap=0.1), row, rows)
    assert all_round.min_overlap_h == 0.0
    assert all_round.weakest_h is not None
    assert set(all_round.weakest_h) == {0, len(yaws) - 1}
    sector = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=-5.0, azimuth_max_deg=340.0)
    cut_open = certify_poses(SCENARIO_2, demand(sector, overlap=0.1), row, rows)
    assert cut_open.min_overlap_h == pytest.approx(0.266, abs=1e-3)


def test_c3_includes_the_row_below_and_above() -> None:
    """The last image of the upper row meets nobody below; all those below are well covered from above."""
    attitudes = rotation([-14.0, 0.0, 14.0, -14.0, 0.0, 14.0, 28.0], [-6.0] * 3 + [6.0] * 4)
    band = Band(elevation_min_deg=-8.0, elevation_max_deg=8.0, azimuth_min_deg=-18.0, azimuth_max_deg=18.0)
    certificate = certify_poses(SCENARIO_2, demand(band), attitudes, [0] * 3 + [1] * 4)
    assert certificate.weakest_v == 6
    assert certificate.min_overlap_v == pytest.approx(0.1, abs=0.02)
    assert {line.split(":")[0] for line in certificate.failures} == {"C3"}
    assert certify_poses(SCENARIO_2, demand(band), attitudes[:6], [0] * 3 + [1] * 3).certified


def test_graph_includes_edges_that_only_the_tight_bound_proves() -> None:
    """Outer images of three share little more than 5 % in the worst case: too little for the rough bound to tell."""
    band = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=-12.0, azimuth_max_deg=12.0)
    first, second = np.array([0, 2]), np.array([2, 0])
    for half, held in ((9.4, True), (9.8, False)):
        row = rotation([-half, 0.0, half], [0.0] * 3)
        corners = ErrorCorners.of(SCENARIO_2, row, PAPER)
        assert not overlaps_at_least(corners, first, second, 0.05).any()
        assert (worst_pair_overlaps(corners, first, second).min() >= 0.05) is np.bool_(held)
        certificate = certify_poses(SCENARIO_2, demand(band, tolerance=PAPER), row, [0] * 3)
        assert certificate.connected
        assert certificate.two_edge_connected is held
        assert certificate.bridges == (() if held else ((0, 1), (1, 2)))


def test_mask_exempts_only_the_pair_across_it_from_c2() -> None:
    yaws = np.arange(20.0, 341.0, 16.0)
    row, rows = rotation(yaws, np.zeros(len(yaws))), [0] * len(yaws)
    gear = AngleBox(elevation_min_deg=-90.0, elevation_max_deg=90.0, azimuth_min_deg=-12.0, azimuth_max_deg=12.0)
    narrow = replace(gear, azimuth_min_deg=-8.0)
    good = certify_poses(SCENARIO_2, demand(full_circle(-5.0, 5.0), overlap=0.1, masks=(gear,)), row, rows)
    assert good.uncovered_fraction == 0.0
    assert good.min_overlap_h == pytest.approx(0.266, abs=1e-3)
    bad = certify_poses(SCENARIO_2, demand(full_circle(-5.0, 5.0), overlap=0.1, masks=(narrow,)), row, rows)
    assert bad.uncovered_fraction > 0
    assert bad.min_overlap_h == 0.0


def test_shots_are_named_by_their_index() -> None:
    shots = tuple(Shot(index=10 + k, row=0, pitch_deg=0.0, yaw_deg=yaw) for k, yaw in enumerate((-14.0, 0.0, 15.0)))
    band = Band(elevation_min_deg=-5.0, elevation_max_deg=5.0, azimuth_min_deg=-20.0, azimuth_max_deg=20.0)
    certificate = certify(Plan(method="foreign", camera=SCENARIO_2, constraints=demand(band, 0.5), shots=shots))
    assert certificate.weakest_h is not None
    assert set(certificate.weakest_h) == {11, 12}
    assert certificate.bridges == ((10, 11), (11, 12))


def test_measured_attitudes_are_judged_as_they_are() -> None:
    """Two neighbours that lean apart open a hole which the planned poses have not."""
    attitudes, rows = even_rows([(-10.0, 12)])
    camera = Camera.from_fov(40.0, 40.0)
    constraints = demand(full_circle(-27.0, 9.0), 0.05)
    assert certify_poses(camera, constraints, attitudes, rows).certified
    for roll, proven in ((0.5, True), (10.0, False)):
        measured = attitudes.copy()
        measured[4], measured[5] = rotation(120.0, -10.0, roll), rotation(150.0, -10.0, -roll)
        assert (certify_poses(camera, constraints, measured, rows).uncovered_fraction == 0.0) is proven


def test_result_without_explanation_agrees_with_the_full_one() -> None:
    attitudes, rows = even_rows([(-45.0, 10), (-10.0, 12)])
    for top, proven in ((5.0, True), (40.0, False)):
        constraints = demand(full_circle(-60.0, top))
        long = certify_poses(WIDE, constraints, attitudes, rows)
        short = certify_poses(WIDE, constraints, attitudes, rows, explain=False)
        assert (short.uncovered_fraction == 0.0) is (long.uncovered_fraction == 0.0) is proven
        assert short.certified is long.certified
        assert short.holes == ()


def test_rows_must_be_given_for_all_images() -> None:
    with pytest.raises(ValueError, match="2 poses with 1 row numbers"):
        certify_poses(WIDE, demand(full_circle(-10.0, 10.0)), rotation([0.0, 9.0], [0.0, 0.0]), [0])


@settings(max_examples=40, deadline=None)
@given(
    hfov=st.floats(25.0, 110.0),
    overlap=st.floats(0.1, 0.5),
    top=st.floats(-60.0, 90.0),
    tolerance=st.one_of(
        st.sampled_from([NO_TOLERANCE, PAPER]),
        st.builds(Tolerance, pitch_deg=st.floats(0.0, 2.0), roll_deg=st.floats(0.0, 2.0), yaw_deg=st.floats(0.0, 2.0)),
    ),
    guarantee=st.sampled_from(["coverage", "all"]),
    span=st.one_of(st.just(360.0), st.floats(60.0, 359.0)),
    seed=st.integers(0, 2**31),
)
def test_certified_plans_pass_random_pointing_errors(
    hfov: float, overlap: float, top: float, tolerance: Tolerance, guarantee: Guarantee, span: float, seed: int
) -> None:
    """Whatever the errors: no hole, the graph holds, and with `all` the overlaps do too."""
    camera = Camera.from_fov(hfov, hfov * 0.75)
    rng = np.random.default_rng(seed)
    layout = enough_rows(camera, overlap, top)
    attitudes, rows = even_rows(layout, rng.uniform(0, 360, len(layout)).tolist())
    band = Band(elevation_min_deg=-90.0, elevation_max_deg=top, azimuth_min_deg=-170.0, azimuth_max_deg=-170.0 + span)
    constraints = demand(band, 0.1, tolerance, guarantee)
    certificate = certify_poses(camera, constraints, attitudes, rows)
    assert certificate.certified == (not certificate.failures)
    for least, worst in (
        (certificate.min_overlap_h, certificate.worst_overlap_h),
        (certificate.min_overlap_v, certificate.worst_overlap_v),
    ):
        if least is not None:
            assert worst is not None
            assert 0 <= worst <= least
    if not certificate.certified:
        return
    directions = random_directions(1500, rng)
    directions = directions[in_domain(directions, band)]
    pairs = [(i, j) for i in range(len(rows)) for j in range(i) if rows[i] == rows[j]]
    for extreme in (True, False):
        taken = with_errors(attitudes, tolerance, rng, extreme=extreme)
        assert len(unseen(camera, taken, directions)) == 0
        assert len(attitudes) > 60 or holds_whatever_is_lost(camera, taken)
        if pairs and guarantee == "all" and certificate.min_overlap_h is not None and span == 360.0:
            # each image's two best partners in its row are its neighbours
            a, b = np.array(pairs).T
            overlap_with = np.zeros((len(rows), len(rows)))
            overlap_with[a, b] = pairwise_overlap(camera, taken[a], taken[b])
            overlap_with[b, a] = pairwise_overlap(camera, taken[b], taken[a])
            members = np.bincount(rows)[rows]
            second = np.sort(overlap_with, axis=1)[:, -2]
            assert second[members > 2].min(initial=1.0) >= 0.1 - 1e-9
