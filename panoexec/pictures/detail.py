"""Compares two photos where they overlap: how bright they are, and how sharp.

Sharpness is relative, so that water, fog and sky are no false alarm: what is smooth is smooth in both photos. In each
photo the outer products of the finest gradients are summed over the overlap, cell by cell at the same places, the
second photo's turned and scaled into the first's pixel grid. The smallest generalised eigenvalue of the two sums is how
much less detail the first photo has along the direction in which it lost most: a smear along one direction is noticed
as well as a lens out of focus. The same ratio of coarse gradients, over all directions, is divided out: it is the
photos' different exposure. What both photos lack along some direction compared with the other (the grids differ, the
perspective too) cancels in the ratio of the two directions of comparison.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.pictures.features import DETAIL_PX, Features

MIN_CELLS: Final = 12
"""Fewer cells in the overlap compare nothing."""
_MIN_FINE: Final = 1.5
"""Least root mean square of the finest gradients, grey levels, that is detail rather than noise."""
_MIN_COARSE: Final = 1.2
_GAMMA: Final = 2.2
"""Stored values are about the power 1/2.2 of light."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """The first photo compared with the second.

    Attributes:
        stops: by how much the first is brighter than the second, stops; NaN without enough overlap.
        sharpness: fine detail of the first over that of the second, along the direction in which one of them has least;
            NaN without detail; of the second over the first it is the inverse.
    """

    stops: float
    sharpness: float


NOTHING: Final = Comparison(stops=float("nan"), sharpness=float("nan"))


def cell_centres(features: Features) -> FloatArray:
    """Pixel positions (rows · columns, 2) of the centres of the cells."""
    rows, columns = features.fine.shape[:2]
    x = np.arange(columns) * DETAIL_PX + (DETAIL_PX - 1) / 2
    y = np.arange(rows) * DETAIL_PX + (DETAIL_PX - 1) / 2
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1).reshape(-1, 2)


def compare(
    first: Features, second: Features, *, cells: NDArray[np.intp], places: FloatArray, jacobian: FloatArray
) -> Comparison:
    """Compare two photos, cell by cell of the first, with what the second shows at the same places.

    Args:
        first: one photo.
        second: the other.
        cells: (k,) numbers of the first's cells that the second shows, too.
        places: (k, 2) their centres in the second, pixels.
        jacobian: (k, 2, 2) derivatives of the map from pixels of the first to pixels of the second there.
    """
    if len(cells) < MIN_CELLS:
        return NOTHING
    rows, columns = first.fine.shape[:2]
    light = float(first.means[:rows, :columns].ravel()[cells].mean())
    other = float(_at(second.means, places).mean())
    stops = _GAMMA * math.log2((light + 1) / (other + 1))
    fine = _tensors(first.fine.reshape(-1, 3)[cells]), _turned(_at(second.fine, places), jacobian)
    coarse = _traces(first.coarse.reshape(-1, 3)[cells]), _traces(_at(second.coarse, places))
    own, others = (np.trace(part, axis1=1, axis2=2) for part in fine)
    detailed = (np.maximum(own, others) >= _MIN_FINE**2) & (np.minimum(*coarse) >= _MIN_COARSE**2)
    if detailed.sum() < MIN_CELLS:
        return Comparison(stops=stops, sharpness=float("nan"))
    # every cell counts alike, so that no bright roof decides alone
    weight = 1 / (own + others)[detailed, None, None]
    sums = [(part[detailed] * weight).sum(axis=0) for part in fine]
    scale = [float((part[detailed] / (coarse[0] + coarse[1])[detailed]).sum()) for part in coarse]
    exposure = scale[0] / scale[1]
    forward, backward = _weakest(sums[0], sums[1] * exposure), _weakest(sums[1] * exposure, sums[0])
    return Comparison(stops=stops, sharpness=math.sqrt(forward / backward) if backward > 0 else float("nan"))


def _at(grid: NDArray[np.float32], places: FloatArray) -> FloatArray:
    """Values of a grid of cells at pixel positions, bilinear; beyond the outermost centres, theirs."""
    position = (places - (DETAIL_PX - 1) / 2) / DETAIL_PX
    column = np.clip(position[:, 0], 0, grid.shape[1] - 1)
    row = np.clip(position[:, 1], 0, grid.shape[0] - 1)
    left = np.minimum(column.astype(np.intp), max(0, grid.shape[1] - 2))
    top = np.minimum(row.astype(np.intp), max(0, grid.shape[0] - 2))
    right, bottom = np.minimum(left + 1, grid.shape[1] - 1), np.minimum(top + 1, grid.shape[0] - 1)
    x, y = column - left, row - top
    if grid.ndim == 3:
        x, y = x[:, None], y[:, None]
    upper = grid[top, left] * (1 - x) + grid[top, right] * x
    return np.asarray(upper * (1 - y) + (grid[bottom, left] * (1 - x) + grid[bottom, right] * x) * y)


def _traces(cells: NDArray[Any]) -> FloatArray:
    return np.asarray(cells[:, 0] + cells[:, 2], dtype=np.float64)


def _tensors(cells: NDArray[Any]) -> FloatArray:
    """Outer products (k, 2, 2) from their components xx, xy, yy."""
    return np.stack([cells[:, [0, 1]], cells[:, [1, 2]]], axis=1).astype(np.float64)


def _turned(cells: FloatArray, jacobian: FloatArray) -> FloatArray:
    """The second photo's outer products in the first one's pixel grid."""
    return np.asarray(np.swapaxes(jacobian, 1, 2) @ _tensors(cells) @ jacobian)


def _weakest(of: FloatArray, against: FloatArray) -> float:
    """Square root of the smallest eigenvalue of `against`^-1 `of`."""
    floor = 0.02 * np.trace(against) * np.eye(2)
    values = np.linalg.eigvals(np.linalg.solve(against + floor, of + floor))
    return float(np.sqrt(max(0.0, float(np.min(values.real)))))
