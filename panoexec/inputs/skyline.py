"""Where the sky begins (`textured_below`), as somebody gives it: one elevation, or pairs of azimuth and elevation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from panoexec.errors import InputFileError
from panoexec.planning.skyline import Skyline

MOST_POINTS = 1000
_SAME_DEG = 1e-9


def skyline_of(value: float | Sequence[Sequence[float]]) -> Skyline:
    """The skyline of one elevation, or of (azimuth, elevation) pairs, degrees, in any order.

    Raises:
        ValueError: a value is out of range, or an azimuth occurs twice; the message says which.
    """
    if isinstance(value, (int, float)):
        return Skyline.level(_elevation(float(value)))
    if not 1 <= len(value) <= MOST_POINTS:
        raise ValueError(f"has {len(value)} points: give 1 to {MOST_POINTS} pairs of azimuth and elevation")
    points: list[tuple[float, float]] = []
    for pair in value:
        if len(pair) != 2:
            raise ValueError(f"has a point of {len(pair)} numbers: give pairs of azimuth and elevation")
        azimuth, elevation = float(pair[0]), float(pair[1])
        if not (math.isfinite(azimuth) and abs(azimuth) <= 720):
            raise ValueError(f"has azimuth {azimuth:g}: give degrees from -360 to 360")
        points.append(((azimuth + 180.0) % 360.0 - 180.0, _elevation(elevation)))
    points.sort()
    for (before, _), (azimuth, _) in pairwise(points):
        if azimuth - before < _SAME_DEG:
            raise ValueError(f"has azimuth {azimuth:g} twice")
    return Skyline(tuple(points))


def skyline_to_data(skyline: Skyline | None) -> float | list[list[float]] | None:
    """A skyline as plan files show it: the inverse of `skyline_of`."""
    if skyline is None:
        return None
    if len(skyline.points) == 1:
        return skyline.points[0][1]
    return [list(point) for point in skyline.points]


def skyline_from_text(text: str) -> Skyline:
    """The skyline of an option: degrees, or a file with an azimuth and an elevation in each line.

    Numbers are separated by blanks, a comma or a semicolon; empty lines and what follows # are ignored.

    Raises:
        InputFileError: the file cannot be read, or a line is wrong, with the line's number.
        ValueError: the elevation is out of range.
    """
    try:
        elevation = float(text)
    except ValueError:
        return _read(Path(text))
    return skyline_of(elevation)


def _read(path: Path) -> Skyline:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputFileError(str(path), [f"cannot be read: {error.strerror or error}"]) from error
    except UnicodeDecodeError as error:
        raise InputFileError(str(path), [f"is not UTF-8 text: byte {error.start}: {error.reason}"]) from error
    pairs, problems = [], []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            azimuth, elevation = (float(word) for word in words)
        except ValueError:
            problems.append(f"line {number}: {line.strip()[:40]!r} is not an azimuth and an elevation in degrees")
            continue
        pairs.append((azimuth, elevation))
    if problems:
        raise InputFileError(str(path), problems[:20])
    try:
        return skyline_of(pairs)
    except ValueError as error:
        raise InputFileError(str(path), [str(error)]) from error


def _elevation(value: float) -> float:
    if not -90 <= value <= 90:  # false for NaN, too
        raise ValueError(f"has elevation {value:g}: give degrees from -90 to 90")
    return value
