"""The files of a mission that the page shows: found by what they are, never by a name from a request."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

_SMALL: Final = 100_000
"""Bytes of a picture in a list, which may be long."""


def stitched_file(folder: Path) -> Path | None:
    """The stitched panorama, the best there is."""
    stitched = folder / "stitch"
    return next((path for name in ("panorama.tif", "panorama.jpg") if (path := stitched / name).is_file()), None)


def preview_file(folder: Path) -> Path | None:
    """A JPEG for a list: of the panorama if that is small, else of the shot in the middle."""
    stitched = folder / "stitch" / "panorama.jpg"
    size = stitched.stat().st_size if stitched.is_file() else 0
    thumbnails = sorted((folder / "thumbnails").glob("*.jpg"))
    if 0 < size <= _SMALL or (size and not thumbnails):
        return stitched
    return thumbnails[len(thumbnails) // 2] if thumbnails else None


def photo_file(folder: Path, name: str) -> Path | None:
    """A photo by its name in the manifest, which is below `images/`; None for any other file."""
    try:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
        files = {shot.get("file") for shot in manifest["shots"]}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None
    wanted = f"images/{name}"
    return folder / wanted if wanted in files and ".." not in name.split("/") else None
