"""A camera on a USB cable or on a network, by libgphoto2: trigger, photos and files, whatever happens to the cable.

The process that holds the camera (`process`) is started anew whenever the camera was unplugged, restarted or hung. What
a trigger then brought is settled by what the camera lists (`photos`). Nothing is ever changed on the camera's card.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import math
import tempfile
import time
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import structlog

from panoexec.adapters.camera.camera_kind import CameraKind, OpenCamera
from panoexec.adapters.camera.capture import Capture
from panoexec.adapters.camera.settings.locked_settings import LockedSettings
from panoexec.adapters.camera.tethered.files import PhotoFiles
from panoexec.adapters.camera.tethered.holder import CameraHolder
from panoexec.adapters.camera.tethered.patience import Patience
from panoexec.adapters.camera.tethered.photos import SCHEME, Photo
from panoexec.adapters.camera.tethered.triggers import Triggers
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import Clock
from panoexec.devices import EvidenceLevel, PendingCapture, RecalledPhotos
from panoexec.errors import DependencyError, DeviceError, PhotoFileError, to_install
from panoexec.formats.photo_settings import PhotoExif, read_settings
from panoexec.inputs.vehicle_sections import CameraSection, LockSection

METER_S: Final = 15.0
"""How long the photo by which the exposure is metered may take."""
_LISTED_S: Final = 1.0
"""How long a listing usually takes."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class TetheredFound:
    """What is known of a tethered camera; implements `CameraFound`."""

    label: str
    model: str = ""
    is_two_way: bool = True
    why: str = ""
    may_tell_files: bool = True
    image_width_px: int = 0
    image_height_px: int = 0


class TetheredCamera:
    """Implements `OpenCamera`; an async context manager."""

    def __init__(
        self,
        *,
        clock: Clock,
        port: str = "",
        model: str = "",
        spool: Path | None = None,
        lock: LockSection | None = None,
        patience: Patience | None = None,
    ) -> None:
        """Create it; entering the context starts its process.

        Args:
            clock: of the mission.
            port: `usb:…`, `ptpip:HOST`, or "" for the only camera on USB.
            model: as libgphoto2 names it, or a part of it; "" for any.
            spool: folder for files that no mission has taken yet; None: a temporary one.
            lock: settings that must not change within a panorama; None: none.
            patience: None: as usual.
        """
        self._patience = patience or Patience()
        self._clock = clock
        self._holder = CameraHolder(
            port,
            model,
            patience=self._patience,
            on_event=self._told,
            on_opened=self._was_opened,
            prepare=self._prepared,
        )
        self.settings = LockedSettings(lock or LockSection(), call=self._holder.call)
        self._wanted_spool = spool
        self._spool = Path()
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._triggers = Triggers(
            self._holder,
            clock=clock,
            patience=self._patience,
            want=self._want,
        )
        self.book = self._triggers.book
        self._storage: list[dict[str, Any]] = []
        self._heard_s = -math.inf
        self._tasks: list[asyncio.Task[None]] = []
        self._files: PhotoFiles | None = None

    # --- life

    async def __aenter__(self) -> Self:
        """Start looking for the camera.

        Raises:
            DependencyError: libgphoto2's Python binding is not installed.
            DeviceError: the spool cannot be made.
        """
        if importlib.util.find_spec("gphoto2") is None:
            raise DependencyError(f'trigger = "gphoto2" needs libgphoto2: {to_install("gphoto2")}')
        try:
            if self._wanted_spool is None:
                self._temporary = tempfile.TemporaryDirectory(prefix="panoexec-camera-")
                self._spool = Path(self._temporary.name)
            else:
                self._wanted_spool.mkdir(parents=True, exist_ok=True)
                self._spool = self._wanted_spool
        except OSError as error:
            raise DeviceError(f"{self._wanted_spool}: no folder for the camera's files ({error.strerror})") from error
        self._files = PhotoFiles(self._spool, clock=self._clock, call=self._holder.call, opened=self._holder.opened)
        self._files.clear()
        self._tasks = [
            asyncio.create_task(self._holder.run(), name="tethered camera"),
            asyncio.create_task(self._files.run(), name="files of the tethered camera"),
        ]
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close the camera; files that were not fetched stay in it."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._triggers.close()
        await self._holder.close()
        self.files.clear()
        if self._temporary is not None:
            self._temporary.cleanup()

    async def _prepared(self, call: Callable[..., Awaitable[Any]]) -> None:
        """Make the settings again: a camera that was switched off may have forgotten them."""
        await self.settings.again(call)

    def _was_opened(self, files: list[tuple[str, str]], storage: list[dict[str, Any]], again: bool) -> None:
        self._storage = storage
        self._heard_s = time.monotonic()
        self._triggers.opened(files, again=again)

    # --- what a mission needs to know of it

    @property
    def files(self) -> PhotoFiles:
        """The files of its photos; only while the context is entered."""
        assert self._files is not None
        return self._files

    @property
    def problem(self) -> str:
        """Why the camera cannot be used now; "" if it can."""
        return self._holder.problem

    @property
    def restarts(self) -> int:
        """How often the camera had to be opened anew."""
        return max(0, self._holder.restarts)

    @property
    def process_id(self) -> int:
        """Of the process that holds the camera; 0 without one."""
        return self._holder.process_id

    @property
    def storage_free_images(self) -> float:
        """See `Camera.storage_free_images`."""
        if not self._storage or any(one["free_images"] < 0 for one in self._storage):
            return math.inf
        return float(sum(0 if one["read_only"] else one["free_images"] for one in self._storage))

    @property
    def surplus_photos(self) -> int:
        """Photos in the camera that no trigger of ours can claim."""
        return len(self.book.surplus)

    @property
    def is_present(self) -> bool:
        """See `OpenCamera.is_present`."""
        return self._holder.opened.is_set()

    @property
    def age_s(self) -> float:
        """See `OpenCamera.age_s`."""
        return time.monotonic() - self._heard_s

    @property
    def reports_photos(self) -> bool:
        """See `ReportsPhotos.reports_photos`."""
        return True

    @property
    def undated_hold_s(self) -> float:
        """See `ReportsUndated.undated_hold_s`: until a listing shows the photo whose event was lost."""
        return self._patience.missing_s + _LISTED_S

    @property
    def interval_s(self) -> float:
        """See `PacesPhotos.interval_s`; a camera refuses what comes too early."""
        return 0.0

    @property
    def ready_s(self) -> float:
        """See `PacesPhotos.ready_s`: not while the photo of a trigger that brought none may still come."""
        return self.book.doubt_until_s(self._clock.monotonic())

    @property
    def image_count(self) -> int:
        """See `PhotoRecall.image_count`."""
        return self.book.count if self._holder.opened.is_set() and not self.book.waiting else -1

    async def recall(self) -> RecalledPhotos:
        """See `PhotoRecall.recall`: the camera cannot tell when its photos were taken, but how many it has.

        Raises:
            DeviceError: it did not answer.
        """
        await self.discover(self._patience.back_s)
        await self._triggers.look()
        return RecalledPhotos(image_count=self.book.count)

    async def discover(self, timeout_s: float = 15.0) -> TetheredFound:
        """See `OpenCamera.discover`.

        Raises:
            DeviceError: no camera; says why.
        """
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._holder.opened.wait()
        if not self._holder.opened.is_set():
            raise DeviceError(f"no camera within {timeout_s:g} s: {self.problem}")
        about = self._holder.about
        return TetheredFound(label=f"{about['model']} on {about['port']}", model=about["model"])

    async def best_evidence(self) -> EvidenceLevel:
        """See `OpenCamera.best_evidence`."""
        return EvidenceLevel.FILE_SEEN

    async def prepare(self) -> str:
        """See `PreparesForPhotos.prepare`: a card that takes photos."""
        await self.discover(self._patience.back_s)
        if not self._storage:
            return "the camera has no card: put one in"
        if all(one["read_only"] for one in self._storage):
            return "the camera's card is write-protected: slide its lock"
        return await self.settings.prepare()

    async def restore(self) -> None:
        """See `PreparesForPhotos.restore`: the settings that were locked."""
        with contextlib.suppress(DeviceError):
            await self.settings.restore()

    @property
    def focal_length_mm(self) -> float:
        """See `TellsLens.focal_length_mm`."""
        return self.settings.focal_length_mm

    @property
    def needs_metering(self) -> bool:
        """See `MetersExposure.needs_metering`."""
        return self.settings.needs_metering

    async def meter(self, known: PhotoExif | None) -> str:
        """See `MetersExposure.meter`: one photo as the camera meters it, whose settings are then kept.

        Raises:
            DeviceError: there is no such photo, or its settings cannot be kept.
        """
        if known is None:
            capture = await self.trigger()
            found = await capture.evidence(EvidenceLevel.FILE_SEEN, METER_S)
            file = self.files.here(found.file_url)
            if found.level < EvidenceLevel.FILE_SEEN or file is None:
                raise DeviceError(f"no photo to meter by within {METER_S:g} s")
            known = await asyncio.to_thread(read_settings, file)
        return await self.settings.keep(known)

    def _want(self, photo: Photo, capture: Capture) -> None:
        self.files.want(photo, capture)

    async def trigger(self) -> PendingCapture:
        """See `Camera.trigger`; not before it is settled what earlier triggers brought."""
        return await self._triggers.trigger()

    def _told(self, event: dict[str, Any]) -> None:
        """An event of the camera."""
        self._heard_s = time.monotonic()
        if event["event"] == "alive":
            self._storage = event["storage"]
        elif event["event"] == "added":
            self._triggers.added([(event["folder"], event["name"])])

    # --- `PhotoFetcher`

    source = "gphoto2"

    def takes(self, url: str) -> bool:
        """See `PhotoFetcher.takes`."""
        return url.startswith(SCHEME)

    async def fetch(self, url: str, part: Path) -> Path:
        """See `PhotoFetcher.fetch`: usually the file is here already.

        Raises:
            PhotoFileError: the camera is not there, or has no such file.
        """
        if not self._holder.opened.is_set():
            raise PhotoFileError(f"the camera is not there: {self.problem}")
        photo = self.book.find(url)
        if photo is None:
            raise PhotoFileError(f"{url.removeprefix(SCHEME)} is not in the camera", final=True)
        return await self.files.take(photo, part)


def _open(section: CameraSection, link: MavsdkLink, spool: Path | None) -> AbstractAsyncContextManager[OpenCamera]:
    return TetheredCamera(
        clock=link.clock, port=section.port or "", model=section.model or "", spool=spool, lock=section.lock
    )


KIND: Final = CameraKind(
    open=_open,
    needed="a camera that libgphoto2 can hold",
    settings="[camera] port, model; systemd/gphoto2.conf for the service",
)
