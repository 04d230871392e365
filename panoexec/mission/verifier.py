"""The certificate of a panorama as flown, and shots that close its holes; computed in threads beside the event loop.

Measured attitudes carry no further pointing error, so they are certified with tolerance 0 (what the gimbal itself
measures wrong, no record can know). Coverage and the graph (C1, C4) count all accepted images. The overlaps within and
between rows (C2, C3) count those that belong to a row, and what they must reach is what the plan promised: its
thresholds, or with the guarantee `coverage`, which means thresholds at the planned poses, its own worst case over the
tolerances. So a panorama whose shots are all within tolerance of a certified plan is certified by that plan's proof.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from panoexec.angles import FloatArray, angle_between, rotation, wrap_180
from panoexec.planning.certificate.holes import HoleRegion, coverage_holes
from panoexec.planning.certificate.verdict import certify_poses
from panoexec.planning.model import NO_TOLERANCE, Certificate, Constraints, Plan, Shot

NO_ROW = -1
"""Row of an image that belongs to none."""
MOST_PATCHES = 12
"""A panorama with more holes than this many shots can close needs another flight, not patches."""


def flown_constraints(plan: Plan) -> Constraints:
    """What a panorama as flown must satisfy."""
    constraints = replace(plan.constraints, tolerance=NO_TOLERANCE)
    planned = plan.certificate
    if plan.constraints.guarantee == "all" or planned is None or not planned.certified:
        return constraints
    return replace(
        constraints,
        overlap_h=_promised(constraints.overlap_h, planned.worst_overlap_h),
        overlap_v=_promised(constraints.overlap_v, planned.worst_overlap_v),
    )


def _promised(asked: float, worst: float | None) -> float:
    return asked if worst is None else max(0.0, min(asked, worst))


def certify_flown(plan: Plan, rotations: FloatArray, rows: Sequence[int]) -> Certificate:
    """The certificate of measured attitudes.

    Args:
        plan: camera, constraints, and the certificate of the planned poses if there is one.
        rotations: camera to plan frame (n, 3, 3).
        rows: the row of each, `NO_ROW` for an image that belongs to none.
    """
    constraints = flown_constraints(plan)
    whole = certify_poses(plan.camera, constraints, rotations, rows)
    in_rows = np.array([row != NO_ROW for row in rows], dtype=np.bool_)
    if bool(in_rows.all()) or not bool(in_rows.any()):
        return whole
    own_rows = [row for row in rows if row != NO_ROW]
    parts = certify_poses(plan.camera, constraints, rotations[in_rows], own_rows, explain=False)
    failures = tuple(line for line in whole.failures if line.startswith(("C1", "C4")))
    failures += tuple(line for line in parts.failures if line.startswith(("C2", "C3")))
    return replace(
        whole,
        certified=not failures,
        failures=failures,
        min_overlap_h=parts.min_overlap_h,
        min_overlap_v=parts.min_overlap_v,
        worst_overlap_h=parts.worst_overlap_h,
        worst_overlap_v=parts.worst_overlap_v,
        weakest_h=None,
        weakest_v=None,
    )


def patch_shots(plan: Plan, rotations: FloatArray) -> list[Shot]:
    """Shots that would close the holes that images leave where the plan leaves none.

    A hole is closed from its middle, or from as near as the plan's own poses go, if an image from there holds it with
    room for the plan's tolerances; else by the planned pose nearest to it. Whatever remains is looked at again.

    Args:
        plan: camera, constraints, shots.
        rotations: attitudes of the accepted images (n, 3, 3).

    Returns:
        Shots with row -1 where they fit no row; empty when there is no hole, when the plan itself leaves holes, or when
        no reasonable number of shots would close them.
    """
    camera, constraints = plan.camera, replace(plan.constraints, tolerance=NO_TOLERANCE)
    if coverage_holes(camera, constraints, plan.rotations()):
        return []
    flown = np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)
    poses: list[tuple[float, float]] = []
    while len(poses) < MOST_PATCHES:
        taken = np.array([rotation(yaw, pitch) for pitch, yaw in poses]).reshape(-1, 3, 3)
        holes = coverage_holes(camera, constraints, np.concatenate([flown, taken]))
        if not holes:
            return [
                Shot(index=i, row=row_of(plan, pitch), pitch_deg=pitch, yaw_deg=yaw)
                for i, (pitch, yaw) in enumerate(poses)
            ]
        pose = _aim(plan, holes[0])
        if pose in poses:
            return []
        poses.append(pose)
    return []


def row_of(plan: Plan, pitch_deg: float) -> int:
    """The row of the plan that a pitch belongs to, within a quarter of the image's height; else `NO_ROW`."""
    nearest = min(plan.shots, key=lambda shot: abs(shot.pitch_deg - pitch_deg), default=None)
    if nearest is None or abs(nearest.pitch_deg - pitch_deg) > plan.camera.vfov_deg / 4:
        return NO_ROW
    return nearest.row


def _aim(plan: Plan, region: HoleRegion) -> tuple[float, float]:
    """Where to point so that an image holds a hole: pitch and yaw."""
    outline = np.asarray(region.outline)
    centre = outline.mean(axis=0)
    elevation, azimuth = region.hole.elevation_deg, region.hole.azimuth_deg
    if float(np.linalg.norm(centre)) > 1e-6:
        pitch = float(np.degrees(np.arctan2(-centre[2], np.hypot(centre[0], centre[1]))))
        yaw = float(np.degrees(np.arctan2(centre[1], centre[0])))
        pitch, yaw = _reachable(plan, pitch, yaw)
        if _holds(plan, pitch, yaw, outline):
            return pitch, float(wrap_180(yaw))
    here = np.array([rotation(azimuth, elevation)[:, 0]])
    boresights = plan.rotations()[:, :, 0]
    nearest = plan.shots[int(np.argmin(angle_between(boresights, here)))]
    return nearest.pitch_deg, nearest.yaw_deg


def _reachable(plan: Plan, pitch_deg: float, yaw_deg: float) -> tuple[float, float]:
    """The pose nearest to a pose that lies among those of the plan, which the gimbal was found to reach.

    Holes at the border of the band are what images leave that drifted inwards, and a gimbal need not point at a border
    to show it.
    """
    pitches = [shot.pitch_deg for shot in plan.shots]
    pitch_deg = min(max(pitch_deg, min(pitches)), max(pitches))
    band = plan.constraints.band
    if band.is_full_circle:
        return pitch_deg, yaw_deg
    middle = (band.azimuth_min_deg + band.azimuth_max_deg) / 2
    offsets = [float(wrap_180(shot.yaw_deg - middle)) for shot in plan.shots]
    return pitch_deg, middle + min(max(float(wrap_180(yaw_deg - middle)), min(offsets)), max(offsets))


def _holds(plan: Plan, pitch_deg: float, yaw_deg: float, outline: FloatArray) -> bool:
    """Whether an image taken there contains all points, with room for the tolerances."""
    inside = outline @ rotation(yaw_deg, pitch_deg)
    tolerance = plan.constraints.tolerance
    slack = np.radians(tolerance.pitch_deg + tolerance.roll_deg + tolerance.yaw_deg)
    depth = inside[:, 0]
    wide = np.abs(inside[:, 1]) <= (plan.camera.half_width - slack) * depth
    high = np.abs(inside[:, 2]) <= (plan.camera.half_height - slack) * depth
    return bool(np.all((depth > 0) & wide & high))


@dataclass(frozen=True, slots=True, kw_only=True)
class ThreadedVerifier:
    """The verifier of real missions: certificates are computed in a thread."""

    plan: Plan

    async def certify(self, rotations: FloatArray, rows: Sequence[int]) -> Certificate:
        """See `Verifier.certify`."""
        return await asyncio.to_thread(certify_flown, self.plan, rotations, rows)

    async def patch(self, rotations: FloatArray, rows: Sequence[int]) -> Sequence[Shot]:
        """See `Verifier.patch`."""
        del rows
        return await asyncio.to_thread(patch_shots, self.plan, rotations)
