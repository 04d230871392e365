"""Exposure and white balance: factors of light that make photos alike where ties say that they show the same.

Light is compared cell by cell over the whole overlap of two tied photos, under the attitudes that the tie found, and
the median ratio counts: a car that has moved and a cell at the edge of a roof do not decide.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Final

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.pictures.matching import Tie
from panoexec.pictures.rotations import rotation_of_vector

_GAMMA: Final = 2.2
_PRIOR: Final = 0.5
"""Standard deviation of a photo's exposure, natural logarithm, before its ties are looked at."""
_TIE: Final = 0.02
_CELLS: Final = 64
"""Cells across a photo's longer side."""
_LEAST_CELLS: Final = 8


def small_colours(content: bytes) -> FloatArray:
    """Linear light (h, w, 3) of the cells of a photo; empty if it cannot be read."""
    try:
        with PIL.Image.open(io.BytesIO(content)) as picture:
            longer = max(picture.size)
            size = (max(1, round(picture.size[0] * _CELLS / longer)), max(1, round(picture.size[1] * _CELLS / longer)))
            picture.draft("RGB", (4 * size[0], 4 * size[1]))
            small = picture.convert("RGB").resize(size, PIL.Image.Resampling.BOX)
    except (OSError, SyntaxError, ValueError):
        return np.zeros((0, 0, 3))
    return np.asarray((np.asarray(small, dtype=np.float64) / 255) ** _GAMMA)


def gains_of(
    colours: Mapping[int, FloatArray],
    ties: Mapping[tuple[int, int], Tie],
    rotations: Mapping[int, FloatArray],
    *,
    half_width: float,
) -> dict[int, tuple[float, float, float]]:
    """Factors of red, green and blue light; their geometric mean over all photos is 1.

    Args:
        colours: of each shot, see `small_colours`.
        ties: good ones, by pairs of shots.
        rotations: measured attitudes (3, 3), camera to world, of the pixels as stored.
        half_width: tangent of half the field of view across the stored width.
    """
    shots = list(colours)
    place = {shot: number for number, shot in enumerate(shots)}
    normal, side = np.eye(len(shots)) / _PRIOR**2, np.zeros((len(shots), 3))
    weight = 1 / _TIE**2
    for (a, b), tie in ties.items():
        # the second photo's attitude as the content says it is, if the first one's is right
        second = rotation_of_vector(-np.radians(tie.turn_world_deg)) @ rotations[b]
        ratio = _log_ratio(colours[a], colours[b], second.T @ rotations[a], half_width)
        if ratio is None:
            continue
        # the gains' logarithms differ by what the light does
        i, j = place[a], place[b]
        normal[[i, j], [i, j]] += weight
        normal[[i, j], [j, i]] -= weight
        side[i] -= weight * ratio
        side[j] += weight * ratio
    if not shots:
        return {}
    logs = np.linalg.solve(normal, side)
    logs -= logs.mean(axis=0)
    return {shot: (float(g[0]), float(g[1]), float(g[2])) for shot, g in zip(shots, np.exp(logs), strict=True)}


def _log_ratio(first: FloatArray, second: FloatArray, relative: FloatArray, half_width: float) -> FloatArray | None:
    """Median of the logarithm of the first's light over the second's, (3,), where neither is black nor saturated."""
    if not first.size or first.shape != second.shape:
        return None
    height, width = first.shape[:2]
    step = 2 * half_width / width
    right = (np.arange(width) + 0.5 - width / 2) * step
    down = (np.arange(height) + 0.5 - height / 2) * step
    y, z = np.meshgrid(right, down)
    seen = np.stack([np.ones_like(y), y, z], axis=-1).reshape(-1, 3) @ relative.T
    with np.errstate(divide="ignore", invalid="ignore"):
        column = seen[:, 1] / seen[:, 0] / step + width / 2
        row = seen[:, 2] / seen[:, 0] / step + height / 2
    inside = (seen[:, 0] > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    one = first.reshape(-1, 3)[inside]
    other = second[row[inside].astype(np.intp), column[inside].astype(np.intp)]
    usable = (np.minimum(one, other).min(axis=1) > 0.002) & (np.maximum(one, other).max(axis=1) < 0.95)
    if usable.sum() < _LEAST_CELLS:
        return None
    return np.asarray(np.median(np.log(one[usable] / other[usable]), axis=0))


def stored_gain(gain: tuple[float, float, float]) -> NDArray[np.uint8]:
    """Tables (3, 256) from stored values to stored values for factors of light."""
    values = np.arange(256) / 255
    tables = [255 * np.clip(values * factor ** (1 / _GAMMA), 0, 1) + 0.5 for factor in gain]
    return np.asarray(tables).astype(np.uint8)
