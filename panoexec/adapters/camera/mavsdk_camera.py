"""A MAVLink camera: one with the camera protocol, or a shutter on the autopilot's servo or relay output."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from functools import partial
from types import TracebackType
from typing import Final, Self

import structlog
from mavsdk.plugins.camera import Camera, CameraList, Information

from panoexec.adapters.camera.camera_clock import CameraClock
from panoexec.adapters.camera.camera_kind import CameraKind, OpenCamera
from panoexec.adapters.camera.capture import Capture
from panoexec.adapters.camera.capture_matching import CaptureMatcher
from panoexec.adapters.camera.capture_messages import captured_report, feedback_report, file_is_there
from panoexec.adapters.camera.mavlink_camera_found import MavlinkCameraFound
from panoexec.adapters.camera.photo_recall import CAPTURE_STATUS, IMAGE_CAPTURED, recall_images, recall_trigger
from panoexec.adapters.gimbal.attitude_messages import number
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.mavsdk_requests import REQUEST_MESSAGE
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.clock import latest_s
from panoexec.devices import EvidenceLevel, PendingCapture, RecalledPhotos
from panoexec.errors import DeviceError
from panoexec.inputs.config import CameraSection

STORAGE_INFORMATION: Final = 261

_MAV_TYPE_CAMERA: Final = 30
_STORAGE_EMPTY, _STORAGE_UNFORMATTED, _STORAGE_READY = 0, 1, 2
_PREFER_S: Final = 2.5
_FIRST_REPORT_S: Final = 20.0
"""A camera that has not reported a photo by then does not report photos."""
_SYNCHRONISE_S: Final = 4.0
"""A stamp of the camera's clock that is older than this (mission seconds) is asked for anew at the next photo."""
_SILENT_S: Final = 15.0
_BYTES_PER_PX: Final = 0.6
"""Upper estimate for a high-quality JPEG: 14 MB for 24 megapixels."""

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
    ) -> None:
        """Create it; entering the context subscribes to messages.

        Args:
            link: to the autopilot, entered before and left after this.
            component: MAVLink component of the camera; 0: a camera that sends heartbeats, else the autopilot's.
            feedback_pin: whether CAMERA_FEEDBACK comes from a wired hot-shoe; None: read CAM1_FEEDBAK_PIN.
            mib_per_image: size of a photo; None: estimate it from the image's dimensions.
        """
        self._link = link
        self._component = component
        self._feedback_pin = feedback_pin
        self._mib_per_image = mib_per_image
        self._found: MavlinkCameraFound | None = None
        self._listed: dict[int, Information] = {}
        self._list_changed = asyncio.Event()
        self._stamps = CameraClock()
        self._matcher = CaptureMatcher(self._stamps)
        self._synchronised_s = -math.inf
        self._storages: dict[int, float] = {}
        self._numbers = 0
        self._last_index = -1
        self._first_trigger_s = math.nan
        self._heard_s = -math.inf
        self._triggering = asyncio.Lock()
        self._recalling = False
        self._off: list[Callable[[], None]] = []

    # --- state

    @property
    def found(self) -> MavlinkCameraFound | None:
        """What discovery found; None before."""
        return self._found

    @property
    def storage_free_images(self) -> float:
        """See `Camera.storage_free_images`."""
        if not self._storages:
            return math.inf
        found, size = self._found, self._mib_per_image
        if size is None:
            pixels = found.image_width_px * found.image_height_px if found is not None else 0
            size = pixels * _BYTES_PER_PX / 2**20
        free = sum(self._storages.values())
        if size <= 0:
            return math.inf if free > 0 else 0.0
        return float(math.floor(free / size))

    @property
    def surplus_photos(self) -> int:
        """Number of reported photos that panoexec did not trigger."""
        return self._matcher.foreign_photos

    @property
    def age_s(self) -> float:
        """Real seconds since the camera's last message; infinity before."""
        if self._found is not None and self._found.by_autopilot:
            return self._link.heartbeat_age_s
        beat = self._link.components.get(self._found.component if self._found else 0, (0, -math.inf))[1]
        return time.monotonic() - max(beat, self._heard_s)

    @property
    def is_present(self) -> bool:
        """See `OpenCamera.is_present`."""
        return self._found is not None and self.age_s < _SILENT_S

    # --- life

    async def __aenter__(self) -> Self:
        """Subscribe to messages."""
        on = self._link.on
        self._off = [
            on("CAMERA_IMAGE_CAPTURED", self._image_captured),
            on("CAMERA_FEEDBACK", self._feedback),
            on("CAMERA_CAPTURE_STATUS", self._capture_status),
            on("CAMERA_INFORMATION", self._stamped),
            on("STORAGE_INFORMATION", self._storage),
            self._link.when_attached(self._attach),
        ]
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Unsubscribe."""
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
        if self._found is not None:
            return self._found
        self._link.requests.plugin(Camera)
        try:
            async with asyncio.timeout(timeout_s):
                information = await self._choose()
        except TimeoutError as error:
            raise DeviceError(f"no camera within {timeout_s:g} s: {self._why_not_found()}") from error
        by_autopilot = information.component_id <= 6
        pin = self._feedback_pin
        if pin is None and by_autopilot and self._link.is_ardupilot:
            pin = (await self._link.requests.parameter("CAM1_FEEDBAK_PIN") or -1) > 0
        self._found = MavlinkCameraFound(
            component=information.component_id,
            vendor=information.vendor_name,
            model=information.model_name,
            image_width_px=information.horizontal_resolution_px,
            image_height_px=information.vertical_resolution_px,
            feedback_pin=bool(pin),
        )
        for message in (STORAGE_INFORMATION, CAPTURE_STATUS):
            with contextlib.suppress(DeviceError):  # then they are unknown
                await self._link.requests.command(REQUEST_MESSAGE, [message], component=self._target)
        _log.info("camera found", camera=self._found)
        return self._found

    async def best_evidence(self) -> EvidenceLevel:
        """See `OpenCamera.best_evidence`."""
        found = await self.discover()
        if not found.by_autopilot:
            return EvidenceLevel.CAPTURE_MESSAGE
        return EvidenceLevel.FEEDBACK_PIN if found.feedback_pin else EvidenceLevel.COUNTED

    async def trigger(self) -> PendingCapture:
        """See `Camera.trigger`."""
        found = await self.discover()
        take_photo = partial(self._link.requests.plugin(Camera).take_photo, found.component)
        clock = self._link.clock
        async with self._triggering:
            self._numbers += 1
            if math.isnan(self._first_trigger_s):
                self._first_trigger_s = clock.monotonic()
            capture = Capture(self._numbers, clock=clock, poll=self._poll_status, synchronise=self._synchronise)
            capture.commanded(clock.monotonic())
            self._matcher.enter(capture)

            def fire() -> float:
                capture.commanded(clock.monotonic())
                take_photo()
                return latest_s(clock)  # the camera's interval started before that

            try:
                acknowledged_s = await self._link.requests.mavsdk_call("taking a photo", fire)
            except DeviceError as error:
                if error.__cause__ is not None and "TIMEOUT" not in str(error.__cause__):
                    self._matcher.withdraw(capture)  # refused; without an answer a photo may still be taken
                raise
            capture.acknowledged(acknowledged_s)
            return capture

    @property
    def image_count(self) -> int:
        """See `PhotoRecall.image_count`."""
        return self._matcher.image_count

    @property
    def reports_photos(self) -> bool:
        """See `ReportsPhotos.reports_photos`: a camera of its own, unless its first photos came without a report."""
        if self._found is None or self._found.by_autopilot:
            return False
        unreported_s = self._link.clock.monotonic() - self._first_trigger_s
        return self._last_index >= 0 or not unreported_s > _FIRST_REPORT_S

    async def recall(self) -> RecalledPhotos:
        """See `PhotoRecall.recall`: for a mission that goes on, before it takes a photo of its own."""
        found = await self.discover()
        self._recalling = True
        try:
            if found.by_autopilot:
                return await recall_trigger(self._link, component=self._target, pin=found.feedback_pin)
            return await recall_images(self._link, component=self._target)
        finally:
            self._recalling = False

    # --- in MAVSDK's thread

    def _image_captured(self, message: MavMessage) -> None:
        if self._is_ours(message):
            self._link.post(self._report_captured, message)

    def _feedback(self, message: MavMessage) -> None:
        if message.component_id == AUTOPILOT:
            self._link.post(self._report_feedback, message)

    def _capture_status(self, message: MavMessage) -> None:
        if self._is_ours(message):
            self._stamped(message)
            self._link.post(self._matcher.counted, int(message.fields["image_count"]), message.received_s)

    def _stamped(self, message: MavMessage) -> None:
        if self._is_ours(message):
            self._heard_s = time.monotonic()
            self._link.post(self._take_stamp, message.fields["time_boot_ms"] / 1000.0, message.received_s)

    def _storage(self, message: MavMessage) -> None:
        if not self._is_ours(message):
            return
        self._stamped(message)
        fields = message.fields
        status, free = int(fields["status"]), number(fields["available_capacity"])
        storages = dict(self._storages)
        if status in (_STORAGE_EMPTY, _STORAGE_UNFORMATTED):
            storages[int(fields["storage_id"])] = 0.0
        elif status == _STORAGE_READY and math.isfinite(free):
            storages[int(fields["storage_id"])] = free
        self._storages = storages

    def _cameras_listed(self, cameras: CameraList, _user_data: object) -> None:
        listed = {camera.component_id: camera for camera in cameras.cameras}
        self._link.post(self._take_list, listed)

    def _is_ours(self, message: MavMessage) -> bool:
        wanted = self._found.component if self._found is not None else self._component
        return wanted > 0 and message.component_id == (AUTOPILOT if wanted <= 6 else wanted)

    # --- on the loop

    @property
    def _target(self) -> int:
        """Target component of commands: the autopilot for its own shutters."""
        return self._found.component if self._found is not None and not self._found.by_autopilot else AUTOPILOT

    def _attach(self) -> None:
        plugin = self._link.requests.plugin(Camera)
        handle = plugin.subscribe_camera_list(self._cameras_listed)
        self._off.append(partial(plugin.unsubscribe_camera_list, handle))

    def _take_list(self, listed: dict[int, Information]) -> None:
        self._listed = listed
        self._list_changed.set()

    async def _choose(self) -> Information:
        """The requested camera, or one with heartbeats; the autopilot's shutter if no other appears in `_PREFER_S`."""
        since = time.monotonic()
        while True:
            self._list_changed.clear()
            if self._component:
                if self._component in self._listed:
                    return self._listed[self._component]
            else:
                own = [camera for component, camera in sorted(self._listed.items()) if component > 6]
                if own:
                    return own[0]
                beats = any(kind == _MAV_TYPE_CAMERA for kind, _ in self._link.components.values())
                if self._listed and not beats and time.monotonic() - since > _PREFER_S:
                    return next(iter(self._listed.values()))
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.25):
                    await self._list_changed.wait()

    def _take_stamp(self, stamp_s: float, received_s: float) -> None:
        """Relate the camera's clock to ours by a message that was stamped when it was sent."""
        self._synchronised_s = received_s
        self._stamps.note(stamp_s, received_s)
        self._matcher.redate(self._link.clock.monotonic())

    async def _synchronise(self) -> None:
        """Ask for a message that is stamped when it is sent, if the last one is old."""
        target, now_s = self._target, self._link.clock.monotonic()
        if target != AUTOPILOT and now_s - self._synchronised_s > _SYNCHRONISE_S:
            await self._link.requests.command(REQUEST_MESSAGE, [CAPTURE_STATUS], component=target)

    def _report_captured(self, message: MavMessage) -> None:
        self._heard_s = time.monotonic()
        report = captured_report(message, self._stamps)
        self._last_index = max(self._last_index, report.index)
        if not self._recalling:  # messages sent on request are no new photos
            self._matcher.report(report)

    def _report_feedback(self, message: MavMessage) -> None:
        if self._recalling:
            return
        self._matcher.report(feedback_report(message, pin=self._found is not None and self._found.feedback_pin))

    async def _poll_status(self, capture: Capture) -> None:
        """Check for the file of a reported photo; else request the image count and a report that may have been lost.

        The first image has the index 0 by the protocol and 1 with some cameras. So the requested index is one more than
        the last reported one, or, before the first report, the image count minus one.
        """
        link, target = self._link, self._target
        if capture.known.level >= EvidenceLevel.CAPTURE_MESSAGE:
            if file_is_there(capture.known.file_url):
                capture.file_seen(link.clock.monotonic())
            return
        try:
            status = await link.requests.message(CAPTURE_STATUS, "CAMERA_CAPTURE_STATUS", component=target)
            if self._stamps.suspicious:
                await link.requests.command(REQUEST_MESSAGE, [CAPTURE_STATUS], component=target)
        finally:
            self._matcher.redate(link.clock.monotonic())
        images = int(status.fields["image_count"])
        if target != AUTOPILOT and images > 0:
            index = self._last_index + 1 if self._last_index >= 0 else images - 1
            await link.requests.command(REQUEST_MESSAGE, [IMAGE_CAPTURED, index], component=target)

    def _why_not_found(self) -> str:
        if not self._link.connected:
            return "no heartbeat from the autopilot"
        seen = ", ".join(str(component) for component in sorted(self._listed)) or "none"
        if self._component and self._listed:
            return f"component {self._component} is configured, but MAVSDK found: {seen}"
        beating = [component for component, (kind, _) in self._link.components.items() if kind == _MAV_TYPE_CAMERA]
        foreign = self._link.identity.foreign(_MAV_TYPE_CAMERA, "camera")
        if foreign and not beating:
            return foreign
        if beating:
            return f"component {beating[0]} sends camera heartbeats but no CAMERA_INFORMATION (259) on request"
        return (
            "no component answers requests for CAMERA_INFORMATION (259); camera on a servo or relay: set CAM1_TYPE "
            "(ArduPilot) and reboot; MAVLink camera: is it on, and does the autopilot forward its messages?"
        )


def _open(section: CameraSection, link: MavsdkLink) -> AbstractAsyncContextManager[OpenCamera]:
    return MavsdkCamera(link, component=section.component)


KIND: Final = CameraKind(
    open=_open, needed="a camera that answers", settings="[camera] component", set_by_autopilot=True
)
