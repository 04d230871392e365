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
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.pictures.correlation import correlate_near, correlate_wide, samples
from panoexec.pictures.detail import Comparison, cell_centres, compare
from panoexec.pictures.features import CELL_PX, DETAIL_PX, DISTINCT_CORNER, Features, Floats
from panoexec.pictures.parallax import downward, ground_consensus, ground_matrix
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
_FAR: Final = 0.01
"""Displacement of the recorded positions, heights, from which they are tried where nothing else ties."""
_WELL_PX: Final = 0.25
"""Residual, and share of the corners, with which a turn alone explains a match so well that no other place is tried."""
_WELL_FRAC: Final = 0.5
_SURE_SIGMAS: Final = 3.0
_GROUND_POINTS: Final = 12
"""Fewer points are no evidence of six unknowns."""
MIN_TEXTURED: Final = 8
"""So many corners in an overlap show that it has texture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A photo with its measured attitude.

    Attributes:
        features: what was measured of it.
        rotation: (3, 3) camera to world.
        focal_px: focal length at the scale of the examination.
        place: (3,) where it was taken, world frame, heights above the ground; None if that is unknown.
    """

    features: Features
    rotation: FloatArray
    focal_px: float
    place: FloatArray | None = None

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
        parallax_deg: by how much the content of the ground is displaced at most because the photos were taken from
            different places; 0 where a rotation explains it all.
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
    parallax_deg: float = 0.0

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
    searched = min(len(corners), _COARSE_CORNERS)
    found = None
    if textured and searched >= MIN_POINTS:
        found = _search(first, second, corners, search)
        if found is None and first.place is not None and second.place is not None:
            # farther apart than is searched: where the recorded positions say
            shift = first.rotation.T @ (second.place - first.place)
            if np.linalg.norm(shift) >= _FAR:
                found = _search(first, second, corners, search, shift)
    match = _NO_MATCH if found is None or len(found.pixels) < MIN_POINTS else found
    return Tie(
        points=len(match.pixels),
        searched=searched,
        textured=textured,
        distinct=distinct,
        turn_world_deg=np.degrees(first.rotation @ match.turn),
        sigma_deg=match.sigma_deg,
        rms_px=match.rms_px,
        pixels=match.pixels,
        comparison=_compared(first, second),
        parallax_deg=match.parallax_deg,
    )


def _project(
    first: View, second: View, places: FloatArray, turn: FloatArray | None = None, shift: FloatArray | None = None
) -> FloatArray:
    """Where pixels (k, 2) of the first photo are in the second, (k, 2); NaN behind it.

    Args:
        first: whose pixels they are.
        second: the photo into which they are projected.
        places: pixels of the first.
        turn: rotation vector that corrects the attitude of the first, its camera's frame.
        shift: where the second camera is from the first, heights above flat ground, the first camera's frame.
    """
    rays = np.concatenate([np.full((len(places), 1), first.focal_px), places - first.centre], axis=1)
    if shift is not None:
        down = downward(places - first.centre, first.focal_px, first.rotation)
        rays = rays - (first.focal_px * down)[:, None] * shift
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Match:
    """Matched pixels (k, 4), the turn of the first photo that they imply, and the rest as in `Tie`."""

    pixels: FloatArray
    turn: FloatArray
    sigma_deg: float
    rms_px: float
    parallax_deg: float = 0.0


_NO_MATCH: Final = _Match(pixels=np.empty((0, 4)), turn=np.zeros(3), sigma_deg=float("nan"), rms_px=float("nan"))


def _search(
    first: View, second: View, corners: FloatArray, search: int, start: FloatArray | None = None
) -> _Match | None:
    """The match, searched about the measured attitudes, and about a shift if one is given (see `_project`)."""
    chosen = corners[:_COARSE_CORNERS]
    reach = search // 2
    places = np.round(chosen)
    template = _patches(first, first, places, half=_COARSE_HALF, step=2)
    window = _patches(first, second, places, half=_COARSE_HALF + reach, step=2, shift=start)
    shift, score = correlate_wide(template, window)
    if (score >= _COARSE_NCC).sum() < MIN_POINTS // 2 + 1:
        return None
    order = _best_first(score, _COARSE_NCC)
    coarse = places[order], 2.0 * shift[order]
    if start is not None:
        return _from_elsewhere(first, second, corners, coarse, start=start)
    matrix = displacement_matrix(places - first.centre, first.focal_px)
    fit = consensus(matrix[order], 2.0 * shift[order], tolerance_px=3.0, weights=score[order])
    # displaced content: the scene, seen from the first photo, appears turned by this
    turned = None if fit is None or fit.inliers.sum() < 4 else _by_turn(first, second, corners, fit.turn)
    if turned is not None and turned.rms_px <= _WELL_PX and len(turned.pixels) >= _WELL_FRAC * len(corners):
        return turned
    return _from_elsewhere(first, second, corners, coarse, turned=turned)


def _by_turn(first: View, second: View, corners: FloatArray, turn: FloatArray) -> _Match | None:
    """The match at full scale, about a turn."""
    places = np.round(corners)
    inside = _inside(second, _project(first, second, places, turn), _FINE_HALF + 2.0)
    places = places[inside]
    if len(places) < MIN_POINTS:
        return None
    template = _patches(first, first, places, half=_FINE_HALF)
    window = _patches(first, second, places, half=_FINE_HALF + _FINE_SEARCH, turn=turn)
    shift, score = correlate_near(template, window)
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
    pixels = np.concatenate([places[kept], other], axis=1)
    return _Match(pixels=pixels, turn=total, sigma_deg=fit.sigma_deg, rms_px=fit.rms_px)


def _from_elsewhere(
    first: View,
    second: View,
    corners: FloatArray,
    coarse: tuple[FloatArray, FloatArray],
    *,
    turned: _Match | None = None,
    start: FloatArray | None = None,
) -> _Match | None:
    """The match if the photos were taken from different places; `turned` unless that explains clearly more.

    Args:
        first: whose corners are searched.
        second: the other photo.
        corners: in the overlap.
        coarse: places and displacements at half the scale, the most certain first.
        turned: what a turn alone explains.
        start: the shift about which the displacements were found.
    """
    where, moved = coarse
    fit = ground_consensus(ground_matrix(where - first.centre, first.focal_px, first.rotation), moved, tolerance_px=2.5)
    places = np.round(corners)
    if fit is None or fit.inliers.sum() < _GROUND_POINTS:
        return turned
    turn, shift = fit.turn, fit.shift if start is None else fit.shift + start
    inside = _inside(second, _project(first, second, places, turn, shift), _FINE_HALF + 2.0)
    places = places[inside]
    if len(places) < _GROUND_POINTS:
        return turned
    template = _patches(first, first, places, half=_FINE_HALF)
    window = _patches(first, second, places, half=_FINE_HALF + _FINE_SEARCH, turn=turn, shift=shift)
    found, score = correlate_near(template, window)
    order = _best_first(score, _FINE_NCC)
    fit = ground_consensus(
        ground_matrix(places[order] - first.centre, first.focal_px, first.rotation), found[order], tolerance_px=1.2
    )
    if fit is None or fit.inliers.sum() < max(_GROUND_POINTS, 0.5 * len(places)):
        return turned
    kept = order[fit.inliers]
    other = _project(first, second, places[kept] + found[kept], turn, shift)
    turn, shift = turn + fit.turn, shift + fit.shift
    clearer = turned is None or (
        len(kept) >= 1.25 * len(turned.pixels)
        or (len(kept) >= 0.9 * len(turned.pixels) and fit.rms_px <= 0.7 * turned.rms_px)
    )
    if not clearer or fit.sigmas(shift) < _SURE_SIGMAS:
        return turned
    rays = ground_matrix(places[kept] - first.centre, first.focal_px, first.rotation)[:, :, 3:]
    displaced = float(np.linalg.norm(rays @ shift, axis=1).max()) / first.focal_px
    return _Match(
        pixels=np.concatenate([places[kept], other], axis=1),
        turn=turn,
        sigma_deg=fit.sigma_deg,
        rms_px=fit.rms_px,
        parallax_deg=float(np.degrees(displaced)),
    )


def _patches(
    first: View,
    of: View,
    places: FloatArray,
    *,
    half: int,
    step: int = 1,
    turn: FloatArray | None = None,
    shift: FloatArray | None = None,
) -> Floats:
    """Square patches (k, 2 half + 1, 2 half + 1) of a photo in the pixel grid of the first about places.

    Args:
        first: whose grid.
        of: whose pixels.
        places: (k, 2) centres, pixels of the first.
        half: half the side, steps.
        step: pixels of the first from one sample to the next; 2 x 2 pixels are averaged for 2.
        turn: see `_project`.
        shift: likewise.
    """
    offsets = np.arange(-half, half + 1) * step
    grey = of.features.grey
    if of is first and turn is None:
        columns = (places[:, 0].astype(np.intp))[:, None] + offsets
        rows = (places[:, 1].astype(np.intp))[:, None] + offsets
        return samples(grey, columns[:, None, :].astype(np.float32), rows[:, :, None].astype(np.float32), step)
    # an affine map about each centre: exact to a tenth of a pixel over a patch
    centre = _project(first, of, places, turn, shift)[:, :, None, None]
    map_ = _derivative(first, of, places, turn, shift)[:, :, :, None, None]
    across, along = offsets[None, None, :], offsets[None, :, None]
    x = centre[:, 0] + map_[:, 0, 0] * across + map_[:, 0, 1] * along
    y = centre[:, 1] + map_[:, 1, 0] * across + map_[:, 1, 1] * along
    return samples(grey, x.astype(np.float32), y.astype(np.float32), step)


def _best_first(score: FloatArray, least: float) -> NDArray[np.intp]:
    """The numbers of the scores that reach the least, the best first."""
    order = np.argsort(-score, kind="stable")
    return np.asarray(order[score[order] >= least])


def _derivative(
    first: View, of: View, places: FloatArray, turn: FloatArray | None, shift: FloatArray | None = None
) -> FloatArray:
    """Derivatives (k, 2, 2) of `_project`, over 16 pixels."""
    steps = (np.array([8.0, 0.0]), np.array([0.0, 8.0]))
    moved = [
        _project(first, of, places + step, turn, shift) - _project(first, of, places - step, turn, shift)
        for step in steps
    ]
    return np.asarray(np.stack(moved, axis=-1) / 16.0)
