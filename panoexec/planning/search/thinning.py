"""Effect of masks: a smaller band, and images that can be dropped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from panoexec.angles import FloatArray, rotation
from panoexec.azimuths import SAME_AZIMUTH_DEG
from panoexec.optics import Camera
from panoexec.planning.certificate.verdict import certify_poses
from panoexec.planning.geometry.domain import Domain
from panoexec.planning.geometry.footprint import rectangle
from panoexec.planning.model import AngleBox, Constraints, Shot

_SAMPLES = 9
_MOST_TRIED = 60


def trim_band(constraints: Constraints) -> Constraints:
    """The constraints with the band reduced where a mask covers its whole upper or lower end."""
    band = constraints.band
    low, high = band.elevation_min_deg, band.elevation_max_deg
    for _ in constraints.masks:
        for mask in constraints.masks:
            if not _spans(mask, band.azimuth_min_deg, band.azimuth_span_deg):
                continue
            if mask.elevation_min_deg <= low < mask.elevation_max_deg < high:
                low = mask.elevation_max_deg
            if low < mask.elevation_min_deg < high <= mask.elevation_max_deg:
                high = mask.elevation_min_deg
    return replace(constraints, band=replace(band, elevation_min_deg=low, elevation_max_deg=high))


def _spans(mask: AngleBox, azimuth_min_deg: float, span_deg: float) -> bool:
    width = mask.azimuth_span_deg
    begin = (azimuth_min_deg - mask.azimuth_min_deg) % 360.0
    if begin > 360.0 - SAME_AZIMUTH_DEG:
        begin = 0.0
    return width >= 360.0 or begin + span_deg <= width + SAME_AZIMUTH_DEG


def drop_redundant_shots(
    camera: Camera, constraints: Constraints, shots: Sequence[Shot], go_on: Callable[[], bool] = lambda: True
) -> tuple[Shot, ...]:
    """The shots without those that masks make redundant; the certificate decides.

    Candidates are tried by the fraction of the domain that they see: first all that see nothing of it, then one by one.

    Args:
        camera: the camera.
        constraints: with the masks.
        shots: of a certified plan.
        go_on: asked before each verdict; False ends it with what was dropped until then.
    """
    needed = _domain_fractions(camera, constraints, shots)
    kept = [shot for shot, share in zip(shots, needed.tolist(), strict=True) if share > 0]
    if len(kept) == len(shots) or not go_on() or not _certified(camera, constraints, kept):
        kept = list(shots)
    candidates = sorted((share, i) for i, share in enumerate(needed.tolist()) if share < 0.6)
    for _, i in candidates[:_MOST_TRIED]:
        if shots[i] not in kept:
            continue
        if not go_on():
            break
        fewer = [shot for shot in kept if shot is not shots[i]]
        if _certified(camera, constraints, fewer):
            kept = fewer
    rows = {row: n for n, row in enumerate(sorted({shot.row for shot in kept}))}
    return tuple(replace(shot, index=n, row=rows[shot.row]) for n, shot in enumerate(kept))


def _certified(camera: Camera, constraints: Constraints, shots: Sequence[Shot]) -> bool:
    if not shots:
        return False
    poses = rotation([s.yaw_deg for s in shots], [s.pitch_deg for s in shots])
    return certify_poses(camera, constraints, poses, [shot.row for shot in shots], explain=False).certified


def _domain_fractions(camera: Camera, constraints: Constraints, shots: Sequence[Shot]) -> FloatArray:
    """Approximate fraction of each image that needs cover, (n,)."""
    domain = Domain.of(constraints.band, constraints.masks)
    width, height = rectangle(camera)[2]
    grid = np.linspace(-1.0, 1.0, _SAMPLES)
    y, z = (a.ravel() for a in np.meshgrid(grid * width, grid * height))
    rays = np.stack([np.ones_like(y), y, z], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    poses = rotation([s.yaw_deg for s in shots], [s.pitch_deg for s in shots])
    world = rays @ np.swapaxes(poses, -1, -2)
    return np.asarray(domain.contains(world.reshape(-1, 3)).reshape(len(shots), -1).mean(axis=1))
