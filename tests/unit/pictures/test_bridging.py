"""Bridge shots are halfway, within the gimbal's limits, only where there is something to tie, and as few as needed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import angle_between, rotation
from panoexec.pictures.bridging import LEAST_CORNERS, Bank, bridge_poses, halfway
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.model import PhotoToCheck
from panoexec.planning.model import Plan, Shot
from tests.support.photo_sets import PhotoSet, photo_set
from tests.unit.pictures.conftest import CAMERA, SCENE, plan_of

FREE = (-90.0, 90.0)


def bank(yaw: float, group: int, *, pitch: float = 0.0, corners: int = 400) -> Bank:
    """A photo with corners everywhere."""
    rng = np.random.default_rng(1)
    y = rng.uniform(-1, 1, corners) * CAMERA.half_width
    z = rng.uniform(-1, 1, corners) * CAMERA.half_height
    rays = np.stack([np.ones(corners), y, z], axis=1)
    return Bank(rotation=rotation(yaw, pitch), rays=rays, group=group)


@given(
    yaws=st.tuples(st.floats(-180, 180), st.floats(-180, 180)),
    pitches=st.tuples(st.floats(-89, 89), st.floats(-89, 89)),
)
def test_halfway_is_on_the_great_circle_between_the_boresights(
    yaws: tuple[float, float], pitches: tuple[float, float]
) -> None:
    first, second = (rotation(yaw, pitch) for yaw, pitch in zip(yaws, pitches, strict=True))
    apart = float(angle_between(first[:, 0], second[:, 0]))
    pose = halfway(first, second, FREE)
    if apart > 179.9:
        return
    assert pose is not None
    middle = rotation(pose[1], pose[0])[:, 0]
    for end in (first, second):
        assert float(angle_between(end[:, 0], middle)) == pytest.approx(apart / 2, abs=1e-4)


def test_opposite_boresights_have_no_halfway_and_limits_are_kept() -> None:
    assert halfway(rotation(0, 0), rotation(180, 0), FREE) is None
    pose = halfway(rotation(-60, 40), rotation(60, 40), (-90.0, 45.0))
    assert pose is not None
    assert pose[0] == 45.0, "the great circle rises to 59°"
    assert pose[1] == pytest.approx(0.0, abs=1e-9)
    straight_down = halfway(rotation(30, -60), rotation(-150, -60), FREE)
    assert straight_down is not None
    assert straight_down[0] == pytest.approx(-90.0)


def test_groups_are_connected_by_as_few_bridges_as_needed() -> None:
    banks = {0: bank(0, 0), 1: bank(50, 0), 2: bank(110, 1), 3: bank(170, 2)}
    found = bridge_poses(CAMERA, banks, most=9)
    assert sorted(one.between for one in found) == [(1, 2), (2, 3)]
    assert {round(one.yaw_deg) for one in found} == {80, 140}
    assert len(bridge_poses(CAMERA, banks, most=1)) == 1
    tried = {frozenset((1, 2)), frozenset((2, 3))}
    others = {one.between for one in bridge_poses(CAMERA, banks, tried=tried, most=9)}
    assert others == {(0, 2)}, "the next best, not those again; 1 and 3 are too far apart for a photo between them"


def test_nothing_is_bridged_that_is_tied_or_has_nothing_to_tie() -> None:
    assert bridge_poses(CAMERA, {0: bank(0, 0), 1: bank(50, 0)}, most=9) == []
    assert bridge_poses(CAMERA, {0: bank(0, 0), 1: bank(60, 1, corners=LEAST_CORNERS - 1)}, most=9) == []
    assert bridge_poses(CAMERA, {}, most=9) == []
    # a limit that keeps the gimbal away from both
    assert bridge_poses(CAMERA, {0: bank(0, 0), 1: bank(60, 1)}, pitch_deg=(-90.0, -60.0), most=9) == []


def gap_plan() -> Plan:
    """Two pairs of photos that do not overlap each other."""
    shots = ((-58.0, 0), (-8.0, 1), (72.0, 2), (122.0, 3))
    plan = plan_of({-30.0: 4})
    return Plan(
        method="certified",
        camera=plan.camera,
        constraints=plan.constraints,
        shots=tuple(Shot(index=index, row=0, pitch_deg=-30.0, yaw_deg=yaw) for yaw, index in shots),
    )


def examined(photos: PhotoSet) -> Examiner:
    examiner = Examiner(photos.camera)
    for photo in photos.photos:
        examiner.add(PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s), photo.content)
    return examiner


def test_photos_that_share_too_little_are_bridged_and_then_tied() -> None:
    plan = gap_plan()
    examiner = examined(photo_set(plan, seed=4, **SCENE))
    assert len(examiner.verdicts(final=True).graph.groups) == 2
    (bridge,) = examiner.bridges(most=4)
    assert bridge.between == (1, 2)
    more = Plan(
        method="certified",
        camera=plan.camera,
        constraints=plan.constraints,
        shots=(*plan.shots, Shot(index=4, row=-1, pitch_deg=bridge.pitch_deg, yaw_deg=bridge.yaw_deg)),
    )
    after = examined(photo_set(more, seed=4, **SCENE))
    graph = after.verdicts(final=True).graph
    assert {(1, 4), (2, 4)} <= {(a, b) for a, b, _ in graph.edges}
    assert graph.connected
    assert after.bridges(most=4) == []


def test_water_is_not_bridged(two_rows: Plan) -> None:
    examiner = examined(photo_set(two_rows, seed=3, kind="lake", **SCENE))
    verdicts = examiner.verdicts(final=True)
    assert verdicts.graph.geometry_only
    wished = {shot for one in examiner.bridges(most=9) for shot in one.between}
    assert not wished & set(verdicts.graph.geometry_only)
