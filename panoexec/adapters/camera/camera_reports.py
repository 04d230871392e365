"""What a MAVLink camera tells of itself and its photos: reports, counts, its clock, its storage."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Sequence
from typing import Final

import structlog

from panoexec.adapters.camera.camera_clock import APART_S, ENOUGH_TRIPS, CameraClock
from panoexec.adapters.camera.camera_pace import CameraPace
from panoexec.adapters.camera.camera_round_trips import RoundTrips
from panoexec.adapters.camera.camera_storage import CameraStorage
from panoexec.adapters.camera.capture import Capture
from panoexec.adapters.camera.capture_matching import CaptureMatcher
from panoexec.adapters.camera.capture_messages import captured_report, feedback_report, file_is_there, px4_report
from panoexec.adapters.camera.deferral import Deferral
from panoexec.adapters.camera.mavlink_camera_found import MavlinkCameraFound
from panoexec.adapters.camera.photo_recall import CAPTURE_STATUS, IMAGE_CAPTURED
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.mavsdk_requests import REQUEST_MESSAGE
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.devices import EvidenceLevel
from panoexec.errors import DeviceError

_VAIN_TRIPS: Final = 3
"""So many requests in a row that prove nothing are enough to relate the clocks."""
_SPREAD_S: Final = (1.0, 1.0, 1.0, 1.0)
"""Pauses between the requests that follow those, which bound the rate of the camera's clock."""
_SYNCHRONISE_S: Final = 4.0
"""A stamp of the camera's clock that is older than this (mission seconds) is asked for anew at the next photo."""
_BOUND_S: Final = 1.0
"""After a report, a round trip is made if the last one is older: other stamps bound nothing."""
_AFTER_REPORT_S: Final = 0.25
"""It is made so much later: what a camera sends by itself after a photo has arrived."""

_log = structlog.get_logger(__name__)


class CameraReports:
    """Receives the messages of one camera and hands them to what learns from them.

    Attributes:
        found: the camera, once it was found; set by whoever looks for it.
        stamps: relates the camera's clock to the mission's.
        matcher: knows which report is of which trigger.
        deferral, pace, storage: what else is learned.
        heard_s: when the camera was heard last, real seconds.
        recalling: reports are sent on request, and are no new photos.
        on_restart: called on the loop when the camera's clock was stepped, as it is when a camera restarts.
    """

    def __init__(self, link: MavsdkLink, *, component: int, mib_per_image: float | None) -> None:
        """Create it; nothing is received before `subscribe`.

        Args:
            link: to the autopilot.
            component: as configured, 0 for any.
            mib_per_image: size of a photo; None: estimate it.
        """
        self.found: MavlinkCameraFound | None = None
        self.stamps = CameraClock()
        self.matcher = CaptureMatcher(self.stamps)
        self.deferral = Deferral(self.matcher)
        self.pace = CameraPace()
        self.storage = CameraStorage(mib_per_image=mib_per_image)
        self.heard_s = -math.inf
        self.recalling = False
        self.on_restart: Callable[[], None] = lambda: None
        self._link = link
        self._component = component
        self._last_index = -1
        self._synchronised_s = -math.inf
        self._answered_s = -math.inf
        self._bounding: asyncio.Task[None] | None = None
        self._trips = RoundTrips(link.clock, self._request_clock)

    def subscribe(self) -> list[Callable[[], None]]:
        """Receive messages; returns what ends that."""
        on = self._link.on
        return [
            on("CAMERA_IMAGE_CAPTURED", self._image_captured),
            on("CAMERA_FEEDBACK", self._feedback),
            on("CAMERA_CAPTURE_STATUS", self._capture_status),
            on("CAMERA_INFORMATION", self._stamped),
            on("STORAGE_INFORMATION", self._stored),
            on("COMMAND_ACK", self._acknowledged),
        ]

    @property
    def target(self) -> int:
        """Target component of commands: the autopilot for its own shutters."""
        return self.found.component if self.found is not None and not self.found.by_autopilot else AUTOPILOT

    @property
    def any_photo(self) -> bool:
        """Whether a photo was reported with its index."""
        return self._last_index >= 0

    async def synchronise(self) -> None:
        """Ask for a message that is stamped when it is sent, if the last one is old."""
        if self.target != AUTOPILOT and self._link.clock.monotonic() - self._synchronised_s > _SYNCHRONISE_S:
            await self._request_clock()

    async def _request_clock(self) -> int:
        return await self._link.requests.command(REQUEST_MESSAGE, [CAPTURE_STATUS], component=self.target)

    def _bound(self) -> None:
        """Make a round trip, so that the bounds of the clock stay narrow; after a report, when the count is no news."""
        if not self.stamps.trips or (self._bounding is not None and not self._bounding.done()):
            return  # nothing is bounded, or it is asked for
        if self.target != AUTOPILOT and self._link.clock.monotonic() - self._answered_s > _BOUND_S:
            self._bounding = asyncio.create_task(self._make_trips((_AFTER_REPORT_S,)), name="camera clock")

    async def _make_trips(self, pauses_s: Sequence[float]) -> None:
        for pause_s in pauses_s:
            await self._link.clock.sleep(pause_s)
            try:
                await self._make_trip()
            except DeviceError as error:
                _log.debug("camera clock request failed", error=str(error))

    async def _make_trip(self) -> bool:
        """Make a round trip; returns whether it proved something."""
        steps = self.stamps.steps
        trip = await self._trips.make()
        if trip is None or self.stamps.steps > steps:
            return False
        self._answered_s = trip.received_s
        self.stamps.note_trip(trip.stamp_s, trip.asked_s, trip.received_s)
        return True

    async def close(self) -> None:
        """Ask no more."""
        if self._bounding is not None:
            self._bounding.cancel()
            await asyncio.gather(self._bounding, return_exceptions=True)

    async def relate(self) -> None:
        """Relate the camera's clock to the mission's by as many round trips as are needed; before its first photo.

        Raises:
            DeviceError: the camera does not acknowledge a request, and has not before.
        """
        vain = 0
        for _ in range(ENOUGH_TRIPS + 2 * _VAIN_TRIPS):  # a clock that is stepped again and again is never related
            if self.stamps.trips >= ENOUGH_TRIPS or vain == _VAIN_TRIPS:
                break
            try:
                proven = await self._make_trip()
            except DeviceError:
                if not self.stamps.trips:
                    raise
                proven = False  # a camera that has answered: a request or its acknowledgement was lost
            vain = 0 if proven else vain + 1
        if self.stamps.trips and (self._bounding is None or self._bounding.done()):
            self._bounding = asyncio.create_task(self._make_trips(_SPREAD_S), name="camera clock")

    async def poll(self, capture: Capture) -> None:
        """Check for the file of a reported photo; else request the image count and a report that may have been lost.

        The first image has the index 0 by the protocol and 1 with some cameras. So the requested index is one more than
        the last reported one, or, before the first report, the image count minus one.
        """
        link, target = self._link, self.target
        if capture.known.level >= EvidenceLevel.CAPTURE_MESSAGE:
            if file_is_there(capture.known.file_url):
                capture.file_seen(link.clock.monotonic())
            return
        try:
            status = await link.requests.message(CAPTURE_STATUS, "CAMERA_CAPTURE_STATUS", component=target)
            if self.stamps.suspicious:
                await link.clock.sleep(APART_S)
                await link.requests.command(REQUEST_MESSAGE, [CAPTURE_STATUS], component=target)
        finally:
            self.matcher.redate(link.clock.monotonic())
        images = int(status.fields["image_count"])
        if target != AUTOPILOT and images > 0:
            index = self._last_index + 1 if self._last_index >= 0 else images - 1
            await link.requests.command(REQUEST_MESSAGE, [IMAGE_CAPTURED, index], component=target)

    # --- in MAVSDK's thread

    def _image_captured(self, message: MavMessage) -> None:
        if self._is_ours(message):
            own_trigger = self.found is not None and self.found.own_trigger
            self._link.post(self._report_feedback if own_trigger else self._report_captured, message)

    def _feedback(self, message: MavMessage) -> None:
        if message.component_id == AUTOPILOT:
            self._link.post(self._report_feedback, message)

    def _capture_status(self, message: MavMessage) -> None:
        if self._is_ours(message):
            self._stamped(message)
            self._link.post(self._trips.stamped, message.fields["time_boot_ms"] / 1000.0, message.received_s)
            self._link.post(self.matcher.counted, int(message.fields["image_count"]), message.received_s)

    def _acknowledged(self, message: MavMessage) -> None:
        if self._is_ours(message) and int(message.fields["command"]) == REQUEST_MESSAGE:
            self._link.post(self._trips.acknowledged, message.received_s)

    def _stamped(self, message: MavMessage) -> None:
        if self._is_ours(message):
            self.heard_s = time.monotonic()
            stamp_s = message.fields["time_boot_ms"] / 1000.0
            self._link.post(self._take_stamp, stamp_s, message.received_s)

    def _stored(self, message: MavMessage) -> None:
        if self._is_ours(message):
            self._stamped(message)
            self.storage.note(message)

    def _is_ours(self, message: MavMessage) -> bool:
        wanted = self.found.component if self.found is not None else self._component
        return wanted > 0 and message.component_id == (AUTOPILOT if wanted <= 6 else wanted)

    # --- on the loop

    def _take_stamp(self, stamp_s: float, received_s: float) -> None:
        """Relate the camera's clock to ours by a message that was stamped when it was sent."""
        steps = self.stamps.steps
        self._synchronised_s = received_s
        self.stamps.note(stamp_s, received_s)
        self.matcher.redate(self._link.clock.monotonic())
        if self.stamps.steps > steps:
            self.on_restart()

    def _report_captured(self, message: MavMessage) -> None:
        self.heard_s = time.monotonic()
        report = captured_report(message, self.stamps)
        self._last_index = max(self._last_index, report.index)
        if not self.recalling:  # messages sent on request are no new photos
            self.matcher.report(report)
            self._bound()

    def _report_feedback(self, message: MavMessage) -> None:
        if self.recalling:
            return
        self.deferral.reports += 1
        pin = self.found is not None and self.found.feedback_pin
        report = feedback_report(message, pin=pin) if message.name == "CAMERA_FEEDBACK" else px4_report(message)
        capture = self.matcher.report(report)
        if capture is not None:
            self.pace.triggered(report.exposed_s, capture.commanded_s)
