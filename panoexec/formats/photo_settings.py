"""What a photo was taken with, and in what it differs from the first photo of its panorama."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from panoexec.formats.exif import read_exif
from panoexec.formats.jpeg_header import read_jpeg_header

_SAME: Final = 0.01
"""Relative difference up to which exposure, aperture and focal length count as the same: EXIF rounds them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoExif:
    """The settings of one photo; None where the file does not tell.

    Attributes:
        exposure_s: shutter time.
        f_number: aperture.
        iso: sensitivity.
        white_balance: `auto` or `manual`.
        focal_length_mm: real focal length.
        width_px, height_px: pixels as stored.
    """

    exposure_s: float | None = None
    f_number: float | None = None
    iso: int | None = None
    white_balance: str | None = None
    focal_length_mm: float | None = None
    width_px: int | None = None
    height_px: int | None = None


def read_settings(path: Path) -> PhotoExif | None:
    """The settings of a photo; None for a file that is no JPEG, or cannot be read.

    Args:
        path: the file.
    """
    try:
        header, told = read_jpeg_header(path), read_exif(path)
    except (OSError, ValueError):
        return None
    balance = told.white_balance
    return PhotoExif(
        exposure_s=_positive(told.exposure_s),
        f_number=_positive(told.aperture),
        iso=int(told.iso) if told.iso > 0 else None,
        white_balance={0.0: "auto", 1.0: "manual"}.get(balance),
        focal_length_mm=_positive(told.focal_length_mm),
        width_px=header.width_px,
        height_px=header.height_px,
    )


def read_taken(path: Path) -> tuple[float, float]:
    """When a photo was taken, by the camera's clock taken as UTC, and the resolution of that, seconds; NaN if unknown.

    Args:
        path: the file, a JPEG or a RAW file.
    """
    try:
        told = read_exif(path)
    except OSError:
        return math.nan, math.nan
    return (math.nan, math.nan) if math.isnan(told.taken_s) else (told.taken_s, told.resolution_s)


def _positive(value: float) -> float | None:
    return value if value > 0 else None


def differences(first: PhotoExif, other: PhotoExif) -> tuple[str, ...]:
    """In what a photo differs from the first one of its panorama, one text each; what one does not tell is ignored.

    Args:
        first: the panorama's first photo.
        other: the photo.
    """
    out = [
        f"{name} {_shown(old, unit)} → {_shown(new, unit)}"
        for name, old, new, unit in (
            ("exposure", first.exposure_s, other.exposure_s, " s"),
            ("aperture", first.f_number, other.f_number, ""),
            ("ISO", first.iso, other.iso, ""),
            ("focal length", first.focal_length_mm, other.focal_length_mm, " mm"),
        )
        if old is not None and new is not None and abs(new - old) > _SAME * abs(old)
    ]
    old_balance, new_balance = first.white_balance, other.white_balance
    if old_balance and new_balance and old_balance != new_balance:
        out.append(f"white balance {old_balance} → {new_balance}")
    sizes = [(one.width_px, one.height_px) for one in (first, other)]
    if all(None not in size for size in sizes) and sizes[0] != sizes[1]:
        out.append("size " + " → ".join(f"{width}×{height}" for width, height in sizes))
    return tuple(out)


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g}{unit}"
