"""Rotations and directions, in degrees at every interface; arrays broadcast over leading dimensions.

Frames (right-handed, as MAVLink's):

* **world**: NED. x points to the plan's yaw reference (true north unless the mission uses the heading), y 90° clockwise
  from it seen from above, z down.
* **camera**: FRD. x is the boresight, y the right of the image, z its bottom.

A *rotation* is the (3, 3) matrix that takes camera coordinates to world coordinates. A gimbal turns its axes in the
order yaw (about world z), roll (about the x so obtained), pitch (about the y so obtained): the 3-1-2 sequence,
R = Rz(yaw) · Rx(roll) · Ry(pitch). It is singular only at roll ±90°, so it stays well-behaved at the nadir, where the
more common 3-2-1 sequence does not. With roll 0 both are the same.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray: TypeAlias = NDArray[np.float64]


def wrap_180(angle_deg: ArrayLike) -> FloatArray:
    """Return the angle in [-180, 180) that differs by whole turns; any shape."""
    angle = np.asarray(angle_deg, dtype=np.float64)
    wrapped = (angle + 180.0) % 360.0 - 180.0
    # -1e-20 % 360 rounds up to 360.0 itself, which would come out as +180
    return np.where(wrapped >= 180.0, -180.0, wrapped)


def direction(elevation_deg: ArrayLike, azimuth_deg: ArrayLike) -> FloatArray:
    """Unit vectors in the world frame.

    Args:
        elevation_deg: above the horizon, -90 = nadir; any shape (...).
        azimuth_deg: clockwise from the yaw reference; broadcasts with `elevation_deg`.

    Returns:
        (..., 3) unit vectors.
    """
    elevation, azimuth = np.broadcast_arrays(
        np.radians(np.asarray(elevation_deg, dtype=np.float64)), np.radians(np.asarray(azimuth_deg, dtype=np.float64))
    )
    cos_e = np.cos(elevation)
    return np.stack([cos_e * np.cos(azimuth), cos_e * np.sin(azimuth), -np.sin(elevation)], axis=-1)


def elevation_azimuth(vectors: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Elevation in [-90, 90] and azimuth in [-180, 180), degrees, of world vectors (..., 3) of any length but 0."""
    v = np.asarray(vectors, dtype=np.float64)
    elevation = np.degrees(np.arctan2(-v[..., 2], np.hypot(v[..., 0], v[..., 1])))
    return elevation, wrap_180(np.degrees(np.arctan2(v[..., 1], v[..., 0])))


def _axis_rotation(axis: int, angle_deg: ArrayLike) -> FloatArray:
    angle = np.radians(np.asarray(angle_deg, dtype=np.float64))
    c, s = np.cos(angle), np.sin(angle)
    out = np.zeros((*angle.shape, 3, 3))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1.0
    out[..., j, j] = c
    out[..., k, k] = c
    out[..., j, k] = -s
    out[..., k, j] = s
    return out


def rotation(yaw_deg: ArrayLike, pitch_deg: ArrayLike, roll_deg: ArrayLike = 0.0) -> FloatArray:
    """Camera-to-world rotations of a gimbal's axes, Rz(yaw) · Rx(roll) · Ry(pitch).

    This is the rotation that the paper's equation (1) means (its printed signs do not give an orthonormal frame), with
    pitch = -β (its tilt β is positive down), yaw = α, and roll added.

    Args:
        yaw_deg: clockwise seen from above; any shape (...).
        pitch_deg: positive up; broadcasts.
        roll_deg: positive when the right of the image goes down; broadcasts.

    Returns:
        (..., 3, 3) orthonormal matrices.
    """
    yaw, pitch, roll = np.broadcast_arrays(
        np.asarray(yaw_deg, np.float64), np.asarray(pitch_deg, np.float64), np.asarray(roll_deg, np.float64)
    )
    yaw, pitch, roll = np.radians(yaw), np.radians(pitch), np.radians(roll)
    cos_y, sin_y, cos_p, sin_p = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    cos_r, sin_r = np.cos(roll), np.sin(roll)
    # Rx(roll) · Ry(pitch) has the rows (cos p, 0, sin p), (sin r·sin p, cos r, -sin r·cos p), and the third one below
    tilted, ahead = sin_r * sin_p, -sin_r * cos_p
    out = np.empty((*yaw.shape, 3, 3))
    out[..., 0, 0] = cos_y * cos_p - sin_y * tilted
    out[..., 0, 1] = -sin_y * cos_r
    out[..., 0, 2] = cos_y * sin_p - sin_y * ahead
    out[..., 1, 0] = sin_y * cos_p + cos_y * tilted
    out[..., 1, 1] = cos_y * cos_r
    out[..., 1, 2] = sin_y * sin_p + cos_y * ahead
    out[..., 2, 0] = -cos_r * sin_p
    out[..., 2, 1] = sin_r
    out[..., 2, 2] = cos_r * cos_p
    return out


def yaw_pitch_roll(rotations: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gimbal angles (3-1-2) of camera-to-world rotations; the inverse of `rotation`.

    Args:
        rotations: (..., 3, 3).

    Returns:
        yaw in [-180, 180), pitch in [-180, 180), roll in [-90, 90], degrees, each (...). At roll ±90° (the sequence's
        only singularity) yaw and pitch are one of many pairs.
    """
    # With c, s of yaw (y), roll (r), pitch (p): R[2] = (-cr·sp, sr, cr·cp), R[0][1] = -sy·cr, R[1][1] = cy·cr.
    m = np.asarray(rotations, dtype=np.float64)
    roll = np.degrees(np.arctan2(m[..., 2, 1], np.hypot(m[..., 0, 1], m[..., 1, 1])))
    yaw = np.degrees(np.arctan2(-m[..., 0, 1], m[..., 1, 1]))
    pitch = np.degrees(np.arctan2(-m[..., 2, 0], m[..., 2, 2]))
    return wrap_180(yaw), wrap_180(pitch), roll


def rotation_from_quaternion(q_wxyz: ArrayLike) -> FloatArray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) `[w, x, y, z]`, which need not be normalised.

    Raises:
        ValueError: a quaternion is zero or not finite.
    """
    q = np.asarray(q_wxyz, dtype=np.float64)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(np.isfinite(norm)) or np.any(norm < 1e-9):
        raise ValueError("a quaternion must be finite and not zero")
    w, x, y, z = np.moveaxis(q / norm, -1, 0)
    rows = [
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
        np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
        np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def quaternion_from_rotation(rotations: ArrayLike) -> FloatArray:
    """Unit quaternions (..., 4) `[w, x, y, z]`, w ≥ 0, of rotation matrices (..., 3, 3).

    Each component's magnitude comes from the diagonal; the best-conditioned one fixes the others (Shepperd).
    """
    m = np.asarray(rotations, dtype=np.float64)
    d = np.stack([m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], axis=-1)
    trace = d.sum(axis=-1)
    # 4·q_i·q_j for all i, j: a rank-one matrix, whose best-conditioned row is the quaternion times 4·q_i
    products = np.empty((*m.shape[:-2], 4, 4))
    products[..., 0, 0] = 1 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[..., i + 1, i + 1] = 1 + 2 * d[..., i] - trace
        products[..., 0, i + 1] = products[..., i + 1, 0] = m[..., k, j] - m[..., j, k]
        products[..., i + 1, j + 1] = products[..., j + 1, i + 1] = m[..., i, j] + m[..., j, i]
    best = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(products, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0, -q, q))


def angle_between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Angle in degrees, [0, 180], between vectors (..., 3); accurate for nearly parallel and opposite ones."""
    u, v = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    cross = np.linalg.norm(np.cross(u, v), axis=-1)
    return np.asarray(np.degrees(np.arctan2(cross, np.sum(u * v, axis=-1))))


def rotation_321(yaw_deg: ArrayLike, pitch_deg: ArrayLike, roll_deg: ArrayLike) -> FloatArray:
    """Camera-to-world rotations Rz(yaw) · Ry(pitch) · Rx(roll): the order of aircraft, XMP tags and Hugin.

    Args:
        yaw_deg: clockwise seen from above; any shape (...).
        pitch_deg: positive up; broadcasts.
        roll_deg: about the boresight, positive when the right of the image goes down; broadcasts.

    Returns:
        (..., 3, 3) orthonormal matrices.
    """
    yaw, pitch, roll = np.broadcast_arrays(
        np.asarray(yaw_deg, np.float64), np.asarray(pitch_deg, np.float64), np.asarray(roll_deg, np.float64)
    )
    return np.asarray(_axis_rotation(2, yaw) @ _axis_rotation(1, pitch) @ _axis_rotation(0, roll))


def yaw_pitch_roll_321(rotations: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles for `rotation_321` of camera-to-world rotations; its inverse, exact at nadir and zenith too.

    Every rotation has two such triples, (y, p, r) and (y + 180, 180 - p, r + 180). The one whose yaw is nearer to the
    gimbal's (3-1-2) is returned, so a camera that is turned a little beyond the nadir has a pitch a little below -90,
    not an image upside down. At the nadir itself, where only yaw + roll is determined, yaw is the gimbal's and roll is
    computed from it, never the two from noise independently.

    Args:
        rotations: (..., 3, 3).

    Returns:
        yaw in [-180, 180), pitch in [-180, 180), roll in [-180, 180), degrees, each (...).
    """
    m = np.asarray(rotations, dtype=np.float64)
    gimbal_yaw = np.radians(yaw_pitch_roll(m)[0])
    level = np.hypot(m[..., 0, 0], m[..., 1, 0])
    yaw = np.where(level > 1e-9, np.arctan2(m[..., 1, 0], m[..., 0, 0]), gimbal_yaw)
    yaw = np.where(np.cos(yaw - gimbal_yaw) < 0, yaw + np.pi, yaw)
    # Rz(-yaw) · R = Ry(pitch) · Rx(roll): its first column is (cp, 0, -sp), its second row (0, cr, -sr)
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-m[..., 2, 0], c * m[..., 0, 0] + s * m[..., 1, 0])
    roll = np.arctan2(s * m[..., 0, 2] - c * m[..., 1, 2], c * m[..., 1, 1] - s * m[..., 0, 1])
    return wrap_180(np.degrees(yaw)), wrap_180(np.degrees(pitch)), wrap_180(np.degrees(roll))
