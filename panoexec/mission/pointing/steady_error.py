"""Recognises a gimbal that comes to rest beside its commands, so that a tolerance that it cannot hold is refused.

A gimbal whose controller leaves an error, or whose reports have coarse steps, never settles within a tolerance that is
smaller. It is at rest then, with the same error at every pose: unlike one that is stuck, disturbed or still moving.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from panoexec.angles import angle_between, direction
from panoexec.devices import SteadyError
from panoexec.mission.pointing.poses import Reading
from panoexec.planning.geometry.pose_error import pose_error
from panoexec.planning.model import Tolerance

AT_REST_S: Final = 1.0
"""The last part of a failed wait in which the gimbal must be at rest."""
_LEAST_READINGS: Final = 5
_REST_SPREAD_DEG: Final = 0.25
"""Largest spread of each error at rest: noise and steps of a report."""
_SAME_DEG: Final = 0.2
"""Errors of two poses that differ by less (or by a third of them, up to `_SAME_MOST_DEG`) have the same cause."""
_SAME_MOST_DEG: Final = 2.0
_POSES_APART_DEG: Final = 3.0
_POSES: Final = 2
MOST_TRIMMED_DEG: Final = 5.0
"""A larger steady error is a fault, not an inaccuracy."""


def describe(steady: SteadyError) -> str:
    """The error in words: `pitch +0.30°, yaw -0.31°`, axes of 0.02° and more."""
    named = [
        f"{axis} {value:+.2f}°"
        for axis, value in zip(("pitch", "roll", "yaw"), steady.mean_deg, strict=True)
        if abs(value) >= 0.02
    ]
    return ", ".join(named) or "0.00°"


def error_at_rest(readings: Sequence[Reading], *, pitch_deg: float, yaw_deg: float) -> SteadyError | None:
    """The errors of a gimbal at rest; None if it is not, or if that cannot be told.

    Args:
        readings: oldest first; the last `AT_REST_S` seconds are judged.
        pitch_deg: of the target.
        yaw_deg: of the target, in the frame of the readings.
    """
    if not readings:
        return None
    last = [reading for reading in readings if reading.time_s >= readings[-1].time_s - AT_REST_S]
    poses = [reading.rotation for reading in last if reading.rotation is not None]
    if len(poses) < len(last) or len(poses) < _LEAST_READINGS:
        return None
    errors = pose_error(pitch_deg, yaw_deg, np.stack(poses))
    axes = [np.asarray(values) for values in (errors.pitch_deg, errors.roll_deg, errors.yaw_deg)]
    if any(float(np.ptp(values)) > _REST_SPREAD_DEG for values in axes):
        return None
    pitch, roll, yaw = (float(np.mean(values)) for values in axes)
    hold = [float(np.max(np.abs(values))) for values in axes]
    return SteadyError(mean_deg=(pitch, roll, yaw), hold_deg=(hold[0], hold[1], hold[2]))


class SteadyErrorWatch:
    """Takes the poses at which a gimbal did not settle, until one settles.

    Attributes:
        found: the error that it had at several poses; None as long as it had none.
    """

    def __init__(self) -> None:
        self.found: SteadyError | None = None
        self._poses: list[tuple[float, float, SteadyError]] = []

    def settled(self) -> None:
        """A pose was reached within tolerance: errors seen before do not show what the gimbal can hold."""
        self._poses.clear()

    def failed(self, at_rest: SteadyError | None, *, pitch_deg: float, yaw_deg: float) -> None:
        """A pose was not reached within tolerance; `at_rest` is None if the gimbal did not come to rest."""
        if at_rest is None:
            self._poses.clear()
            return
        poses = [pose for pose in self._poses if _same(pose[2], at_rest)]
        if all(_apart_deg(pose[:2], (pitch_deg, yaw_deg)) >= _POSES_APART_DEG for pose in poses):
            poses.append((pitch_deg, yaw_deg, at_rest))
        self._poses = poses
        if len(poses) >= _POSES:
            self.found = at_rest


def cannot_hold(steady: SteadyError, tolerance: Tolerance) -> str:
    """Why a gimbal with this error cannot hold a tolerance, and what to set; "" if it can."""
    limits = (tolerance.pitch_deg, tolerance.roll_deg, tolerance.yaw_deg)
    keys = [
        (f"tolerance_{axis}_deg", limit, proposed(hold))
        for axis, limit, hold in zip(("pitch", "roll", "yaw"), limits, steady.hold_deg, strict=True)
        if hold > limit
    ]
    if not keys:
        return ""
    has = ", ".join(f"{name} = {limit:g}" for name, limit, _ in keys)
    needs = ", ".join(f"{name} = {value:g}" for name, _, value in keys)
    if max(map(abs, steady.mean_deg)) > MOST_TRIMMED_DEG:
        return (
            f"the gimbal comes to rest {describe(steady)} beside its commands, at every pose: calibrate it (its compass"
            " or its mounting), no tolerance mends that"
        )
    return (
        f"the gimbal comes to rest with a steady error of {describe(steady)}: it cannot hold {has}; set"
        f" [pointing] {needs} or more, or trim the gimbal"
    )


def proposed(hold_deg: float) -> float:
    """A tolerance for a gimbal whose readings at rest are within `hold_deg`: half as much again, in tenths."""
    return max(math.ceil(15 * hold_deg - 1e-6) / 10, 0.1)


def _same(one: SteadyError, other: SteadyError) -> bool:
    return all(
        abs(a - b) <= max(_SAME_DEG, min(abs(a) / 3, _SAME_MOST_DEG))
        for a, b in zip(one.mean_deg, other.mean_deg, strict=True)
    )


def _apart_deg(one: tuple[float, float], other: tuple[float, float]) -> float:
    return float(angle_between(direction(*one), direction(*other)))
