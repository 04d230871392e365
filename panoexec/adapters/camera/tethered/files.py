"""Fetches the photos of a tethered camera, beside the mission: newest first, again after the camera was gone.

What is on disk here with the size that the camera tells and a SHA-256 is handed over to whoever keeps the mission.
"""

from __future__ import annotations

import asyncio
import contextlib
import shutil
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import structlog

from panoexec.adapters.camera.capture import Capture
from panoexec.adapters.camera.tethered.child import CallFailedError
from panoexec.adapters.camera.tethered.photos import Photo
from panoexec.clock import Clock, work
from panoexec.errors import DeviceError, PhotoFileError

RAW_WAIT_S: Final = 1.0
"""How long after its RAW file a photo's JPEG may come, real seconds."""
_FETCH_S: Final = 120.0
"""Longest transfer: 256 MiB at 2 MB/s."""
_TRIES: Final = 3
_MOST_HERE: Final = 16
"""Files that wait here for whoever takes them."""
_PREFIX: Final = "tethered-"
_AGAIN_S: Final = 0.5

_log = structlog.get_logger(__name__)

Call = Callable[..., Awaitable[Any]]
"""Asks the camera's process: what, seconds, fields."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TakenFile:
    """The file of a photo, copied from the camera to this computer, whole and on disk.

    Attributes:
        told: its URL, which is what the evidence of the photo names.
        also: paths of the same photo in the camera, this one included: a RAW file and its JPEG.
        path: where it is; until it is taken away.
        size_bytes: as the camera tells it, and as it is.
        sha256: of its content, 64 hexadecimal digits.
        transfer_s: how long the camera took to send it, real seconds.
    """

    told: str
    also: tuple[str, ...] = ()
    path: Path
    size_bytes: int
    sha256: str
    transfer_s: float = 0.0


@dataclass(slots=True, kw_only=True)
class _Wanted:
    """A photo whose file is to be fetched."""

    photo: Photo
    capture: Capture | None
    tries: int = 0


class PhotoFiles:
    """Fetches files one after the other; `run` it in a task.

    Attributes:
        failed: why files could not be fetched, by URL.
        arrived: what was fetched since the beginning.
    """

    def __init__(self, spool: Path, *, clock: Clock, call: Call, opened: asyncio.Event) -> None:
        """Create it.

        Args:
            spool: folder for the files.
            clock: of the mission.
            call: asks the camera's process.
            opened: set while the camera is open.
        """
        self.failed: dict[str, str] = {}
        self._spool = spool
        self._clock = clock
        self._call = call
        self._opened = opened
        self._wanted: list[_Wanted] = []
        self._more = asyncio.Event()
        self.arrived: list[TakenFile] = []
        self._here: dict[str, TakenFile] = {}
        self._changed = asyncio.Event()
        self._numbers = 0
        self._current: Photo | None = None
        self.busy = False
        """Whether a file is being transferred."""

    def want(self, photo: Photo, capture: Capture | None = None) -> None:
        """Fetch the file of a photo, before those that were wanted earlier."""
        self._wanted.append(_Wanted(photo=photo, capture=capture))
        self._more.set()

    @property
    def pending(self) -> int:
        """Files that are still to be fetched."""
        return len(self._wanted) + int(self.busy)

    async def take(self, photo: Photo, part: Path) -> Path:
        """Hand over the file of a photo; it is fetched now if it is not here.

        Args:
            photo: in the camera.
            part: where it is to be.

        Raises:
            PhotoFileError: it could not be fetched; `final` if it is no whole photo.
        """
        if photo.url not in self._here and not self._is_coming(photo):
            self.failed.pop(photo.url, None)
            self.want(photo)
        while photo.url not in self._here:
            if photo.url in self.failed:
                raise PhotoFileError(self.failed[photo.url], final=True)
            self._changed.clear()
            await self._changed.wait()
        taken = self._here.pop(photo.url)
        await asyncio.to_thread(shutil.move, taken.path, part)
        return part

    def here(self, url: str) -> Path | None:
        """The file of a photo, if it is here."""
        taken = self._here.get(url)
        return None if taken is None else taken.path

    def _is_coming(self, photo: Photo) -> bool:
        return photo is self._current or any(one.photo is photo for one in self._wanted)

    async def run(self) -> None:
        """Fetch for ever."""
        while True:
            await self._more.wait()
            await self._opened.wait()
            if not self._wanted:
                self._more.clear()
                continue
            one = self._wanted.pop()
            self.busy, self._current = True, one.photo
            try:
                with work(self._clock):
                    await self._fetch(one)
            finally:
                self.busy, self._current = False, None
                self._changed.set()

    async def _fetch(self, one: _Wanted) -> None:
        if one.photo.is_raw_only:
            await asyncio.sleep(RAW_WAIT_S)
        photo = one.photo
        self._numbers += 1
        path = self._spool / f"{_PREFIX}{self._numbers:06d}-{photo.file}"
        one.tries += 1
        try:
            told = await self._call("fetch", _FETCH_S, folder=photo.folder, name=photo.file, to=str(path))
        except CallFailedError as error:
            if one.tries < _TRIES:
                self._wanted.insert(0, one)
                await asyncio.sleep(_AGAIN_S)
                return
            _log.warning("file of a photo not fetched", file=photo.url, reason=str(error))
            self.failed[photo.url] = str(error)
            return
        except DeviceError:  # it is gone: once it is back
            self._wanted.append(one)
            self._more.set()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_AGAIN_S):
                    await asyncio.sleep(_AGAIN_S)
            return
        self.failed.pop(photo.url, None)
        taken = TakenFile(
            told=photo.url,
            also=tuple(photo.urls),
            path=path,
            size_bytes=int(told["size"]),
            sha256=str(told["sha256"]),
            transfer_s=float(told["seconds"]),
        )
        if one.capture is not None:
            one.capture.file_seen(self._clock.monotonic(), file_url=photo.url)
        self.arrived.append(taken)
        self._here[photo.url] = taken
        while len(self._here) > _MOST_HERE:  # nobody's photos; the camera keeps them
            oldest = next(iter(self._here))
            self._here.pop(oldest).path.unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove what nobody took; the camera still has it."""
        for path in self._spool.glob(f"{_PREFIX}*"):
            path.unlink(missing_ok=True)
