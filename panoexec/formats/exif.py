"""EXIF of photos, read without decoding them: from a JPEG's header, or from a RAW file that is a TIFF (ARW, NEF, DNG).

Source: Exif 2.32 (CIPA DC-008), TIFF 6.0. EXIF's times are those of the camera's clock, without a time zone unless the
camera wrote one.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, TypeAlias

_READ_BYTES: Final = 1 << 18
_IFD_EXIF: Final = 0x8769
_DIGITS: Final = 9
"""Of a fraction of a second, the most that are read."""
_ZONE: Final = re.compile(r"(?P<sign>[+-])(?P<hours>[0-9]{2}):(?P<minutes>[0-5][0-9])")
_SIZES: Final = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 9: 4, 10: 8}

Value: TypeAlias = "str | float"


@dataclass(frozen=True, slots=True, kw_only=True)
class Exif:
    """What a camera wrote about a photo.

    Attributes:
        taken_s: when, by the camera's clock taken as UTC, seconds since 1970; NaN if unknown.
        resolution_s: of `taken_s`: 1, or the fraction that the camera writes.
        zone_s: the camera's offset from UTC; NaN if it wrote none.
        make: the camera's maker.
        model: the camera's model.
        orientation: 1 = upright, 6 and 8 = turned by a quarter; 0 if unknown.
        exposure_s: shutter time; NaN if unknown.
        aperture: f-number; NaN if unknown.
        iso: sensitivity; NaN if unknown.
        white_balance: 0 = auto, 1 = manual; NaN if unknown.
        focal_length_mm: real focal length; NaN if unknown.
        focal_length_35_mm: that of a 35 mm camera with the same field of view; NaN if unknown.
    """

    taken_s: float = math.nan
    resolution_s: float = 1.0
    zone_s: float = math.nan
    make: str = ""
    model: str = ""
    orientation: int = 0
    exposure_s: float = math.nan
    aperture: float = math.nan
    iso: float = math.nan
    white_balance: float = math.nan
    focal_length_mm: float = math.nan
    focal_length_35_mm: float = math.nan


def read_exif(path: Path) -> Exif:
    """The EXIF of a file; empty if it has none that can be read.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_READ_BYTES)
    return exif_of(head)


def exif_of(head: bytes) -> Exif:
    """The EXIF of a file's first 256 KiB; empty if it has none that can be read."""
    tiff = head if head[:4] in {b"II*\x00", b"MM\x00*"} else _block(head)
    try:
        values = _values(tiff)
    except (struct.error, ValueError, IndexError):
        return Exif()
    taken_s, resolution_s = _moment(_text(values, 0x9003) or _text(values, 0x0132), _text(values, 0x9291))
    return Exif(
        taken_s=taken_s,
        resolution_s=resolution_s,
        zone_s=_zone(_text(values, 0x9011)),
        make=_text(values, 0x010F),
        model=_text(values, 0x0110),
        orientation=int(_number(values, 0x0112)) if 1 <= _number(values, 0x0112) <= 8 else 0,
        exposure_s=_number(values, 0x829A),
        aperture=_number(values, 0x829D),
        iso=_number(values, 0x8827),
        white_balance=_number(values, 0xA403),
        focal_length_mm=_number(values, 0x920A),
        focal_length_35_mm=_number(values, 0xA405),
    )


def _block(head: bytes) -> bytes:
    """The EXIF block of a JPEG; empty without one."""
    at = 2
    while head[:2] == b"\xff\xd8" and at + 4 <= len(head) and head[at] == 0xFF and head[at + 1] != 0xDA:
        length = int.from_bytes(head[at + 2 : at + 4])
        body = head[at + 4 : at + 2 + length]
        if head[at + 1] == 0xE1 and body.startswith(b"Exif\x00\x00"):
            return body[6:]
        at += 2 + length
    return b""


def _values(tiff: bytes) -> dict[int, Value]:
    """Tags of the first directory and of its EXIF directory."""
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return {}
    (first,) = struct.unpack_from(order + "I", tiff, 4)
    found = _directory(tiff, order, first)
    inner = found.get(_IFD_EXIF)
    if isinstance(inner, float):
        found |= _directory(tiff, order, int(inner))
    return found


def _directory(tiff: bytes, order: str, start: int) -> dict[int, Value]:
    found: dict[int, Value] = {}
    (count,) = struct.unpack_from(order + "H", tiff, start)
    for entry in range(min(count, 1000)):
        at = start + 2 + 12 * entry
        tag, kind, length = struct.unpack_from(order + "HHI", tiff, at)
        size = _SIZES.get(kind, 0) * length
        if not size:
            continue
        where = at + 8 if size <= 4 else struct.unpack_from(order + "I", tiff, at + 8)[0]
        if where + size <= len(tiff) and (value := _value(tiff[where : where + size], order, kind)) is not None:
            found[tag] = value
    return found


def _value(data: bytes, order: str, kind: int) -> Value | None:
    """The text, or the first number."""
    if kind == 2:
        return data.split(b"\0")[0].decode("latin-1").strip()
    if kind in {5, 10}:
        upper, lower = struct.unpack_from(order + ("II" if kind == 5 else "ii"), data)
        return upper / lower if lower else math.nan
    code = {1: "B", 3: "H", 4: "I", 9: "i"}.get(kind)
    return None if code is None else float(struct.unpack_from(order + code, data)[0])


def _text(values: dict[int, Value], tag: int) -> str:
    value = values.get(tag, "")
    return value if isinstance(value, str) else ""


def _number(values: dict[int, Value], tag: int) -> float:
    value = values.get(tag, math.nan)
    return value if isinstance(value, float) else math.nan


def _moment(stamp: str, fraction: str) -> tuple[float, float]:
    """Seconds since 1970 of `YYYY:MM:DD HH:MM:SS` taken as UTC, and their resolution; NaN if it is none."""
    try:
        whole = datetime.strptime(stamp, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return math.nan, 1.0
    digits = fraction.strip()[:_DIGITS]
    if digits.isascii() and digits.isdigit() and digits.strip("0"):  # "000" of cameras that have no fraction
        return whole + int(digits) / 10 ** len(digits), 10.0 ** -len(digits)
    return whole, 1.0


def _zone(text: str) -> float:
    """Seconds of `+HH:MM`; NaN if it is none."""
    found = _ZONE.fullmatch(text)
    if found is None:
        return math.nan
    return (-1 if found["sign"] == "-" else 1) * (int(found["hours"]) * 3600 + int(found["minutes"]) * 60.0)
