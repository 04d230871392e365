"""What C2 and C3 allow closed rows of one pitch at most, whatever their phases and spacings: for lower bounds.

All values are for *cells* of pitch, given by their middles and half their width, and are the most favourable ones in a
cell: rotating an image by an angle changes an elevation by at most that angle, and the overlap of two images by at most
L times it, L = (w + h)·(1 + w² + h²)/(w·h), as the border of what they share moves by at most (1 + w² + h²) times the
angle and is no longer than that of an image. Only the quantiles of C3 and the rows after a cap of one image are
evaluated on a grid with slack.

The overlap of two images of one pitch p changes by much less with the yaw λ between them. In the plane of one of them,
y right and z down, the other one's border moves at v = (cos p·(1 + y²) + z·sin p, y·(z·cos p - sin p)). With R what
they share, d(area of R)/dλ is ∫ div v over R, div v = 3y·cos p, less the flux of v out of R through the borders of the
image itself. So where λ grows, the overlap falls by at most

    [S + w²·max(|sin p|, h·cos p) + 3·w²·h·cos p] / (4·w·h),  S = ∫ |(1 + w²)·cos p + z·sin p| dz from -h to h:

the flux outwards through both sides, that through the borders above and below, and the part of R at y < 0.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, rotation
from panoexec.optics import Camera
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import Band

BoolArray = NDArray[np.bool_]

_COARSE_NODES, _NODES, _QUANTILE_NODES = 121, 1201, 1441
"""Pitches, 0 to 90° and -90° to 90°, at which the widest spacing and the quantiles are computed."""
_COLUMNS = 16
_BISECTIONS = 26
_CLOSE_RAD = 2e-4
_MOST_SCANS, _FEW_LEFT = 120, 0.02
"""The scan of spacings ends after so many steps, or with this part of the nodes left, which stay at what is known."""
_INTERPOLATION_DEG = 0.01
"""Slack for the interpolation of quantiles between nodes, which are smooth in the pitch."""
_CAP_STEPS, _CAP_TILTS, _CAP_YAWS, _CAP_ASIDE = 100, 9, 25, 9
_CAP_SLACK = 0.01
"""Overlap that a cap may lack: its pitches are evaluated on a grid."""


def fewest_images(camera: Camera, across: float, pitch: FloatArray, half_cell: float) -> tuple[FloatArray, FloatArray]:
    """Fewest images of closed rows in cells (k,), and the widest spacing (k,) at which neighbours overlap, degrees.

    n images all round have two neighbours that are at least 360°/n apart, and by C2 these overlap by `across`.
    """
    widest = np.degrees(_greatest(_widest_at_nodes(camera, across), 90.0 / (_NODES - 1), np.abs(pitch), half_cell))
    return np.maximum(3.0, np.ceil(360.0 / np.maximum(widest, 1e-6) - 1e-9)), widest


@lru_cache(maxsize=16)
def _widest_at_nodes(camera: Camera, across: float) -> FloatArray:
    """The widest spacings (n,) at any pitch nearer to nodes of 0 to ±90° than to others; radians."""
    coarse = np.linspace(0.0, 90.0, _COARSE_NODES)
    w, h = camera.half_width, camera.half_height
    reach = math.atan(math.hypot(w, h))
    # farther apart than twice the half diagonal two images share nothing
    share = math.sin(min(reach, math.pi / 2)) / np.maximum(np.cos(np.radians(coarse + coarse[1] / 2)), 1e-12)
    share[-1] = 1.0
    outer = _widest(camera, across, coarse, 2 * np.arcsin(np.clip(share, 0.0, 1.0)), coarse[1] / 2)
    nodes = np.linspace(0.0, 90.0, _NODES)
    return _widest(camera, across, nodes, _greatest(outer, coarse[1], nodes, nodes[1] / 2), nodes[1] / 2)


def _widest(camera: Camera, across: float, nodes: FloatArray, yaw: FloatArray, apart_deg: float) -> FloatArray:
    """The widest spacing (k,) at any pitch nearer than `apart_deg` to nodes, none being wider than `yaw`; radians."""
    w, h = camera.half_width, camera.half_height
    most_rate = (w + h) * (1 + w * w + h * h) / (w * h)
    rate = yaw_rate(camera, nodes)
    apart = math.radians(apart_deg) * (1 + 1e-6)
    yaw, todo = yaw.copy(), np.arange(len(nodes))
    for _ in range(_MOST_SCANS):
        here = rotation(0.0, nodes[todo])
        there = rotation(np.degrees(yaw[todo]), nodes[todo])
        found = pairwise_overlap(camera, here, there) * (camera.image_area / (4 * w * h))
        lacking = across - found - most_rate * 2 * np.sin(yaw[todo] / 2) * apart
        step = lacking / rate[todo]
        going = step > _CLOSE_RAD
        yaw[todo[going]] -= step[going]
        todo = todo[going]
        if len(todo) <= _FEW_LEFT * len(nodes):
            break
    return yaw


def yaw_rate(camera: Camera, pitch_deg: FloatArray) -> FloatArray:
    """How fast the overlap of images of one pitch (k,) falls at most with the yaw between them, per radian."""
    w, h = camera.half_width, camera.half_height
    sine, cosine = np.abs(np.sin(np.radians(pitch_deg))), np.abs(np.cos(np.radians(pitch_deg)))
    flat = (1 + w * w) * cosine
    tilted = (flat**2 + (h * sine) ** 2) / np.maximum(sine, 1e-12)
    sides = np.where(flat >= h * sine, 2 * h * flat, tilted)
    return np.asarray((sides + w * w * np.maximum(sine, h * cosine) + 3 * w * w * h * cosine) / (4 * w * h))


def _greatest(values: FloatArray, step: float, middles: FloatArray, half: float) -> FloatArray:
    """The greatest of the values at nodes 0, step, … whose surroundings of half a step meet `middles` ± half; (k,)."""
    low = np.clip(np.round((middles - half) / step - 1e-6), 0, len(values) - 1).astype(np.intp)
    high = np.clip(np.round((middles + half) / step + 1e-6), 0, len(values) - 1).astype(np.intp)
    found = values[low]
    for offset in range(1, int((high - low).max(initial=0)) + 1):
        found = np.maximum(found, values[np.minimum(low + offset, high)])
    return found


def highest_next(camera: Camera, upwards: float, pitch: FloatArray, half_cell: float) -> np.ndarray:
    """The highest cell (k,) in which the row after one in each cell may be; non-decreasing."""
    above = quantile(camera, upwards, pitch) + half_cell
    shown_from = np.minimum.accumulate(lowest_shown(camera, pitch)[::-1])[::-1] - half_cell
    shown_to = -lowest_shown(camera, -pitch) + half_cell
    below = np.minimum.accumulate(-quantile(camera, upwards, -pitch)[::-1])[::-1] - half_cell
    by_own = np.searchsorted(shown_from, above, side="right") - 1
    by_next = np.searchsorted(below, shown_to, side="right") - 1
    return np.maximum.accumulate(np.minimum(by_own, by_next))


def lowest_shown(camera: Camera, pitch: FloatArray) -> FloatArray:
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


def useful_caps(camera: Camera, band: Band, pitch: FloatArray, error_deg: float) -> tuple[BoolArray, BoolArray]:
    """Which pitches (k,) images about the nadir, and about the zenith, may have that show anything of a band.

    Without the others a plan has fewer images, and the next row begins, or ends, the band.

    Args:
        camera: the camera.
        band: to cover.
        pitch: of the images.
        error_deg: how far the pitch may be from these.
    """
    low = (pitch < 0) & (-lowest_shown(camera, -pitch) + error_deg >= band.elevation_min_deg)
    return low, (pitch > 0) & (lowest_shown(camera, pitch) - error_deg <= band.elevation_max_deg)


def quantile(camera: Camera, share: float, pitch: FloatArray) -> FloatArray:
    """The elevation (k,) above which the fraction `share` of an image lies, rounded up, degrees."""
    return np.asarray(np.interp(pitch, *_quantiles_at_nodes(camera, share)))


@lru_cache(maxsize=16)
def _quantiles_at_nodes(camera: Camera, share: float) -> tuple[FloatArray, FloatArray]:
    """Pitches from -90° to 90° and the elevations for `quantile`, degrees."""
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
    return nodes, np.where(polar, -lowest_shown(camera, -nodes), found)


@lru_cache(maxsize=16)
def highest_after_caps(camera: Camera, across: float, upwards: float) -> tuple[float, float]:
    """The highest pitches of closed rows of which all images overlap with one, or two, images of a row about the nadir.

    Some direction is at 180° from one image in yaw, or at 90° at least from both of two, one on each side; an image of
    the row is within half its widest spacing of it. What two images share with it is at most the sum.

    Args:
        camera: the camera.
        across: the share of each other that neighbours in the row see.
        upwards: the share that is asked for.
    """
    tilts = np.linspace(-90.0, -90.0 + camera.vfov_deg / 2, _CAP_TILTS)
    # images farther apart than twice the half diagonal share nothing
    diagonal = math.degrees(2 * math.atan(math.hypot(camera.half_width, camera.half_height)))
    candidates = np.linspace(-90.0, min(-90.0 + camera.vfov_deg / 2 + diagonal, 90.0), _CAP_STEPS)
    step = float(candidates[1] - candidates[0])
    yaws = np.linspace(0.0, 180.0, _CAP_YAWS)
    rows = rotation(0.0, candidates)[:, None]
    whole = camera.image_area / (4 * camera.half_width * camera.half_height)
    seen = np.stack([pairwise_overlap(camera, rows, rotation(yaws, np.full(_CAP_YAWS, tilt))[None]) for tilt in tilts])
    # at this yaw or farther
    seen = np.maximum.accumulate(seen[:, :, ::-1], axis=2)[:, :, ::-1] * whole
    half = np.minimum(fewest_images(camera, across, candidates, step)[1], 180.0) / 2
    aside = half[:, None] * np.linspace(0.0, 1.0, _CAP_ASIDE)
    near, far = 90.0 - aside, np.minimum(90.0 + aside, 180.0 - aside)
    one = _at_yaws(seen, 180.0 - half[:, None]).max(axis=(0, 2))
    two = (_at_yaws(seen, near) + _at_yaws(seen, far)).max(axis=(0, 2))
    return (
        float(candidates[one >= upwards - _CAP_SLACK].max(initial=-90.0) + step),
        float(candidates[two >= upwards - 2 * _CAP_SLACK].max(initial=-90.0) + step),
    )


def _at_yaws(seen: FloatArray, yaw_deg: FloatArray) -> FloatArray:
    """What is seen (t, k, n) at yaws (k, n), by linear interpolation of samples (t, k, m) at 0 to 180°."""
    last = seen.shape[2] - 1
    x = yaw_deg / 180.0 * last
    i = np.clip(x.astype(np.intp), 0, last - 1)
    left, right = (np.take_along_axis(seen, np.broadcast_to(j, (len(seen), *j.shape)), axis=2) for j in (i, i + 1))
    return np.asarray(left + (x - i) * (right - left))
