"""The gimbal's attitude samples converted to the plan's frame, or the reason why a sample is unusable.

A sample is relative to the earth, to the vehicle's heading or to its airframe; `read_pose` composes it with the
vehicle's attitude of the same time and converts it to the plan's frame (yaw 0 = the plan's reference). A sample that
cannot be composed, is not finite, is flagged by the device or is frozen is unusable, and its reading says why.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from panoexec.angles import (
    FloatArray,
    quaternion_from_rotation,
    rotation_from_quaternion,
    wrap_180,
    yaw_pitch_roll,
)
from panoexec.devices import AttitudeFeed, AttitudeSample, Quaternion, VehicleAttitude, YawFrame
from panoexec.mission.log.events import MeasuredPose

GIMBAL_FAILURES: dict[int, str] = {
    8: "encoder error",
    16: "power error",
    32: "motor error",
    64: "software error",
    128: "communication error",
    256: "calibration running",
}
"""GIMBAL_DEVICE_ERROR_FLAGS that make a pose unusable; the others (at a limit, no manager) do not."""


RATE_INTERVALS = 16
"""Number of intervals between samples from which the rate of the stream is told."""


@dataclass(frozen=True, slots=True)
class Reading:
    """A sample converted to the plan's frame, or the reason why it is unusable.

    Attributes:
        time_s: when it arrived.
        rotation: camera to plan frame (3, 3), None with a problem.
        rate_deg_s: angular speed, NaN if not reported.
        problem: why the sample is unusable, "" if it is usable.
        axis_rates_deg_s: of pitch, roll and yaw, NaN if not reported.
    """

    time_s: float
    rotation: FloatArray | None
    rate_deg_s: float
    problem: str = ""
    axis_rates_deg_s: tuple[float, float, float] = (math.nan, math.nan, math.nan)


def heading_deg(vehicle: VehicleAttitude) -> float:
    """Heading of the airframe, clockwise from north: the yaw of the 3-2-1 angles, as autopilots report it."""
    w, x, y, z = vehicle.q_wxyz
    return math.degrees(math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))


def read_pose(sample: AttitudeSample, vehicle: VehicleAttitude | None, reference_yaw_north_deg: float) -> Reading:
    """The camera's attitude in the plan's frame.

    Args:
        sample: as the gimbal reports it.
        vehicle: the airframe's attitude at that time, required unless the sample is earth-fixed.
        reference_yaw_north_deg: direction of the plan's yaw 0, clockwise from true north.

    Returns:
        A reading; with a problem when the sample is not finite, flagged, or cannot be composed.
    """
    problem = _device_problem(sample) or ("" if _is_attitude(sample.q_wxyz) else _NOT_FINITE.format("gimbal"))
    turn_deg = -reference_yaw_north_deg
    q = sample.q_wxyz
    if not problem and sample.yaw_frame is not YawFrame.EARTH:
        if vehicle is None:
            problem = "no vehicle attitude at the time of the gimbal's sample"
        elif not _is_attitude(vehicle.q_wxyz):
            problem = _NOT_FINITE.format("vehicle")
        elif sample.yaw_frame is YawFrame.BODY:
            q = _product(vehicle.q_wxyz, q)
        else:
            turn_deg += heading_deg(vehicle)
    if problem:
        return Reading(sample.received_s, None, sample.rate_deg_s, problem)
    half = math.radians(turn_deg) / 2
    matrix = _matrix(_product((math.cos(half), 0.0, 0.0, math.sin(half)), q))
    return Reading(sample.received_s, matrix, sample.rate_deg_s, axis_rates_deg_s=sample.axis_rates_deg_s)


_NOT_FINITE = "the {} reports a non-finite attitude"


def _is_attitude(q: Quaternion) -> bool:
    """Whether a quaternion is finite and not zero."""
    norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    return 1e-18 < norm < math.inf


# Plain floats, because this runs for every sample at 50 Hz: they take a tenth of the time of the array functions, which
# a test checks.


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


class PoseReader:
    """Converts the samples of one feed to readings, and detects a frozen device.

    A gimbal that measures never reports equal samples in succession, unless its output is quantised or echoes the
    setpoint. So once `LEARN_PAIRS` successive pairs have shown that this gimbal does not repeat itself, `FROZEN_RUN`
    equal samples in a row count as frozen, even with new time stamps.

    Args:
        feed: the gimbal's reports.
        reference_yaw_north_deg: direction of the plan's yaw 0, clockwise from true north.
    """

    LEARN_PAIRS = 50
    REPEATS_FRAC = 0.1
    HELD_FRAC = 0.4
    FROZEN_RUN = 4

    def __init__(self, *, feed: AttitudeFeed, reference_yaw_north_deg: float) -> None:
        self._feed = feed
        self._reference = reference_yaw_north_deg
        self._readings: deque[Reading] = deque(maxlen=2048)
        self._newest_s = -math.inf
        self._newest: AttitudeSample | None = None
        self._last: Quaternion | None = None
        self._run = 1
        self._pairs = 0
        self._repeats = 0
        self._intervals: deque[float] = deque(maxlen=RATE_INTERVALS)

    @property
    def interval_s(self) -> float:
        """Median time between the newest samples, seconds; NaN before there are enough."""
        if len(self._intervals) < RATE_INTERVALS // 2:
            return math.nan
        return sorted(self._intervals)[len(self._intervals) // 2]

    @property
    def late_s(self) -> float:
        """See `AttitudeFeed.late_s`."""
        return self._feed.late_s

    @property
    def holds(self) -> bool:
        """Whether samples are known to be repeated until something new is known: what they tell is of earlier."""
        return self._pairs >= RATE_INTERVALS // 2 and self._repeats > self.HELD_FRAC * self._pairs

    @property
    def measures(self) -> bool:
        """Whether the device is known not to repeat samples."""
        return self._pairs >= self.LEARN_PAIRS and self._repeats <= self.REPEATS_FRAC * self._pairs

    def since(self, since_s: float) -> list[Reading]:
        """Readings of all samples that arrived after `since_s`, oldest first; ingests what has arrived."""
        self._feed.ingest()
        self._read_new(since_s)
        newer = []
        for reading in reversed(self._readings):
            if reading.time_s <= since_s:
                break
            newer.append(reading)
        return newer[::-1]

    def _read_new(self, since_s: float) -> None:
        # samples long before `since_s` are not composed; a second earlier is read to detect runs of equal samples.
        # Samples may share a time stamp, so the position is found by the identity of the newest sample
        samples = list(self._feed.since(max(self._newest_s, since_s - 1.0) - 1e-9))
        known = next((i for i, sample in enumerate(samples) if sample is self._newest), -1)
        for sample in samples[known + 1 :]:
            if known >= 0 or self._newest is not None:
                self._intervals.append(sample.received_s - self._newest_s)
            self._newest, self._newest_s = sample, sample.received_s
            reading = read_pose(sample, self._feed.vehicle_attitude_at(sample), self._reference)
            self._readings.append(self._checked(sample.q_wxyz, reading))

    def _checked(self, q: Quaternion, reading: Reading) -> Reading:
        if reading.rotation is None:
            self._last, self._run = None, 1
            return reading
        measured_before = self.measures
        if self._last is not None:
            self._run = self._run + 1 if q == self._last else 1
            # a run that is known to be frozen must not count as normal repetition
            if not (measured_before and self._run >= self.FROZEN_RUN):
                self._pairs += 1
                self._repeats += q == self._last
        self._last = q
        if not (measured_before and self._run >= self.FROZEN_RUN):
            return reading
        return Reading(
            reading.time_s, None, reading.rate_deg_s, "the gimbal's attitude is frozen: it repeats one value"
        )


def readings_since(feed: AttitudeFeed, since_s: float, reference_yaw_north_deg: float) -> list[Reading]:
    """Readings of all samples that arrived after `since_s`, oldest first."""
    return PoseReader(feed=feed, reference_yaw_north_deg=reference_yaw_north_deg).since(since_s)


def _device_problem(sample: AttitudeSample) -> str:
    names = [name for flag, name in GIMBAL_FAILURES.items() if sample.failure_flags & flag]
    return f"the gimbal reports: {', '.join(names)}" if names else ""


def mean_pose(rotations: FloatArray) -> MeasuredPose:
    """The mean of attitudes (n, 3, 3) that are close together (sum of sign-aligned quaternions, normalised)."""
    q = quaternion_from_rotation(rotations)
    q = np.where((q @ q[0])[:, None] < 0, -q, q).sum(axis=0)
    return pose_of(rotation_from_quaternion(q))


def pose_of(matrix: FloatArray) -> MeasuredPose:
    """A rotation as quaternion and gimbal angles."""
    yaw, pitch, roll = yaw_pitch_roll(matrix)
    w, x, y, z = (float(v) for v in quaternion_from_rotation(matrix))
    return MeasuredPose(q_wxyz=(w, x, y, z), roll_deg=float(roll), pitch_deg=float(pitch), yaw_deg=float(yaw))


def to_north(yaw_deg: float, reference_yaw_north_deg: float) -> float:
    """Convert a yaw of the plan's frame to yaw from true north, [-180, 180)."""
    return float(wrap_180(yaw_deg + reference_yaw_north_deg))
