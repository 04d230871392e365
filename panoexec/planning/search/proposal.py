"""A proposal of the search: the shots of rows, the verdict on them, and what they lack of a certified plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.certificate.verdict import THRESHOLD_SLACK, certify_poses
from panoexec.planning.model import Certificate, Constraints, Shot
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_refinement import Rows

_UNKNOWN = 0.02
"""Margin that is added where the missing one is unknown."""

_CLOSE = 0.05
"""Proposals that lack more overlap are not planned again."""

_DECIMALS = 7
"""Digits of pitch and yaw in a plan, degrees."""


@dataclass(frozen=True, slots=True)
class Found:
    """Shots, row by row, with their certificate."""

    shots: tuple[Shot, ...]
    certificate: Certificate
    cut: bool = False
    """Whether the budget ended the search."""

    @property
    def rank(self) -> tuple[int, int]:
        """Sort key, lower is better: certified plans by images, others by the number of failed conditions."""
        certificate = self.certificate
        return (0 if certificate.certified else 1 + len(certificate.failures), certificate.images)


def verdict(camera: Camera, constraints: Constraints, shots: Sequence[Shot]) -> Certificate:
    """The certificate of shots, without an explanation of holes."""
    poses = rotation([shot.yaw_deg for shot in shots], [shot.pitch_deg for shot in shots])
    return certify_poses(camera, constraints, poses, [shot.row for shot in shots], explain=False)


def row_shots(rules: RowConstraints, rows: Rows) -> tuple[Shot, ...]:
    """The shots of rows, row by row."""
    shots: list[Shot] = []
    for number, (pitch, count, phase) in enumerate(zip(rows.pitch_deg, rows.count, rows.phase_deg, strict=True)):
        tilt = round(pitch, _DECIMALS)
        for yaw in np.round(rules.layout.yaws_deg(pitch, count, phase), _DECIMALS).tolist():
            shots.append(Shot(index=len(shots), row=number, pitch_deg=tilt, yaw_deg=yaw if yaw < 180.0 else -180.0))
    return tuple(shots)


def reindexed(found: Found, shots: Sequence[Shot]) -> Certificate:
    """The certificate with image numbers adapted to a new order of the shots."""
    place = {(shot.row, shot.yaw_deg): shot.index for shot in shots}
    name = [place[shot.row, shot.yaw_deg] for shot in found.shots]
    pair, image = found.certificate.weakest_h, found.certificate.weakest_v
    return replace(
        found.certificate,
        weakest_h=None if pair is None else (name[pair[0]], name[pair[1]]),
        weakest_v=None if image is None else name[image],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Lack:
    """What rows that are close to certified lack: margin between rows (C1, C3), overlap of neighbours (C2)."""

    margin: float = 0.0
    across: float = 0.0


def missing(certificate: Certificate, constraints: Constraints) -> Lack | None:
    """What is missing for C1 to C3, if the rows are close to certified; None if more fails."""
    every = constraints.guarantee == "all"
    upwards = certificate.worst_overlap_v if every else certificate.min_overlap_v
    across = certificate.worst_overlap_h if every else certificate.min_overlap_h
    missing_v = 0.0 if upwards is None else constraints.overlap_v - upwards
    missing_h = 0.0 if across is None else constraints.overlap_h - across
    if max(missing_h, missing_v) > _CLOSE or not certificate.two_edge_connected:
        return None
    margin = 2e-3 if certificate.uncovered_fraction > 0 else 0.0
    if missing_v > THRESHOLD_SLACK:
        # overlaps are clamped at 0, so there the missing margin is unknown
        margin = missing_v + 2e-4 if upwards else max(missing_v, _UNKNOWN)
    return Lack(margin=margin, across=missing_h + 2e-4 if missing_h > THRESHOLD_SLACK else 0.0)
