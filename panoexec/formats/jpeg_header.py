"""JPEG headers: size and orientation, and whether the end marker exists."""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

_SIZE_MARKERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_SCAN: Final = 0xDA
_ORIENTATION_TAG: Final = 0x0112
_TAIL_BYTES: Final = 1 << 22


@dataclass(frozen=True, slots=True)
class JpegHeader:
    """Size and orientation of the stored pixels.

    Attributes:
        width_px: stored pixels across.
        height_px: stored pixels down.
        orientation: EXIF's, 1 = upright, 6 = to be turned clockwise by 90° for viewing, 8 = by 270°, 3 = by 180°.
        complete: whether the end marker exists; a truncated file has none.
    """

    width_px: int
    height_px: int
    orientation: int
    complete: bool


def read_jpeg_header(path: Path) -> JpegHeader:
    """Read a JPEG's header without decoding it.

    Raises:
        OSError: the file cannot be read.
        ValueError: not a JPEG, or truncated in its header.
    """
    with path.open("rb") as file:
        if file.read(2) != b"\xff\xd8":
            raise ValueError("is not a JPEG")
        orientation, size = 1, None
        while True:
            head = file.read(4)
            if len(head) < 4 or head[0] != 0xFF:
                raise ValueError("is a JPEG that is cut off in its header")
            marker, length = head[1], int.from_bytes(head[2:4])
            if marker == _SCAN:
                break
            body = file.read(length - 2)
            if len(body) != length - 2:
                raise ValueError("is a JPEG that is cut off in its header")
            if marker in _SIZE_MARKERS:
                size = int.from_bytes(body[3:5]), int.from_bytes(body[1:3])
            elif marker == 0xE1 and body.startswith(b"Exif\x00\x00"):
                orientation = _orientation(body[6:])
        if size is None:
            raise ValueError("is a JPEG without a size")
        return JpegHeader(size[0], size[1], orientation, _has_end(file))


def _has_end(file: BinaryIO) -> bool:
    """Whether an end marker follows the scan that begins here (some cameras append more data after it)."""
    start = file.tell()
    end = file.seek(0, os.SEEK_END)
    file.seek(max(start, end - _TAIL_BYTES))
    # image data never contains these two bytes in a row: its 0xFF are followed by 0x00 or a restart marker
    return b"\xff\xd9" in file.read()


def _orientation(tiff: bytes) -> int:
    """The orientation in a block of EXIF data, 1 if it is missing or invalid."""
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return 1
    try:
        (first,) = struct.unpack_from(order + "I", tiff, 4)
        (count,) = struct.unpack_from(order + "H", tiff, first)
        for entry in range(count):
            tag, kind, _, value = struct.unpack_from(order + "HHIH", tiff, first + 2 + 12 * entry)
            if tag == _ORIENTATION_TAG and kind == 3 and 1 <= value <= 8:
                return int(value)
    except struct.error:
        return 1
    return 1
