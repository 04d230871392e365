"""Where the sky begins. Imports nothing heavy: configuration and requests use it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Skyline:
    """Where the sky begins, in which nothing can be matched: elevations by azimuth, linear between the points.

    Attributes:
        points: (azimuth, elevation), degrees, azimuths ascending in [-180, 180); one point for the same all round.
    """

    points: tuple[tuple[float, float], ...]

    @staticmethod
    def level(elevation_deg: float) -> Skyline:
        """The same elevation all round."""
        return Skyline(((0.0, elevation_deg),))
