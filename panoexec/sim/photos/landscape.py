"""Paints the generated scene: a landscape seen from about a hundred metres up.

Fields, roads, houses and trees on the ground with texture at every scale down to the pixel, so that feature detectors
find points everywhere on it; hills and towers on the horizon; a sky with clouds. The content is a function of the
direction alone, so there is no seam at the back and no pinch at the nadir.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from panoexec.sim.photos.landscape_kinds import KINDS, Floats, Surroundings, darken, night

Image: TypeAlias = NDArray[np.uint8]

_TILE: Final = 1024

_BEND: Final = np.radians(64.0)
"""Angle from the nadir up to which the ground is a true plane; beyond, its depth is stretched (see `_ground_plane`)."""


def _tile(rng: np.random.Generator, slope: float, cutoff: float = 0.5) -> Floats:
    """A periodic noise texture with amplitude falling as frequency^-slope, zero mean, unit deviation, (1024, 1024)."""
    frequency = np.hypot(np.fft.fftfreq(_TILE)[:, None], np.fft.rfftfreq(_TILE)[None, :])
    frequency[0, 0] = 1.0
    shape = frequency.shape
    spectrum = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) * frequency**-slope
    spectrum[frequency > cutoff] = 0.0
    spectrum[0, 0] = 0.0
    tile = np.fft.irfft2(spectrum, s=(_TILE, _TILE))
    return np.asarray(tile / tile.std(), dtype=np.float32)


def _sample(tile: Floats, x: Floats, y: Floats) -> Floats:
    """The texel under (x, y), texels; the tile repeats."""
    column = x.astype(np.int32) & (_TILE - 1)
    row = y.astype(np.int32) & (_TILE - 1)
    return np.asarray(tile.ravel().take((row << 10) + column))


def _hash(i: NDArray[np.int32], j: NDArray[np.int32], salt: int) -> NDArray[np.uint32]:
    """Well-mixed 32 bits for every cell (i, j)."""
    h = i.astype(np.uint32) * np.uint32(0x9E3779B1) ^ j.astype(np.uint32) * np.uint32(0x85EBCA77)
    h ^= np.uint32(salt * 0x27D4EB2F & 0xFFFFFFFF)
    h ^= h >> np.uint32(15)
    h *= np.uint32(0x2C1B3C6D)
    h ^= h >> np.uint32(12)
    h *= np.uint32(0x297A2D39)
    h ^= h >> np.uint32(15)
    return h


def _byte(h: NDArray[np.uint32], which: int) -> Floats:
    """Byte number `which` of a hash, as [0, 1]."""
    return np.asarray(((h >> np.uint32(8 * which)) & np.uint32(255)).astype(np.float32) * np.float32(1 / 255))


_FIELDS: Final = np.array(
    [
        [104, 128, 62], [134, 146, 74], [86, 112, 54], [158, 150, 92], [176, 162, 104], [122, 100, 70], [94, 84, 60],
        [148, 160, 84], [72, 100, 52], [190, 178, 122], [112, 136, 82], [140, 118, 84], [64, 86, 46], [166, 148, 80],
        [98, 120, 70], [128, 138, 92],
    ],
    dtype=np.float32,
)  # fmt: skip
_ROOFS: Final = np.array(
    [
        [168, 74, 54], [142, 62, 48], [120, 116, 112], [186, 182, 176], [96, 84, 78], [204, 196, 182], [152, 96, 70],
        [82, 88, 98],
    ],
    dtype=np.float32,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Objects:
    """Pixels that may show one of the objects strewn over the ground.

    Attributes:
        at: flat indices of the pixels, (n,).
        right, down: the pixel's place relative to the object's centre, in units of the object's cell, (n,).
        half: half the object's size, likewise, (n,).
        random: the object's own random bits, (n,).
    """

    at: NDArray[np.intp]
    right: Floats
    down: Floats
    half: Floats
    random: NDArray[np.uint32]


class Landscape:
    """Paints blocks of rows of one landscape; holds what depends on azimuth alone.

    Args:
        seed: chooses the landscape.
        width_px: pixels around the horizon.
        kind: what it shows: `city`, or one of `landscape_kinds.KINDS`.
    """

    def __init__(self, seed: int, width_px: int, kind: str = "city") -> None:
        rng = np.random.default_rng(seed)
        self._salt = int(rng.integers(1 << 24))
        self._scale = np.float32(width_px / (2 * np.pi))
        self._fine = _tile(rng, 0.55)
        self._coarse = _tile(rng, 1.3, 0.12)
        self._offset = rng.uniform(_TILE, 3 * _TILE, 6).astype(np.float32)
        azimuth = np.radians((np.arange(width_px, dtype=np.float32) + 0.5) / width_px * 360 - 180)
        self._cos, self._sin = np.cos(azimuth), np.sin(azimuth)
        self._azimuth = azimuth
        self._hills = self._hill_heights(rng, azimuth)
        self._tower, self._tower_left, self._tower_colour = self._towers(rng, azimuth)
        self._sun = np.float32(rng.uniform(-np.pi, np.pi))
        self._street = np.float32(rng.uniform(0, np.pi / 2))
        self._kind = KINDS.get(kind)
        self._shore = rng.uniform(0, 2 * np.pi, 4).astype(np.float32)

    @staticmethod
    def _hill_heights(rng: np.random.Generator, azimuth: Floats) -> Floats:
        """Elevation of the hills' crest by azimuth, radians."""
        crest = np.full_like(azimuth, 1.1)
        for harmonic in range(2, 60):
            amplitude = 1.2 / harmonic
            crest += (amplitude * rng.normal() * np.cos(harmonic * azimuth + rng.uniform(0, 2 * np.pi))).astype(
                np.float32
            )
        return np.asarray(np.radians(np.clip(crest, 0.15, None)), dtype=np.float32)

    @staticmethod
    def _towers(rng: np.random.Generator, azimuth: Floats) -> tuple[Floats, Floats, Floats]:
        """Per column: elevation of the tallest tower's roof (0 = none), azimuth of its left edge, its colour."""
        roof = np.zeros_like(azimuth)
        left = np.zeros_like(azimuth)
        colour = np.zeros((len(azimuth), 3), dtype=np.float32)
        centres = rng.uniform(-np.pi, np.pi, 6)
        for _ in range(150):
            centre = rng.choice(centres) + rng.normal() * 0.16 if rng.random() < 0.75 else rng.uniform(-np.pi, np.pi)
            width = np.radians(rng.uniform(0.5, 1.8))
            height = np.radians(rng.gamma(3.0, 0.7) + 0.5)
            offset = (azimuth - centre + np.pi) % (2 * np.pi) - np.pi
            covered = (np.abs(offset) < width / 2) & (height > roof)
            roof[covered] = height
            left[covered] = centre - width / 2
            colour[covered] = rng.uniform(70, 190) * np.array([1.0, 0.99, 0.98]) + rng.normal(size=3) * 7
        return roof, left, colour

    def paint(self, elevation: Floats, out: Image) -> None:
        """Paint rows of the given elevations (radians) into `out` (rows, width, 3)."""
        ground = elevation < 0
        if ground.any():
            rgb = self._ground(elevation[ground])
            if self._kind is not None:
                self._kind(rgb, self._around(elevation[ground]))
            out[ground] = np.clip(rgb, 0, 255).astype(np.uint8).transpose(1, 2, 0)
        if not ground.all():
            sky = elevation[~ground]
            rgb = self._sky(sky)
            if sky.min() < np.radians(12.0):
                self._skyline(sky, rgb)
            if self._kind is night:
                darken(rgb)
            out[~ground] = np.clip(rgb, 0, 255).astype(np.uint8).transpose(1, 2, 0)

    def _ground_plane(self, elevation: Floats) -> tuple[Floats, Floats]:
        """Ground coordinates (x, y) in units of the height above ground, each (rows, width).

        Within 64° of the nadir the ground is a plane. Beyond, its depth grows only linearly: a true plane would crowd
        all its detail into the last few pixel rows below the horizon, where no detector could use it.
        """
        angle = np.pi / 2 + elevation
        slope = 1 / np.cos(_BEND) ** 2
        radius = np.where(angle < _BEND, np.tan(np.minimum(angle, _BEND)), np.tan(_BEND) + slope * (angle - _BEND))
        radius = radius.astype(np.float32)[:, None]
        return radius * self._cos, radius * self._sin

    def _around(self, elevation: Floats) -> Surroundings:
        """What the kinds of landscapes need to know of rows of the ground."""
        x, y = self._ground_plane(elevation)
        return Surroundings(
            x=x,
            y=y,
            phases=self._shore,
            smooth=_sample(
                self._coarse, x * 130 + (self._offset[0] + 8 * _TILE), y * 130 + (self._offset[1] + 8 * _TILE)
            ),
            sparks=_hash(
                np.floor(x * np.float32(55)).astype(np.int32), np.floor(y * np.float32(55)).astype(np.int32), self._salt
            ),
        )

    def _ground(self, elevation: Floats) -> Floats:
        """Colours of rows of the ground, (3, rows, width)."""
        x, y = self._ground_plane(elevation)
        c, s = np.cos(self._street), np.sin(self._street)
        x, y = c * x - s * y + 50, s * x + c * y + 50
        coarse = _sample(self._coarse, x * 260 + self._offset[0], y * 260 + self._offset[1])
        rgb = self._fields(x + 0.02 * coarse, y)
        self._scatter(rgb, x, y, 0.11, 1, density=0.35, size=0.36, kind="tree")
        self._scatter(rgb, x, y, 0.043, 2, density=0.5, size=0.34, kind="tree")
        self._scatter(rgb, x, y, 0.155, 3, density=0.5, size=0.27, kind="house")
        self._scatter(rgb, x, y, 0.37, 4, density=0.3, size=0.26, kind="house")
        self._roads(rgb, x, y)
        fine = _sample(self._fine, x * self._scale + self._offset[2], y * self._scale + self._offset[3])
        turned = _sample(
            self._fine,
            (0.6 * x - 0.8 * y) * (self._scale * 0.29) + (self._offset[4] + 64 * _TILE),
            (0.8 * x + 0.6 * y) * (self._scale * 0.29) + self._offset[5],
        )
        rgb *= 1 + np.float32(0.10) * fine + np.float32(0.085) * turned + np.float32(0.10) * coarse
        haze = np.exp(elevation * np.float32(9.0))[:, None] * np.float32(0.45)
        for channel, value in enumerate((176, 188, 200)):
            rgb[channel] += (np.float32(value) - rgb[channel]) * haze
        return rgb

    def _fields(self, x: Floats, y: Floats) -> Floats:
        """Fields of a patchwork with furrows, and tracks between them, (3, rows, width)."""
        j = np.floor(y * np.float32(1 / 0.52)).astype(np.int32)
        shift = _byte(_hash(j, j, self._salt), 0)
        fx = x * (np.float32(0.9) + np.float32(0.8) * shift) + shift * 7
        i = np.floor(fx).astype(np.int32)
        h = _hash(i, j, self._salt + 1)
        rgb = np.ascontiguousarray(np.moveaxis(_FIELDS[h & np.uint32(15)], -1, 0))
        along = np.where(h & np.uint32(16), x, y) * (np.float32(60) + 90 * _byte(h, 1))
        furrow = along - np.floor(along)
        rgb *= 1 + (np.float32(0.10) + 0.16 * _byte(h, 2)) * (np.abs(furrow - np.float32(0.5)) - np.float32(0.25))
        track = (np.abs(fx - i - 0.5) > np.float32(0.487)) | (
            np.abs(y * np.float32(1 / 0.52) - j - 0.5) > np.float32(0.480)
        )
        rgb[:, track] = np.array([[158.0], [140.0], [112.0]], dtype=np.float32)
        return rgb

    @staticmethod
    def _roads(rgb: Floats, x: Floats, y: Floats) -> None:
        """Draw main roads with their broken centre line over `rgb`; nothing stands on them."""
        for axis, pitch, phase in ((y, 2.6, 0.4), (x, 3.1, 1.7)):
            across = (axis + phase) * np.float32(1 / pitch)
            offset = np.abs(across - np.floor(across) - np.float32(0.5)) * np.float32(pitch)
            rgb[:, offset < np.float32(0.034)] = np.array([[92.0], [92.0], [96.0]], dtype=np.float32)
            other = (x if axis is y else y) * np.float32(9)
            dash = (offset < np.float32(0.003)) & (other - np.floor(other) < np.float32(0.6))
            rgb[:, dash] = 224.0

    def _scatter(
        self,
        rgb: Floats,
        x: Floats,
        y: Floats,
        cell: float,
        salt: int,
        *,
        density: float,
        size: float,
        kind: Literal["tree", "house"],
    ) -> None:
        """Put at most one tree or house into every cell, each with its shadow, over `rgb`."""
        u, v = x * np.float32(1 / cell), y * np.float32(1 / cell)
        i, j = np.floor(u).astype(np.int32), np.floor(v).astype(np.int32)
        h = _hash(i, j, self._salt + salt)
        # groves and villages: whole groups of 5 x 5 cells are empty or crowded
        group = _byte(_hash(i // 5, j // 5, self._salt + salt), 3)
        present = _byte(h, 0) < group * np.float32(2 * density)
        where = np.flatnonzero(present)
        if not len(where):
            return
        h = h.ravel()[where]
        half = np.float32(size) * (np.float32(0.45) + np.float32(0.55) * _byte(h, 1))
        room = np.float32(0.94) - 2 * half - np.float32(0.16) * half
        du = u.ravel()[where] - i.ravel()[where] - np.float32(0.03) - half - room * _byte(h, 2)
        dv = v.ravel()[where] - j.ravel()[where] - np.float32(0.03) - half - room * _byte(h, 3)
        flat = rgb.reshape(3, -1)
        objects = _Objects(where, du, dv, half, h)
        if kind == "tree":
            self._trees(flat, objects)
        else:
            self._houses(flat, objects)

    @staticmethod
    def _trees(flat: Floats, trees: _Objects) -> None:
        du, dv, half = trees.right, trees.down, trees.half
        shade = np.float32(0.3) * half
        crown = du * du + dv * dv < half * half
        shadow = ((du - shade) ** 2 + (dv - shade) ** 2 < half * half) & ~crown
        flat[:, trees.at[shadow]] *= np.float32(0.55)
        at = trees.at[crown]
        light = np.float32(0.8) - np.float32(0.25) * ((du + dv) / half)[crown]
        light *= np.float32(0.7) + np.float32(0.5) * _byte(trees.random[crown], 2)
        for channel, value in enumerate((72, 98, 48)):
            flat[channel, at] = value * light

    @staticmethod
    def _houses(flat: Floats, houses: _Objects) -> None:
        du, dv, half, h = houses.right, houses.down, houses.half, houses.random
        hv = half * (np.float32(0.55) + np.float32(0.45) * _byte(h, 1))
        roof = (np.abs(du) < half) & (np.abs(dv) < hv)
        shade = np.float32(0.28) * half
        shadow = (np.abs(du - shade) < half) & (np.abs(dv - shade) < hv) & ~roof
        flat[:, houses.at[shadow]] *= np.float32(0.45)
        at = houses.at[roof]
        du, dv, half, hv, h = du[roof], dv[roof], half[roof], hv[roof], h[roof]
        colour = _ROOFS[(h >> np.uint32(5)) & np.uint32(7)]
        light = np.where(dv < 0, np.float32(1.1), np.float32(0.84))
        chimney = (np.abs(du - 0.4 * half) < 0.12 * half) & (np.abs(dv + 0.3 * hv) < 0.14 * half)
        light = np.where(chimney, np.float32(0.4), light)
        for channel in range(3):
            flat[channel, at] = colour[:, channel] * light

    def _sky(self, elevation: Floats) -> Floats:
        """Colours of rows of the sky, (3, rows, width)."""
        height = np.sin(elevation)[:, None]
        # clouds lie on a plane, bent upwards towards the horizon as the ground is
        radius = (np.cos(elevation) / (np.sin(elevation) + 0.22))[:, None]
        u, v = radius * self._cos, radius * self._sin
        noise = _sample(self._coarse, u * 150 + self._offset[4], v * 150 + self._offset[5])
        detail = _sample(self._fine, u * 420 + self._offset[2], v * 420 + self._offset[3])
        cloud = np.clip((noise - np.float32(0.15)) * np.float32(0.75) + np.float32(0.06) * detail, 0, 1)
        cloud *= np.clip(height * 6 + np.float32(0.15), 0, 1) * np.float32(0.9)
        toward = np.cos(elevation)[:, None] * np.cos(self._azimuth - self._sun) * np.float32(0.8) + 0.6 * height
        glow = np.float32(34) * np.clip(toward, 0, 1) ** 8
        rgb = np.empty((3, *noise.shape), dtype=np.float32)
        blue = np.clip(height, 0, 1) ** np.float32(0.55)
        for channel, (low, high) in enumerate(((202, 62), (214, 112), (226, 188))):
            clear = low + (high - low) * blue + glow
            rgb[channel] = clear + (np.float32(238) - clear) * cloud + np.float32(1.2) * detail
        return rgb

    def _skyline(self, elevation: Floats, rgb: Floats) -> None:
        """Hills and towers over the lowest rows of the sky."""
        rows = elevation[:, None]
        row, column = np.nonzero(rows < self._hills)
        depth = elevation[row] / self._hills[column]
        texture = _sample(
            self._fine, (self._azimuth[column] + 4) * self._scale, elevation[row] * self._scale + self._offset[0]
        )
        for channel, (foot, crest) in enumerate(((142, 86), (156, 106), (162, 98))):
            rgb[channel, row, column] = (foot + (crest - foot) * depth) * (1 + np.float32(0.12) * texture)
        row, column = np.nonzero(rows < self._tower)
        up = elevation[row] * np.float32(1 / np.radians(0.21))
        right = (self._azimuth[column] - self._tower_left[column]) * np.float32(1 / np.radians(0.17))
        i, j = np.floor(right).astype(np.int32), np.floor(up).astype(np.int32)
        window = (np.abs(right - i - 0.5) < np.float32(0.32)) & (np.abs(up - j - 0.5) < np.float32(0.28))
        lit = _byte(_hash(i, j + column // 97, self._salt), 1)
        light = np.where(window, np.float32(0.45) + np.float32(0.8) * lit * lit, np.float32(1.0))
        for channel in range(3):
            rgb[channel, row, column] = self._tower_colour[column, channel] * light
