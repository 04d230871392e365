"""Blends remapped images in two bands: fine detail from one image at each place, brightness from all of them smoothly.

At each place the image whose border is farthest away gives the detail; near the line where two are equally good, their
weights change over a few hundredths of their depth. Brightness (everything coarser than a few dozen pixels) is weighed
by the square of the depth, so that differences in exposure fade over the whole overlap. Weights follow from the
geometry alone, so blocks that are blended one at a time fit together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

_SHARPNESS = 40.0
"""Exponent of the detail's weights: a depth ratio of 0.95 weighs exp(-40 · 0.05) = 0.13."""
_LEAST_DEPTH = 1e-3


@dataclass(frozen=True, slots=True)
class Patch:
    """An image as remapped into a view.

    Attributes:
        number: the image.
        left: column of the view where it starts.
        top: row.
        pixels: (h, w, 3) uint8.
        mask: (h, w), where it has pixels.
    """

    number: int
    left: int
    top: int
    pixels: NDArray[np.uint8]
    mask: NDArray[np.bool_]

    @property
    def place(self) -> tuple[slice, slice]:
        """Rows and columns of the view that it covers."""
        h, w = self.mask.shape
        return slice(self.top, self.top + h), slice(self.left, self.left + w)


def blend(
    shape: tuple[int, int], patches: Sequence[Patch], depth_of: Callable[[int], Floats], blur_px: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Blend patches into one picture.

    Args:
        shape: (height, width) of the view.
        patches: remapped images.
        depth_of: gives the depth (height, width) of an image in the view: 1 in its middle, 0 at its border.
        blur_px: radius that separates detail from brightness.

    Returns:
        (height, width, 3) uint8 and the mask of what is covered by at least one image.
    """
    height, width = shape
    depths = [np.maximum(depth_of(patch.number)[patch.place], _LEAST_DEPTH) for patch in patches]
    best = np.full(shape, _LEAST_DEPTH, dtype=np.float32)
    for patch, depth in zip(patches, depths, strict=True):
        view = best[patch.place]
        np.maximum(view, np.where(patch.mask, depth, 0), out=view)
    coarse, coarse_weight = np.zeros((height, width, 3), np.float32), np.zeros(shape, np.float32)
    fine, fine_weight = np.zeros((height, width, 3), np.float32), np.zeros(shape, np.float32)
    for patch, depth in zip(patches, depths, strict=True):
        colour = patch.pixels.astype(np.float32)
        smooth = _blurred(colour, patch.mask, blur_px)
        weight = np.where(patch.mask, depth * depth, 0).astype(np.float32)
        coarse[patch.place] += smooth * weight[..., None]
        coarse_weight[patch.place] += weight
        weight = np.where(patch.mask, np.exp(_SHARPNESS * (depth / best[patch.place] - 1)), 0).astype(np.float32)
        colour -= smooth
        fine[patch.place] += colour * weight[..., None]
        fine_weight[patch.place] += weight
    covered = coarse_weight > 0
    coarse /= np.where(covered, coarse_weight, 1)[..., None]
    fine /= np.where(covered, fine_weight, 1)[..., None]
    coarse += fine
    picture = np.clip(coarse + np.float32(0.5), 0, 255).astype(np.uint8)
    picture[~covered] = 0
    return picture, covered


def _blurred(colour: Floats, mask: NDArray[np.bool_], radius: int) -> Floats:
    """Two box blurs over the mask's pixels alone."""
    weight = mask.astype(np.float32)
    total = colour * weight[..., None]
    for _ in range(2):
        total, weight = _box(total, radius), _box(weight[..., None], radius)[..., 0]
    return np.asarray(total / np.maximum(weight, 1e-6)[..., None], dtype=np.float32)


def _box(values: Floats, radius: int) -> Floats:
    """Mean over a square of 2 · radius + 1 pixels, what is outside counting as 0; (h, w, c)."""
    out = values
    for axis in (0, 1):
        length = out.shape[axis]
        edges = [(0, 0)] * 3
        edges[axis] = (1, 0)
        # running sums in double precision: differences of long sums lose digits
        sums = np.pad(np.cumsum(out, axis=axis, dtype=np.float64), edges)
        upper = np.minimum(np.arange(length) + radius + 1, length)
        lower = np.maximum(np.arange(length) - radius, 0)
        out = ((sums.take(upper, axis=axis) - sums.take(lower, axis=axis)) / (2 * radius + 1)).astype(np.float32)
    return out
