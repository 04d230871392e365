"""Bounds the pose errors that no sample shows: those between two samples, and those that a late heading hides.

A sample tells the pose of one moment. Between two samples the camera may be further off than at either; and where the
yaw is the vehicle's heading, which another component measures at another time, it is off by what the vehicle turned in
between. Both grow with the motion that the samples show.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.mission.pointing.poses import Reading
from panoexec.planning.geometry.pose_error import PoseError
from panoexec.planning.model import Tolerance

DENSE_GAP_S: Final = 0.1
"""Readings that are closer leave no room for a motion between them, but one that shows in their differences."""
NOISE_STEP_DEG: Final = 0.1
"""Differences of two readings within this are noise of encoders."""
NOISE_RMS_DEG: Final = 0.07
"""So are larger ones, up to `JOLT_DEG`, while the root mean square of all of an exposure is within this: encoder and
airframe of 0.02° each make 0.04°, in which 0.1° comes now and then."""
JOLT_DEG: Final = 0.2
"""A single difference above this is a motion."""
HEADING_LAG_S: Final = 0.03
"""How much older than the gimbal's report the vehicle's heading in it may be."""
_AXES: Final = ("pitch", "roll", "yaw")
_SLACK_S: Final = 1e-6


def unseen_error(
    judged: Sequence[Reading], errors: PoseError, tolerance: Tolerance, *, heading_lag_s: float = 0.0
) -> str:
    """Why the pose may have been out of tolerance though no reading is; "" if it may not.

    The error between two readings is at most the larger of theirs plus a margin:

    * more than `DENSE_GAP_S` apart, half the gap times the angular speed (the larger of the reported ones and the one
      from reading to reading);
    * else half of the largest difference between two neighbours (a nose that shakes at 15 Hz shows 50 readings a second
      with differences of its amplitude, and its peaks are between them); differences that are noise count 0;
    * and in yaw `heading_lag_s` times its mean speed.

    Args:
        judged: of the exposure and beside it, oldest first, all with a rotation.
        errors: theirs, (n,).
        tolerance: of each axis.
        heading_lag_s: see `HEADING_LAG_S`; 0 where the gimbal measures its yaw itself.
    """
    times = np.array([reading.time_s for reading in judged])
    limits = (tolerance.pitch_deg, tolerance.roll_deg, tolerance.yaw_deg)
    axes = [np.asarray(values) for values in (errors.pitch_deg, errors.roll_deg, errors.yaw_deg)]
    gaps = np.diff(times)
    dense = gaps <= DENSE_GAP_S + _SLACK_S
    sparse_deg = [
        0.0 if close else _between_deg(a, b) for close, (a, b) in zip(dense, itertools.pairwise(judged), strict=True)
    ]
    for name, values, limit in zip(_AXES, axes, limits, strict=True):
        shaken_deg = _largest_step_deg(values, dense) / 2
        lagging_deg = heading_lag_s * abs(slope(times, values)) if name == "yaw" else 0.0
        for i, gap in enumerate(gaps):
            margin = (shaken_deg if dense[i] else sparse_deg[i]) + lagging_deg
            error = float(max(abs(values[i]), abs(values[i + 1]))) + margin
            if error > limit:
                return f"{name} may be off by {error:.3g}° between two samples {gap:.2f} s apart (at most {limit:g}°)"
    return ""


def slope(times: FloatArray, values: FloatArray) -> float:
    """The mean rate of change, by least squares; 0 for fewer than three values, or within `_SLACK_S`."""
    if len(times) < 3 or float(np.ptp(times)) < _SLACK_S:
        return 0.0
    centred = times - times.mean()
    return float(centred @ (values - values.mean()) / (centred @ centred))


def _largest_step_deg(values: FloatArray, dense: NDArray[np.bool_]) -> float:
    steps = np.abs(np.diff(values))[dense]
    largest = float(steps.max()) if len(steps) else 0.0
    shakes = largest > JOLT_DEG or math.sqrt(float(steps @ steps)) > NOISE_RMS_DEG * math.sqrt(max(1, len(steps)))
    return largest if largest > NOISE_STEP_DEG and shakes else 0.0


def _between_deg(a: Reading, b: Reading) -> float:
    """How far from both the camera may have been between two readings that are far apart."""
    gap_s = b.time_s - a.time_s
    fastest = max([rotation_deg(a, b) / gap_s, *(r.rate_deg_s for r in (a, b) if math.isfinite(r.rate_deg_s))])
    return fastest * gap_s / 2


def rotation_deg(a: Reading, b: Reading) -> float:
    """The angle of the rotation from one reading to the other."""
    assert a.rotation is not None
    assert b.rotation is not None
    chord = float(np.linalg.norm(a.rotation - b.rotation)) / math.sqrt(8.0)
    return math.degrees(2 * math.asin(min(chord, 1.0)))
