"""Landscapes with little to tie photos by: a lake, snow, night. Each changes the painted ground in place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float32]

_NIGHT: Final = np.float32(0.07)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Rows of the ground.

    Attributes:
        x, y: ground coordinates in units of the height, north and east, (rows, width).
        phases: four angles that are the landscape's own.
        smooth: noise without fine detail, unit deviation, (rows, width).
        sparks: random bits of each small square of the ground, (rows, width).
    """

    x: Floats
    y: Floats
    phases: Floats
    smooth: Floats
    sparks: NDArray[np.uint32]


def lake(rgb: Floats, around: Surroundings) -> None:
    """Water below and around, without waves that a camera resolves, up to an irregular shore."""
    first, second, third, fourth = (float(phase) for phase in around.phases)
    x, y = around.x - np.float32(0.35 * np.cos(first)), around.y - np.float32(0.35 * np.sin(first))
    azimuth = np.arctan2(y, x)
    shore = (
        1.35
        + 0.22 * np.sin(azimuth + second)
        + 0.14 * np.sin(3 * azimuth + third)
        + 0.06 * np.sin(8 * azimuth + fourth)
    )
    water = np.hypot(x, y) < shore
    swell = np.float32(1.5) * around.smooth[water]
    for channel, value in enumerate((58, 84, 98)):
        rgb[channel, water] = np.float32(value) + swell


def snow(rgb: Floats, around: Surroundings) -> None:
    """Snow over fields and roads; of the trees and houses, one in some squares sticks out."""
    grey = rgb.mean(axis=0)
    covered = grey > np.float32(62)
    drift = np.float32(1.8) * around.smooth
    faint = np.float32(0.012) * (grey - np.float32(110))
    for channel, value in enumerate((232, 236, 242)):
        white = np.float32(value) + drift + faint
        rgb[channel] = np.where(covered, white, rgb[channel] * np.float32(0.6) + white * np.float32(0.4))


def night(rgb: Floats, around: Surroundings) -> None:
    """Almost dark, with lamps."""
    darken(rgb)
    lamp = (around.sparks & np.uint32(127)) == 0
    strength = ((around.sparks >> np.uint32(8)) & np.uint32(127)).astype(np.float32)[lamp] + np.float32(90)
    for channel, tint in enumerate((1.0, 0.86, 0.6)):
        rgb[channel, lamp] = np.float32(tint) * strength


def darken(rgb: Floats) -> None:
    """The light of a night."""
    rgb *= _NIGHT
    rgb += np.float32(4)


KINDS: Final[dict[str, Callable[[Floats, Surroundings], None]]] = {"lake": lake, "snow": snow, "night": night}
"""Every kind but `city`, which is the landscape as it is painted."""
