"""Ties two photos: corners of the first are searched in the second where the measured attitudes say they are.

Patches of the second photo are resampled into the pixel grid of the first, so that a pure difference of attitudes is a
small displacement, and correlated by normalised cross-correlation: first at half the scale over everything that a wrong
attitude of `SEARCH_DEG` could do, then, about the rotation that most of these displacements agree with, at full scale.
Single corners may be mistaken (waves, furrows, windows); a tie is what many of them say alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.pictures.detail import Comparison, cell_centres, compare
from panoexec.pictures.features import CELL_PX, DETAIL_PX, DISTINCT_CORNER, Features, Floats
from panoexec.pictures.rotations import consensus, displacement_matrix, rotation_of_vector

SEARCH_DEG: Final = 2.2
"""How far apart from the measured attitudes a tie is searched, unless asked for otherwise."""
_MOST_SEARCH_PX: Final = 96
_COARSE_CORNERS: Final = 32
_FINE_CORNERS: Final = 48
_COARSE_HALF: Final = 8
"""Half the side of a template at half scale."""
_FINE_HALF: Final = 8
_FINE_SEARCH: Final = 4
_COARSE_NCC: Final = 0.5
_FINE_NCC: Final = 0.6
MIN_POINTS: Final = 6
"""Fewer agreeing points are no tie."""
MIN_TEXTURED: Final = 8
"""So many corners in an overlap show that it has texture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A photo with its measured attitude.

    Attributes:
        features: what was measured of it.
        rotation: (3, 3) camera to world.
        focal_px: focal length at the scale of the examination.
    """

    features: Features
    rotation: FloatArray
    focal_px: float

    @property
    def centre(self) -> FloatArray:
        """The principal point, pixels, 0 at the first pixel's centre."""
        width, height = self.features.size
        return np.array([(width - 1) / 2, (height - 1) / 2])


@dataclass(frozen=True, slots=True, kw_only=True)
class Tie:
    """The result for two photos.

    Attributes:
        points: how many corners agree on one rotation; 0: no tie was found.
        searched: how many corners were searched.
        textured: whether both photos show texture in the overlap.
        distinct: corners in the overlap that are unmistakable, in the photo that shows fewer of them.
        turn_world_deg: (3,) how the second photo's measured attitude differs from what the content says, world frame
            (north, east, down), degrees; zero without a tie.
        sigma_deg: standard deviation of that turn about its worst axis.
        rms_px: residual of the points.
        pixels: (points, 4) x, y in the first and in the second photo, at the scale of the examination.
        comparison: brightness and sharpness in the overlap.
    """

    points: int
    searched: int
    textured: bool
    distinct: int
    turn_world_deg: FloatArray
    sigma_deg: float
    rms_px: float
    pixels: FloatArray
    comparison: Comparison

    @property
    def tied(self) -> bool:
        """Whether the content ties the two photos."""
        return self.points >= MIN_POINTS

    @property
    def angle_deg(self) -> float:
        """Size of the disagreement."""
        return float(np.linalg.norm(self.turn_world_deg))


def tie(first: View, second: View, *, search_deg: float = SEARCH_DEG) -> Tie | None:
    """Tie two photos; None if they do not overlap.

    Args:
        first: whose corners are searched.
        second: the photo that is resampled.
        search_deg: how far apart from the measured attitudes a tie is searched.
    """
    search = min(_MOST_SEARCH_PX, int(np.ceil(np.radians(search_deg) * first.focal_px)))
    shared = _shared_corners(first, second)
    if shared is None:
        return None
    corners, textured, distinct = shared
    pixels, fit_turn, sigma, rms = np.empty((0, 4)), np.zeros(3), float("nan"), float("nan")
    searched = min(len(corners), _COARSE_CORNERS)
    if textured and searched >= MIN_POINTS:
        found = _search(first, second, corners, search)
        if found is not None:
            pixels, fit_turn, sigma, rms = found
    if len(pixels) < MIN_POINTS:
        pixels, fit_turn = np.empty((0, 4)), np.zeros(3)
    return Tie(
        points=len(pixels),
        searched=searched,
        textured=textured,
        distinct=distinct,
        turn_world_deg=np.degrees(first.rotation @ fit_turn),
        sigma_deg=sigma,
        rms_px=rms,
        pixels=pixels,
        comparison=_compared(first, second),
    )


def _project(first: View, second: View, places: FloatArray, turn: FloatArray | None = None) -> FloatArray:
    """Where pixels (k, 2) of the first photo are in the second, (k, 2); NaN behind it.

    Args:
        first: whose pixels they are.
        second: the photo into which they are projected.
        places: pixels of the first.
        turn: rotation vector that corrects the attitude of the first, its camera's frame.
    """
    rays = np.concatenate([np.full((len(places), 1), first.focal_px), places - first.centre], axis=1)
    relative = second.rotation.T @ first.rotation
    if turn is not None:
        relative = relative @ rotation_of_vector(turn)
    seen = rays @ relative.T
    depth = np.where(seen[:, 0] > 1e-6, seen[:, 0], np.nan)
    return np.asarray(second.focal_px * seen[:, 1:] / depth[:, None] + second.centre)


def _inside(view: View, places: FloatArray, margin: float) -> NDArray[np.bool_]:
    width, height = view.features.size
    with np.errstate(invalid="ignore"):
        x, y = places[:, 0], places[:, 1]
        return np.asarray((x >= margin) & (y >= margin) & (x <= width - 1 - margin) & (y <= height - 1 - margin))


def _shared_corners(first: View, second: View) -> tuple[FloatArray, bool, int] | None:
    """The first photo's corners in the overlap, best first but spread; texture in both; `Tie.distinct`."""
    margin = _FINE_HALF + 2.0
    ends = second.rotation.T @ first.rotation @ np.array([1.0, 0, 0])
    reach = np.hypot(*first.features.size) / 2 / first.focal_px
    if ends[0] < np.cos(min(np.pi, 2 * np.arctan(reach))):
        return None
    own = first.features.corners
    seen = _inside(second, _project(first, second, own), margin) & _inside(first, own, margin)
    other = second.features.corners
    visible = _inside(first, _project(second, first, other), margin)
    corners, strength = own[seen], first.features.strength[seen]
    textured = len(corners) >= MIN_TEXTURED and int(visible.sum()) >= MIN_TEXTURED
    distinct = min(int((part >= DISTINCT_CORNER).sum()) for part in (strength, second.features.strength[visible]))
    return _spread(corners, strength, _FINE_CORNERS), textured, distinct


def _spread(corners: FloatArray, strength: Floats, most: int) -> FloatArray:
    """At most about `most` corners: the strongest of each of equal squares, the strongest squares first."""
    if len(corners) <= most:
        return np.asarray(corners[np.argsort(-strength)])
    side = CELL_PX
    best = np.arange(len(corners))
    while len(best) > most:
        side = side * 5 // 4
        squares = corners // side
        key = squares[:, 1] * 100_000 + squares[:, 0]
        order = np.lexsort((-strength, key))
        new = np.ones(len(order), dtype=bool)
        new[1:] = key[order][1:] != key[order][:-1]
        best = order[new]
    return np.asarray(corners[best[np.argsort(-strength[best])]])


def _compared(first: View, second: View) -> Comparison:
    centres = cell_centres(first.features)
    places = _project(first, second, centres)
    cells = np.flatnonzero(_inside(second, places, DETAIL_PX / 2))
    jacobian = _derivative(first, second, centres[cells], None)
    return compare(first.features, second.features, cells=cells, places=places[cells], jacobian=jacobian)


def _search(
    first: View, second: View, corners: FloatArray, search: int
) -> tuple[FloatArray, FloatArray, float, float] | None:
    """Matched pixels (k, 4), the turn of the first photo that they imply, its uncertainty (degrees), and rms (px)."""
    chosen = corners[:_COARSE_CORNERS]
    reach = search // 2
    places = np.round(chosen)
    template = _patches(first, first, places, half=_COARSE_HALF, step=2)
    window = _patches(first, second, places, half=_COARSE_HALF + reach, step=2)
    shift, score = _correlate_wide(template, window)
    if (score >= _COARSE_NCC).sum() < MIN_POINTS // 2 + 1:
        return None
    matrix = displacement_matrix(places - first.centre, first.focal_px)
    order = _best_first(score, _COARSE_NCC)
    fit = consensus(matrix[order], 2.0 * shift[order], tolerance_px=3.0, weights=score[order])
    if fit is None or fit.inliers.sum() < 4:
        return None
    # displaced content: the scene, seen from the first photo, appears turned by this
    turn = fit.turn
    places = np.round(corners)
    inside = _inside(second, _project(first, second, places, turn), _FINE_HALF + 2.0)
    places = places[inside]
    if len(places) < MIN_POINTS:
        return None
    template = _patches(first, first, places, half=_FINE_HALF)
    window = _patches(first, second, places, half=_FINE_HALF + _FINE_SEARCH, turn=turn)
    shift, score = _correlate_near(template, window)
    order = _best_first(score, _FINE_NCC)
    matrix = displacement_matrix(places[order] - first.centre, first.focal_px)
    fit = consensus(matrix, shift[order], tolerance_px=1.2)
    if fit is None:
        return None
    kept = order[fit.inliers]
    if len(kept) < MIN_POINTS or len(kept) < 0.3 * len(places):
        return None
    # a point at `places` of the first is found where the second shows `places + shift`, resampled under the turn
    other = _project(first, second, places[kept] + shift[kept], turn)
    total = turn + fit.turn
    return np.concatenate([places[kept], other], axis=1), total, fit.sigma_deg, fit.rms_px


def _patches(
    first: View, of: View, places: FloatArray, *, half: int, step: int = 1, turn: FloatArray | None = None
) -> Floats:
    """Square patches (k, 2 half + 1, 2 half + 1) of a photo in the pixel grid of the first about places.

    Args:
        first: whose grid.
        of: whose pixels.
        places: (k, 2) centres, pixels of the first.
        half: half the side, steps.
        step: pixels of the first from one sample to the next; 2 x 2 pixels are averaged for 2.
        turn: see `_project`.
    """
    offsets = np.arange(-half, half + 1) * step
    grey = of.features.grey
    if of is first and turn is None:
        columns = (places[:, 0].astype(np.intp))[:, None] + offsets
        rows = (places[:, 1].astype(np.intp))[:, None] + offsets
        return _samples(grey, columns[:, None, :].astype(np.float32), rows[:, :, None].astype(np.float32), step)
    # an affine map about each centre: exact to a tenth of a pixel over a patch
    centre = _project(first, of, places, turn)[:, :, None, None]
    map_ = _derivative(first, of, places, turn)[:, :, :, None, None]
    across, along = offsets[None, None, :], offsets[None, :, None]
    x = centre[:, 0] + map_[:, 0, 0] * across + map_[:, 0, 1] * along
    y = centre[:, 1] + map_[:, 1, 0] * across + map_[:, 1, 1] * along
    return _samples(grey, x.astype(np.float32), y.astype(np.float32), step)


def _best_first(score: FloatArray, least: float) -> NDArray[np.intp]:
    """The numbers of the scores that reach the least, the best first."""
    order = np.argsort(-score, kind="stable")
    return np.asarray(order[score[order] >= least])


def _derivative(first: View, of: View, places: FloatArray, turn: FloatArray | None) -> FloatArray:
    """Derivatives (k, 2, 2) of `_project`, over 16 pixels."""
    steps = (np.array([8.0, 0.0]), np.array([0.0, 8.0]))
    moved = [_project(first, of, places + step, turn) - _project(first, of, places - step, turn) for step in steps]
    return np.asarray(np.stack(moved, axis=-1) / 16.0)


def _samples(grey: NDArray[np.uint8], columns: Floats, rows: Floats, step: int) -> Floats:
    """Bilinear samples, or with step 2 means of 2 x 2 neighbours; NaN-free: the border repeats."""
    height, width = grey.shape
    columns = np.clip(columns, 0, width - 1.001)
    rows = np.clip(rows, 0, height - 1.001)
    left, top = columns.astype(np.int32), rows.astype(np.int32)
    flat = grey.ravel()
    index = top * np.int32(width) + left
    a, b = flat.take(index).astype(np.float32), flat.take(index + 1).astype(np.float32)
    index = index + np.int32(width)
    c, d = flat.take(index).astype(np.float32), flat.take(index + 1).astype(np.float32)
    if step == 2:
        return np.asarray((a + b + c + d) * np.float32(0.25))
    x, y = columns - left, rows - top
    upper = a + (b - a) * x
    return np.asarray(upper + (c + (d - c) * x - upper) * y)


def _normalised(template: Floats) -> Floats:
    """Templates with zero mean and unit norm."""
    centred = template - template.mean(axis=(1, 2), keepdims=True)
    norm = np.sqrt((centred**2).sum(axis=(1, 2), keepdims=True))
    return np.asarray(centred / np.maximum(norm, np.float32(1e-3)))


def _window_norms(window: Floats, side: int) -> Floats:
    """Norm about the mean of every place of a template in the windows, (k, s, s)."""

    def sums(values: Floats) -> FloatArray:
        total = np.zeros((len(values), values.shape[1] + 1, values.shape[2] + 1))
        np.cumsum(np.cumsum(values, axis=1, dtype=np.float64), axis=2, out=total[:, 1:, 1:])
        return total[:, side:, side:] - total[:, :-side, side:] - total[:, side:, :-side] + total[:, :-side, :-side]

    mean = sums(window)
    square = sums(window * window)
    return np.asarray(np.sqrt(np.maximum(square - mean**2 / side**2, 1.0)), dtype=np.float32)


def _correlate_wide(template: Floats, window: Floats) -> tuple[FloatArray, FloatArray]:
    """Displacement (k, 2) of the best correlation over large windows, by Fourier transforms, and its score (k,)."""
    side = template.shape[1]
    span = window.shape[1] - side + 1
    window = window - window.mean(axis=(1, 2), keepdims=True)
    size = _fast_length(window.shape[1])
    spectrum = np.fft.rfft2(window, s=(size, size)) * np.conj(np.fft.rfft2(_normalised(template), s=(size, size)))
    score = np.fft.irfft2(spectrum, s=(size, size))[:, :span, :span].astype(np.float32)
    score /= _window_norms(window, side)
    return _peaks(score, span // 2)


def _correlate_near(template: Floats, window: Floats) -> tuple[FloatArray, FloatArray]:
    """Likewise over small windows, directly."""
    side = template.shape[1]
    span = window.shape[1] - side + 1
    window = window - window.mean(axis=(1, 2), keepdims=True)
    views = sliding_window_view(window, (side, side), axis=(1, 2))
    score = np.einsum("kabij,kij->kab", views, _normalised(template), optimize=True)
    score /= _window_norms(window, side)
    return _peaks(score, span // 2)


def _peaks(score: Floats, middle: int) -> tuple[FloatArray, FloatArray]:
    """The highest value of each map, with a parabola through its neighbours; a peak at the border has score 0."""
    count, side = score.shape[:2]
    best = score.reshape(count, -1).argmax(axis=1)
    row, column = best // side, best % side
    number = np.arange(count)
    value = score[number, row, column].astype(np.float64)
    inner = (row > 0) & (row < side - 1) & (column > 0) & (column < side - 1)
    r, c = np.clip(row, 1, side - 2), np.clip(column, 1, side - 2)

    def vertex(before: FloatArray, at: FloatArray, after: FloatArray) -> FloatArray:
        curve = before - 2 * at + after
        return np.clip(np.where(curve < -1e-9, (before - after) / (2 * np.minimum(curve, -1e-9)), 0.0), -0.5, 0.5)

    centre = score[number, r, c]
    x = column + vertex(score[number, r, c - 1], centre, score[number, r, c + 1])
    y = row + vertex(score[number, r - 1, c], centre, score[number, r + 1, c])
    return np.stack([x - middle, y - middle], axis=-1), np.where(inner, value, 0.0)


def _fast_length(least: int) -> int:
    """The next length of small prime factors."""
    best = 1 << (least - 1).bit_length()
    for fives in (1, 5):
        for threes in (1, 3, 9):
            length = fives * threes
            while length < least:
                length *= 2
            best = min(best, length)
    return best
