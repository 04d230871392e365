"""What a gimbal's attitude reports are good for: rate, repetition, step and noise; and what to set for them. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from panoexec.angles import FloatArray, rotation_from_quaternion, yaw_pitch_roll
from panoexec.devices import AttitudeSample, YawFrame
from panoexec.inputs.vehicle_sections import PointingSection
from panoexec.mission.pointing.tolerance_gate import SPARSE_INTERVALS
from panoexec.mission.pointing.unseen_motion import DENSE_GAP_S

LEAST_SAMPLES: Final = 10
_REPEATS_FRAC: Final = 0.4
"""A measurement that is renewed with every report is never the same in so many pairs."""
_STEP_FIT: Final = 0.08
"""All differences are whole numbers of steps within this fraction of a step: the reports are quantised."""
_LEAST_STEP_DEG: Final = 0.02
_SIGMAS: Final = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportQuality:
    """The reports of some seconds.

    Attributes:
        hz: reports a second.
        fresh_hz: how often a second what they tell is renewed; NaN if it never was.
        repeats_frac: fraction of successive pairs that are equal.
        step_deg: steps of the angles; 0 if there are none that could be seen.
        noise_deg: standard deviation of pitch and roll about a slow mean, the larger.
    """

    hz: float
    fresh_hz: float
    repeats_frac: float
    step_deg: float
    noise_deg: float

    @property
    def repeats(self) -> bool:
        """Whether reports are repeated until something new is known."""
        return self.repeats_frac > _REPEATS_FRAC

    def text(self) -> str:
        """For display."""
        told = f"{self.hz:.0f} Hz"
        if self.repeats and math.isnan(self.fresh_hz):
            told += ", but they repeat: all are equal (coarse steps, or not measured)"
        elif self.repeats:
            told += f", but they repeat: renewed at about {self.fresh_hz:.0f} Hz"
        steps = f", steps of {self.step_deg:.2g}°" if self.step_deg else ""
        return f"{told}{steps}, noise {self.noise_deg:.3f}°"

    def least_tolerance_deg(self) -> float:
        """The least tolerance of pitch and roll that noise and steps leave, in tenths."""
        return max(math.ceil(10 * (self.step_deg / 2 + _SIGMAS * self.noise_deg) - 1e-6) / 10, 0.1)

    def gap_s(self) -> float:
        """The longest gap between reports that belongs to their rate."""
        return max(DENSE_GAP_S, math.ceil(100 * SPARSE_INTERVALS / self.hz) / 100)

    def settle_s(self) -> float:
        """The settle time in which what they tell is renewed four times."""
        slowest = self.hz if math.isnan(self.fresh_hz) else min(self.hz, self.fresh_hz)
        return max(0.3, math.ceil(40 / slowest) / 10)

    def settings(self, pointing: PointingSection) -> list[str]:
        """Keys of `[pointing]` that do not fit these reports, each with a value that does."""
        least = self.least_tolerance_deg()
        keys = [f"tolerance_{axis}_deg" for axis in ("pitch", "roll", "yaw")]
        out = [f"{key} = {least:g}" for key in keys if getattr(pointing, key) < least]
        if pointing.max_gap_s < self.gap_s() <= 1.0:
            out.append(f"max_gap_s = {self.gap_s():g}")
        if pointing.settle_s < self.settle_s():
            out.append(f"settle_s = {self.settle_s():g}")
        return out


def measured(samples: Sequence[AttitudeSample]) -> ReportQuality | None:
    """The quality of successive samples of a gimbal that is not moved; None if there are too few."""
    usable = [one for one in samples if all(map(math.isfinite, one.q_wxyz)) and any(one.q_wxyz)]
    if len(usable) < LEAST_SAMPLES or usable[-1].received_s <= usable[0].received_s:
        return None
    times = np.array([one.received_s for one in usable])
    yaw, pitch, roll = yaw_pitch_roll(rotation_from_quaternion(np.array([one.q_wxyz for one in usable])))
    # a yaw from north may have the vehicle's heading composed into it: then it never repeats
    relative = all(one.yaw_frame is not YawFrame.EARTH for one in usable)
    angles = np.stack([pitch, roll, yaw] if relative else [pitch, roll], axis=1)
    changes = np.flatnonzero(np.any(np.abs(np.diff(angles, axis=0)) > 1e-4, axis=1)) + 1
    between = np.diff(times[changes])
    return ReportQuality(
        hz=(len(usable) - 1) / float(times[-1] - times[0]),
        fresh_hz=1 / float(np.percentile(between, 20)) if len(between) else math.nan,
        repeats_frac=1 - len(changes) / (len(usable) - 1),
        step_deg=_step(angles),
        noise_deg=max(float(np.std(_detrended(times, values))) for values in angles.T[:2]),
    )


def _step(angles: FloatArray) -> float:
    """The step of which all differences of angles (n, k) are whole numbers; 0 if there is none."""
    differences = np.abs(np.concatenate([np.diff(np.unique(np.round(values, 4))) for values in angles.T]))
    if not len(differences):
        return 0.0
    step = float(differences.min())
    if step < _LEAST_STEP_DEG:
        return 0.0
    whole = differences / step
    return round(step, 3) if bool(np.all(np.abs(whole - np.round(whole)) <= _STEP_FIT)) else 0.0


def _detrended(times: FloatArray, values: FloatArray) -> FloatArray:
    slope, offset = np.polyfit(times - times[0], values, 1)
    return np.asarray(values - slope * (times - times[0]) - offset)
