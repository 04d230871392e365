"""The survey's judge: it passes plans that are right, and finds each kind of fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from panoexec.angles import rotation
from panoexec.inputs.camera_profiles import load_profile
from panoexec.lens.distortion import Distortion
from panoexec.optics import Camera
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import AngleBox, Band, Constraints, Plan, Tolerance
from panoexec.planning.search.planner import plan_certified
from panoexec.planning.skyline import Skyline
from tests.support.plan_judge import Raster, holds_without_any_edge, violations

WIDE = Camera.from_fov(59.94, 46.86)
LENS = replace(load_profile("dji-x5s-15mm").camera, distortion=Distortion(k1=-0.12, k2=0.03), fov_margin=0.004)
ASKED = Constraints(
    overlap_h=0.15,
    overlap_v=0.15,
    band=Band(elevation_min_deg=-60.0, elevation_max_deg=20.0),
    tolerance=Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7),
)
GEAR = AngleBox(elevation_min_deg=-60.0, elevation_max_deg=10.0, azimuth_min_deg=170.0, azimuth_max_deg=-100.0)
SECTOR = Band(elevation_min_deg=-30.0, elevation_max_deg=20.0, azimuth_min_deg=120.0, azimuth_max_deg=-130.0)


def kinds(lines: list[str]) -> set[str]:
    return {line.partition(":")[0] for line in lines}


@pytest.fixture(scope="module")
def plan() -> Plan:
    return plan_certified(WIDE, ASKED)


@pytest.mark.parametrize(
    ("camera", "constraints"),
    [
        (WIDE, ASKED),
        (WIDE, replace(ASKED, guarantee="all")),
        (WIDE, replace(ASKED, masks=(GEAR,))),
        (WIDE, replace(ASKED, textured_below=Skyline(((-90.0, 25.0), (90.0, 8.0))))),
        (WIDE, replace(ASKED, band=SECTOR)),
        (LENS, ASKED),
    ],
    ids=["plain", "all errors", "mask", "sky", "sector across 180", "distorted"],
)
def test_a_certified_plan_is_right(camera: Camera, constraints: Constraints) -> None:
    found = plan_certified(camera, constraints)
    assert found.certificate is not None
    assert found.certificate.certified
    assert violations(found) == []


def test_a_missing_image_and_a_weak_demand_are_found(plan: Plan) -> None:
    assert "C1" in kinds(violations(replace(plan, shots=plan.shots[1:])))
    certificate = plan.certificate
    assert certificate is not None
    least_h, least_v = certificate.min_overlap_h, certificate.min_overlap_v
    assert least_h is not None
    assert least_v is not None
    for change, kind in (({"overlap_h": least_h + 0.01}, "C2"), ({"overlap_v": least_v + 0.01}, "C3")):
        more = replace(plan, constraints=replace(plan.constraints, **change))  # type: ignore[arg-type]
        assert kinds(violations(more)) == {kind}


def test_what_holds_at_the_planned_poses_alone_is_no_guarantee_for_all_errors(plan: Plan) -> None:
    certificate = plan.certificate
    assert certificate is not None
    assert certificate.min_overlap_h is not None
    assert certificate.worst_overlap_h is not None
    assert certificate.worst_overlap_h < certificate.min_overlap_h - 0.01
    asked = replace(plan.constraints, overlap_h=certificate.min_overlap_h - 0.002)
    assert violations(replace(plan, constraints=asked)) == []
    assert "C2" in kinds(violations(replace(plan, constraints=replace(asked, guarantee="all"))))


def test_a_chain_and_parted_images_are_found() -> None:
    chain = [(k, k + 1) for k in range(5)]
    assert not holds_without_any_edge(range(6), chain)
    assert holds_without_any_edge(range(6), [*chain, (5, 0)])
    assert not holds_without_any_edge(range(6), [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3)])
    assert not holds_without_any_edge(range(6), [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3)])


def test_wrong_marks_of_the_sky_are_found() -> None:
    found = plan_certified(WIDE, replace(ASKED, textured_below=Skyline.level(-25.0)))
    marked = [shot for shot in found.shots if shot.geometry_only]
    assert marked
    shots = tuple(replace(shot, geometry_only=False) for shot in found.shots)
    assert "sky" in kinds(violations(replace(found, shots=shots)))


def test_the_raster_is_as_exact_as_its_slack() -> None:
    raster = Raster.of(WIDE, np.random.default_rng(4))
    own, others = rotation(0.0, -20.0), rotation([40.0, -35.0], [-25.0, 10.0])
    one, both = pairwise_overlap(WIDE, own, others[0]), union_overlap(WIDE, own[None], others[None])[0]
    assert raster.seen(WIDE, own, others[:1]) == pytest.approx(float(one), abs=0.002)
    assert raster.seen(WIDE, own, others) == pytest.approx(float(both), abs=0.002)
