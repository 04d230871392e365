"""The page's files, read once: no name of a request ever becomes a path."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import PurePath
from typing import Final

_TYPES: Final = {
    ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".png": "image/png",
    ".jpg": "image/jpeg", ".webp": "image/webp", ".woff2": "font/woff2", ".json": "application/json",
    ".webmanifest": "application/manifest+json", ".ico": "image/x-icon",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class StaticFile:
    """One file of the page.

    Attributes:
        content: its bytes.
        kind: MIME type.
        charset: of a text; None for others.
        etag: changes with the content.
    """

    content: bytes
    kind: str
    charset: str | None
    etag: str


def read_static_files() -> dict[str, StaticFile]:
    """The files by their path below `/assets/`; `pages/` has what the report shares, `report/` the report's own."""
    found: dict[str, StaticFile] = {}
    package = files("panoexec")
    for prefix, folder in (
        ("", package / "web" / "assets"),
        ("pages/", package / "pages"),
        ("report/", package / "report" / "assets"),
    ):
        _read(folder, prefix, found)
    return found


def _read(folder: Traversable, prefix: str, found: dict[str, StaticFile]) -> None:
    for one in folder.iterdir():
        if one.is_dir():
            _read(one, f"{prefix}{one.name}/", found)
            continue
        kind = _TYPES.get(PurePath(one.name).suffix)
        if kind is not None:
            content = one.read_bytes()
            etag = f'"{hashlib.sha256(content).hexdigest()[:20]}"'
            found[prefix + one.name] = StaticFile(content, kind, "utf-8" if kind.startswith("text/") else None, etag)
