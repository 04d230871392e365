"""One file that a camera serves, by HTTP or MAVLink FTP, brought here: its definition, or a photo to meter by."""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

from panoexec.adapters.files.http_files import HttpFiles
from panoexec.adapters.files.mavlink_ftp import MavlinkFtpFiles
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.errors import PhotoFileError

_AGAIN_S: Final = 0.5


@contextlib.asynccontextmanager
async def served_file(
    link: MavsdkLink, url: str, *, component: int, max_bytes: int, timeout_s: float, documents: bool = False
) -> AsyncIterator[Path]:
    """A copy of a file for the block; HTTP only from hosts that the link expects files of.

    Args:
        link: to the vehicle.
        url: `http(s)://…`, or MAVLink FTP's.
        component: the camera's MAVLink component.
        max_bytes: of the file.
        timeout_s: for all of it, real seconds; a file that is not there yet is asked for again.
        documents: texts are wanted, which are refused where a photo is.

    Raises:
        PhotoFileError: it could not be brought, or is not to be.
    """
    http = HttpFiles(lambda: link.files.hosts, max_bytes=max_bytes, timeout_s=timeout_s, documents=documents)
    ftp = MavlinkFtpFiles(lambda: link, component=lambda: component, burst=lambda: True, max_bytes=max_bytes)
    fetcher = next((one for one in (http, ftp) if one.takes(url)), None)
    if fetcher is None:
        raise PhotoFileError(f"{url}: neither http nor MAVLink FTP", final=True)
    with tempfile.TemporaryDirectory(prefix="panoexec-served-", ignore_cleanup_errors=True) as folder:
        try:
            if fetcher is http:
                await http.start()
            path = await _brought(fetcher, url, Path(folder) / "part", timeout_s)
        finally:
            await http.close()
        yield path


async def _brought(fetcher: HttpFiles | MavlinkFtpFiles, url: str, part: Path, timeout_s: float) -> Path:
    problem: PhotoFileError | None = None
    try:
        async with asyncio.timeout(timeout_s):
            while True:
                try:
                    return await fetcher.fetch(url, part)
                except PhotoFileError as error:
                    if error.final:
                        raise
                    problem = error
                await asyncio.sleep(_AGAIN_S)
    except TimeoutError as error:
        raise problem or PhotoFileError(f"{url}: not here after {timeout_s:g} s") from error
