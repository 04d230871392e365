"""`[camera.lock]` on a MAVLink camera: settings by its definition, and the photo by which the exposure is metered."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

import structlog

from panoexec.adapters.camera.capture_messages import file_is_there
from panoexec.adapters.camera.settings.locked_settings import LockedSettings
from panoexec.adapters.camera.settings.mavlink_settings import MavlinkSettings, NoSettingsError
from panoexec.adapters.files.camera_served import served_file
from panoexec.adapters.files.http_files import MAX_BYTES
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import work
from panoexec.devices import EvidenceLevel, PendingCapture
from panoexec.errors import DeviceError, PhotoFileError
from panoexec.formats.photo_settings import PhotoExif, read_settings
from panoexec.inputs.vehicle_sections import LockSection

METER_S: Final = 15.0
"""How long the photo by which the exposure is metered may take to be reported, and again to arrive."""
_LOOK_S: Final = 0.25

_log = structlog.get_logger(__name__)


class MavlinkLock:
    """What `[camera.lock]` asks for, on one MAVLink camera."""

    def __init__(self, lock: LockSection, link: MavsdkLink, *, component: Callable[[], int]) -> None:
        """Create it; nothing is sent.

        Args:
            lock: `[camera.lock]`.
            link: to the vehicle.
            component: returns the camera's component.
        """
        self.wanted = lock != LockSection()
        self._link = link
        self._component = component
        self._source = MavlinkSettings(link, component=component)
        self._settings = LockedSettings(lock, call=self._source.call)
        self._tasks: set[asyncio.Task[None]] = set()

    async def close(self) -> None:
        """End what runs."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def begin(self) -> None:
        """Fetch the camera's definition beside everything else, so that a mission need not wait for it."""
        if self.wanted:
            self._spawn(self._source.defined(), "camera definition")

    def again(self) -> None:
        """Make the settings again, which a camera that restarted may have forgotten."""
        self._spawn(self._settings.again(self._source.call), "camera settings")

    def _spawn(self, work_to_do: Awaitable[object], what: str) -> None:
        async def run() -> None:
            try:
                await work_to_do
            except DeviceError as error:
                _log.warning("camera settings", doing=what, problem=str(error))

        task = asyncio.create_task(run(), name=what)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def prepare(self) -> str:
        """Make the settings that need no metering; returns what prevents that, "" if nothing does.

        Raises:
            DeviceError: the camera did not answer.
        """
        try:
            return await self._settings.prepare() if self.wanted else ""
        except NoSettingsError as error:
            return f"the settings of [camera.lock] cannot be made on this camera: {error}"

    async def restore(self) -> None:
        """Put back what was set; never raises."""
        with contextlib.suppress(DeviceError):
            await self._settings.restore()

    @property
    def needs_metering(self) -> bool:
        """See `MetersExposure.needs_metering`."""
        return self._settings.needs_metering

    async def meter(self, known: PhotoExif | None, trigger: Callable[[], Awaitable[PendingCapture]]) -> str:
        """See `MetersExposure.meter`: one photo as the camera meters it, whose settings are then kept.

        Raises:
            DeviceError: there is no such photo, or its settings cannot be kept.
        """
        if known is None:
            capture = await trigger()
            found = await capture.evidence(EvidenceLevel.CAPTURE_MESSAGE, METER_S)
            if found.level < EvidenceLevel.CAPTURE_MESSAGE or not found.file_url:
                raise DeviceError(f"the camera told no file of a photo to meter by within {METER_S:g} s")
            known = await self._exif(found.file_url)
        return await self._settings.keep(known)

    async def _exif(self, url: str) -> PhotoExif | None:
        """The EXIF of a photo that the camera serves, or that is in a folder of this computer.

        Raises:
            DeviceError: its file does not come here.
        """
        try:
            with work(self._link.clock):
                if urlsplit(url).scheme == "file":
                    return await self._local(url)
                served = served_file(
                    self._link, url, component=self._component(), max_bytes=MAX_BYTES, timeout_s=METER_S
                )
                async with served as path:
                    return await asyncio.to_thread(read_settings, path)
        except PhotoFileError as error:
            text = f'[camera.lock] exposure = "first" needs the file of one photo: {error}; or use exposure = "manual"'
            raise DeviceError(text) from error

    async def _local(self, url: str) -> PhotoExif | None:
        path = Path(unquote(urlsplit(url).path))
        try:
            async with asyncio.timeout(METER_S):
                while True:
                    known = await asyncio.to_thread(read_settings, path) if file_is_there(url) else None
                    if known is not None:
                        return known
                    await asyncio.sleep(_LOOK_S)
        except TimeoutError as error:
            raise PhotoFileError(f"{path}: not there after {METER_S:g} s") from error
