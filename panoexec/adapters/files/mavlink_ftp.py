"""The files of a camera by MAVLink FTP, over the link itself; MAVSDK's plugin transfers them.

While a mission flies a file is read packet by packet, each after the answer to the last one: commands then wait for at
most one packet. After landing it is read in bursts. MAVSDK begins an interrupted file anew.
"""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Final

from mavsdk.plugins.ftp import Ftp, FtpResult, ProgressData

from panoexec.adapters.link.file_urls import mavlink_ftp_component, mavlink_ftp_path
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.thread_state import keep_thread_state
from panoexec.errors import DeviceError, PhotoFileError

MAX_BYTES: Final = 256 * 1024 * 1024
_SILENT_S: Final = 20.0
_FINAL: Final = frozenset({FtpResult.FILE_PROTECTED, FtpResult.INVALID_PARAMETER, FtpResult.UNSUPPORTED})
_TEXTS: Final = {
    FtpResult.FILE_DOES_NOT_EXIST: "there is no such file",
    FtpResult.TIMEOUT: "not answered",
    FtpResult.UNSUPPORTED: "the camera has no MAVLink FTP",
}


class MavlinkFtpFiles:
    """Reads photos, one at a time; implements `PhotoFetcher`."""

    source = "mavftp"
    CAMERA: Final = 100
    """MAV_COMP_ID_CAMERA."""

    def __init__(
        self,
        link: Callable[[], MavsdkLink | None],
        *,
        component: Callable[[], int],
        burst: Callable[[], bool],
        max_bytes: int = MAX_BYTES,
    ) -> None:
        """Describe it.

        Args:
            link: returns the open link.
            component: returns the camera's MAVLink component, for URLs that name none.
            burst: whether the link is free for bursts.
            max_bytes: of one file.
        """
        self._link = link
        self._component = component
        self._burst = burst
        self._max_bytes = max_bytes
        self._running: asyncio.Future[FtpResult] | None = None

    def takes(self, url: str) -> bool:
        """See `PhotoFetcher.takes`."""
        return bool(mavlink_ftp_path(url))

    async def fetch(self, url: str, part: Path) -> Path:
        """See `PhotoFetcher.fetch`."""
        link, path = self._link(), mavlink_ftp_path(url)
        if link is None or not link.connected:
            raise PhotoFileError(f"{url}: no link to the vehicle")
        if self._running is not None and not self._running.done():
            raise PhotoFileError(f"{url}: an earlier transfer has not ended yet")  # MAVSDK cannot end one
        folder = part.with_name(f"{part.name}.ftp")
        await asyncio.to_thread(_emptied, folder)
        try:
            ftp = link.requests.plugin(Ftp)
            component = mavlink_ftp_component(url) or self._component()
            await link.requests.mavsdk_call("select the camera's files", lambda: ftp.set_target_compid(component))
            await self._check_size(link, ftp, url, PurePosixPath(path))
            result = await self._downloaded(link, ftp, path, folder, url)
        except DeviceError as error:
            raise PhotoFileError(f"{url}: {error}", final=getattr(error, "final", False)) from error
        if result is not FtpResult.SUCCESS:
            text = _TEXTS.get(result, result.name.lower().replace("_", " "))
            raise PhotoFileError(f"{url}: {text}", final=result in _FINAL)
        await asyncio.to_thread((folder / PurePosixPath(path).name).replace, part)
        await asyncio.to_thread(shutil.rmtree, folder, True)
        return part

    async def _check_size(self, link: MavsdkLink, ftp: Ftp, url: str, path: PurePosixPath) -> None:
        """Refuse a file that the camera's list says is too large; a camera without lists is asked for the file."""
        try:
            folder = str(path.parent)
            listed = await link.requests.mavsdk_call("list the camera's files", lambda: ftp.list_directory(folder))
        except DeviceError:
            return
        for entry in listed.entries:
            if entry.name == path.name and entry.size_bytes > self._max_bytes:
                raise _too_large(url, int(entry.size_bytes), self._max_bytes)

    async def _downloaded(self, link: MavsdkLink, ftp: Ftp, path: str, folder: Path, url: str) -> FtpResult:
        running: asyncio.Future[FtpResult] = asyncio.get_running_loop().create_future()
        self._running = running
        news = asyncio.Event()
        progress = [0]

        def told(result: FtpResult, data: ProgressData, _user_data: object) -> None:
            keep_thread_state()
            if result is FtpResult.NEXT:
                progress[0] = int(data.total_bytes or 0)
                link.post(news.set)
            else:
                link.post(_finish, running, result)
                link.post(news.set)

        ftp.download_async(path, str(folder), self._burst(), told)
        while not running.done():
            news.clear()
            try:
                async with asyncio.timeout(_SILENT_S):
                    await news.wait()
            except TimeoutError as error:
                raise PhotoFileError(f"{url}: nothing more arrives") from error
            if progress[0] > self._max_bytes:
                raise _too_large(url, progress[0], self._max_bytes)
        return running.result()


def _finish(running: asyncio.Future[FtpResult], result: FtpResult) -> None:
    if not running.done():
        running.set_result(result)


def _emptied(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)


def _too_large(url: str, size: int, most: int) -> PhotoFileError:
    return PhotoFileError(f"{url}: has {size} bytes, at most {most} are accepted", final=True)
