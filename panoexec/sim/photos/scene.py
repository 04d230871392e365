"""The scene of the simulated camera: an equirectangular image of the whole sphere, generated or loaded.

Convention of every equirectangular picture in panoexec, as Hugin's and GPano's: the centre is azimuth 0 (the yaw
reference), azimuth grows to the right, the left border is -180, the top border elevation +90. Pixel (column, row)
counts from 0 at its centre, so its direction is

    azimuth = (column + 0.5) / width · 360 - 180,      elevation = 90 - (row + 0.5) / height · 180.

The generated scene is painted by `panoexec.sim.photos.landscape`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from panoexec.errors import InputFileError
from panoexec.sim.photos.landscape import Image, Landscape

DEFAULT_WIDTH_PX: Final = 4096
MAX_WIDTH_PX: Final = 16384
MIN_WIDTH_PX: Final = 64

_LEAST_WIDTH_PX: Final = 1024
"""Less is painted within 0.1 s: it would save nothing."""
_FINER: Final = 2.0
"""A scene that is painted for photos has at least so many times the pixels per radian that their centre has."""

_BLOCK_PIXELS: Final = 1 << 17
"""Pixels painted at a time, so that the float32 arrays fit the processor's cache."""


@dataclass(frozen=True, slots=True)
class Scene:
    """An equirectangular picture of the sphere.

    Attributes:
        pixels: (height, 2 · height, 3) uint8, RGB, in the module's convention.
        name: its source, for logs.
    """

    pixels: Image
    name: str

    @property
    def width_px(self) -> int:
        """Pixels around the horizon."""
        return int(self.pixels.shape[1])

    @property
    def pixels_per_radian(self) -> float:
        """Resolution at the horizon."""
        return self.width_px / (2 * np.pi)


def load_scene(path: Path) -> Scene:
    """Read a scene from a JPEG, PNG or any other picture that Pillow reads.

    Args:
        path: an equirectangular picture of the whole sphere, twice as wide as high.

    Raises:
        InputFileError: no such file, no picture, a truncated one, not 2:1, or of a size that is out of bounds.
    """
    import PIL.Image  # noqa: PLC0415  (for those who have a scene)

    try:
        with warnings.catch_warnings():
            # a scene of gigapixel size is permitted; its size is checked below, before pixels are read
            warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)
            with PIL.Image.open(path) as picture:
                _check_size(path, *picture.size)
                pixels = np.array(picture.convert("RGB"))
    except PIL.Image.DecompressionBombError as error:
        raise InputFileError(str(path), [f"scene of more than {MAX_WIDTH_PX} px width; make it smaller"]) from error
    except FileNotFoundError as error:
        raise InputFileError(str(path), ["no such file; name an equirectangular JPEG or PNG"]) from error
    except PIL.UnidentifiedImageError as error:
        raise InputFileError(str(path), ["is no image; name an equirectangular JPEG or PNG"]) from error
    except (OSError, SyntaxError, ValueError) as error:
        # exceptions of Pillow for truncated and broken files, and of the system for folders and permissions
        reason = getattr(error, "strerror", None) or str(error)
        raise InputFileError(str(path), [f"cannot be read as an image ({reason})"]) from error
    return Scene(pixels, str(path))


def _check_size(path: Path, width: int, height: int) -> None:
    if width != 2 * height:
        raise InputFileError(
            str(path),
            [f"image is {width} x {height} px; an equirectangular scene of the whole sphere is twice as wide as high"],
        )
    if not MIN_WIDTH_PX <= width <= MAX_WIDTH_PX:
        raise InputFileError(str(path), [f"image width {width} px; a scene has {MIN_WIDTH_PX} to {MAX_WIDTH_PX} px"])


def procedural_scene(seed: int = 1, width_px: int = DEFAULT_WIDTH_PX, kind: str = "city") -> Scene:
    """The generated landscape; the same for the same arguments, kept in memory for the next call.

    Args:
        seed: chooses the landscape.
        width_px: even, pixels around the horizon; detail goes down to the pixel at any size.
        kind: what it shows, see `panoexec.sim.photos.landscape_kinds`.
    """
    if width_px % 2 or not MIN_WIDTH_PX <= width_px <= MAX_WIDTH_PX:
        raise ValueError(f"width_px must be even and within {MIN_WIDTH_PX} to {MAX_WIDTH_PX}, got {width_px}")
    return _procedural_scene(seed, width_px, kind)


def width_for_photos_px(pixels_per_radian: float) -> int:
    """How wide a generated scene need be, at most `DEFAULT_WIDTH_PX`: painting that takes longer than small photos.

    Args:
        pixels_per_radian: in the centre of the photos.
    """
    width_px = DEFAULT_WIDTH_PX
    while width_px > _LEAST_WIDTH_PX and width_px / 2 >= _FINER * 2 * np.pi * pixels_per_radian:
        width_px //= 2
    return width_px


@lru_cache(maxsize=2)
def _procedural_scene(seed: int, width_px: int, kind: str) -> Scene:
    height = width_px // 2
    landscape = Landscape(seed, width_px, kind)
    pixels = np.empty((height, width_px, 3), dtype=np.uint8)
    step = max(1, _BLOCK_PIXELS // width_px)
    elevation = np.radians(90 - (np.arange(height, dtype=np.float32) + 0.5) / height * 180)
    for top in range(0, height, step):
        landscape.paint(elevation[top : top + step], pixels[top : top + step])
    pixels.setflags(write=False)
    return Scene(pixels, f"procedural {kind} {seed}")
