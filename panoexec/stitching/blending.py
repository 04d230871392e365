"""Two-band blending of remapped images: detail from one image at each pixel, brightness smoothly from all of them.

At each pixel the detail comes from the image whose border is farthest away; near the line of equal depth the weights
change over a few hundredths of the depth. Brightness (everything coarser than a few dozen pixels) is weighted by the
square of the depth, so that exposure differences fade over the whole overlap. Weights depend on the geometry alone, so
blocks that are blended one at a time match at their borders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

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
    shape: tuple[int, int], patches: Sequence[Patch], depth_of: Callable[[Patch], Floats], blur_px: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Blend patches into one image.

    Args:
        shape: (height, width) of the view.
        patches: remapped images.
        depth_of: gives the depth (h, w) of a patch's pixels in their image: 1 in its middle, 0 at its border.
        blur_px: radius that separates detail from brightness.

    Returns:
        (height, width, 3) uint8 and the mask of what is covered by at least one image.
    """
    height, width = shape
    depths = [np.maximum(depth_of(patch), _LEAST_DEPTH) for patch in patches]
    best = np.full(shape, _LEAST_DEPTH, dtype=np.float32)
    for patch, depth in zip(patches, depths, strict=True):
        view = best[patch.place]
        np.maximum(view, np.where(patch.mask, depth, 0), out=view)
    coarse, coarse_weight = np.zeros((height, width, 3), np.float32), np.zeros(shape, np.float32)
    fine, fine_weight = np.zeros((height, width, 3), np.float32), np.zeros(shape, np.float32)
    for patch, depth in zip(patches, depths, strict=True):
        smooth = _blurred(patch.pixels, patch.mask, blur_px)
        weight = np.where(patch.mask, depth * depth, 0).astype(np.float32)
        coarse[patch.place] += smooth * weight[..., None]
        coarse_weight[patch.place] += weight
        # masked pixels may be deeper than the best of the others: avoid an overflow
        behind = np.minimum(depth / best[patch.place] - 1, 0)
        weight = np.where(patch.mask, np.exp(_SHARPNESS * behind), 0).astype(np.float32)
        fine[patch.place] += (patch.pixels - smooth) * weight[..., None]
        fine_weight[patch.place] += weight
    covered = coarse_weight > 0
    coarse /= np.where(covered, coarse_weight, 1)[..., None]
    fine /= np.where(covered, fine_weight, 1)[..., None]
    coarse += fine
    picture = np.clip(coarse + np.float32(0.5), 0, 255).astype(np.uint8)
    picture[~covered] = 0
    return picture, covered


def _blurred(pixels: NDArray[np.uint8], mask: NDArray[np.bool_], radius: int) -> Floats:
    """Means (h, w, 3) over two box blurs of the mask's pixels alone."""
    # integer sums are exact; intermediate ones may wrap around if the final ones fit
    kind: type[np.unsignedinteger[Any]] = np.uint32 if 255 * (2 * radius + 1) ** 4 < 1 << 32 else np.uint64
    weight: NDArray[np.unsignedinteger[Any]] = mask.astype(kind)
    total: NDArray[np.unsignedinteger[Any]] = pixels.astype(kind)
    total[~mask] = 0
    for _ in range(2):
        for axis in (0, 1):
            total, weight = _box_sums(total, radius, axis), _box_sums(weight, radius, axis)
    share = weight.astype(np.float32)
    return np.asarray(total / np.where(share > 0, share, 1)[..., None], dtype=np.float32)


def _box_sums(values: NDArray[np.unsignedinteger[Any]], radius: int, axis: int) -> NDArray[np.unsignedinteger[Any]]:
    """Sums over 2 · radius + 1 neighbours along an axis, with zeros outside."""
    sums = np.moveaxis(np.cumsum(values, axis=axis, dtype=values.dtype), axis, 0)
    length = len(sums)
    out = np.empty_like(sums)
    inside = max(0, length - radius)
    out[:inside] = sums[radius:]
    out[inside:] = sums[-1]
    out[radius + 1 :] -= sums[: max(0, length - radius - 1)]
    return np.moveaxis(out, 0, axis)
