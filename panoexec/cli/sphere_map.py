"""A character map of the sphere that shows which directions are photographed, current, pending or missing.

The map is equirectangular: azimuth to the right with the plan's yaw 0 in the middle, elevation up. Each character holds
two pixels, one above the other. A pixel gets the colour of the best mark among the images that contain its centre: a
direction covered by one image is not shown as a gap because another image is missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from itertools import groupby
from typing import TYPE_CHECKING, Final, Protocol

from panoexec.mission.log.mark_text import ShotMark

if TYPE_CHECKING:
    from rich.text import Text

WIDTH: Final = 72
HEIGHT: Final = 18
"""Size of the map in characters; a pixel is 5° wide and 5° high."""
SMALL: Final = ((48, 12), (36, 9))
"""Sizes of the map where there is less room; a pixel is 7.5° or 10° wide and high."""
MARGIN: Final = 4
"""Columns of the elevations beside the map."""
CAPTIONS: Final = 2
"""Lines below the map: azimuths and legend."""
_NORTH: Final = ("S", "W", "N", "E", "S")
_PLAIN: Final = ("-180", "-90", "0°", "+90", "+180")
"""Azimuths where yaw 0 is north, and where it is not or nobody knows."""
_STEP_DEG: Final = 30
"""From one elevation beside the map to the next."""


class Mark(IntEnum):
    """Status of a direction; where images overlap, the largest value is shown."""

    OUTSIDE = 0
    PENDING = 1
    MISSING = 2
    AGAIN = 3
    RETAKEN = 4
    DONE = 5
    CURRENT = 6


MARKS: Final[Mapping[ShotMark, Mark]] = {
    ShotMark.TO_DO: Mark.PENDING,
    ShotMark.CURRENT: Mark.CURRENT,
    ShotMark.DONE: Mark.DONE,
    ShotMark.RETAKEN: Mark.RETAKEN,
    ShotMark.AGAIN: Mark.AGAIN,
    ShotMark.MISSING: Mark.MISSING,
}
LEGEND: Final[Mapping[Mark, tuple[str, str, str]]] = {
    Mark.DONE: ("#2e9e44", "█", "done"),
    Mark.RETAKEN: ("#1fa6a6", "▓", "retaken"),
    Mark.CURRENT: ("#ffd43b", "◉", "now"),
    Mark.AGAIN: ("#e07b1f", "?", "again"),
    Mark.MISSING: ("#c92a2a", "x", "missing"),
    Mark.PENDING: ("#5c5f66", "·", "to do"),
}
"""For each mark: colour, character for terminals without colours, and label."""
_OUTSIDE_COLOUR: Final = "#16181d"


def size_for(columns: int, lines: int, *, beside: int) -> tuple[int, int] | None:
    """The largest map that a terminal has room for, in characters; None if there is none.

    Args:
        columns: of the terminal.
        lines: of the terminal.
        beside: lines that are needed for something else.
    """
    for width, height in ((WIDTH, HEIGHT), *SMALL):
        if columns >= width + MARGIN and lines >= height + CAPTIONS + beside:
            return width, height
    return None


class MapShot(Protocol):
    """What the map needs of a shot."""

    @property
    def index(self) -> int:
        """Its number."""

    @property
    def pitch_deg(self) -> float:
        """Elevation of the boresight."""

    @property
    def yaw_deg(self) -> float:
        """Azimuth of the boresight."""


class SphereMap:
    """Draws the shots of one mission; the pixels of each image are computed once."""

    def __init__(self, half_width: float, half_height: float, *, width: int = WIDTH, height: int = HEIGHT) -> None:
        """Create an empty map.

        Args:
            half_width: half an image's width in the ideal image plane at distance 1.
            half_height: half its height, likewise.
            width: width of the map in characters.
            height: height of the map in characters.
        """
        self._half_width, self._half_height = half_width, half_height
        self._reach_deg = math.degrees(math.atan(math.hypot(half_width, half_height)))
        self.size = width, height
        self.lines = height + CAPTIONS
        self._step_deg = 360.0 / width, 90.0 / height
        self._seen: dict[int, list[int]] = {}

    def pixels(self, shots: Sequence[MapShot], marks: Mapping[int, Mark]) -> list[list[Mark]]:
        """The mark of each pixel: 2 * height rows of width pixels, top row first."""
        width, height = self.size
        out = [Mark.OUTSIDE] * (2 * height * width)
        for shot in shots:
            mark = marks.get(shot.index, Mark.PENDING)
            for pixel in self._pixels_of(shot):
                out[pixel] = max(out[pixel], mark)
        return [out[row * width : (row + 1) * width] for row in range(2 * height)]

    def _pixels_of(self, shot: MapShot) -> list[int]:
        found = self._seen.get(shot.index)
        if found is None:
            found = self._seen[shot.index] = sorted({self._nearest(shot), *self._inside(shot)})
        return found

    def _nearest(self, shot: MapShot) -> int:
        """The pixel of the boresight: an image smaller than a pixel is shown, too."""
        width, height = self.size
        across, down = self._step_deg
        column = int((shot.yaw_deg + 180.0) % 360.0 / across) % width
        return min(int((90.0 - shot.pitch_deg) / down), 2 * height - 1) * width + column

    def _inside(self, shot: MapShot) -> Iterator[int]:
        """The pixels whose centre the image shows."""
        width, height = self.size
        across, down = self._step_deg
        pitch = math.radians(shot.pitch_deg)
        level, upward = math.cos(pitch), math.sin(pitch)
        for row in range(2 * height):
            elevation_deg = 90.0 - down * (row + 0.5)
            if abs(elevation_deg - shot.pitch_deg) > self._reach_deg:
                continue
            flat, rise = math.cos(math.radians(elevation_deg)), math.sin(math.radians(elevation_deg))
            for column in range(width):
                aside = math.radians(across * (column + 0.5) - 180.0 - shot.yaw_deg)
                ahead = flat * math.cos(aside)
                depth = ahead * level + rise * upward
                if (
                    depth > 0
                    and abs(flat * math.sin(aside)) <= self._half_width * depth
                    and abs(ahead * upward - rise * level) <= self._half_height * depth
                ):
                    yield row * width + column

    def text(
        self, shots: Sequence[MapShot], marks: Mapping[int, Mark], *, colours: bool = True, north: bool = False
    ) -> Text:
        """The map with azimuths, elevations and its legend.

        Args:
            shots: all shots of the mission.
            marks: marks by shot index; a shot without a mark is pending.
            colours: False draws with characters only, for terminals without colours.
            north: the plan's yaw 0 is true north: azimuths are N, E, S, W instead of degrees.
        """
        from rich.text import Text  # noqa: PLC0415

        pixels = self.pixels(shots, marks)
        out = Text(no_wrap=True)
        beside = self._elevations()
        for line, (above, below) in enumerate(zip(pixels[0::2], pixels[1::2], strict=True)):
            out.append(f"{beside.get(line, ''):>{MARGIN - 1}} ", "dim" if colours else "")
            # equal neighbours are one piece: a frame has 3 kB instead of 50, which matters on slow remote shells
            for (top, bottom), alike in groupby(zip(above, below, strict=True)):
                length = len(list(alike))
                if colours:
                    out.append("▀" * length, f"{_colour(top)} on {_colour(bottom)}")
                else:
                    out.append(_character(max(top, bottom)) * length)
            out.append("\n")
        out.append(" " * MARGIN + self._azimuths(_NORTH if north else _PLAIN) + "\n", "dim" if colours else "")
        counts = {mark: sum(marks.get(shot.index, Mark.PENDING) is mark for shot in shots) for mark in LEGEND}
        for mark, (colour, character, word) in LEGEND.items():
            if counts[mark]:
                out.append("■ " if colours else f"{character} ", colour if colours else "")
                out.append(f"{word} {counts[mark]}  ")
        return out

    def _elevations(self) -> dict[int, str]:
        """What is written beside the lines: +60 to -60."""
        height = self.size[1]
        return {
            min(int((90 - elevation) * height / 180), height - 1): f"{elevation:+d}" if elevation else "0°"
            for elevation in range(90 - _STEP_DEG, -90, -_STEP_DEG)
        }

    def _azimuths(self, names: Sequence[str]) -> str:
        """What is written below the map: the first and the last at its ends, the others where they are."""
        width = self.size[0]
        line = [" "] * width
        for place, name in enumerate(names):
            at = round(place * width / (len(names) - 1)) - len(name) // 2
            at = min(max(at, 0), width - len(name))
            line[at : at + len(name)] = name
        return "".join(line)


def _colour(mark: Mark) -> str:
    return LEGEND[mark][0] if mark else _OUTSIDE_COLOUR


def _character(mark: Mark) -> str:
    return LEGEND[mark][1] if mark else " "
