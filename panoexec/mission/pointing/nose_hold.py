"""Recognises a vehicle that cannot hold its heading within the tolerance of a plan, where that is the camera's yaw.

A nose sways in wind about its set point, and a vehicle that is badly tuned shakes. Both are told from a wait in which
the pose did not settle: by how far the heading strayed from its own mean (the mean is corrected, see `heading`), and by
its speed. What happens at one heading alone may be a gust; at two, it is the vehicle in this wind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from panoexec.angles import wrap_180, yaw_pitch_roll
from panoexec.mission.pointing.poses import Reading
from panoexec.mission.pointing.steady_error import proposed

HEADING_CODE: Final = "heading"
"""Code of the hold."""
JUDGED_S: Final = 5.0
"""The last part of a failed wait that is judged; it is longer than the sway's period (ArduCopter: 3 s)."""
LEAST_S: Final = 2.0
HEADINGS: Final = 2
APART_DEG: Final = 10.0
ATTEMPTS: Final = 4
"""How many waits in a row must have failed: more than one shot is tried at once, so that it is seen at two headings."""
_SPEED_OVER_S: Final = 0.1
_MOST: Final = (2.5, 97.5)
"""Percentiles of the yaw."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoseMotion:
    """How a heading moved about its mean.

    Attributes:
        sway_deg: half of the range in which 95 % of the samples are.
        speed_deg_s: median speed, over 0.1 s.
    """

    sway_deg: float
    speed_deg_s: float


def motion_of(readings: Sequence[Reading], *, since_s: float) -> NoseMotion | None:
    """How the camera's yaw moved; None if there are too few samples.

    Args:
        readings: oldest first; the last `JUDGED_S` seconds of those after `since_s` are judged.
        since_s: when the turn had ended.
    """
    last = [r for r in readings if r.time_s >= since_s and r.rotation is not None]
    last = [r for r in last if r.time_s >= last[-1].time_s - JUDGED_S]
    if not last or last[-1].time_s - last[0].time_s < LEAST_S:
        return None
    times = np.array([r.time_s for r in last])
    yaws = np.unwrap(
        np.asarray(yaw_pitch_roll(np.stack([r.rotation for r in last if r.rotation is not None]))[0]), period=360.0
    )
    after = np.searchsorted(times, times + _SPEED_OVER_S)
    at = np.flatnonzero(after < len(times))
    if not len(at):
        return None
    speeds = np.abs(yaws[after[at]] - yaws[at]) / (times[after[at]] - times[at])
    sway = np.diff(np.percentile(yaws, _MOST)).item() / 2
    return NoseMotion(sway_deg=float(sway), speed_deg_s=float(np.median(speeds)))


class NoseHold:
    """Takes the waits of a mission in which the pose did not settle, until one settles."""

    def __init__(self) -> None:
        self._failed: list[tuple[int, float, NoseMotion]] = []

    @property
    def shots(self) -> tuple[int, ...]:
        """The shots that failed, in the order of their first failure."""
        return tuple(dict.fromkeys(shot for shot, _, _ in self._failed))

    def settled(self) -> None:
        """A pose was reached and held, or the operator has resumed the mission."""
        self._failed.clear()

    def failed(self, motion: NoseMotion | None, *, shot: int, yaw_deg: float) -> None:
        """A pose was not held; `motion` is None if the heading is not known well enough."""
        if motion is not None:
            self._failed.append((shot, yaw_deg, motion))

    def cannot_hold(self, tolerance_yaw_deg: float, max_rate_deg_s: float) -> str:
        """Why this vehicle cannot hold that tolerance now, and what to plan with; "" if it may."""
        headings: list[float] = []
        for _, yaw, _ in self._failed:
            if all(abs(float(wrap_180(yaw - other))) >= APART_DEG for other in headings):
                headings.append(yaw)
        if len(headings) < HEADINGS or len(self._failed) < ATTEMPTS:
            return ""
        motions = [motion for _, _, motion in self._failed]
        speed = min(motion.speed_deg_s for motion in motions)
        where = f"at {len(headings)} headings ({len(motions)} attempts in a row)"
        if speed > max_rate_deg_s:
            return (
                f"the vehicle's heading moves at {speed:.0f}°/s {where}, at most {max_rate_deg_s:g}°/s are allowed: it"
                " shakes or turns; check its tuning and its frame type, or wait for less wind, then resume"
            )
        if min(motion.sway_deg for motion in motions) <= tolerance_yaw_deg:
            return ""
        sway = max(motion.sway_deg for motion in motions)
        return (
            f"the vehicle holds its heading within {math.ceil(10 * sway - 1e-6) / 10:g}° only, {where}: it cannot hold"
            f" tolerance_yaw_deg = {tolerance_yaw_deg:g}; plan with {proposed(sway):g} or more, or wait for less wind,"
            " then resume"
        )
