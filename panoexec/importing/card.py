"""The photos on a card: JPEG and RAW of one photo together, in the order in which they were taken."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from panoexec.errors import UsageError
from panoexec.formats.exif import read_exif
from panoexec.formats.photo_kind import photo_kind

_JPEG: Final = frozenset({".jpg", ".jpeg", ".jpe"})
_RAW: Final = frozenset(
    {".dng", ".arw", ".cr2", ".cr3", ".nef", ".nrw", ".raf", ".orf", ".rw2", ".pef", ".srw", ".3fr", ".iiq", ".raw"}
)
_OTHER: Final = frozenset({".tif", ".tiff", ".png", ".heic", ".heif"})
_HALF_THE_NUMBERS: Final = 5000
"""Names with numbers of four digits that are further apart than this, in the same second: the counter wrapped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CardPhoto:
    """One photo on the card.

    Attributes:
        path: its JPEG, or its RAW file if there is no JPEG.
        raw: its RAW file beside the JPEG; None without one.
        taken_s: the middle of the interval in which it was taken, by the camera's clock taken as UTC.
        half_s: half that interval.
    """

    path: Path
    raw: Path | None
    taken_s: float
    half_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Card:
    """What was found on a card.

    Attributes:
        folder: the folder.
        photos: in the order in which they were taken.
        problems: files that cannot be paired, with the reason.
    """

    folder: Path
    photos: tuple[CardPhoto, ...]
    problems: tuple[tuple[Path, str], ...]


def read_card(folder: Path) -> Card:
    """Read the headers of all photos below a folder.

    Raises:
        UsageError: it is not a folder, cannot be read, or has no photos.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; expected the folder of a memory card, or of its copy")
    try:
        files = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    except OSError as error:
        raise UsageError(f"{error.filename or folder}: cannot be read ({error.strerror})") from error
    photos, problems = [], []
    for path, raw in _pairs(files):
        found = _read(path, raw)
        if isinstance(found, CardPhoto):
            photos.append(found)
        else:
            problems.append((path, found))
    if not photos and not problems:
        raise UsageError(f"{folder}: has no photos; expected the folder of a memory card, or of its copy")
    return Card(folder=folder, photos=tuple(_in_order(photos)), problems=tuple(problems))


def _pairs(files: Iterable[Path]) -> list[tuple[Path, Path | None]]:
    """Each photo's file, and its RAW file beside it."""
    groups: dict[tuple[Path, str], list[Path]] = {}
    for path in files:
        if path.suffix.lower() in _JPEG | _RAW | _OTHER:
            groups.setdefault((path.parent, path.stem.upper()), []).append(path)
    out: list[tuple[Path, Path | None]] = []
    for group in groups.values():
        raw = next((path for path in group if path.suffix.lower() in _RAW), None)
        others = [path for path in group if path.suffix.lower() not in _RAW]
        out += [(path, raw) for path in others[:1]] or ([(raw, None)] if raw is not None else [])
        out += [(path, None) for path in others[1:]]
    return out


def _read(path: Path, raw: Path | None) -> CardPhoto | str:
    """The photo, or why it cannot be paired."""
    try:
        if path.suffix.lower() not in _RAW:
            photo_kind(path)
        exif = read_exif(path)
        if math.isnan(exif.taken_s) and raw is not None:
            exif = read_exif(raw)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    except ValueError as error:
        return str(error)
    if math.isnan(exif.taken_s):
        return "has no EXIF time"
    half_s = exif.resolution_s / 2
    return CardPhoto(path=path, raw=raw, taken_s=exif.taken_s + half_s, half_s=half_s)


def _in_order(photos: list[CardPhoto]) -> list[CardPhoto]:
    """By time; photos of the same second by the number in their name, which may have wrapped."""
    by_second: dict[int, list[CardPhoto]] = {}
    for photo in photos:
        by_second.setdefault(math.floor(photo.taken_s), []).append(photo)
    out: list[CardPhoto] = []
    for _, group in sorted(by_second.items()):
        numbers = {photo.path: _number(photo.path) for photo in group}
        wrapped = max(numbers.values()) - min(numbers.values()) > _HALF_THE_NUMBERS

        def key(photo: CardPhoto, numbers: dict[Path, int] = numbers, wrapped: bool = wrapped) -> tuple[object, ...]:
            late = wrapped and numbers[photo.path] < _HALF_THE_NUMBERS
            exact = photo.taken_s if photo.half_s < 0.5 else 0.0
            return exact, late, numbers[photo.path], str(photo.path)

        out += sorted(group, key=key)
    return out


def _number(path: Path) -> int:
    digits = re.findall(r"\d+", path.stem)
    return int(digits[-1]) if digits else 0
