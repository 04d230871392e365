"""A character map of the sphere that shows which directions are photographed, current, pending or missing.

The map is equirectangular: azimuth to the right with the plan's yaw 0 in the middle, elevation up. Each character holds
two pixels, one above the other. A pixel gets the colour of the best mark among the images that contain its centre: a
direction covered by one image is not shown as a gap because another image is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from itertools import groupby
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import rotation
from panoexec.mission.log import shot_marks
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_marks import ShotMark
from panoexec.mission.log.shot_record import ShotRecord
from panoexec.optics import Camera
from panoexec.planning.model import Shot

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


def mark_of(record: ShotRecord, *, current: bool) -> Mark:
    """The mark of a shot.

    Args:
        record: the record of the shot.
        current: whether the shot is being taken now.
    """
    return MARKS[shot_marks.mark_of(record, current=current)]


def marks_of(record: MissionRecord) -> dict[int, Mark]:
    """The marks of all shots of a mission, by index."""
    return {index: mark_of(shot, current=index == record.current) for index, shot in record.shots.items()}


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


class SphereMap:
    """Draws the shots of one mission; the pixels of each image are computed once."""

    def __init__(self, camera: Camera, *, width: int = WIDTH, height: int = HEIGHT) -> None:
        """Create an empty map.

        Args:
            camera: optics of the images.
            width: width of the map in characters.
            height: height of the map in characters.
        """
        self._camera = camera
        self.size = width, height
        self.lines = height + CAPTIONS
        self._shape = (2 * height, width)
        azimuth = np.radians(-180.0 + 360.0 * (np.arange(width) + 0.5) / width)[None, :]
        elevation = np.radians(90.0 - 180.0 * (np.arange(2 * height) + 0.5) / (2 * height))[:, None]
        flat = np.cos(elevation)
        north, east = flat * np.cos(azimuth), flat * np.sin(azimuth)
        down = np.broadcast_to(-np.sin(elevation), north.shape)
        self._directions = np.stack([north, east, down], axis=-1).reshape(-1, 3)
        self._seen: dict[int, NDArray[np.intp]] = {}

    def pixels(self, shots: Sequence[Shot], marks: Mapping[int, Mark]) -> NDArray[np.int8]:
        """The mark of each pixel, shape (2 * height, width), top row first."""
        out = np.zeros(self._directions.shape[0], dtype=np.int8)
        for shot in shots:
            seen = self._pixels_of(shot)
            out[seen] = np.maximum(out[seen], marks.get(shot.index, Mark.PENDING))
        return out.reshape(self._shape)

    def _pixels_of(self, shot: Shot) -> NDArray[np.intp]:
        found = self._seen.get(shot.index)
        if found is None:
            inside = self._directions @ rotation(shot.yaw_deg, shot.pitch_deg)
            depth = inside[:, 0]
            wide = np.abs(inside[:, 1]) <= self._camera.half_width * depth
            high = np.abs(inside[:, 2]) <= self._camera.half_height * depth
            found = np.union1d(np.flatnonzero((depth > 0) & wide & high), [int(np.argmax(depth))])
            self._seen[shot.index] = found
        return found

    def text(
        self, shots: Sequence[Shot], marks: Mapping[int, Mark], *, colours: bool = True, north: bool = False
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
            for (top, bottom), alike in groupby(zip(above.tolist(), below.tolist(), strict=True)):
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


def _colour(mark: int) -> str:
    return LEGEND[Mark(mark)][0] if mark else _OUTSIDE_COLOUR


def _character(mark: int) -> str:
    return LEGEND[Mark(mark)][1] if mark else " "
