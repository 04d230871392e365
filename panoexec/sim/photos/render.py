"""Renders images of a camera by its lens: back-projection of every pixel, with motion blur.

Pixel (column, row) of an image of w x h pixels looks, in the camera's frame (x boresight, y right, z bottom), along

    (1, s · (column + 0.5 - w/2), s · (row + 0.5 - h/2)),      s = 2 · pinhole_half_width / w,

or, with distortion or a principal point beside the middle, along the ray that the lens images there (`Camera.rays`).
The
image's width is exactly the sensor's in focal lengths, and its pixels are exactly square, as stitchers
assume. Its height is the whole number of rows nearest to the vertical field of view.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.sim.photos.landscape import Image
from panoexec.sim.photos.landscape_kinds import Floats
from panoexec.sim.photos.scene import Scene

_BLOCK_PIXELS: Final = 1 << 15
"""Pixels processed at a time, so that intermediate arrays fit the processor's cache."""

_STILL_PX: Final = 0.2
"""A camera that moves less than this during an exposure counts as stationary."""

_NO_SHIFT: Final = (0.0, 0.0, 0.0)
_LOW_BYTES: Final = np.uint32(0x00FF00FF)


def image_size(camera: Camera, width_px: int) -> tuple[int, int]:
    """Width and height of a rendered image of that width: the height that makes pixels square."""
    return width_px, max(1, round(width_px * camera.pinhole_half_height / camera.pinhole_half_width))


def pixels_per_radian(camera: Camera, width_px: int) -> float:
    """How fine an image of that width is in its centre."""
    return width_px / (2 * camera.pinhole_half_width)


class Renderer:
    """Renders images of one scene; caches downsampled copies of it for coarse images.

    Args:
        scene: the scene, at infinite distance.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._coarser: list[Image] = [scene.pixels]
        self._packed: dict[int, NDArray[np.uint32]] = {}

    def render(
        self,
        camera: Camera,
        rotations: FloatArray,
        width_px: int,
        *,
        shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Image:
        """Render one exposure.

        Args:
            camera: the camera.
            rotations: camera-to-world rotation (3, 3), or (k, 3, 3): evenly spaced over the time that the shutter was
                open, whose images are averaged.
            width_px: width of the image.
            shift: where the camera is, north, east and down of where the scene was taken from, as shares of its height
                above flat ground: what is above the horizon stays at infinite distance.

        Returns:
            (h, width_px, 3) uint8 RGB; h from `image_size`.
        """
        poses = np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)
        poses = _distinct(poses, camera, width_px)
        texture = self._texture(_level(self.scene, camera, width_px))
        if len(poses) == 1:
            return _render_still(texture, camera, poses[0], width_px, shift)
        total = np.zeros((*image_size(camera, width_px)[::-1], 3), dtype=np.uint32)
        for pose in poses:
            total += _render_still(texture, camera, pose, width_px, shift)
        return np.asarray((total + len(poses) // 2) // len(poses), dtype=np.uint8)

    def _texture(self, level: int) -> NDArray[np.uint32]:
        """The scene halved `level` times, each pixel packed into 32 bits, with a border of one pixel (see `_pack`)."""
        if level not in self._packed:
            while len(self._coarser) <= level:
                self._coarser.append(_halved(self._coarser[-1]))
            self._packed[level] = _pack(self._coarser[level])
        return self._packed[level]


def _level(scene: Scene, camera: Camera, width_px: int) -> int:
    """Number of halvings after which the scene's pixels are about as fine as the image's at its centre.

    A side of an odd number of pixels is not halved: that would shift pixel centres.
    """
    wanted = max(0, round(math.log2(scene.pixels_per_radian / pixels_per_radian(camera, width_px))))
    height = scene.width_px // 2
    halvings = (height & -height).bit_length() - 1
    return min(wanted, halvings)


def _halved(pixels: Image) -> Image:
    """Halve the resolution by averaging 2 x 2 pixels; keeps the convention of pixel centres."""
    wide = pixels.astype(np.uint16)
    total = wide[0::2, 0::2] + wide[0::2, 1::2] + wide[1::2, 0::2] + wide[1::2, 1::2]
    return np.asarray((total + 2) >> 2, dtype=np.uint8)


def _pack(pixels: Image) -> NDArray[np.uint32]:
    """Pixels as 0x00BBGGRR with a border that continues the sphere at the back and over the poles."""
    height, width = pixels.shape[:2]
    channels = pixels.astype(np.uint32)
    packed = np.empty((height + 2, width + 2), dtype=np.uint32)
    packed[1:-1, 1:-1] = channels[..., 0] | channels[..., 1] << 8 | channels[..., 2] << 16
    # the row beyond a pole is the same row shifted by half a turn
    packed[0, 1:-1] = np.roll(packed[1, 1:-1], width // 2)
    packed[-1, 1:-1] = np.roll(packed[-2, 1:-1], width // 2)
    packed[:, 0] = packed[:, -2]
    packed[:, -1] = packed[:, 1]
    return packed


def _distinct(poses: FloatArray, camera: Camera, width_px: int) -> FloatArray:
    """Drop poses that do not visibly change any pixel; keeps at least the middle one."""
    if len(poses) == 1:
        return poses
    w, h = camera.pinhole_half_width, camera.pinhole_half_height
    rays = np.array([[1, 0, 0], [1, -w, -h], [1, w, -h], [1, w, h], [1, -w, h]])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    world = rays @ np.swapaxes(poses, -1, -2)
    moved = np.linalg.norm(world - world[:1], axis=-1).max() * width_px / (2 * w)
    return poses[len(poses) // 2 : len(poses) // 2 + 1] if moved < _STILL_PX else poses


def _render_still(
    texture: NDArray[np.uint32], camera: Camera, pose: FloatArray, width_px: int, shift: tuple[float, float, float]
) -> Image:
    width, height = image_size(camera, width_px)
    right, down = _rays(camera, width)
    m = pose.astype(np.float32)
    out = np.empty((height, width, 3), dtype=np.uint8)
    rows = max(1, _BLOCK_PIXELS // width)
    for top in range(0, height, rows):
        block = slice(top, top + rows)
        x, y, z = (m[axis, 0] + m[axis, 1] * right[block] + m[axis, 2] * down[block] for axis in range(3))
        if any(shift):
            # the ground seen along (x, y, z) is this far down, in heights; from the scene's place it is elsewhere
            down_by = np.maximum(z, np.float32(0)) / np.float32(1 - shift[2])
            x, y, z = (axis + np.float32(part) * down_by for axis, part in zip((x, y, z), shift, strict=True))
        # little-endian bytes are R, G, B, 0
        rgb = _bilinear(texture, x, y, z).astype("<u4", copy=False).view(np.uint8)
        out[top : top + rows] = rgb.reshape(*x.shape, 4)[..., :3]
    return out


@lru_cache(maxsize=4)
def _rays(camera: Camera, width: int) -> tuple[Floats, Floats]:
    """Right and down of the ray of unit depth of each pixel; (1 or h, width) and (h, 1 or width)."""
    height = image_size(camera, width)[1]
    step = 2 * camera.pinhole_half_width / width
    right = ((np.arange(width) + 0.5 - width / 2) * step)[None]
    down = ((np.arange(height) + 0.5 - height / 2) * step)[:, None]
    if camera.distortion_used is not None or camera.principal_point_px is not None:
        ideal = camera.rays(right / camera.pinhole_half_width, down / camera.pinhole_half_height)
        right, down = ideal[..., 0], ideal[..., 1]
    else:
        right = np.broadcast_to(right, (height, width))
    return right.astype(np.float32), down.astype(np.float32)


def _bilinear(texture: NDArray[np.uint32], x: Floats, y: Floats, z: Floats) -> NDArray[np.uint32]:
    """Packed colours of the scene in the world directions (x, y, z) of any length."""
    height, width = texture.shape[0] - 2, texture.shape[1] - 2
    # Pixel centres are at integers, the border's first column at 0. Azimuth ±π is column 0.5 or width + 0.5,
    # the poles are rows 0.5 and height + 0.5: all four neighbours always exist.
    column = np.arctan2(y, x)
    column *= np.float32(width / (2 * np.pi))
    column += np.float32(width / 2 + 0.5)
    row = np.arctan2(z, np.sqrt(x * x + y * y))
    row *= np.float32(height / np.pi)
    row += np.float32(height / 2 + 0.5)
    left, top = column.astype(np.int32), row.astype(np.int32)
    column -= left
    row -= top
    # a fraction of 256/256 is valid: it selects the neighbour itself
    right_part = (column * np.float32(256) + np.float32(0.5)).astype(np.uint32)
    lower_part = (row * np.float32(256) + np.float32(0.5)).astype(np.uint32)
    index = top * np.int32(width + 2) + left
    flat = texture.ravel()
    upper = _mix(flat.take(index), flat.take(index + 1), right_part)
    index += np.int32(width + 2)
    lower = _mix(flat.take(index), flat.take(index + 1), right_part)
    return _mix(upper, lower, lower_part)


def _mix(a: NDArray[np.uint32], b: NDArray[np.uint32], part: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The colours a + (b - a) · part / 256, rounded; two channels of a pixel in one multiplication."""
    rest = np.uint32(256) - part
    red_blue = (a & _LOW_BYTES) * rest + (b & _LOW_BYTES) * part + np.uint32(0x00800080)
    green = ((a >> 8) & np.uint32(0xFF)) * rest + ((b >> 8) & np.uint32(0xFF)) * part + np.uint32(0x80)
    return np.asarray((red_blue >> 8) & _LOW_BYTES | green & np.uint32(0xFF00))
