"""Where the simulated camera says that its photos and its definition are; its web server runs meanwhile."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.camera_settings import FILE_NAME, definition
from panoexec.sim.mavlink.ftp_server import definition_uri, mftp_url
from panoexec.sim.photos.file_server import serving_photos


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """What the camera tells of its files.

    Attributes:
        file_url: the URL of a photo.
        definition_uri: of its definition, "" for none.
    """

    file_url: Callable[[Path], str]
    definition_uri: str = ""


@contextlib.asynccontextmanager
async def served_files(config: SimConfig) -> AsyncIterator[Served]:
    """Run the camera's web server for the block, if it has one."""
    camera = config.camera
    by_http = camera.files == "http" and config.output is not None
    file_url: Callable[[Path], str] = lambda path: path.name  # noqa: E731
    if camera.files == "folder":
        file_url = Path.as_uri
    elif camera.files == "mftp":
        file_url = mftp_url
    uri = definition_uri() if camera.definition == "mftp" else ""
    if not by_http and camera.definition != "http":
        yield Served(file_url=file_url, definition_uri=uri)
        return
    besides = {FILE_NAME: definition()} if camera.definition == "http" else {}
    with serving_photos(config.output if by_http else None, kb_s=camera.files_kb_s, besides=besides) as base:
        yield Served(
            file_url=(lambda path: f"{base}/{path.name}") if by_http else file_url,
            definition_uri=f"{base}/{FILE_NAME}" if besides else uri,
        )
