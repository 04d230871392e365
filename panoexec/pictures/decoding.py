"""Decodes photos at a reduced scale, and proves that a JPEG is readable to its last byte.

Decoders forgive damage: libjpeg fills what is missing with grey and goes on, and Pillow does not pass its warnings on.
So three things are required of a JPEG. Its segments are intact up to the end marker. Its entropy-coded data contain
no marker that does not belong there. And the decoder needs exactly all of these data: with the last byte withheld the
last row of blocks is still missing, and with it (and a few bytes of padding, because the decoder looks ahead) it is
there. Damage inside the data makes the decoder lose count of its blocks, so that it finishes early or late.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import PIL.Image
from numpy.typing import NDArray

Grey: TypeAlias = NDArray[np.uint8]

_SOI, _EOI, _SOS = 0xD8, 0xD9, 0xDA
_BASELINE: Final = frozenset({0xC0, 0xC1})
_PADDING: Final = b"\xa5" * 8
"""Appended to complete data: the decoder looks ahead, and these bytes are no marker."""
_LONGEST_RUN: Final = 96
"""Equal bytes in a row that entropy-coded data do not have: a plain sky takes at most a byte or two a block, and its
blocks are followed by the end of the row. Cards and file systems leave whole sectors of zeros or ones."""
_MAX_PIXELS: Final = 400_000_000


class UnreadableError(ValueError):
    """The photo cannot be read to its last byte; the text says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Decoded:
    """A photo at a reduced scale.

    Attributes:
        grey: (h, w) luma.
        width_px, height_px: of the stored photo.
    """

    grey: Grey
    width_px: int
    height_px: int


def decode_file(path: Path, longer_px: int) -> Decoded:
    """Read a photo file; see `decode`.

    Raises:
        UnreadableError: it cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UnreadableError(f"cannot be read ({error.strerror})") from error
    return decode(content, longer_px)


def decode(content: bytes, longer_px: int) -> Decoded:
    """Decode a photo completely.

    Args:
        content: the file's content; a JPEG, or another format that Pillow reads.
        longer_px: the longer side of the result is at most this; smaller photos keep their size.

    Raises:
        UnreadableError: it is no photo, truncated or damaged.
    """
    try:
        image = PIL.Image.open(io.BytesIO(content))
        width, height = _checked_size(image)
        if image.format in {"JPEG", "MPO"}:
            image = _decode_jpeg(image, content, longer_px)
        else:
            image.load()
        grey = image.convert("L") if image.mode != "L" else image
    except UnreadableError:
        raise
    except (OSError, SyntaxError, ValueError, PIL.Image.DecompressionBombError) as error:
        raise UnreadableError(f"is not an image that can be read ({error})") from error
    scale = max(grey.size) / longer_px
    if scale > 1:
        size = (
            max(1, round(width * longer_px / max(width, height))),
            max(1, round(height * longer_px / max(width, height))),
        )
        grey = grey.resize(size, PIL.Image.Resampling.BOX)
    return Decoded(grey=np.asarray(grey), width_px=width, height_px=height)


def _checked_size(image: Any) -> tuple[int, int]:
    width, height = image.size
    if width * height > _MAX_PIXELS:
        raise UnreadableError(f"{width} x {height} px: too large to examine")
    return int(width), int(height)


def _decode_jpeg(image: Any, content: bytes, longer_px: int) -> Any:
    """The decoded luma of a JPEG whose data are proved to be complete."""
    frame, start = scan_start(content)
    end = scan_end(content, start)
    width, height = image.size
    image.draft(
        "L", (max(1, longer_px * width // max(width, height)), max(1, longer_px * height // max(width, height)))
    )
    if frame not in _BASELINE:
        # progressive: several scans, each of which may end early; the markers are what can be proved
        image.load()
        return image
    if content[end + 1] != _EOI:
        raise UnreadableError(f"damaged: marker {content[end + 1]:02x} at byte {end}, inside the picture data")
    if run := _longest_run(content, start, end):
        raise UnreadableError(f"damaged: {run[1]} equal bytes at byte {run[0]} of the picture data")
    return _decode_exactly(image, content, end)


def _decode_exactly(image: Any, content: bytes, end: int) -> Any:
    """Decode, and check that exactly the bytes up to `end` were needed."""
    if len(image.tile) != 1:
        raise UnreadableError("is a JPEG of several tiles")
    tile = image.tile[0]
    image.load_prepare()
    decoder = PIL.Image._getdecoder(image.mode, "jpeg", tile.args, image.decoderconfig)  # noqa: SLF001 (the only way to feed it)
    decoder.setimage(image.im, tile.extents)
    last = end - 1
    # a byte of 0xFF is followed by its stuffed zero, which belongs to it
    if content[last] == 0 and content[last - 1] == 0xFF:
        last -= 1
    rest = content[:last]
    used, code = decoder.decode(rest)
    if code < 0:
        raise UnreadableError("damaged: the picture data cannot be decoded")
    rest = rest[used:] if used >= 0 else b""
    bottom = image.size[1] - 1
    step = max(1, image.size[0] // 64)
    row = [(x, bottom) for x in range(0, image.size[0], step)]
    if used < 0 or any(image.im.getpixel(place) for place in row):
        raise UnreadableError("damaged: the picture is complete before its data end")
    rest += content[last:end] + _PADDING
    used, code = decoder.decode(rest)
    done = used < 0 or any(image.im.getpixel(place) for place in row)
    if not done and not _is_black_at_the_bottom(content, image.mode, image.size):
        raise UnreadableError("damaged: data are missing at the end of the picture")
    image.tile = []
    decoder.cleanup()
    return image


def _is_black_at_the_bottom(content: bytes, mode: str, size: tuple[int, int]) -> bool:
    """Whether a forgiving decoder finds the last row black, too: then it cannot tell whether the row was decoded."""
    other = PIL.Image.open(io.BytesIO(content))
    other.draft(mode, size)
    other.load()
    return max(other.crop((0, size[1] - 1, size[0], size[1])).convert("L").tobytes()) == 0


def scan_start(content: bytes) -> tuple[int, int]:
    """Type of the frame (0xC0 baseline …), and where the entropy-coded data of the first scan begin.

    Raises:
        UnreadableError: the segments before it are damaged or truncated.
    """
    if content[:2] != bytes((0xFF, _SOI)):
        raise UnreadableError("is not a JPEG")
    place, frame = 2, 0
    while True:
        while content[place : place + 2] == b"\xff\xff":
            place += 1
        if place + 4 > len(content):
            raise UnreadableError("is truncated before the picture data")
        if content[place] != 0xFF:
            raise UnreadableError(f"damaged: no marker at byte {place}")
        marker = content[place + 1]
        if marker == _EOI:
            raise UnreadableError("has no picture data")
        length = int.from_bytes(content[place + 2 : place + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in {0xC4, 0xC8, 0xCC}:
            frame = marker
        place += 2 + length
        if marker == _SOS:
            return frame, place


def scan_end(content: bytes, start: int) -> int:
    """Where the first marker after `start` is that does not belong into entropy-coded data (RST does).

    Raises:
        UnreadableError: there is none: the file is truncated.
    """
    data = np.frombuffer(content, dtype=np.uint8)
    places = np.flatnonzero(data[start:-1] == 0xFF) + start
    following = data[places + 1]
    ends = places[(following != 0) & ((following < 0xD0) | (following > 0xD7)) & (following != 0xFF)]
    if not len(ends):
        raise UnreadableError("is truncated: the end marker is missing")
    return int(ends[0])


def _longest_run(content: bytes, start: int, end: int) -> tuple[int, int] | None:
    """Place and length of the first run of equal bytes that is too long; None if there is none."""
    data = np.frombuffer(content, dtype=np.uint8)[start:end]
    if len(data) <= _LONGEST_RUN:
        return None
    # every run of that length contains at least two whole blocks of a third of it
    block = _LONGEST_RUN // 3
    blocks = data[: len(data) // block * block].reshape(-1, block)
    plain = np.flatnonzero(
        (blocks == blocks[:, :1]).all(axis=1) & np.isin(blocks[:, 0], (0x00, 0xFF, 0x55, 0xAA, 0xE5))
    )
    for number in plain.tolist():
        place = number * block
        value = data[place]
        before = place
        while before and data[before - 1] == value:
            before -= 1
        after = np.flatnonzero(data[place:] != value)
        stop = place + int(after[0]) if len(after) else len(data)
        if stop - before > _LONGEST_RUN:
            return before + start, stop - before
    return None
