"""The pointing gate: verdicts on poses. Pure logic over readings of the gimbal's attitude (`poses`).

`SettleTracker` determines when a pose has been inside tolerance and slow for long enough; `judge_window` checks every
reading of an exposure afterwards. Pose errors are defined in `planning.geometry.pose_error`.

A missing, late or unusable reading counts as out of tolerance, with a reason. A reading counts from its arrival, which
is later than its measurement by the delay of the link.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from panoexec.angles import (
    FloatArray,
    angle_between,
)
from panoexec.mission.log.events import AxisErrors, MeasuredPose
from panoexec.mission.pointing.foresight import Foresight, axis_errors
from panoexec.mission.pointing.poses import Reading, mean_pose
from panoexec.mission.pointing.rate_bias import RateBias
from panoexec.mission.pointing.unseen_motion import DENSE_GAP_S, unseen_error
from panoexec.planning.geometry.pose_error import PoseError, pose_error
from panoexec.planning.model import Tolerance

FORESEEN_FROM_S = 0.25
"""The speed at which a pose goes on is that of the readings of this time: noise of encoders has little part in it."""
GUST_FROM_S = 0.1
"""The same for a gimbal in a gust, which turns about within half a period of its control loop (4 Hz)."""
KICK = 3.0
"""A pose that is off by more times the tolerance may swing again."""
SPARSE_INTERVALS = 2.5
"""A stream may have gaps of so many of its own intervals: one message is lost now and then."""


def allowed_gap_s(interval_s: float, *, max_gap_s: float) -> float:
    """The longest gap that a stream may have during an exposure.

    Args:
        interval_s: between its samples; NaN if unknown.
        max_gap_s: configured.

    Returns:
        `DENSE_GAP_S`, or more for a stream that is slower by nature; never more than `max_gap_s`.
    """
    own_s = SPARSE_INTERVALS * interval_s if math.isfinite(interval_s) else 0.0
    return min(max_gap_s, max(DENSE_GAP_S, own_s))


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """The target pose of a shot, in the plan's frame; roll is 0.

    Attributes:
        pitch_deg: positive up.
        yaw_deg: clockwise from the plan's reference.
        tolerance: of each axis.
    """

    pitch_deg: float
    yaw_deg: float
    tolerance: Tolerance


@dataclass(frozen=True, slots=True, kw_only=True)
class SettleLimits:
    """What settled means.

    Attributes:
        settle_s: how long every sample must have been inside tolerance.
        max_rate_deg_s: largest angular speed.
        max_gap_s: longest gap between samples.
        foresee_s: for how long from now on the pose must stay inside tolerance, at its present speed; 0: not judged.
        gust_s: the same, of the moment of the trigger alone.
        again_s: what takes the place of `settle_s` when a pose that was settled is out of tolerance, by no more than
            `KICK` times of it: the swing of the slew is over.
        use_reported_rate: whether to use the angular speed that the device reports; else it is computed from the
            attitudes. Without a pan axis the reported one contains the airframe's vibration.
    """

    settle_s: float
    max_rate_deg_s: float
    max_gap_s: float
    foresee_s: float = 0.0
    gust_s: float = 0.0
    again_s: float = math.inf
    use_reported_rate: bool = True


class SettleTracker:
    """Determines from readings, in order of arrival, whether the pose is settled.

    If the gimbal reports no angular speed, it is computed from the oldest to the newest reading of the settle time, so
    that encoder noise does not look like motion.
    """

    def __init__(self, *, target: Target, limits: SettleLimits, bias: RateBias | None = None) -> None:
        self._target = target
        self._limits = limits
        self._inside: deque[Reading] = deque()
        self._inside_since = math.nan
        self._newest = math.nan
        self._last: PoseError | None = None
        span_s = FORESEEN_FROM_S if limits.foresee_s else GUST_FROM_S if limits.gust_s else 0.0
        self._bias = bias or RateBias()
        self._foresight = Foresight(target.tolerance, span_s, self._bias)
        self._leaving_s = -math.inf
        self._held = False
        self._run_s = limits.settle_s  # how long the current run of good readings must be
        self._problem: str | None = "no attitude sample received"

    @property
    def problem(self) -> str:
        """Why the newest reading is not inside tolerance and slow; "" if it is."""
        if self._problem is None and self._last is not None:  # formatted only when needed
            self._problem = describe_error(self._last, self._target.tolerance)
        return self._problem or ""

    @property
    def inside_since_s(self) -> float:
        """Start of the current run of good readings; NaN if the newest one is bad."""
        return self._inside_since

    @property
    def settled_at_s(self) -> float:
        """End of the settle time if all further readings are good; NaN if the newest one is bad."""
        if math.isnan(self._inside_since):
            return math.nan
        return max(self._inside_since + self._run_s, self._leaving_s)

    @property
    def needed_s(self) -> float:
        """How long every sample must be inside tolerance from the next one on, if the newest one is not."""
        return min(self._limits.settle_s, self._limits.again_s) if self._held else self._limits.settle_s

    def is_settled(self, now_s: float) -> bool:
        """Whether every sample has been inside tolerance, and slow, for the settle time, and the newest is fresh."""
        return self.settled_at_s <= now_s + 1e-9 and not self.is_stale(now_s)

    def is_calm(self, now_s: float) -> bool:
        """Whether no gust is about to take a pose out of the tolerance that is settled, and may be triggered now.

        Asked when nothing else holds the trigger: how long a calm moment is waited for counts from the first time.
        """
        age_s = max(0.0, now_s - self._newest)
        if not self._limits.gust_s or not self._foresight.is_gusty(self._limits.gust_s + age_s):
            return True
        self._leaving_s = self._newest
        return False

    @property
    def error(self) -> PoseError | None:
        """The newest pose error; None without a usable reading."""
        return self._last

    def add(self, *readings: Reading) -> None:
        """Take the next readings; a batch costs little more than a single one."""
        usable = [reading.rotation for reading in readings if reading.rotation is not None]
        errors = pose_error(self._target.pitch_deg, self._target.yaw_deg, np.stack(usable)) if usable else None
        inside = iter([] if errors is None else errors.within(self._target.tolerance).tolist())
        axes = iter([] if errors is None else axis_errors(errors))
        if errors is not None and self._held and not np.all(errors.within(self._target.tolerance.times(KICK))):
            self._held = False
        for reading in readings:
            if reading.rotation is None:
                self._foresight.clear()
                self._bias.interrupt()
                self._take(reading, inside=False)
                continue
            off, is_inside = next(axes), next(inside)
            if self._foresight.keeps:
                self._foresight.add(reading.time_s, off, reading.axis_rates_deg_s)
            if is_inside:
                self._bias.note(reading.time_s, off, reading.axis_rates_deg_s)
            else:
                self._bias.interrupt()
            self._take(reading, inside=is_inside)
        if readings:
            self._last = None if errors is None or readings[-1].rotation is None else errors[-1]

    def _take(self, reading: Reading, *, inside: bool) -> None:
        silent = reading.time_s - self._newest
        self._newest = reading.time_s
        self._problem = self._judge(reading, inside=inside)
        bad = self._problem != ""
        if bad or silent > self._limits.max_gap_s:
            self._inside.clear()
            self._inside_since = math.nan
            self._held = self._held and reading.rotation is not None and silent <= self._limits.max_gap_s
        if bad:
            return
        if math.isnan(self._inside_since):
            self._inside_since, self._run_s = reading.time_s, self.needed_s
        self._held |= reading.time_s - self._inside_since >= self._limits.settle_s - 1e-9
        self._inside.append(reading)
        while len(self._inside) > 2 and self._inside[1].time_s <= reading.time_s - self._limits.settle_s:
            self._inside.popleft()

    def is_stale(self, now_s: float) -> bool:
        """Whether the newest reading is too old to be valid at `now_s`."""
        return not now_s - self._newest <= self._limits.max_gap_s

    def _judge(self, reading: Reading, *, inside: bool) -> str | None:
        """The problem of a reading: "" if it is good, None if it is out of tolerance."""
        if reading.rotation is None:
            return reading.problem
        if not inside:
            return None
        rate = self._rate_deg_s(reading)
        if rate > self._limits.max_rate_deg_s:
            return f"still turning at {rate:.1f}°/s (at most {self._limits.max_rate_deg_s:g}°/s)"
        return self._foresight.leaving(self._limits.foresee_s) if self._limits.foresee_s else ""

    def _rate_deg_s(self, reading: Reading) -> float:
        if self._limits.use_reported_rate and not math.isnan(reading.rate_deg_s):
            return reading.rate_deg_s
        oldest = self._inside[0] if self._inside else None
        if oldest is None or oldest.rotation is None or reading.rotation is None:
            return 0.0
        elapsed = reading.time_s - oldest.time_s
        if elapsed < min(0.1, self._limits.settle_s) or elapsed <= 0:
            return 0.0
        turned = pose_error(0.0, 0.0, oldest.rotation.T @ reading.rotation)
        return (
            math.sqrt(sum(float(v) ** 2 for v in (turned.across_deg, turned.along_deg, turned.rotation_deg))) / elapsed
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowVerdict:
    """The verdict on an exposure.

    Attributes:
        ok: the whole window is verified to be inside tolerance.
        reason: why not, with figures; of a verdict on a part of an exposure, what the rest was like; "" otherwise.
        code: `pointing` (out of tolerance) or `no_samples` (not verified); "" when ok.
        samples: number of samples judged.
        measured: mean attitude of the usable samples; None without one.
        errors: the largest of each error over the usable samples; None without one.
        spread_deg: the largest boresight angle between a usable sample and the first.
        proof: what verifies it: `samples`, each of the exposure; `opening`, each while the shutter was open; `curve`,
            a curve through them, whose errors `errors` are; "" when not ok, or where nothing is measured.
    """

    ok: bool
    reason: str
    code: str
    samples: int
    measured: MeasuredPose | None
    errors: AxisErrors | None
    spread_deg: float = math.nan
    proof: str = ""


def judge_window(
    readings: Iterable[Reading],
    *,
    target: Target,
    start_s: float,
    end_s: float,
    max_gap_s: float,
    heading_lag_s: float = 0.0,
) -> WindowVerdict:
    """Judge every reading of an exposure.

    The window is verified when a reading lies at most `max_gap_s` before its start, no reading is out of tolerance, and
    no gap between readings exceeds `max_gap_s`: a deviation that lasts longer than that is detected.

    The error between two readings must be inside tolerance as well (`unseen_motion`). With gaps above `DENSE_GAP_S` the
    readings must bracket the window for this.

    Args:
        readings: oldest first; those well before or after the window are ignored.
        target: the commanded pose.
        start_s: earliest possible opening of the shutter.
        end_s: latest possible closing of the shutter.
        max_gap_s: longest gap between readings.
        heading_lag_s: how much older than a reading the heading in it may be; 0 where the gimbal measures its yaw.
    """
    ordered = list(readings)
    before = [r for r in ordered if start_s - max_gap_s <= r.time_s <= start_s][-1:]
    judged = before + [r for r in ordered if start_s < r.time_s <= end_s]
    sparse = bool(before) and _widest_gap_s([*(r.time_s for r in judged), end_s]) > DENSE_GAP_S + 1e-6
    after = [r for r in ordered if end_s < r.time_s <= end_s + max_gap_s][:1] if sparse else []
    judged += after
    usable = np.array([r.rotation for r in judged if r.rotation is not None]).reshape(-1, 3, 3)
    errors = pose_error(target.pitch_deg, target.yaw_deg, usable) if len(usable) else None
    code = reason = ""
    if len(usable) < len(judged):
        code, reason = "no_samples", next(r.problem for r in judged if r.rotation is None)
    elif errors is not None and not bool(np.all(errors.within(target.tolerance))):
        code, reason = "pointing", describe_error(errors, target.tolerance)
    elif not before:
        code, reason = "no_samples", f"no attitude sample in the {max_gap_s:g} s before the exposure"
    else:
        inside = judged[1 : len(judged) - len(after)]
        gap = _widest_gap_s([start_s, *(r.time_s for r in inside), end_s])
        if gap > max_gap_s:
            code = "no_samples"
            reason = f"no attitude sample for {gap:.2f} s of the exposure (at most {max_gap_s:g} s)"
        elif sparse and not after:
            code = "no_samples"
            reason = f"no attitude sample in the {max_gap_s:g} s after the exposure, and those in it are few"
        elif errors is not None:
            reason = unseen_error(judged, errors, target.tolerance, heading_lag_s=heading_lag_s)
            code = "pointing" if reason else ""
    return WindowVerdict(
        ok=not reason,
        reason=reason,
        code=code,
        samples=len(judged),
        measured=mean_pose(usable) if len(usable) else None,
        errors=worst_errors(errors) if errors is not None else None,
        spread_deg=float(np.max(angle_between(usable[0, :, 0], usable[:, :, 0]))) if len(usable) else math.nan,
        proof="" if reason else "samples",
    )


def _widest_gap_s(times_s: list[float]) -> float:
    return max((b - a for a, b in itertools.pairwise(times_s)), default=0.0)


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
