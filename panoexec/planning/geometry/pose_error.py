"""The single definition of pose error, used by the certificate and by the mission's pointing gate.

The gimbal's axes are yaw, roll, pitch (3-1-2, see `panoexec.angles`). A camera with the setpoint yaw ψ, pitch θ and
roll 0 has the attitude R = Rz(ψ + e_yaw) · Rx(e_roll) · Ry(θ + e_pitch). The pose error is (e_pitch, e_roll, e_yaw); a
pose is *within τ* when each component is within its tolerance. The sequence is singular only at roll ±90°, so the three
errors are unique and continuous everywhere, at the nadir too, where differences of 3-2-1 Euler angles are not.

Effect on the image: in the camera frame (x boresight, y right, z down), with R₀ the target attitude, the rotation
R₀ᵀ·R has to first order the rotation vector

    about z, *across* (boresight moves right):        e_yaw · cos θ + e_roll · sin θ
    about y, *along*  (boresight moves up):           e_pitch
    about x, *rotation* (image turns clockwise):     -e_yaw · sin θ + e_roll · cos θ

The neglected terms are at most (|e_yaw| + |e_roll| + |e_pitch|)² / 2 radians. At the nadir, a yaw error therefore
rotates the image about the boresight and a roll error moves the boresight sideways.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panoexec.angles import FloatArray, rotation, wrap_180, yaw_pitch_roll
from panoexec.planning.model import Tolerance


@dataclass(frozen=True, slots=True)
class PoseError:
    """Errors of poses relative to their targets; all fields have the same shape.

    Attributes:
        pitch_deg: error of the pitch axis, [-180, 180).
        roll_deg: error of the roll axis, [-90, 90].
        yaw_deg: error of the yaw axis, [-180, 180).
        across_deg: displacement of the boresight to the image's right.
        along_deg: displacement of the boresight to the image's top.
        rotation_deg: rotation about the boresight, clockwise positive.
        boresight_deg: angle between target and measured boresight, [0, 180].
    """

    pitch_deg: FloatArray
    roll_deg: FloatArray
    yaw_deg: FloatArray
    across_deg: FloatArray
    along_deg: FloatArray
    rotation_deg: FloatArray
    boresight_deg: FloatArray

    def __getitem__(self, index: int) -> PoseError:
        """The error of one pose, by its index along the first dimension."""
        return PoseError(*(getattr(self, field.name)[index] for field in fields(self)))

    def within(self, tolerance: Tolerance) -> NDArray[np.bool_]:
        """Whether the error of each axis is within its tolerance (inclusive); False for NaN."""
        return np.asarray(
            (np.abs(self.pitch_deg) <= tolerance.pitch_deg)
            & (np.abs(self.roll_deg) <= tolerance.roll_deg)
            & (np.abs(self.yaw_deg) <= tolerance.yaw_deg)
        )


def pose_error(target_pitch_deg: ArrayLike, target_yaw_deg: ArrayLike, measured: ArrayLike) -> PoseError:
    """The errors of measured poses relative to targets with roll 0.

    Args:
        target_pitch_deg: (...) or scalar.
        target_yaw_deg: (...) or scalar, in the same yaw frame as the measurement.
        measured: camera-to-world rotations (..., 3, 3).

    Returns:
        The errors, each (...).
    """
    m = np.asarray(measured, dtype=np.float64)
    yaw, pitch, roll = yaw_pitch_roll(m)
    relative = np.swapaxes(rotation(target_yaw_deg, target_pitch_deg), -1, -2) @ m
    vector = np.degrees(_rotation_vector(relative))
    boresight = np.degrees(np.arctan2(np.hypot(relative[..., 1, 0], relative[..., 2, 0]), relative[..., 0, 0]))
    return PoseError(
        pitch_deg=wrap_180(pitch - np.asarray(target_pitch_deg, dtype=np.float64)),
        roll_deg=roll,
        yaw_deg=wrap_180(yaw - np.asarray(target_yaw_deg, dtype=np.float64)),
        across_deg=vector[..., 2],
        along_deg=vector[..., 1],
        rotation_deg=vector[..., 0],
        boresight_deg=boresight,
    )


def _rotation_vector(rotations: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), radians, of rotations (..., 3, 3); the axis is arbitrary at exactly half a turn."""
    m = rotations
    twice_sin_axis = np.stack(
        [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1
    )
    sin = np.linalg.norm(twice_sin_axis, axis=-1) / 2
    cos = (np.trace(m, axis1=-2, axis2=-1) - 1) / 2
    angle = np.arctan2(sin, cos)
    scale = np.where(sin > 1e-12, angle / np.maximum(2 * sin, 1e-300), 0.5)
    return np.asarray(twice_sin_axis * scale[..., None])
