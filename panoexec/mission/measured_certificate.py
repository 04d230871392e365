"""The certificate of measured attitudes, and shots that close their holes; computed in threads beside the event loop.

Measured attitudes have no further pointing error, so they are certified with tolerance 0 (errors of the gimbal's own
measurement are unknown). Coverage and the overlap graph (C1, C4) include all accepted images. The overlaps within and
between rows (C2, C3) include the images that belong to a row. They must reach the plan's thresholds; with the guarantee
`coverage`, where the thresholds apply to the planned poses, the plan's worst case over the tolerances. So a panorama
whose shots are all within tolerance of a certified plan is certified by that plan's proof.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from panoexec.angles import FloatArray, angle_between, rotation, wrap_180
from panoexec.mission.context import MissionContext
from panoexec.mission.log.events import MeasuredPose
from panoexec.planning.certificate.holes import HoleRegion, coverage_holes
from panoexec.planning.certificate.verdict import certify_poses
from panoexec.planning.model import NO_TOLERANCE, Certificate, Constraints, Plan, Shot

NO_ROW = -1
"""Row number of an image that belongs to no row."""
MAX_PATCHES = 12
"""Most patch shots; a panorama that needs more is flown again instead."""


def measured_constraints(plan: Plan) -> Constraints:
    """The constraints that measured attitudes must satisfy."""
    constraints = replace(plan.constraints, tolerance=NO_TOLERANCE)
    planned = plan.certificate
    if plan.constraints.guarantee == "all" or planned is None or not planned.certified:
        return constraints
    return replace(
        constraints,
        overlap_h=_promised(constraints.overlap_h, planned.worst_overlap_h),
        overlap_v=_promised(constraints.overlap_v, planned.worst_overlap_v),
    )


def _promised(threshold: float, worst: float | None) -> float:
    return threshold if worst is None else max(0.0, min(threshold, worst))


def certify_measured(plan: Plan, rotations: FloatArray, rows: Sequence[int]) -> Certificate:
    """The certificate of measured attitudes.

    Args:
        plan: camera, constraints, and the certificate of the planned poses if there is one.
        rotations: camera to plan frame (n, 3, 3).
        rows: the row of each, or `NO_ROW`.
    """
    constraints = measured_constraints(plan)
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
    """Shots that close the holes of the accepted images, if the plan itself has none.

    The camera is pointed at the centre of a hole, limited to the range of the plan's poses, if an image from there
    contains the hole with a margin for the plan's tolerances; else the nearest planned pose is repeated. Holes are
    computed again after each shot.

    Args:
        plan: camera, constraints, shots.
        rotations: attitudes of the accepted images (n, 3, 3).

    Returns:
        Shots, with row -1 if they fit no row; empty if there is no hole, if the plan itself has holes, or if
        `MAX_PATCHES` shots do not close them.
    """
    camera, constraints = plan.camera, replace(plan.constraints, tolerance=NO_TOLERANCE)
    if coverage_holes(camera, constraints, plan.rotations()):
        return []
    flown = np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)
    poses: list[tuple[float, float]] = []
    while len(poses) < MAX_PATCHES:
        taken = np.array([rotation(yaw, pitch) for pitch, yaw in poses]).reshape(-1, 3, 3)
        holes = coverage_holes(camera, constraints, np.concatenate([flown, taken]))
        if not holes:
            return [
                Shot(index=i, row=row_of(plan, pitch), pitch_deg=pitch, yaw_deg=yaw)
                for i, (pitch, yaw) in enumerate(poses)
            ]
        pose = _patch_pose(plan, holes[0])
        if pose in poses:
            return []
        poses.append(pose)
    return []


def row_of(plan: Plan, pitch_deg: float) -> int:
    """The plan's row nearest to a pitch, if within a quarter of the vertical field of view; else `NO_ROW`."""
    nearest = min(plan.shots, key=lambda shot: abs(shot.pitch_deg - pitch_deg), default=None)
    if nearest is None or abs(nearest.pitch_deg - pitch_deg) > plan.camera.vfov_deg / 4:
        return NO_ROW
    return nearest.row


def _patch_pose(plan: Plan, region: HoleRegion) -> tuple[float, float]:
    """Pitch and yaw of an image that contains a hole."""
    outline = np.asarray(region.outline)
    centre = outline.mean(axis=0)
    elevation, azimuth = region.hole.elevation_deg, region.hole.azimuth_deg
    if float(np.linalg.norm(centre)) > 1e-6:
        pitch = float(np.degrees(np.arctan2(-centre[2], np.hypot(centre[0], centre[1]))))
        yaw = float(np.degrees(np.arctan2(centre[1], centre[0])))
        pitch, yaw = _reachable(plan, pitch, yaw)
        if _contains(plan, pitch, yaw, outline):
            return pitch, float(wrap_180(yaw))
    here = np.array([rotation(azimuth, elevation)[:, 0]])
    boresights = plan.rotations()[:, :, 0]
    nearest = plan.shots[int(np.argmin(angle_between(boresights, here)))]
    return nearest.pitch_deg, nearest.yaw_deg


def _reachable(plan: Plan, pitch_deg: float, yaw_deg: float) -> tuple[float, float]:
    """The given pose limited to the range of the plan's poses, which the gimbal can reach.

    Holes at the border of the band come from images that drifted inwards; the gimbal need not point at the border to
    cover it.
    """
    pitches = [shot.pitch_deg for shot in plan.shots]
    pitch_deg = min(max(pitch_deg, min(pitches)), max(pitches))
    band = plan.constraints.band
    if band.is_full_circle:
        return pitch_deg, yaw_deg
    middle = (band.azimuth_min_deg + band.azimuth_max_deg) / 2
    offsets = [float(wrap_180(shot.yaw_deg - middle)) for shot in plan.shots]
    return pitch_deg, middle + min(max(float(wrap_180(yaw_deg - middle)), min(offsets)), max(offsets))


def _contains(plan: Plan, pitch_deg: float, yaw_deg: float, outline: FloatArray) -> bool:
    """Whether an image with this pose contains all points, with a margin for the tolerances."""
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
        return await asyncio.to_thread(certify_measured, self.plan, rotations, rows)

    async def patch(self, rotations: FloatArray, rows: Sequence[int]) -> Sequence[Shot]:
        """See `Verifier.patch`."""
        del rows
        return await asyncio.to_thread(patch_shots, self.plan, rotations)


async def overlaps_hold(context: MissionContext, shot: int, measured: MeasuredPose | None) -> bool:
    """Whether the certificate holds with this measured pose, assuming that all remaining shots go as planned.

    Decides on a sharp photo whose pose is outside tolerance (`accept = "overlap"`).
    """
    if measured is None:
        return False
    record = context.record
    rotations, rows = record.measured(also=[*record.wanted(), (shot, measured)])
    return (await context.verifier.certify(rotations, rows)).certified
