"""A MAVLink camera: one with the camera protocol, or a shutter on the autopilot's servo or relay output."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import structlog
from mavsdk.plugins.camera import Camera

from panoexec.adapters.camera.camera_choice import CAPTURES_VIDEO, HAS_MODES, CameraCandidate
from panoexec.adapters.camera.camera_discovery import CameraDiscovery
from panoexec.adapters.camera.camera_kind import CameraKind, OpenCamera
from panoexec.adapters.camera.camera_reports import CameraReports
from panoexec.adapters.camera.capture import Capture
from panoexec.adapters.camera.deferral import has_feedback_pin, least_interval_s
from panoexec.adapters.camera.mavlink_camera_found import MavlinkCameraFound
from panoexec.adapters.camera.photo_mode import PhotoMode
from panoexec.adapters.camera.photo_recall import CAPTURE_STATUS, recall_images, recall_trigger
from panoexec.adapters.camera.settings.mavlink_lock import MavlinkLock
from panoexec.adapters.link.mavsdk_errors import MAV_RESULTS
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.mavsdk_requests import REQUEST_MESSAGE
from panoexec.clock import latest_s
from panoexec.devices import EvidenceLevel, PendingCapture, RecalledPhotos
from panoexec.errors import DeviceError, PanoexecError
from panoexec.formats.photo_settings import PhotoExif
from panoexec.inputs.camera_profiles import load_profile
from panoexec.inputs.vehicle_sections import CameraSection, LockSection

STORAGE_INFORMATION: Final = 261

DO_DIGICAM_CONTROL: Final = 203

_FIRST_REPORT_S: Final = 20.0
"""A camera that has not reported a photo by then does not report photos."""
_SILENT_S: Final = 15.0
_MODE_AGAIN_S: Final = 5.0
_TOLD_BY_TABLE: Final = ("siyi",)
"""Vendors for whose cameras the autopilot tells a focal length from a table: ArduPilot (AP_Mount_Siyi) tells the 35 mm
equivalent of some models, and of the others the wide end, whatever the zoom."""

_log = structlog.get_logger(__name__)


class MavsdkCamera:
    """Implements `OpenCamera`; an async context manager on an open link.

    Evidence is read from MAVLink messages: MAVSDK's `capture_info` does not work with ArduPilot, has no boot time, and
    stops when a camera counts from 1 again.
    """

    def __init__(
        self,
        link: MavsdkLink,
        *,
        component: int = 0,
        feedback_pin: bool | None = None,
        mib_per_image: float | None = None,
        image_px: tuple[int, int] | None = None,
        lock: LockSection | None = None,
    ) -> None:
        """Create it; entering the context subscribes to messages.

        Args:
            link: to the autopilot, entered before and left after this.
            component: MAVLink component of the camera; 0: see `camera_choice.choose`.
            feedback_pin: whether CAMERA_FEEDBACK comes from a wired hot-shoe; None: read CAM1_FEEDBAK_PIN.
            mib_per_image: size of a photo; None: estimate it from the image's dimensions.
            image_px: image size of the profile, by which one of several cameras is chosen.
            lock: settings that must not change within a panorama; None: none.
        """
        self._link = link
        self._component = component
        self._feedback_pin = feedback_pin
        self._discovery = CameraDiscovery(link, component=component, image_px=image_px)
        self._mode: PhotoMode | None = None
        self._mode_checked_s = -math.inf
        self._prepared = False
        self._reports = CameraReports(link, component=component, mib_per_image=mib_per_image)
        self._reports.on_restart = self._restarted
        self._lock = MavlinkLock(lock or LockSection(), link, component=lambda: self._reports.target)
        self._numbers = 0
        self._first_trigger_s = math.nan
        self._triggering = asyncio.Lock()
        self._off: list[Callable[[], None]] = []

    # --- state

    @property
    def found(self) -> MavlinkCameraFound | None:
        """What discovery found; None before."""
        return self._reports.found

    @property
    def storage_free_images(self) -> float:
        """See `Camera.storage_free_images`."""
        found = self._reports.found
        return self._reports.storage.free_images(0 if found is None else found.image_width_px * found.image_height_px)

    @property
    def surplus_photos(self) -> int:
        """Number of reported photos that panoexec did not trigger."""
        return self._reports.matcher.foreign_photos

    @property
    def age_s(self) -> float:
        """Real seconds since the camera's last message; infinity before."""
        if self._reports.found is not None and self._reports.found.by_autopilot:
            return self._link.heartbeat_age_s
        beat = self._link.components.get(self._reports.found.component if self._reports.found else 0, (0, -math.inf))[1]
        return time.monotonic() - max(beat, self._reports.heard_s)

    @property
    def is_present(self) -> bool:
        """See `OpenCamera.is_present`."""
        return self._reports.found is not None and self.age_s < _SILENT_S

    # --- life

    async def __aenter__(self) -> Self:
        """Subscribe to messages."""
        self._off = [*self._reports.subscribe(), *self._discovery.subscribe()]
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Unsubscribe."""
        await self._lock.close()
        await self._reports.close()
        for off in self._off:
            off()

    async def discover(self, timeout_s: float = 15.0) -> MavlinkCameraFound:
        """Return when the camera is there.

        Args:
            timeout_s: real seconds.

        Raises:
            DeviceError: no camera; the message says what is missing.
            LinkError: no autopilot.
        """
        if self._reports.found is not None:
            return self._reports.found
        self._link.requests.plugin(Camera)
        try:
            async with asyncio.timeout(timeout_s):
                choice = await self._discovery.choose()
        except TimeoutError as error:
            raise self._discovery.none_found(timeout_s) from error
        camera = choice.camera
        own_trigger = camera.by_autopilot and not self._link.is_ardupilot and not camera.flags
        found = MavlinkCameraFound(
            component=camera.component,
            vendor=camera.vendor,
            model=camera.model,
            image_width_px=camera.image_width_px,
            image_height_px=camera.image_height_px,
            focal_length_mm=camera.focal_length_mm,
            feedback_pin=camera.by_autopilot and await self._has_pin(own_trigger=own_trigger),
            own_trigger=own_trigger,
            why=choice.reason,
        )
        if found.by_autopilot:
            self._reports.deferral.by_autopilot = True
            self._reports.deferral.told_s = await least_interval_s(self._link, own_trigger=own_trigger)
            self._reports.pace.told(self._reports.deferral.told_s or 0.0)
        elif camera.flags & (HAS_MODES | CAPTURES_VIDEO):
            self._mode = PhotoMode(self._link, camera.component)
            await self._mode.read()
        self._reports.found = found
        if not own_trigger:
            for message in (STORAGE_INFORMATION, CAPTURE_STATUS):
                with contextlib.suppress(DeviceError):  # then they are unknown
                    await self._link.requests.command(REQUEST_MESSAGE, [message], component=self._reports.target)
        if not found.by_autopilot:
            self._lock.begin()
        others = [one.summary for one in self._discovery.candidates if one.component != found.component]
        _log.info("camera found", camera=found, others=others)
        return found

    async def _has_pin(self, *, own_trigger: bool) -> bool:
        if self._feedback_pin is not None:
            return self._feedback_pin
        return await has_feedback_pin(self._link, own_trigger=own_trigger)

    async def best_evidence(self) -> EvidenceLevel:
        """See `OpenCamera.best_evidence`."""
        found = await self.discover()
        if not found.by_autopilot:
            return EvidenceLevel.CAPTURE_MESSAGE
        return EvidenceLevel.FEEDBACK_PIN if found.feedback_pin else EvidenceLevel.COUNTED

    async def trigger(self) -> PendingCapture:
        """See `Camera.trigger`. A trigger that was refused or not answered, but deferred, returns when it is done."""
        found = await self.discover()
        clock = self._link.clock
        async with self._triggering:
            self._numbers += 1
            if math.isnan(self._first_trigger_s):
                self._first_trigger_s = clock.monotonic()
            capture = Capture(
                self._numbers,
                clock=clock,
                poll=None if found.own_trigger else self._reports.poll,
                synchronise=self._reports.synchronise,
                defer_s=self._reports.deferral.may_defer_s(
                    is_first=self._numbers == 1, clock_is_related=self._reports.stamps.related
                ),
                must_report=self._reports.deferral.must_report,
            )
            capture.commanded(clock.monotonic())
            self._reports.matcher.enter(capture)
            try:
                capture.acknowledged(await self._fire(capture, found))
            except DeviceError as error:
                # without an answer a photo may still be taken
                refused = error.__cause__ is not None and "TIMEOUT" not in str(error.__cause__)
                if not await self._is_done_later(capture):
                    if refused:
                        await self._refused(capture)
                    raise
            self._reports.pace.accepted(capture.commanded_s)
            return capture

    async def _fire(self, capture: Capture, found: MavlinkCameraFound) -> float:
        """Send the trigger; returns when it was acknowledged."""
        clock = self._link.clock
        if found.own_trigger:
            capture.commanded(clock.monotonic())
            result = await self._link.requests.command(DO_DIGICAM_CONTROL, [0, 0, 0, 0, 1])
            if result != 0:
                text = f"taking a photo (203): {MAV_RESULTS.get(result, result)}"
                raise DeviceError(text) from DeviceError(text)
            return clock.monotonic()
        take_photo = partial(self._link.requests.plugin(Camera).take_photo, found.component)

        def fire() -> float:
            capture.commanded(clock.monotonic())
            take_photo()
            return latest_s(clock)  # the camera's interval started before that

        return await self._link.requests.mavsdk_call("taking a photo", fire)

    async def _is_done_later(self, capture: Capture) -> bool:
        """Whether a trigger without an acceptance took its photo all the same, for which nothing may move meanwhile."""
        if capture.defer_s <= 0:
            return False
        await capture.fired()
        if capture.is_reported:
            _log.info("a trigger that was not accepted was carried out later", number=capture.number)
            return True
        self._reports.deferral.vain_waits += 1
        return False

    async def _refused(self, capture: Capture) -> None:
        """Learn from a refusal: too soon, or not in photo mode (a camera that restarted in flight forgets it)."""
        self._reports.matcher.withdraw(capture)
        self._reports.pace.refused(capture.commanded_s)
        now_s = self._link.clock.monotonic()
        if self._mode is not None and self._prepared and now_s - self._mode_checked_s > _MODE_AGAIN_S:
            self._mode_checked_s = now_s
            with contextlib.suppress(DeviceError):
                await self._mode.ensure()

    # --- what a mission needs to know of it

    @property
    def candidates(self) -> list[CameraCandidate]:
        """All cameras that were found, with what they can do."""
        return self._discovery.candidates

    @property
    def mode(self) -> PhotoMode | None:
        """The camera's mode; None if it has none."""
        return self._mode

    @property
    def focal_length_mm(self) -> float:
        """See `TellsLens.focal_length_mm`: CAMERA_INFORMATION."""
        found = self._reports.found
        if found is None or (found.by_autopilot and found.vendor.lower() in _TOLD_BY_TABLE):
            return math.nan
        return found.focal_length_mm

    @property
    def interval_s(self) -> float:
        """See `PacesPhotos.interval_s`."""
        return self._reports.pace.interval_s

    @property
    def ready_s(self) -> float:
        """See `PacesPhotos.ready_s`."""
        return self._reports.pace.ready_s

    async def prepare(self) -> str:
        """See `PreparesForPhotos.prepare`: photo mode, and the settings that must not change."""
        found = await self.discover()
        self._prepared = True
        problem = "" if self._mode is None else await self._mode.ensure()
        if not found.by_autopilot:
            with contextlib.suppress(DeviceError):  # then its dates are less exact
                await self._reports.relate()
        if not problem and self._lock.wanted and found.by_autopilot:
            return "a shutter of the autopilot has no settings: [camera.lock] cannot be made on it"
        return problem or await self._lock.prepare()

    async def restore(self) -> None:
        """See `PreparesForPhotos.restore`."""
        self._prepared = False
        await self._lock.restore()
        if self._mode is not None:
            await self._mode.restore()

    def _restarted(self) -> None:
        """A camera that restarts may forget its settings; what it took meanwhile is told by the EXIF of its photos."""
        if self._prepared:
            self._lock.again()

    @property
    def needs_metering(self) -> bool:
        """See `MetersExposure.needs_metering`."""
        return self._lock.needs_metering

    async def meter(self, known: PhotoExif | None) -> str:
        """See `MetersExposure.meter`."""
        return await self._lock.meter(known, self.trigger)

    @property
    def image_count(self) -> int:
        """See `PhotoRecall.image_count`."""
        return self._reports.matcher.image_count

    @property
    def reports_photos(self) -> bool:
        """See `ReportsPhotos.reports_photos`: a camera of its own, unless its first photos came without a report."""
        if self._reports.found is None or self._reports.found.by_autopilot:
            return False
        unreported_s = self._link.clock.monotonic() - self._first_trigger_s
        return self._reports.any_photo or not unreported_s > _FIRST_REPORT_S

    async def recall(self) -> RecalledPhotos:
        """See `PhotoRecall.recall`: for a mission that goes on, before it takes a photo of its own."""
        found = await self.discover()
        self._reports.recalling = True
        try:
            if found.by_autopilot:
                return await recall_trigger(self._link, component=self._reports.target, pin=found.feedback_pin)
            return await recall_images(self._link, component=self._reports.target)
        finally:
            self._reports.recalling = False


def _open(section: CameraSection, link: MavsdkLink, spool: Path | None) -> AbstractAsyncContextManager[OpenCamera]:
    del spool  # nothing comes over its link but messages
    image_px = None
    with contextlib.suppress(PanoexecError):  # a bad profile is reported where it is needed
        camera = load_profile(section.profile, focal_length_mm=section.focal_length_mm).camera
        image_px = (camera.image_width_px, camera.image_height_px)
    return MavsdkCamera(link, component=section.component, image_px=image_px, lock=section.lock)


KIND: Final = CameraKind(
    open=_open, needed="a camera that answers", settings="[camera] component", set_by_autopilot=True
)
