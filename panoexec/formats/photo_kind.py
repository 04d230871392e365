"""What a photo's file is, told by its content: an image, and whether it was cut off."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from panoexec.formats.jpeg_header import read_jpeg_header

_HEAD_BYTES: Final = 64
_MAGIC: Final = {
    b"\xff\xd8\xff": "JPEG",
    b"\x89PNG\r\n\x1a\n": "PNG",
    b"II*\x00": "TIFF",  # DNG, ARW, NEF, CR2, PEF and SRW are TIFF files too
    b"MM\x00*": "TIFF",
    b"IIRO": "ORF",
    b"IIRS": "ORF",
    b"IIU\x00": "RW2",
    b"FUJIFILMCCD-RAW": "RAF",
    b"BM": "BMP",
}
_BRANDS: Final = {b"crx ": "CR3", b"heic": "HEIF", b"heix": "HEIF", b"mif1": "HEIF", b"avif": "AVIF"}


def photo_kind(path: Path) -> str:
    """The kind of image that a file is, by its first bytes: `JPEG`, `TIFF`, …; a JPEG is also whole.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is empty, no image, or a JPEG that is cut off; the message completes "the file …".
    """
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    kind = _kind(head)
    if not head:
        raise ValueError("is empty")
    if not kind:
        raise ValueError("is a web page, not an image" if _is_html(head) else "is not an image")
    if kind == "JPEG" and not read_jpeg_header(path).complete:
        raise ValueError("is a JPEG that is cut off")
    return kind


def _kind(head: bytes) -> str:
    if head[4:8] == b"ftyp":
        return _BRANDS.get(head[8:12], "")
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "WEBP"
    return next((kind for magic, kind in _MAGIC.items() if head.startswith(magic)), "")


def _is_html(head: bytes) -> bool:
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"<", b"{"))
