"""The panorama's canvas in blocks that fit into memory, and the depth of each image in them.

A block is processed with a margin, so that blurred colours agree across its border. It is rendered on a canvas rotated
by whole pixels with the block in its middle, so that azimuth ±180° needs no special case.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray, direction, rotation
from panoexec.formats.hugin_pto import PtoProject

BYTES_PER_PIXEL = 180
"""Peak memory of blending a block, by its pixels, margin included: 134 to 140 measured on 25 images of 60°, and eight
for each more that touches the block, of which narrow lenses have some at the nadir."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A rectangle of the canvas.

    Attributes:
        row: index of the block's row.
        column: likewise.
        left: first column of the canvas.
        top: first row.
        width: columns.
        height: rows.
    """

    row: int
    column: int
    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A block with its margin on a canvas rotated so that the block is in the middle.

    Attributes:
        block: the block.
        left: first column of the view on the turned canvas.
        top: first row.
        width: columns, margin included.
        height: rows, margin included.
        shift: columns by which the canvas was turned: turned column = column + shift.
    """

    block: Block
    left: int
    top: int
    width: int
    height: int
    shift: int

    @property
    def inner(self) -> tuple[slice, slice]:
        """Rows and columns of the block within the view."""
        top = self.block.top - self.top
        left = self.block.left + self.shift - self.left
        return slice(top, top + self.block.height), slice(left, left + self.block.width)


def block_side(memory_bytes: int, canvas_width: int, margin: int) -> int:
    """Side of square blocks, a multiple of 512, that can be blended within the memory given."""
    side = int(math.sqrt(memory_bytes / BYTES_PER_PIXEL)) - 2 * margin
    widest = canvas_width - 2 * margin - 2
    return max(512, min(side, widest) // 512 * 512)


def blocks(canvas: tuple[int, int], side: int) -> Iterator[Block]:
    """The blocks of a canvas (width, height), row by row; the last ones may be smaller."""
    width, height = canvas
    for row, top in enumerate(range(0, height, side)):
        for column, left in enumerate(range(0, width, side)):
            yield Block(
                row=row,
                column=column,
                left=left,
                top=top,
                width=min(side, width - left),
                height=min(side, height - top),
            )


def view_of(block: Block, canvas: tuple[int, int], margin: int) -> View:
    """The block with a margin, limited at the poles and to the width of the canvas."""
    width, height = canvas
    span = min(width, block.width + 2 * margin)
    left = (width - span) // 2
    inside = (span - block.width) // 2
    top = max(0, block.top - margin)
    bottom = min(height, block.top + block.height + margin)
    return View(block=block, left=left, top=top, width=span, height=bottom - top, shift=left + inside - block.left)


def turned(project: PtoProject, view: View) -> PtoProject:
    """The project on the view's turned canvas, output restricted to the view."""
    width = project.canvas_px[0]
    whole = rotation(view.shift * 360.0 / width, 0.0)
    crop = (view.left, view.left + view.width, view.top, view.top + view.height)
    return replace(project.with_rotations(whole @ project.rotations()), crop_px=crop)


def directions_of(view: View, canvas: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Elevations (height,) and azimuths (width,) of the view's pixels on the turned canvas, degrees."""
    width, height = canvas
    elevation = 90 - (view.top + np.arange(view.height) + 0.5) / height * 180
    azimuth = (view.left + np.arange(view.width) + 0.5) / width * 360 - 180
    return elevation, azimuth


def image_depth(project: PtoProject, number: int, view: View, place: tuple[slice, slice]) -> NDArray[np.float32]:
    """Depth of a view's pixels in an image, without distortion: 1 at its centre, 0 at its border.

    Args:
        project: the turned project.
        number: the image.
        view: the view.
        place: rows and columns of the view.

    Returns:
        (rows, columns); negative outside, -1 behind the camera.
    """
    elevation, azimuth = (np.radians(a) for a in directions_of(view, project.canvas_px))
    image = project.images[number]
    matrix = image.rotation
    cos_e, sin_e = np.cos(elevation[place[0]])[:, None], np.sin(elevation[place[0]])[:, None]
    cos_a, sin_a = np.cos(azimuth[place[1]]), np.sin(azimuth[place[1]])

    def axis(k: int, scale: float) -> NDArray[np.float32]:
        # a component of Rᵀ·d for d = (cos e · cos a, cos e · sin a, -sin e)
        level = (scale * (matrix[0, k] * cos_a + matrix[1, k] * sin_a)).astype(np.float32)
        return np.asarray(cos_e.astype(np.float32) * level - (scale * matrix[2, k] * sin_e).astype(np.float32))

    front = axis(0, 1.0)
    side = np.abs(axis(1, 2 * project.focal_length_px / image.width_px))
    np.maximum(side, np.abs(axis(2, 2 * project.focal_length_px / image.height_px)), out=side)
    behind = front < 1e-3
    front[behind] = 1.0
    depth = 1 - side / front
    depth[behind] = -1.0
    return np.asarray(depth)


def images_in_view(project: PtoProject, view: View, step: int = 16) -> list[int]:
    """Numbers of the images that may touch a view; tested on a grid of its pixels, with a margin for those between.

    Args:
        project: the turned project.
        view: the view.
        step: pixels of the canvas between the grid's points.
    """
    elevation, azimuth = directions_of(view, project.canvas_px)
    rows = np.unique(np.append(np.arange(0, view.height, step), view.height - 1))
    columns = np.unique(np.append(np.arange(0, view.width, step), view.width - 1))
    grid = direction(elevation[rows][:, None], azimuth[columns][None, :]).reshape(-1, 3)
    # a margin for distortion
    room = np.radians(step * 360.0 / project.canvas_px[0]) + 0.02
    image = project.images[0]
    half = np.array([image.width_px, image.height_px]) / 2 / project.focal_length_px
    found = []
    for number, matrix in enumerate(project.rotations()):
        rays = grid @ matrix
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = np.abs(rays[:, 1:]) / rays[:, :1]
        limit = (half + room) * (1 + room)
        if ((rays[:, 0] > 0) & (plane <= limit).all(axis=1)).any():
            found.append(number)
    return found
