"""Judges an exposure by a curve through its readings instead of each reading: encoders have noise.

A camera at 0.07° beside its target is inside a tolerance of 0.1°, but one of four readings with 0.017° of noise is
outside in every sixth exposure. A parabola through seven readings or more knows the pose to half of that noise. It
proves the pose if it is inside together with the confidence bound of its own error (Student's t, 97.5 %), and also if
all of what the readings are beside it were a vibration of the airframe, whose amplitude is √2 times its standard
deviation: which of both it is, readings do not tell. Readings that are farther from it than noise is are a motion, and
no parabola: then they count themselves. A reading that was repeated counts once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from panoexec.angles import FloatArray
from panoexec.mission.pointing.poses import Reading
from panoexec.planning.geometry.pose_error import PoseError
from panoexec.planning.model import Tolerance

BESIDE_S: Final = 0.07
"""Readings of so long before and after an exposure tell of the pose in it; gusts turn about within twice of it."""
LEAST_READINGS: Final = 7
_STUDENT_T: Final = (2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)
"""Student's t, 97.5 %, for 4 to 10 degrees of freedom; the last one for more, where it is smaller."""
_AMPLITUDE: Final = math.sqrt(2.0)
"""Amplitude of a vibration over its standard deviation."""
NOISE_DEG: Final = 0.03
"""Largest noise of encoders, standard deviation: what is more is a motion."""
_DEGREE: Final = 2
_STEP_S: Final = 0.005
_SIGNED: Final = ("pitch_deg", "roll_deg", "yaw_deg", "across_deg", "along_deg", "rotation_deg")


def fitted(
    readings: Sequence[Reading], errors: PoseError, tolerance: Tolerance, *, start_s: float, end_s: float
) -> PoseError | None:
    """The errors of a curve through the readings, (m,), if it proves the pose from a time until another; else None.

    Args:
        readings: oldest first, all with a rotation, of the exposure and `BESIDE_S` beside it, where the camera was to
            look at the same target.
        errors: theirs, (n,).
        tolerance: of each axis.
        start_s: of the exposure.
        end_s: its end.
    """
    distinct = [k for k, one in enumerate(readings) if k == 0 or not _repeats(one, readings[k - 1])]
    times = np.array([readings[k].time_s for k in distinct])
    if len(times) < LEAST_READINGS or not times[0] <= start_s <= end_s <= times[-1]:
        return None
    middle_s = (start_s + end_s) / 2
    within = np.linspace(start_s, end_s, max(2, math.ceil((end_s - start_s) / _STEP_S)))
    fit = np.linalg.pinv(_powers(times - middle_s))
    curve, through = _powers(within - middle_s) @ fit, _powers(times - middle_s) @ fit
    error_of_curve = np.sqrt((curve**2).sum(axis=1))
    freedom = len(times) - _DEGREE - 1
    t = _STUDENT_T[min(freedom - 4, len(_STUDENT_T) - 1)]
    limits = (tolerance.pitch_deg, tolerance.roll_deg, tolerance.yaw_deg)
    for axis, limit in zip((errors.pitch_deg, errors.roll_deg, errors.yaw_deg), limits, strict=True):
        values = np.asarray(axis)[distinct]
        left = values - through @ values
        noise_deg = math.sqrt(float(left @ left) / freedom)
        bound = np.abs(curve @ values) + noise_deg * np.maximum(t * error_of_curve, _AMPLITUDE)
        if not (noise_deg <= NOISE_DEG and float(bound.max()) <= limit):
            return None
    on_curve = {name: curve @ np.asarray(getattr(errors, name))[distinct] for name in _SIGNED}
    return PoseError(**on_curve, boresight_deg=np.hypot(on_curve["across_deg"], on_curve["along_deg"]))


def _repeats(reading: Reading, before: Reading) -> bool:
    """Whether a reading is the one before it, forwarded again."""
    return reading.time_s <= before.time_s or np.array_equal(np.asarray(reading.rotation), np.asarray(before.rotation))


def _powers(times: FloatArray) -> FloatArray:
    return np.vander(times, _DEGREE + 1, increasing=True)
