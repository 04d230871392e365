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

import numpy as np

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import Constraints
from panoexec.planning.search.row_layout import reachable_pitch

_CELLS = 900
"""Cells of pitch per vertical field of view, and at most so many in all."""
_MOST_CELLS = 60_000
_NODES, _QUANTILE_NODES = 601, 1441
"""Pitches, 0 to 90° and -90° to 90°, at which the widest spacing and the quantiles are computed."""
_COLUMNS = 16
_BISECTIONS = 26
_CLOSE_RAD = 2e-4
_MOST_SCANS = 120
_INTERPOLATION_DEG = 0.01
"""Slack for the interpolation of quantiles between nodes, which are smooth in the pitch."""
_AROUND = 720
_POLAR_END_DEG = 0.1
_CAP_STEPS, _CAP_TILTS, _CAP_YAWS = 200, 12, 9
_CAP_SLACK = 0.01
"""Overlap that a cap may lack: its pitches are evaluated on a grid."""


def least_images_in_rows(camera: Camera, constraints: Constraints) -> int | None:
    """The bound; None where it does not apply, or says nothing."""
    asked = camera.image_area / (4 * camera.half_width * camera.half_height)
    across, upwards = constraints.overlap_h * asked, constraints.overlap_v * asked
    band = constraints.band
    if not band.is_full_circle or constraints.masks or constraints.textured_below is not None:
        return None
    if not (0 < across < 1 and 0 < upwards < 1):
        return None
    low, high = reachable_pitch(constraints.gimbal)
    step = max(camera.vfov_deg / _CELLS, (high - low) / _MOST_CELLS)
    count = max(2, math.ceil((high - low) / step))
    pitch = low + (np.arange(count) + 0.5) * (high - low) / count
    half_cell = (high - low) / count / 2
    images, widest = _images(camera, across, pitch, half_cell)
    reach = _steps(camera, upwards, pitch, half_cell)
    error = constraints.tolerance.pitch_deg + half_cell
    begins = np.minimum.accumulate(_lowest(camera, pitch)[::-1])[::-1] - error <= band.elevation_min_deg
    ends = np.maximum.accumulate(-_lowest(camera, -pitch)) + error >= band.elevation_max_deg
    capped = 90.0 - np.abs(pitch) <= camera.vfov_deg / 2 + half_cell
    first = np.where(begins, images, np.inf)
    first = np.where(begins & capped & (pitch < 0), np.minimum(first, 2), first)
    more = _more_at_end(camera, constraints.band.elevation_max_deg, pitch, images, error)
    last = np.where(ends, more, np.inf)
    more = _more_at_end(camera, -constraints.band.elevation_min_deg, -pitch, images, error)
    first = np.where(capped, first, first + more)
    highest = _after_a_cap(camera, upwards, widest, pitch)
    if low <= -90.0 + camera.vfov_deg / 2:
        # after a cap of one image
        first = np.where(pitch <= highest + half_cell, np.minimum(first, 1 + images), first)
    if high >= 90.0 - camera.vfov_deg / 2:
        last = np.where(-pitch <= highest + half_cell, np.minimum(last, 1), last)
        # a cap of two images in place of a row
        top = ends & capped & (pitch > 0)
        images = np.where(top, np.minimum(images, 2), images)
    if np.any(begins & ends & capped):
        return 1  # one image about a pole may show all of the band
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


def _images(camera: Camera, across: float, pitch: FloatArray, half_cell: float) -> tuple[FloatArray, FloatArray]:
    """Fewest images of closed rows in cells (k,), and the widest spacing (k,) at which neighbours overlap, degrees."""
    nodes = np.linspace(0.0, 90.0, _NODES)
    apart = math.radians(nodes[1]) / 2 + math.radians(half_cell)
    w, h = camera.half_width, camera.half_height
    rate = (w + h) * (1 + w * w + h * h) / (w * h)
    reach = math.atan(math.hypot(w, h))
    # farther apart than twice the half diagonal two images share nothing
    share = math.sin(min(reach, math.pi / 2)) / np.maximum(np.cos(np.radians(nodes)), 1e-12)
    yaw = 2 * np.arcsin(np.minimum(share, 1.0))
    todo = np.arange(_NODES)
    for _ in range(_MOST_SCANS):
        here = rotation(0.0, nodes[todo])
        there = rotation(np.degrees(yaw[todo]), nodes[todo])
        found = pairwise_overlap(camera, here, there) * (camera.image_area / (4 * w * h))
        lacking = across - found - rate * 2 * np.sin(yaw[todo] / 2) * apart
        going = lacking / rate > _CLOSE_RAD
        yaw[todo[going]] -= lacking[going] / rate
        todo = todo[going]
        if not len(todo):
            break
    near = np.minimum((np.abs(pitch) / nodes[1]).astype(np.intp), _NODES - 2)
    widest = np.degrees(np.maximum(yaw[near], yaw[near + 1]))
    return np.maximum(3.0, np.ceil(360.0 / np.maximum(widest, 1e-6) - 1e-9)), widest


def _more_at_end(camera: Camera, end_deg: float, pitch: FloatArray, images: FloatArray, error_deg: float) -> FloatArray:
    """Images (k,) that the last row must have in addition, or another row, to cover the parallel at the band's end."""
    if end_deg > 90.0 - _POLAR_END_DEG:
        return np.zeros(len(pitch))
    more = np.zeros(len(pitch))
    near = np.nonzero(np.abs(pitch - end_deg) <= camera.vfov_deg)[0]
    if len(near):
        shown = _shown_deg(camera, pitch[near] - error_deg, end_deg, error_deg)
        wanted = np.ceil(360.0 / np.maximum(shown, 1e-3) - 1e-9)
        more[near] = np.maximum(wanted - images[near], 0.0)
    return np.minimum(more, 1.0)


def _shown_deg(camera: Camera, pitch: FloatArray, elevation_deg: float, error_deg: float) -> FloatArray:
    """Azimuths (k,) of a parallel that images show, of any pitch nearer than the error, rounded up; degrees."""
    grown = math.radians(error_deg) * (1 + camera.half_width**2 + camera.half_height**2)
    w, h = camera.half_width + grown, camera.half_height + grown
    around = (np.arange(_AROUND) + 0.5) * math.pi / _AROUND
    p, e = np.radians(pitch)[:, None], math.radians(elevation_deg)
    ahead = math.cos(e) * np.cos(around) * np.cos(p) + math.sin(e) * np.sin(p)
    down = math.cos(e) * np.cos(around) * np.sin(p) - math.sin(e) * np.cos(p)
    inside = (ahead > 0) & (np.abs(down) <= h * ahead) & (math.cos(e) * np.sin(around) <= w * ahead)
    return np.asarray(2 * (inside.sum(axis=1) + 3) * 180.0 / _AROUND)


def _steps(camera: Camera, upwards: float, pitch: FloatArray, half_cell: float) -> np.ndarray:
    """The highest cell (k,) in which the row after one in each cell may be; non-decreasing."""
    above = _quantile(camera, upwards, pitch) + half_cell
    shown_from = np.minimum.accumulate(_lowest(camera, pitch)[::-1])[::-1] - half_cell
    shown_to = -_lowest(camera, -pitch) + half_cell
    below = np.minimum.accumulate(-_quantile(camera, upwards, -pitch)[::-1])[::-1] - half_cell
    by_own = np.searchsorted(shown_from, above, side="right") - 1
    by_next = np.searchsorted(below, shown_to, side="right") - 1
    return np.maximum.accumulate(np.minimum(by_own, by_next))


def _lowest(camera: Camera, pitch: FloatArray) -> FloatArray:
    """The lowest elevation (k,) that images show, degrees."""
    p, w, h = np.radians(pitch), camera.half_width, camera.half_height
    sine, cosine = np.sin(p), np.cos(p)
    across = np.array([0.0, w])[:, None, None]
    down = np.stack([np.full(len(p), -h), np.full(len(p), h)])
    # along a side the lowest point is an end, or where the derivative vanishes
    turning = np.clip(-(1 + across**2) * cosine / np.where(np.abs(sine) > 1e-9, sine, 1e-9), -h, h)
    down = np.concatenate([np.broadcast_to(down, (2, 2, len(p))), turning], axis=1)
    found = (sine - down * cosine) / np.sqrt(1 + across**2 + down**2)
    lowest = np.degrees(np.arcsin(np.clip(found.min(axis=(0, 1)), -1.0, 1.0)))
    return np.where(pitch - camera.vfov_deg / 2 <= -90.0, -90.0, lowest)


def _quantile(camera: Camera, share: float, pitch: FloatArray) -> FloatArray:
    """The elevation (k,) above which the fraction `share` of an image lies, rounded up, degrees."""
    nodes = np.linspace(-90.0, 90.0, _QUANTILE_NODES)
    p = np.radians(nodes)[:, None]
    y, weights = np.polynomial.legendre.leggauss(2 * _COLUMNS)
    s = 1 + (camera.half_width * y[_COLUMNS:]) ** 2
    weights = 2 * weights[_COLUMNS:]
    low = np.radians(np.maximum(nodes - camera.vfov_deg, -90.0) - 60.0)
    high = np.full(len(nodes), math.pi / 2)
    low = np.maximum(low, -math.pi / 2)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        k = np.sin(middle)[:, None]
        root = np.sin(p) ** 2 + s * (np.cos(p) ** 2 - k * k)
        divisor = np.cos(p) ** 2 - k * k
        divisor = np.where(np.abs(divisor) > 1e-9, divisor, 1e-9)
        z = (np.sin(p) * np.cos(p) - k * np.sqrt(np.maximum(root, 0.0))) / divisor
        z = np.where(root < 0, np.where(k > 0, -np.inf, np.inf), z)
        z = np.clip(z, -camera.half_height, camera.half_height)
        part = ((z + camera.half_height) / (2 * camera.half_height)) @ weights / 2
        enough = part >= share
        low, high = np.where(enough, middle, low), np.where(enough, high, middle)
    found = np.degrees(high) + _INTERPOLATION_DEG
    # where an image shows a pole nothing is claimed but what it shows at all
    polar = 90.0 - np.abs(nodes) <= camera.vfov_deg / 2 + nodes[1] - nodes[0]
    found = np.where(polar, -_lowest(camera, -nodes), found)
    return np.asarray(np.interp(pitch, nodes, found))


def _after_a_cap(camera: Camera, upwards: float, widest: FloatArray, pitch: FloatArray) -> float:
    """The highest pitch of a closed row of which all images overlap with one image that shows the nadir, degrees."""
    tilts = np.linspace(-90.0, -90.0 + camera.vfov_deg / 2, _CAP_TILTS)
    candidates = np.linspace(-90.0, min(-90.0 + 2 * camera.vfov_deg, 90.0), _CAP_STEPS)
    step = candidates[1] - candidates[0]
    gap = np.interp(candidates, pitch, widest)
    yaws = 180.0 - np.minimum(gap, 180.0)[:, None] / 2 * np.linspace(1.0, 0.0, _CAP_YAWS)
    rows = rotation(yaws, candidates[:, None])[None]
    caps = rotation(0.0, tilts)[:, None, None]
    shape = (len(tilts), _CAP_STEPS, _CAP_YAWS)
    seen = pairwise_overlap(camera, np.broadcast_to(rows, (*shape, 3, 3)), np.broadcast_to(caps, (*shape, 3, 3))) * (
        camera.image_area / (4 * camera.half_width * camera.half_height)
    )
    possible = (seen >= upwards - _CAP_SLACK).any(axis=(0, 2))
    return float(candidates[possible].max(initial=-90.0) + step)
