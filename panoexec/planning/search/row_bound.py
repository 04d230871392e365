"""Lower bound of the number of images of plans in closed rows, by the overlaps that C2 and C3 ask for.

**The class of plans.** Rows of one pitch each, roll 0, numbered by ascending pitch. Each row is closed: three or more
images all round, at any phase and any spacing. Only the lowest and the highest row may be a *cap* of one or two images
that see the pole; one such image may be all. The band is a full circle, without masks and skyline; both overlaps are
above 0.

**Images in a row.** n images all round have two neighbours that are at least 360°/n apart, and by C2 these overlap by
`overlap_h`. Let d(p) be the widest yaw difference at which two images of pitch p overlap so much: n ≥ 360°/d(p).

**Steps between rows.** Whatever the next row is, it shows nothing below the lowest elevation that an image of its pitch
shows at any yaw. By C3 each image has the fraction `overlap_v` of its area above that elevation, and each image of the
next row that fraction below the highest elevation which the row shows. Both limit the pitch of the next row. A cap of
one image must overlap with images of the next row that are at least 180° - d/2 away in yaw.

**Ends.** Some image shows a direction at each end of the band for every pitch error.

The bound is the shortest chain of rows under these conditions, by dynamic programming over cells of pitch. A cell uses
the most favourable values within it: rotating an image by an angle changes an elevation by at most that angle, and the
overlap of two images by at most L times it, L = (w + h)·(1 + w² + h²)/(w·h), as the border of what they share moves by
at most (1 + w² + h²) times the angle and is no longer than that of an image. Coverage between the rows, whole numbers
of seams and C4 are left out: no plan of the class has fewer images, but there may be none with as few.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.planning.model import Constraints
from panoexec.planning.search.cover_bound import least_images_that_cover
from panoexec.planning.search.parallels import grown_shown_deg
from panoexec.planning.search.row_layout import reachable_pitch
from panoexec.planning.search.row_limits import (
    fewest_images,
    highest_after_caps,
    highest_next,
    lowest_shown,
    useful_caps,
)

_CELLS = 900
"""Cells of pitch per vertical field of view, and at most so many in all."""
_MOST_CELLS = 60_000
_POLAR_END_DEG = 0.1


def least_images_in_rows(
    camera: Camera,
    constraints: Constraints,
    *,
    images: int | None = None,
    go_on: Callable[[], bool] = lambda: True,
) -> int | None:
    """The bound; None where it does not apply, or says nothing.

    Args:
        camera: the camera.
        constraints: what is asked for.
        images: there is a plan of the class with so many, so that a larger bound is not looked for, and far below not a
            little tighter one either; None if none is known.
        go_on: asked now and then; with False the bound is what is known by then.
    """
    band = constraints.band
    if not band.is_full_circle or constraints.masks or constraints.textured_below is not None:
        return None
    if not (constraints.overlap_h < 1 and constraints.overlap_v < 1):
        return None
    known = _by_overlaps(camera, constraints)
    if known == 1:
        return 1
    if images is not None and known is not None and known >= images:
        return known
    least = least_images_that_cover(camera, constraints, known or 1, images=images, go_on=go_on)
    return least if known is not None or least > 1 else None


def _by_overlaps(camera: Camera, constraints: Constraints) -> int | None:
    """The bound by C2, C3 and the ends alone; None where they ask nothing."""
    asked = camera.image_area / (4 * camera.half_width * camera.half_height)
    across, upwards = constraints.overlap_h * asked, constraints.overlap_v * asked
    band = constraints.band
    if not (0 < across < 1 and 0 < upwards < 1):
        return None
    low, high = reachable_pitch(constraints.gimbal)
    step = max(camera.vfov_deg / _CELLS, (high - low) / _MOST_CELLS)
    count = max(2, math.ceil((high - low) / step))
    pitch = low + (np.arange(count) + 0.5) * (high - low) / count
    half_cell = (high - low) / count / 2
    error = constraints.tolerance.pitch_deg + half_cell
    begins = np.minimum.accumulate(lowest_shown(camera, pitch)[::-1])[::-1] - error <= band.elevation_min_deg
    ends = np.maximum.accumulate(-lowest_shown(camera, -pitch)) + error >= band.elevation_max_deg
    capped = 90.0 - np.abs(pitch) <= camera.vfov_deg / 2 + half_cell
    if np.any(begins & ends & capped):
        return 1  # one image about a pole may show all of the band
    images, _ = fewest_images(camera, across, pitch, half_cell)
    reach = highest_next(camera, upwards, pitch, half_cell)
    low_caps, top_caps = useful_caps(camera, band, pitch, error)
    low_caps, top_caps = capped & low_caps & begins, capped & top_caps & ends
    first = np.where(begins, images, np.inf)
    first = np.where(low_caps, np.minimum(first, 2), first)
    tolerance = constraints.tolerance.pitch_deg
    more = more_at_end(camera, band.elevation_max_deg, pitch - tolerance, images, half_cell)
    last = np.where(ends, more, np.inf)
    more = more_at_end(camera, -band.elevation_min_deg, -pitch - tolerance, images, half_cell)
    first = np.where(capped, first, first + more)
    if np.any(low_caps | top_caps):
        highest, _ = highest_after_caps(camera, across, upwards)
        if np.any(low_caps):
            # after a cap of one image
            first = np.where(pitch <= highest + half_cell, np.minimum(first, 1 + images), first)
        if np.any(top_caps):
            last = np.where(-pitch <= highest + half_cell, np.minimum(last, 1), last)
            # a cap of two images in place of a row
            images = np.where(top_caps, np.minimum(images, 2), images)
    least = _shortest(first, images, last, reach)
    return None if not math.isfinite(least) else int(least)


def _shortest(first: FloatArray, images: FloatArray, last: FloatArray, reach: np.ndarray) -> float:
    """Least images of a chain of rows: one in cell i may follow one in cell j < i if i ≤ reach[j] (non-decreasing)."""
    best = math.inf
    costs = [0.0] * len(first)
    window: deque[int] = deque()
    starts, each, ends, far = first.tolist(), images.tolist(), last.tolist(), reach.tolist()
    for i in range(len(costs)):
        while window and far[window[0]] < i:
            window.popleft()
        cost = min(starts[i], each[i] + costs[window[0]]) if window else starts[i]
        costs[i] = cost
        best = min(best, cost + ends[i])
        while window and costs[window[-1]] >= cost:
            window.pop()
        window.append(i)
    return best


def more_at_end(camera: Camera, end_deg: float, pitch: FloatArray, images: FloatArray, half_cell: float) -> FloatArray:
    """Images (k,) that the last row must have in addition, or another row, to cover the parallel at the band's end.

    Args:
        camera: the camera.
        end_deg: the band's upper end.
        pitch: (k,) of the row, less the pitch error.
        images: (k,) that the row has at least.
        half_cell: how far its pitch may be from these, degrees.
    """
    if end_deg > 90.0 - _POLAR_END_DEG:
        return np.zeros(len(pitch))
    more = np.zeros(len(pitch))
    near = np.nonzero(np.abs(pitch - end_deg) <= camera.vfov_deg)[0]
    if len(near):
        shown = grown_shown_deg(camera, pitch[near], half_cell, end_deg)
        wanted = np.ceil(360.0 / np.maximum(shown, 1e-3) - 1e-9)
        more[near] = np.maximum(wanted - images[near], 0.0)
    return np.minimum(more, 1.0)
