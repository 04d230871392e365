"""Readings of a gimbal's attitude for tests of the gate, and the target that they are held to."""

from __future__ import annotations

from panoexec.angles import FloatArray, quaternion_from_rotation, rotation
from panoexec.devices import AttitudeSample, Quaternion, YawFrame
from panoexec.mission.pointing.poses import (
    Reading,
)
from panoexec.mission.pointing.tolerance_gate import (
    SettleLimits,
    Target,
    judge_window,
)
from panoexec.planning.model import Tolerance

NAN = float("nan")


TOLERANCE = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.5)


TARGET = Target(pitch_deg=-30.0, yaw_deg=100.0, tolerance=TOLERANCE)


LIMITS = SettleLimits(settle_s=0.2, max_rate_deg_s=2.0, max_gap_s=0.1)


def quaternion_of(matrix: FloatArray) -> Quaternion:
    w, x, y, z = (float(v) for v in quaternion_from_rotation(matrix))
    return w, x, y, z


def sample_of(matrix: FloatArray, frame: YawFrame = YawFrame.EARTH, **more: float) -> AttitudeSample:
    flags = int(more.get("failure_flags", 0))
    return AttitudeSample(1.0, 1.0, quaternion_of(matrix), frame, more.get("rate", 0.0), flags)


def reading_at(t: float, *, pitch: float = 0.0, roll: float = 0.0, yaw: float = 0.0, rate: float = 0.0) -> Reading:
    """A reading off the target by these errors."""
    return Reading(t, rotation(TARGET.yaw_deg + yaw, TARGET.pitch_deg + pitch, roll), rate)


def judged(readings: list[Reading], start: float = 1.0, end: float = 1.2) -> tuple[bool, str, str]:
    verdict = judge_window(readings, target=TARGET, start_s=start, end_s=end, max_gap_s=0.1)
    return verdict.ok, verdict.code, verdict.reason


def stream_of(start: float = 0.8, end: float = 1.5, step: float = 0.02) -> list[Reading]:
    return [reading_at(round(start + i * step, 6)) for i in range(round((end - start) / step) + 1)]
