"""Decides from slews whether a gimbal's reports are measured, or repeat the command.

PX4 with a gimbal on AUX outputs, ArduPilot with a servo or PWM mount and some gimbals themselves report the angles that
were demanded. Such reports agree with the target whatever the camera does, so they prove nothing. What gives them away
is dynamics: a gimbal takes time for a slew and is seen on the way, an echo is at the target with its next report.

A slew shows an echo if two successive reports, from beside the start to beside the target, are closer in time than any
gimbal could move (`FASTEST_DEG_S2`; for reports that equal the target, `USUAL_DEG_S2`). One slew of reports that equal
the target decides, two decide otherwise, unless as many slews showed the gimbal on its way. Reports that move, but come
to rest exactly at the target again and again, are an echo as well: a measurement has noise.

Pitch and yaw are judged for themselves, too: where a servo tilts a camera and a motor with an encoder pans it, only the
pan is measured, and its motion proves nothing about the tilt.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from panoexec.angles import FloatArray, rotation, wrap_180
from panoexec.mission.pointing.poses import Reading

LEAST_SLEW_DEG: Final = 10.0
"""Shorter slews are not judged: with ten reports a second a fast gimbal may not be seen on the way."""
FASTEST_DEG_S2: Final = 3000.0
"""No gimbal with a camera accelerates faster."""
USUAL_DEG_S2: Final = 800.0
"""No usual gimbal accelerates faster."""
EXACT_DEG: Final = 1e-3
"""Reports within this angle of the target equal it: single precision leaves 1e-5 to 1e-4°."""
EXACT_POSES: Final = 4
"""At so many poses in a row a moving echo is recognised by its exactness."""
LEAST_TIMED_DEG: Final = 4.0
"""Shorter slews do not tell the age of reports."""
MOVED_DEG: Final = 1.0
"""A report that is so much nearer to the target shows motion; the sway of a hovering vehicle is less."""
STARTS_DEG_S2: Final = 240.0
"""Acceleration at which a gimbal is taken to start."""
_DELAYS: Final = 9
_LATELY: Final = 3
_BESIDE_FRAC: Final = 0.15
"""Within this fraction of a slew, a report is beside its start or its target."""
_MIDDLE_FRAC: Final = 1.0 - math.sqrt(2 * _BESIDE_FRAC)
"""Fraction of the duration of a slew (full acceleration, then full braking) that its middle part takes."""
_POSES_APART_DEG: Final = 2.0
_LEVEL_DEG: Final = 60.0
"""A yaw is judged for itself up to this pitch: towards the vertical it is hardly told from roll."""


@dataclass(frozen=True, slots=True)
class _Slew:
    """What the reports of one slew show."""

    jumped: bool = False
    moved: bool = False
    exact: bool = False
    seconds: float = math.nan
    angle_deg: float = math.nan


@dataclass(slots=True)
class _Shown:
    """How many slews were seen to jump in one angle, and how many to move."""

    jumps: int = 0
    moves: int = 0


class EchoWatch:
    """Judges the slews of one gimbal; `reason` tells its finding.

    Args:
        reason: a finding of earlier, or of the configuration of the autopilot; "" for none.
    """

    def __init__(self, reason: str = "") -> None:
        self.reason = reason
        """Why the reports are an echo; "" as long as they are not known to be one."""
        self._delays: list[float] = []
        self._shown = {"": _Shown(), "pitch": _Shown(), "yaw": _Shown()}
        self._exact: list[FloatArray] = []

    @property
    def has_moved(self) -> bool:
        """Whether a slew has shown the gimbal on its way, as only a measurement (or a simulated one) does."""
        return any(shown.moves for shown in self._shown.values())

    @property
    def delay_s(self) -> float:
        """Time from a command to the first report of its motion, the median of the slews so far; NaN before the first.

        The time that the motion itself takes is taken off; what is left is latency of commands and age of reports.
        """
        return sorted(self._delays)[len(self._delays) // 2] if self._delays else math.nan

    @property
    def longest_delay_s(self) -> float:
        """The longest of the last delays, which a stream that falls behind lengthens at once; NaN before the first."""
        return max(self._delays[-_LATELY:], default=math.nan)

    def slew(
        self,
        readings: Sequence[Reading],
        *,
        commanded_s: float,
        pitch_deg: float,
        yaw_deg: float,
        yaw_follows: bool = False,
    ) -> bool:
        """Judge one slew; returns whether it showed the age of the reports.

        Args:
            readings: oldest first, from before the command until the pose was reached, or was given up.
            commanded_s: when it was commanded.
            pitch_deg: of the target, roll 0.
            yaw_deg: of the target, in the frame of the readings.
            yaw_follows: the vehicle's heading sets the yaw, so only the pitch shows the gimbal.
        """
        if self.reason:
            return False
        usable = [reading for reading in readings if reading.rotation is not None]
        first = max((i for i, reading in enumerate(usable) if reading.time_s <= commanded_s), default=-1)
        usable = usable[max(first, 0) :]
        if len(usable) < 2 or first < 0:
            return False
        times = np.array([reading.time_s for reading in usable])
        poses = np.stack([reading.rotation for reading in usable if reading.rotation is not None])
        target = rotation(yaw_deg, pitch_deg)
        to_target = _angles(poses, target)
        from_start = _angles(poses, poses[0])
        shows_age = self._note_delay(times, to_target, commanded_s)
        self._note_exact(target, exact=bool(to_target[-1] <= EXACT_DEG) and not yaw_follows)
        pitches = np.degrees(np.arcsin(np.clip(-poses[:, 2, 0], -1.0, 1.0)))
        yaws = np.degrees(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
        slews = {"pitch": _judged(times, abs(pitches - pitches[0]), abs(pitches - pitch_deg))}
        if not yaw_follows:
            slews[""] = _judged(times, from_start, to_target)
            if max(float(np.max(abs(pitches))), abs(pitch_deg)) <= _LEVEL_DEG:
                slews["yaw"] = _judged(times, abs(wrap_180(yaws - yaws[0])), abs(wrap_180(yaws - yaw_deg)))
        self._count(slews)
        return shows_age

    def _note_delay(self, times: FloatArray, to_target: FloatArray, commanded_s: float) -> bool:
        nearer = np.flatnonzero((to_target < to_target[0] - MOVED_DEG) & (times > commanded_s))
        arrived = to_target[-1] <= _BESIDE_FRAC * to_target[0]  # else nothing tells which motion the command caused
        if to_target[0] < LEAST_TIMED_DEG or not len(nearer) or not arrived:
            return False
        travel_s = math.sqrt(2 * MOVED_DEG / STARTS_DEG_S2)
        self._delays.append(max(float(times[nearer[0]]) - commanded_s - travel_s, 0.0))
        del self._delays[:-_DELAYS]
        return True

    def _note_exact(self, target: FloatArray, *, exact: bool) -> None:
        if not exact:
            self._exact.clear()
        elif all(_angles(target[None], old)[0] >= _POSES_APART_DEG for old in self._exact):
            self._exact.append(target)
        if len(self._exact) >= EXACT_POSES:
            self.reason = (
                f"at {len(self._exact)} poses in a row its reports equal the command within {EXACT_DEG:g}°, without"
                " any noise: they repeat the command, they are not measured"
            )

    def _count(self, slews: Mapping[str, _Slew]) -> None:
        """Take a slew as it was seen in each angle; "" is that of the whole pose."""
        echoed = {}
        for axis, slew in slews.items():
            shown = self._shown[axis]
            shown.moves += slew.moved
            shown.jumps += slew.jumped
            if slew.jumped and shown.jumps >= (1 if slew.exact else 2) and shown.jumps > shown.moves:
                echoed[axis] = slew
        if echoed:
            axis = "" if "" in echoed else max(echoed, key=lambda one: echoed[one].angle_deg)
            self.reason = (
                f"a slew of {echoed[axis].angle_deg:.0f}°{axis and f' in {axis}'} took"
                f" {1000 * echoed[axis].seconds:.0f} ms in its reports, which no gimbal can do: they repeat the"
                " command, they are not measured"
            )


def _judged(times: FloatArray, from_start: FloatArray, to_target: FloatArray) -> _Slew:
    """What one slew shows in one angle.

    Args:
        times: of the readings (n,), seconds; the first is from before the command.
        from_start: angle of each from the first reading, degrees.
        to_target: angle of each from the target, degrees.
    """
    angle = float(to_target[0])
    if angle < LEAST_SLEW_DEG:
        return _Slew()
    arrived = np.flatnonzero(to_target <= _BESIDE_FRAC * angle)
    if not len(arrived):
        return _Slew()
    last = int(arrived[0])
    at_start = np.flatnonzero(from_start[:last] <= _BESIDE_FRAC * angle)
    start = int(at_start[-1]) if len(at_start) else 0
    if last - start > 1:
        return _Slew(moved=True, angle_deg=angle)
    seconds = float(times[last] - times[start])
    is_exact = bool(np.all(to_target[last:] <= EXACT_DEG))
    fastest = USUAL_DEG_S2 if is_exact else FASTEST_DEG_S2
    jumped = seconds < _MIDDLE_FRAC * 2 * math.sqrt(angle / fastest)
    return _Slew(jumped=jumped, exact=is_exact, seconds=seconds, angle_deg=angle)


def _angles(poses: FloatArray, other: FloatArray) -> FloatArray:
    """Rotation angles (n,) between attitudes (n, 3, 3) and one (3, 3), degrees; accurate for small ones, too."""
    chord = np.linalg.norm(poses - other, axis=(1, 2)) / math.sqrt(8.0)
    return np.asarray(np.degrees(2 * np.arcsin(np.clip(chord, 0.0, 1.0))))
