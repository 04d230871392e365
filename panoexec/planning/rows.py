"""Summary of a plan by row, for display: images, spacing, and overlap at the planned poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from panoexec.angles import wrap_180
from panoexec.optics import Camera
from panoexec.planning.geometry.overlap import pairwise_overlap, union_overlap
from panoexec.planning.model import Plan, Shot, shot_rotations


@dataclass(frozen=True, slots=True, kw_only=True)
class RowSummary:
    """One row; None where there is nothing to measure.

    Attributes:
        number: from 0, the lowest.
        pitch_deg: pitch of the row's first image.
        images: number of images.
        spacing_deg: largest yaw difference of neighbours (including last and first if the band is a full circle).
        overlap_h: smallest overlap of neighbours.
        overlap_below: smallest overlap of an image with the union of the row below.
    """

    number: int
    pitch_deg: float
    images: int
    spacing_deg: float | None
    overlap_h: float | None
    overlap_below: float | None


def row_table(plan: Plan) -> list[RowSummary]:
    """Summaries of a plan's rows, from the lowest to the highest."""
    rows = [shots for _, shots in plan.rows()]
    summaries = []
    for number, shots in enumerate(rows):
        spacing, overlap = _neighbours(plan.camera, shots, closed=plan.constraints.band.is_full_circle)
        summaries.append(
            RowSummary(
                number=number,
                pitch_deg=shots[0].pitch_deg,
                images=len(shots),
                spacing_deg=spacing,
                overlap_h=overlap,
                overlap_below=_with_row(plan.camera, shots, rows[number - 1]) if number else None,
            )
        )
    return summaries


def _neighbours(camera: Camera, shots: Sequence[Shot], *, closed: bool) -> tuple[float | None, float | None]:
    if len(shots) < 2:
        return None, None
    turns = shot_rotations(shots)
    following = np.roll(turns, -1, axis=0)
    yaws = np.array([shot.yaw_deg for shot in shots])
    spacing = np.abs(wrap_180(np.roll(yaws, -1) - yaws))
    overlap = np.minimum(pairwise_overlap(camera, turns, following), pairwise_overlap(camera, following, turns))
    if not closed:
        # a sector's row is cut at its widest step, which need not be where yaw wraps
        widest = int(np.argmax(spacing))
        spacing, overlap = np.delete(spacing, widest), np.delete(overlap, widest)
    return float(spacing.max()), float(overlap.min())


def _with_row(camera: Camera, shots: Sequence[Shot], others: Sequence[Shot]) -> float:
    turns, partners = shot_rotations(shots), shot_rotations(others)
    # skip images that are too far apart to overlap: this only saves time
    reach = np.cos(np.radians(min(180.0, 2 * np.degrees(np.arctan(np.hypot(camera.half_width, camera.half_height))))))
    near = turns[:, :, 0] @ partners[:, :, 0].T > reach
    most = max(1, int(near.sum(axis=1).max()))
    order = np.argsort(~near, axis=1, kind="stable")[:, :most]
    present = np.take_along_axis(near, order, axis=1)
    return float(union_overlap(camera, turns, partners[order], present).min())
