"""Fetches the photos of a tethered camera, beside the mission: newest first, again after the camera was gone.

What is on disk here with the size that the camera tells and a SHA-256 is handed over to whoever keeps the mission.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import structlog

from panoexec.adapters.camera.capture import Capture
from panoexec.adapters.camera.tethered.child import CallFailedError
from panoexec.adapters.camera.tethered.photos import Photo
from panoexec.clock import Clock, work
from panoexec.devices import TakenFile
from panoexec.errors import DeviceError

RAW_WAIT_S: Final = 1.0
"""How long after its RAW file a photo's JPEG may come, real seconds."""
_FETCH_S: Final = 120.0
"""Longest transfer: 256 MiB at 2 MB/s."""
_TRIES: Final = 3
_AGAIN_S: Final = 0.5

_log = structlog.get_logger(__name__)

Call = Callable[..., Awaitable[Any]]
"""Asks the camera's process: what, seconds, fields."""


@dataclass(slots=True, kw_only=True)
class _Wanted:
    """A photo whose file is to be fetched."""

    photo: Photo
    capture: Capture | None
    tries: int = 0


class PhotoFiles:
    """Fetches files one after the other; `run` it in a task.

    Attributes:
        failed: why files could not be fetched, by their path in the camera.
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
        self._taken: asyncio.Queue[TakenFile] = asyncio.Queue()
        self._numbers = 0
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

    async def next(self) -> TakenFile:
        """The next file that is here; see `HandsOverFiles.next_file`."""
        return await self._taken.get()

    async def run(self) -> None:
        """Fetch for ever."""
        while True:
            await self._more.wait()
            await self._opened.wait()
            if not self._wanted:
                self._more.clear()
                continue
            one = self._wanted.pop()
            self.busy = True
            try:
                with work(self._clock):
                    await self._fetch(one)
            finally:
                self.busy = False

    async def _fetch(self, one: _Wanted) -> None:
        if one.photo.is_raw_only:
            await asyncio.sleep(RAW_WAIT_S)
        photo = one.photo
        self._numbers += 1
        path = self._spool / f"{self._numbers:06d}-{photo.file}"
        one.tries += 1
        try:
            told = await self._call("fetch", _FETCH_S, folder=photo.folder, name=photo.file, to=str(path))
        except CallFailedError as error:
            if one.tries < _TRIES:
                self._wanted.insert(0, one)
                await asyncio.sleep(_AGAIN_S)
                return
            _log.warning("file of a photo not fetched", file=photo.path, reason=str(error))
            self.failed[photo.path] = str(error)
            return
        except DeviceError:  # it is gone: once it is back
            self._wanted.append(one)
            self._more.set()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_AGAIN_S):
                    await asyncio.sleep(_AGAIN_S)
            return
        self.failed.pop(photo.path, None)
        taken = TakenFile(
            told=photo.path,
            also=tuple(photo.paths),
            path=path,
            size_bytes=int(told["size"]),
            sha256=str(told["sha256"]),
            transfer_s=float(told["seconds"]),
        )
        if one.capture is not None:
            one.capture.file_seen(self._clock.monotonic(), file_url=photo.path)
        self._taken.put_nowait(taken)
