"""The pointing gate: from what a gimbal reports to a verdict on its pose. Pure logic over attitude samples.

A sample says where the camera looks relative to the earth, to the vehicle's heading or to its airframe; `read_pose`
composes it with the vehicle's attitude of the same moment and turns it into the plan's frame (yaw 0 = the plan's
reference). `SettleTracker` says when a pose has been inside tolerance and still for long enough; `judge_window` checks
every sample of an exposure afterwards. What a pose error is, is defined in one place, `panoexec.planning.pose_error`.

Missing, late, not finite, or flagged by the device: each is out of tolerance, with a reason. A sample counts from the
moment it arrived, which is later than when it was measured by the delay of the link.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from panoexec.angles import (
    FloatArray,
    angle_between,
    quaternion_from_rotation,
    rotation_from_quaternion,
    wrap_180,
    yaw_pitch_roll,
)
from panoexec.devices import AttitudeFeed, AttitudeSample, Quaternion, VehicleAttitude, YawFrame
from panoexec.events import AxisErrors, MeasuredPose
from panoexec.planning.model import Tolerance
from panoexec.planning.pose_error import PoseError, pose_error

GIMBAL_FAILURES: dict[int, str] = {
    8: "encoder error",
    16: "power error",
    32: "motor error",
    64: "software error",
    128: "communication error",
    256: "calibration running",
}
"""GIMBAL_DEVICE_ERROR_FLAGS that make a pose untrustworthy; the others (at a limit, no manager) do not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Where a shot must point, in the plan's frame; roll is 0.

    Attributes:
        pitch_deg: positive up.
        yaw_deg: clockwise from the plan's reference.
        tolerance: of each axis.
    """

    pitch_deg: float
    yaw_deg: float
    tolerance: Tolerance


@dataclass(frozen=True, slots=True)
class Reading:
    """A sample made comparable: a rotation in the plan's frame, or the reason why there is none.

    Attributes:
        time_s: when it arrived.
        rotation: camera to plan frame (3, 3), None with a problem.
        rate_deg_s: angular speed, NaN if not told.
        problem: why it cannot be used, "" if it can.
    """

    time_s: float
    rotation: FloatArray | None
    rate_deg_s: float
    problem: str = ""


def heading_deg(vehicle: VehicleAttitude) -> float:
    """Heading of the airframe's nose, clockwise from north: the yaw of the 3-2-1 angles, as autopilots state it."""
    w, x, y, z = vehicle.q_wxyz
    return math.degrees(math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))


def read_pose(sample: AttitudeSample, vehicle: VehicleAttitude | None, reference_yaw_north_deg: float) -> Reading:
    """The camera's attitude in the plan's frame.

    Args:
        sample: as the gimbal reports it.
        vehicle: the airframe's attitude at that moment, needed unless the sample is earth-fixed.
        reference_yaw_north_deg: direction of the plan's yaw 0, clockwise from true north.

    Returns:
        A reading; with a problem when the sample is not finite, flagged, or cannot be composed.
    """
    problem = _device_problem(sample) or ("" if _is_attitude(sample.q_wxyz) else _NO_NUMBER.format("gimbal"))
    turn_deg = -reference_yaw_north_deg
    q = sample.q_wxyz
    if not problem and sample.yaw_frame is not YawFrame.EARTH:
        if vehicle is None:
            problem = "no attitude of the vehicle to compose the gimbal's with"
        elif not _is_attitude(vehicle.q_wxyz):
            problem = _NO_NUMBER.format("vehicle")
        elif sample.yaw_frame is YawFrame.BODY:
            q = _product(vehicle.q_wxyz, q)
        else:
            turn_deg += heading_deg(vehicle)
    if problem:
        return Reading(sample.received_s, None, sample.rate_deg_s, problem)
    half = math.radians(turn_deg) / 2
    return Reading(
        sample.received_s, _matrix(_product((math.cos(half), 0.0, 0.0, math.sin(half)), q)), sample.rate_deg_s
    )


_NO_NUMBER = "the {} reports an attitude that is not a number"


def _is_attitude(q: Quaternion) -> bool:
    """Whether a quaternion is finite and not zero."""
    norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    return 1e-18 < norm < math.inf


# With plain floats, as this is done for every sample at 50 Hz: a tenth of the time of the array functions, which the
# tests hold it to.


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation `b` followed by `a` (Hamilton)."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _matrix(q: Quaternion) -> FloatArray:
    """The rotation matrix of a quaternion of any length but 0."""
    w, x, y, z = q
    s = 2 / (w * w + x * x + y * y + z * z)
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
        ]
    )


def readings_since(feed: AttitudeFeed, since_s: float, reference_yaw_north_deg: float) -> list[Reading]:
    """Readings of all samples that arrived after `since_s`, oldest first."""
    return [
        read_pose(sample, feed.vehicle_attitude_at(sample), reference_yaw_north_deg) for sample in feed.since(since_s)
    ]


def _device_problem(sample: AttitudeSample) -> str:
    names = [name for flag, name in GIMBAL_FAILURES.items() if sample.failure_flags & flag]
    return f"the gimbal reports: {', '.join(names)}" if names else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SettleLimits:
    """What settled means.

    Attributes:
        settle_s: how long every sample must have been inside tolerance.
        max_rate_deg_s: largest angular speed.
        max_gap_s: longest silence between samples that still proves something.
    """

    settle_s: float
    max_rate_deg_s: float
    max_gap_s: float


class SettleTracker:
    """Fed with readings in the order they arrive, it says whether the pose is settled now.

    Where the gimbal tells no angular speed, the speed is that from the oldest to the newest reading of the settle
    time, so that encoder noise does not look like motion.
    """

    def __init__(self, *, target: Target, limits: SettleLimits) -> None:
        self._target = target
        self._limits = limits
        self._inside: deque[Reading] = deque()
        self._inside_since = math.nan
        self._newest = math.nan
        self._last: PoseError | None = None
        self._rate = math.nan
        self._problem: str | None = "no attitude sample arrived"

    @property
    def problem(self) -> str:
        """Why the newest reading is not inside tolerance and still; "" when it is."""
        if self._problem is None and self._last is not None:  # put into words only when somebody asks
            self._problem = describe_error(self._last, self._target.tolerance)
        return self._problem or ""

    @property
    def inside_since_s(self) -> float:
        """When the unbroken run of good readings began; NaN outside one."""
        return self._inside_since

    @property
    def settled_at_s(self) -> float:
        """When the settle time is over if nothing changes; NaN while the newest reading is bad."""
        return self._inside_since + self._limits.settle_s

    def is_settled(self, now_s: float) -> bool:
        """Whether every sample has been inside tolerance, and slow, for the settle time, and the newest is fresh."""
        return self.settled_at_s <= now_s + 1e-9 and not self.is_stale(now_s)

    @property
    def error(self) -> PoseError | None:
        """The newest pose error; None without a usable reading."""
        return self._last

    def add(self, reading: Reading) -> None:
        """Take the next reading."""
        silent = reading.time_s - self._newest
        self._newest = reading.time_s
        self._problem = self._judge(reading)
        bad = self._problem != ""
        if bad or silent > self._limits.max_gap_s:
            self._inside.clear()
            self._inside_since = math.nan
        if bad:
            return
        if math.isnan(self._inside_since):
            self._inside_since = reading.time_s
        self._inside.append(reading)
        while len(self._inside) > 2 and self._inside[1].time_s <= reading.time_s - self._limits.settle_s:
            self._inside.popleft()

    def is_stale(self, now_s: float) -> bool:
        """Whether the newest reading is too old to say where the gimbal is at `now_s`."""
        return not now_s - self._newest <= self._limits.max_gap_s

    def _judge(self, reading: Reading) -> str | None:
        """What is wrong with a reading: "" nothing, None that it is out of tolerance."""
        if reading.rotation is None:
            self._last = None
            return reading.problem
        self._last = error = pose_error(self._target.pitch_deg, self._target.yaw_deg, reading.rotation)
        if not bool(error.within(self._target.tolerance)):
            return None
        rate = self._rate_deg_s(reading)
        if rate > self._limits.max_rate_deg_s:
            return f"still turning at {rate:.1f}°/s (at most {self._limits.max_rate_deg_s:g}°/s)"
        return ""

    def _rate_deg_s(self, reading: Reading) -> float:
        if not math.isnan(reading.rate_deg_s):
            return reading.rate_deg_s
        oldest = self._inside[0] if self._inside else None
        if oldest is None or oldest.rotation is None or reading.rotation is None:
            return 0.0
        elapsed = reading.time_s - oldest.time_s
        if elapsed < min(0.1, self._limits.settle_s):
            return 0.0
        turned = pose_error(0.0, 0.0, oldest.rotation.T @ reading.rotation)
        return (
            math.sqrt(sum(float(v) ** 2 for v in (turned.across_deg, turned.along_deg, turned.rotation_deg))) / elapsed
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowVerdict:
    """The verdict on an exposure.

    Attributes:
        ok: every moment of the window is proven inside tolerance.
        reason: why not, with figures; "" when ok.
        code: `pointing` (out of tolerance) or `no_samples` (not proven); "" when ok.
        samples: how many were judged.
        measured: mean attitude of the usable samples; None without one.
        errors: the worst of each error over the usable samples; None likewise.
        spread_deg: the largest boresight angle between a usable sample and the first: how far it moved.
    """

    ok: bool
    reason: str
    code: str
    samples: int
    measured: MeasuredPose | None
    errors: AxisErrors | None
    spread_deg: float = math.nan


def judge_window(
    readings: Iterable[Reading], *, target: Target, start_s: float, end_s: float, max_gap_s: float
) -> WindowVerdict:
    """Judge every reading of an exposure.

    The window is proven when a reading lies close before its start, none is out of tolerance, and no part of the
    window longer than `max_gap_s` is without one: what needs longer than that to leave the tolerance and to come back
    has been seen.

    Args:
        readings: oldest first; those well before or after the window are ignored.
        target: the pose asked for.
        start_s: the earliest moment the shutter may have opened.
        end_s: the latest moment it may have closed.
        max_gap_s: longest silence that still proves something.
    """
    ordered = list(readings)
    before = [r for r in ordered if start_s - max_gap_s <= r.time_s <= start_s][-1:]
    judged = before + [r for r in ordered if start_s < r.time_s <= end_s]
    usable = [r.rotation for r in judged if r.rotation is not None]
    errors = pose_error(target.pitch_deg, target.yaw_deg, np.stack(usable)) if usable else None
    code = reason = ""
    if len(usable) < len(judged):
        code, reason = "no_samples", next(r.problem for r in judged if r.rotation is None)
    elif errors is not None and not bool(np.all(errors.within(target.tolerance))):
        code, reason = "pointing", describe_error(errors, target.tolerance)
    elif not before:
        code, reason = "no_samples", f"no attitude sample in the {max_gap_s:g} s before the exposure"
    else:
        times = [start_s, *(r.time_s for r in judged[1:]), end_s]
        gap = max(b - a for a, b in itertools.pairwise(times))
        if gap > max_gap_s:
            code = "no_samples"
            reason = f"no attitude sample for {gap:.2f} s of the exposure (at most {max_gap_s:g} s)"
    return WindowVerdict(
        ok=not reason,
        reason=reason,
        code=code,
        samples=len(judged),
        measured=mean_pose(usable) if usable else None,
        errors=worst_errors(errors) if errors is not None else None,
        spread_deg=max(float(angle_between(usable[0][:, 0], r[:, 0])) for r in usable) if usable else math.nan,
    )


def worst_errors(errors: PoseError) -> AxisErrors:
    """The largest of each error by magnitude, with its sign."""

    def worst(values: FloatArray) -> float:
        flat = np.atleast_1d(values)
        return float(flat[int(np.argmax(np.abs(flat)))])

    return AxisErrors(
        pitch_deg=worst(errors.pitch_deg),
        roll_deg=worst(errors.roll_deg),
        yaw_deg=worst(errors.yaw_deg),
        across_deg=worst(errors.across_deg),
        along_deg=worst(errors.along_deg),
        rotation_deg=worst(errors.rotation_deg),
        boresight_deg=worst(errors.boresight_deg),
    )


def mean_pose(rotations: Sequence[FloatArray]) -> MeasuredPose:
    """The mean of attitudes that lie close together (sum of quaternions of one sign, normalised)."""
    q = quaternion_from_rotation(np.stack(rotations))
    q = np.where((q @ q[0])[:, None] < 0, -q, q).sum(axis=0)
    return pose_of(rotation_from_quaternion(q))


def pose_of(matrix: FloatArray) -> MeasuredPose:
    """A rotation as quaternion and gimbal angles."""
    yaw, pitch, roll = yaw_pitch_roll(matrix)
    w, x, y, z = (float(v) for v in quaternion_from_rotation(matrix))
    return MeasuredPose(q_wxyz=(w, x, y, z), roll_deg=float(roll), pitch_deg=float(pitch), yaw_deg=float(yaw))


def describe_error(errors: PoseError, tolerance: Tolerance) -> str:
    """The axes that are out of tolerance, worst first: `yaw off by +1.30° (at most 0.667°)`."""
    worst = worst_errors(errors)
    axes = [
        ("pitch", worst.pitch_deg, tolerance.pitch_deg),
        ("roll", worst.roll_deg, tolerance.roll_deg),
        ("yaw", worst.yaw_deg, tolerance.yaw_deg),
    ]
    out = [axis for axis in axes if not abs(axis[1]) <= axis[2]]
    out.sort(key=lambda axis: abs(axis[1]) - axis[2], reverse=True)
    return ", ".join(f"{name} off by {value:+.3g}° (at most {limit:g}°)" for name, value, limit in out)


def to_north(yaw_deg: float, reference_yaw_north_deg: float) -> float:
    """A yaw of the plan's frame as yaw from true north, [-180, 180)."""
    return float(wrap_180(yaw_deg + reference_yaw_north_deg))
