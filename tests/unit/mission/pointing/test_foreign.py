"""Another station that points the gimbal is told from a gimbal that is stuck, slow, shaken or badly calibrated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import rotation
from panoexec.mission.pointing.foreign import ForeignPointing
from panoexec.mission.pointing.poses import Reading

Pose = tuple[float, float]
"""Pitch, yaw."""
START, TARGET, THERE = (-10.0, 0.0), (-30.0, 60.0), (-70.0, 20.0)


def slew(*ways: Pose, wobble_deg: float = 0.0) -> list[Reading]:
    """From pose to pose, a second each, and two seconds at the last; 20 Hz."""
    corners = [*ways, ways[-1], ways[-1]]
    times = np.arange(0, len(corners) - 1, 0.05)
    pitch, yaw = (np.interp(times, range(len(corners)), [corner[i] for corner in corners]) for i in (0, 1))
    shake = wobble_deg * np.sin(7 * times)
    turned = rotation(yaw, pitch + shake)
    return [Reading(float(t), pose, math.nan) for t, pose in zip(times, turned, strict=True)]


def why(watch: ForeignPointing, readings: list[Reading], target: Pose = TARGET) -> str:
    return watch.failed(readings, commanded_s=0.0, pitch_deg=target[0], yaw_deg=target[1])


def test_a_gimbal_that_leaves_its_target_for_another_pose_is_pointed_by_another_station() -> None:
    reason = why(ForeignPointing(), slew(START, TARGET, THERE))
    assert reason.startswith("another station points the gimbal: it came to rest at pitch -70.0°, yaw 20.0°, ")


def test_so_is_one_that_turns_back_on_its_way() -> None:
    assert why(ForeignPointing(), slew(THERE, (-50.0, 40.0), THERE))


def test_one_that_does_not_leave_that_pose_any_more_still_is() -> None:
    watch = ForeignPointing()
    assert not why(watch, slew(THERE, THERE)), "it may be stuck"
    assert why(watch, slew(START, TARGET, THERE))
    assert why(watch, slew(THERE, THERE), (10.0, -100.0))
    watch.settled()
    assert not why(watch, slew(THERE, THERE), (10.0, -100.0))


@pytest.mark.parametrize(
    "ways",
    [
        [(-30.0, 0.0), (-30.0, 60.0), (-30.0, 60.0), (-30.0, 95.0)],
        [(-30.0, 0.0), (-30.0, 40.0), (-30.0, -50.0)],
        [(-30.0, 150.0), (-30.0, 190.0), (-30.0, 100.0)],
    ],
    ids=["rests at its target and leaves it", "turns back", "turns back beyond south"],
)
def test_so_is_one_that_leaves_its_way_in_yaw_alone(ways: list[Pose]) -> None:
    assert why(ForeignPointing(), slew(*ways))


@pytest.mark.parametrize(
    "readings",
    [
        slew(START, (-20.0, 30.0)),
        slew(START, START),
        slew(START, (-30.0, 60.0), (-30.0, 95.0)),
        slew((-30.0, 0.0), (-30.0, 0.0), (-30.0, 95.0)),
        slew((-30.0, 0.0), (-30.0, 80.0), (-30.0, 74.0)),
        slew(START, TARGET, (-27.0, 62.0)),
        slew(START, TARGET, THERE)[:45],
        slew(START, TARGET, THERE, wobble_deg=2.0),
        [],
    ],
    ids=[
        "stuck on its way",
        "never moved",
        "north off",
        "north off, late",
        "overshoots",
        "little beside",
        "still moving",
        "shaken",
        "silent",
    ],
)
def test_no_other_fault_is_taken_for_it(readings: list[Reading]) -> None:
    assert not why(ForeignPointing(), readings)


@given(
    start=st.tuples(st.floats(-90, 30), st.floats(-170, 170)),
    way=st.floats(0.0, 1.0),
)
def test_a_gimbal_that_is_stuck_anywhere_on_its_way_is_never_taken_for_it(start: Pose, way: float) -> None:
    stuck = (start[0] + way * (TARGET[0] - start[0]), start[1] + way * (TARGET[1] - start[1]))
    assert not why(ForeignPointing(), slew(start, stuck))
