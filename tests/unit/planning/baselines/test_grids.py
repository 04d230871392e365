"""HDRpano's grid and the plans of the paper's Table 1."""

import pytest

from panoexec.errors import PlanningError, UsageError
from panoexec.inputs.camera_profiles import load_profile
from panoexec.optics import Camera
from panoexec.planning.baselines.hdrpano import plan_hdrpano
from panoexec.planning.baselines.published import A6000_35MM, PUBLISHED, X5S_15MM, X5S_45MM, published_plan
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Band, Constraints, GimbalLimits


def wanted(low: float = -90.0, high: float = 30.0, azimuth: tuple[float, float] = (-180, 180)) -> Constraints:
    band = Band(elevation_min_deg=low, elevation_max_deg=high, azimuth_min_deg=azimuth[0], azimuth_max_deg=azimuth[1])
    return Constraints(overlap_h=0.15, overlap_v=0.15, band=band)


@pytest.mark.parametrize(
    ("camera", "columns", "rows", "name"),
    [(X5S_15MM, 8, 4, "scenario-1-hdrpano"), (X5S_45MM, 21, 10, "scenario-2-hdrpano")],
)
def test_hdrpano_makes_both_of_its_published_plans(camera: Camera, columns: int, rows: int, name: str) -> None:
    plan = plan_hdrpano(camera, wanted(), columns, rows)
    assert plan.method == "hdrpano"
    assert plan.shots == published_plan(name).shots


def test_a_grid_that_does_not_reach_the_nadir_has_no_cap() -> None:
    plan = plan_hdrpano(X5S_15MM, wanted(-30, 30), 10, 2)
    assert [(pitch, len(shots)) for pitch, shots in plan.rows()] == [(-30, 9), (0, 10), (30, 10)]


def test_a_sector_takes_its_share_of_the_columns() -> None:
    plan = plan_hdrpano(X5S_15MM, wanted(-30, 30, azimuth=(0, 90)), 12, 2)
    assert [len(shots) for _, shots in plan.rows()] == [3, 3, 3]
    assert sorted(shot.yaw_deg for shot in plan.shots if shot.row == 1) == [15.0, 45.0, 75.0]


@pytest.mark.parametrize(("columns", "rows"), [(0, 4), (8, 0), (-1, 4), (10**9, 4), (1000, 1000)])
def test_invalid_grids_are_rejected(columns: int, rows: int) -> None:
    with pytest.raises(PlanningError, match=r"columns|rows"):
        plan_hdrpano(X5S_15MM, wanted(), columns, rows)


def test_grid_beyond_the_gimbal_limits_is_rejected() -> None:
    constraints = Constraints(
        overlap_h=0.15, overlap_v=0.15, band=wanted().band, gimbal=GimbalLimits(pitch_min_deg=-60)
    )
    with pytest.raises(PlanningError, match="the gimbal reaches -60"):
        plan_hdrpano(X5S_15MM, constraints, 8, 4)


@pytest.mark.parametrize(
    ("name", "images"),
    [
        ("scenario-1-proposed", 25),
        ("scenario-1-hdrpano", 28),
        ("scenario-2-proposed", 155),
        ("scenario-2-hdrpano", 161),
        ("scenario-3-proposed", 49),
    ],
)
def test_the_published_totals(name: str, images: int) -> None:
    plan = published_plan(name)
    assert len(plan.shots) == PUBLISHED[name].images == images
    assert plan.method == "published"
    assert plan.constraints.tolerance.yaw_deg == 0.667
    for pitch, shots in plan.rows():
        assert len({shot.row for shot in shots}) == 1
        yaws = sorted(shot.yaw_deg % 360 for shot in shots)
        assert yaws == pytest.approx([i * 360 / len(shots) for i in range(len(shots))])
        assert -90 <= pitch <= 30


def test_published_scenario_2_breaks_its_own_threshold_where_the_paper_does_not_say_so() -> None:
    certificate = certify(published_plan("scenario-2-proposed"))
    assert not certificate.certified
    assert certificate.min_overlap_h == pytest.approx(0.122, abs=0.001)
    assert certificate.uncovered_fraction == 0


def test_hdrpanos_scenario_2_has_the_hole_of_the_papers_figure_4() -> None:
    certificate = certify(published_plan("scenario-2-hdrpano"))
    assert not certificate.certified
    assert {round(hole.elevation_deg) for hole in certificate.holes} == {-74}


def test_unknown_plans_are_named() -> None:
    with pytest.raises(UsageError, match="scenario-2-hdrpano"):
        published_plan("scenario-4")


@pytest.mark.parametrize("camera", [X5S_15MM, X5S_45MM, A6000_35MM])
def test_the_papers_cameras_are_the_shipped_profiles(camera: Camera) -> None:
    assert load_profile(camera.name).camera.with_lens("nominal") == camera
