"""Headings of the vehicle: every shot is reachable, with as few headings as possible."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import wrap_180
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.model import GimbalLimits, Shot, Timing, Turning
from panoexec.planning.order.duration import estimate, slew_time_s, turn_times_s
from panoexec.planning.order.shot_order import order_shots
from panoexec.planning.order.vehicle_yaw import PanReach, heading_for, heading_groups, headings_deg
from panoexec.planning.reach import check_reachable

TURNING = Turning()
TWO_AXES = GimbalLimits(yaw_min_deg=0.0, yaw_max_deg=0.0, yaw_endless=False, turning=TURNING)
LITTLE = GimbalLimits(yaw_min_deg=-40.0, yaw_max_deg=40.0, yaw_endless=False, turning=TURNING)
MUCH = GimbalLimits(yaw_min_deg=-160.0, yaw_max_deg=160.0, yaw_endless=False, turning=TURNING)
YAWS = st.lists(st.integers(-180, 179).map(float), min_size=1, max_size=9)
HALVES = st.sampled_from([0.0, 10.0, 30.0, 75.0, 150.0])


def a_sphere() -> list[Shot]:
    rows = ((-90.0, 1), (-55.0, 6), (-15.0, 8), (20.0, 8))
    poses = [(row, pitch, 360.0 * k / n - 180) for row, (pitch, n) in enumerate(rows) for k in range(n)]
    return [Shot(index=i, row=row, pitch_deg=pitch, yaw_deg=yaw) for i, (row, pitch, yaw) in enumerate(poses)]


def turns(shots: tuple[Shot, ...], limits: GimbalLimits) -> int:
    headings = headings_deg([shot.yaw_deg for shot in shots], limits)
    return int(np.sum(np.abs(wrap_180(np.diff(headings))) > 0.01))


def test_the_reach_is_the_pan_range_less_its_margins() -> None:
    assert PanReach.of(TWO_AXES) == PanReach(centre_deg=0.0, half_deg=0.0)
    assert PanReach.of(LITTLE) == PanReach(centre_deg=0.0, half_deg=30.0)
    narrow = GimbalLimits(yaw_min_deg=0.0, yaw_max_deg=20.0, yaw_endless=False, turning=TURNING)
    assert PanReach.of(narrow) == PanReach(centre_deg=10.0, half_deg=5.0)
    assert PanReach.of(GimbalLimits()).half_deg == 180.0


def test_two_axis_gimbal_points_along_the_nose() -> None:
    assert heading_for([30.0, 60.0], 0.0, PanReach.of(TWO_AXES)) == pytest.approx(30.0)
    assert headings_deg([30.0, 30.0, -170.0, 170.0], TWO_AXES) == pytest.approx([30.0, 30.0, -170.0, 170.0])


def test_vehicle_turns_only_beyond_reach_and_to_the_heading_for_most_next_shots() -> None:
    reach = PanReach.of(LITTLE)
    assert heading_for([25.0, 200.0], 0.0, reach) == 0.0
    # 60° is 30° out of reach; from 90° on the next two are within it too, and 120° is not to be had with 60°
    assert heading_for([60.0, 90.0, 120.0, 150.0], 0.0, reach) == pytest.approx(90.0)
    assert heading_for([60.0], 0.0, reach) == pytest.approx(30.0), "for one shot no farther than it must"
    assert heading_for([-170.0, 170.0], 100.0, reach) == pytest.approx(160.0), "the short way through the back"


@given(yaws=YAWS, half=HALVES, heading=st.floats(-180, 179), centre=st.sampled_from([0.0, 20.0]))
def test_every_shot_is_reached_from_the_heading_found_for_it(
    yaws: list[float], half: float, heading: float, centre: float
) -> None:
    reach = PanReach(centre_deg=centre, half_deg=half)
    for number in range(len(yaws)):
        turned = heading_for(yaws[number:], heading, reach)
        assert reach.has(yaws[number], turned)
        if reach.has(yaws[number], heading):
            assert turned == heading
        heading = turned


@settings(max_examples=60)
@given(yaws=st.lists(st.integers(-18, 17).map(lambda k: 10.0 * k), min_size=1, max_size=7), half=HALVES)
def test_heading_groups_contain_each_shot_once_and_are_minimal(yaws: list[float], half: float) -> None:
    groups = heading_groups(yaws, PanReach(centre_deg=0.0, half_deg=half))
    assert sorted(int(i) for group in groups for i in group) == list(range(len(yaws)))
    for group in groups:
        assert (yaws[group[-1]] - yaws[group[0]]) % 360.0 <= 2 * half + 0.011

    def serves(headings: tuple[float, ...]) -> bool:
        return all(any(abs(float(wrap_180(yaw - h))) <= half + 0.006 for h in headings) for yaw in yaws)

    # a heading at which some shot is at the end of the reach is as good as any other
    candidates = sorted({float(wrap_180(yaw + half)) for yaw in yaws})
    fewest = next(
        k
        for k in range(1, len(yaws) + 1)
        if any(serves(headings) for headings in itertools.combinations(candidates, k))
    )
    assert len(groups) == fewest


@pytest.mark.parametrize(("limits", "fewest"), [(TWO_AXES, 17), (LITTLE, 6), (MUCH, 1)])
def test_the_fastest_order_makes_the_fewest_turns_and_goes_once_round(limits: GimbalLimits, fewest: int) -> None:
    shots = a_sphere()
    ordered = order_shots(shots, limits, Timing())
    assert sorted((s.pitch_deg, s.yaw_deg) for s in ordered) == sorted((s.pitch_deg, s.yaw_deg) for s in shots)
    assert [shot.index for shot in ordered] == list(range(len(shots)))
    found = turns(ordered, limits)
    others = [turns(order_shots(shots, limits, Timing(), order=o), limits) for o in ("rows", "columns", "nadir-first")]
    assert found <= min(others)
    distinct = len(heading_groups([s.yaw_deg for s in shots], PanReach.of(limits)))
    assert found == distinct - 1 <= fewest
    headings = headings_deg([s.yaw_deg for s in ordered], limits)
    assert float(np.abs(wrap_180(np.diff(headings))).sum()) <= 360.0


def test_time_of_a_turn_and_of_no_turn() -> None:
    # 90° at 45°/s with 90°/s²: 2 s and half a second of ramps, and it comes to rest
    assert float(turn_times_s(TURNING, 90.0)) == pytest.approx(2.5 + TURNING.settle_s)
    slew = {"from_pitch_deg": 0.0, "to_pitch_deg": 0.0}
    assert slew_time_s(TWO_AXES, from_yaw_deg=170.0, to_yaw_deg=-100.0, **slew) == pytest.approx(2.5 + TURNING.settle_s)
    assert slew_time_s(TWO_AXES, from_yaw_deg=5.0, to_yaw_deg=5.0, **slew) == 0.0


def test_the_estimate_counts_the_turns_under_a_gimbal_that_pans() -> None:
    camera = Camera.from_fov(60.0, 45.0)
    shots = order_shots(a_sphere(), LITTLE, Timing(interval_s=0.0))
    free = GimbalLimits()
    with_turns = estimate(shots, camera, LITTLE, Timing(interval_s=0.0)).duration_s
    without = estimate(shots, camera, free, Timing(interval_s=0.0)).duration_s
    assert without + 4 * TURNING.settle_s < with_turns < without + 6 * (4.0 + TURNING.settle_s)


def test_a_grid_beyond_the_pan_range_is_refused_unless_the_vehicle_may_turn() -> None:
    still = GimbalLimits(yaw_min_deg=-40.0, yaw_max_deg=40.0, yaw_endless=False)
    with pytest.raises(PlanningError, match="pans from -40 to 40"):
        check_reachable(a_sphere()[7:], still)
    check_reachable(a_sphere()[7:], LITTLE)
