"""Lower bound of the number of images of any plan, by solid angle; `row_bound` has a better one for closed rows.

Let N images cover the part D of the sphere. There are two bounds; the larger one counts:

* **Guaranteed cover.** An image's robust core (what it sees for every error) is inside the image rotated by the pitch
  axis's errors ±τ, and the intersection of both extremes has at most the half height tan(ψ_v/2 - τ). So D needs at
  least its solid angle divided by that of such a reduced image.
* **Overlap.** With more than one image, C2 or C3 makes every image share at least the fraction f = min(overlap_h,
  overlap_v) of its area with others (two images in a row with each other; else with the adjacent row). That part has at
  least the solid angle s of the image's outermost fraction f. A direction that m ≥ 2 images see is counted m times in
  the sum of their solid angles Ω, so m - 1 ≥ m/2 times too often: N·Ω ≥ D + N·s/2.

Masks are subtracted from D, each with its solid angle inside the band; so overlapping masks only lower the bound.
"""

from __future__ import annotations

import math

import numpy as np

from panoexec.optics import Camera
from panoexec.planning.certificate.adjacency import MUTUAL_OVERLAP
from panoexec.planning.model import AngleBox, Band, Constraints

_RAYS = 400


def least_images(camera: Camera, constraints: Constraints) -> int:
    """Lower bound of the number of images of a plan for these constraints."""
    domain = domain_sr(constraints)
    core = _pyramid_sr(camera.half_width, _lowered(camera, constraints.tolerance.pitch_deg))
    certain = math.ceil(domain / core - 1e-9) if core > 0 else 1
    if certain <= 1 and domain <= camera.solid_angle_sr:
        return 1
    if constraints.textured_below is not None:
        return max(certain, 1)  # images of the sky alone need not overlap
    least_overlap = min(constraints.overlap_h, constraints.overlap_v)
    if constraints.masks:
        # neighbours separated by a mask need no overlap, but then C4 requires an overlap with some other image
        least_overlap = min(least_overlap, MUTUAL_OVERLAP)
    shared = _outermost_sr(camera, least_overlap)
    return max(certain, math.ceil(domain / (camera.solid_angle_sr - shared / 2) - 1e-9), 1)


def domain_sr(constraints: Constraints) -> float:
    """Lower bound of the solid angle of the domain, steradians."""
    band = constraints.band
    whole = _box_sr(band)
    masked = sum(_common_sr(band, mask) for mask in constraints.masks)
    return max(whole - masked, 0.0)


def _lowered(camera: Camera, pitch_tolerance_deg: float) -> float:
    left = math.atan(camera.half_height) - math.radians(pitch_tolerance_deg)
    return math.tan(max(left, 0.0))


def _pyramid_sr(half_width: float, half_height: float) -> float:
    a, b = half_width, half_height
    return 4 * math.asin(a * b / math.sqrt((1 + a * a) * (1 + b * b)))


def _outermost_sr(camera: Camera, fraction: float) -> float:
    """Solid angle of the outermost fraction of an image's area, the minimum over all parts of that area; steradians."""
    y = (np.arange(_RAYS) + 0.5) / _RAYS * camera.half_width
    z = (np.arange(_RAYS) + 0.5) / _RAYS * camera.half_height
    density = np.sort(((1 + y[:, None] ** 2 + z**2) ** -1.5).ravel())
    cell = camera.half_width * camera.half_height / _RAYS**2
    # slightly reduced for the error of the quadrature
    return float(4 * cell * density[: int(fraction * len(density))].sum()) * (1 - 1e-3)


def _box_sr(box: Band | AngleBox) -> float:
    low, high = math.radians(box.elevation_min_deg), math.radians(box.elevation_max_deg)
    width = math.radians(min(box.azimuth_span_deg, 360.0))
    return max(math.sin(high) - math.sin(low), 0.0) * width


def _common_sr(band: Band, mask: AngleBox) -> float:
    low, high = max(band.elevation_min_deg, mask.elevation_min_deg), min(band.elevation_max_deg, mask.elevation_max_deg)
    if high <= low:
        return 0.0
    start, stop = band.azimuth_min_deg, band.azimuth_max_deg
    shift = 360.0 * math.floor((mask.azimuth_min_deg - start) / 360.0)
    left, right = mask.azimuth_min_deg - shift, mask.azimuth_max_deg - shift
    width = sum(max(0.0, min(right + turn, stop) - max(left + turn, start)) for turn in (-360.0, 0.0, 360.0))
    height = math.sin(math.radians(high)) - math.sin(math.radians(low))
    return height * math.radians(min(width, stop - start))
