"""Requests the latest photos from a camera: those that an earlier process triggered.

Sources: MAVLink common.xml: MAV_CMD_REQUEST_MESSAGE (512) for CAMERA_IMAGE_CAPTURED (263) with the image index in
param2; CAMERA_CAPTURE_STATUS (262), whose image_count is the newest index plus one (some cameras count from 1).
ArduPilot sends its last CAMERA_FEEDBACK (180) again on request.
"""

from __future__ import annotations

import math
import time
from typing import Final

from panoexec.adapters.camera.camera_clock import CameraClock
from panoexec.adapters.camera.capture_messages import captured_report, feedback_report
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.devices import CaptureEvidence, RecalledPhoto, RecalledPhotos
from panoexec.errors import DeviceError, LinkError

CAPTURE_STATUS: Final = 262
IMAGE_CAPTURED: Final = 263
CAMERA_FEEDBACK: Final = 180
LAST_IMAGES: Final = 4
"""Number of images requested: more than can have been pending."""
_ANSWER_S: Final = 2.0
_ALL_S: Final = 4.0
"""How long (real seconds) images are asked for that do not come."""
_NO_CLOCK: Final = CameraClock()


async def recall_images(link: MavsdkLink, *, component: int) -> RecalledPhotos:
    """The last images of a camera with its own MAVLink component.

    Raises:
        DeviceError: it does not report its image count.
        LinkError: no link.
    """
    status = await link.requests.message(CAPTURE_STATUS, "CAMERA_CAPTURE_STATUS", component=component)
    count = int(status.fields["image_count"])
    photos: list[RecalledPhoto] = []
    deadline = time.monotonic() + _ALL_S
    for index in range(count, max(-1, count - LAST_IMAGES - 1), -1):  # the newest matter most
        if time.monotonic() > deadline:
            break
        try:
            message = await link.requests.message(
                IMAGE_CAPTURED,
                "CAMERA_IMAGE_CAPTURED",
                component=component,
                timeout_s=_ANSWER_S,
                index=index,
                fits=lambda found, wanted=index: int(found.fields["image_index"]) == wanted,  # type: ignore[misc]
            )
        except LinkError:
            raise
        except DeviceError:
            continue  # it has no image with this index
        report = captured_report(message, _NO_CLOCK)
        if report.success:
            photos.append(_recalled(link, report.evidence, status))
    return RecalledPhotos(photos=tuple(reversed(photos)), image_count=count)


async def recall_trigger(link: MavsdkLink, *, component: int, pin: bool) -> RecalledPhotos:
    """The last photo that an autopilot triggered, and its image count.

    Raises:
        DeviceError: it does not report its image count.
        LinkError: no link.
    """
    status = await link.requests.message(CAPTURE_STATUS, "CAMERA_CAPTURE_STATUS", component=component)
    count = int(status.fields["image_count"])
    try:
        message = await link.requests.message(
            CAMERA_FEEDBACK, "CAMERA_FEEDBACK", component=component, timeout_s=_ANSWER_S
        )
    except LinkError:
        raise
    except DeviceError:
        return RecalledPhotos(image_count=count)
    found = feedback_report(message, pin=pin).evidence
    return RecalledPhotos(photos=(_recalled(link, found, status),), image_count=count)


def _recalled(link: MavsdkLink, found: CaptureEvidence, status: MavMessage) -> RecalledPhoto:
    """The photo with its time on this machine's wall clock: by its age on the camera's boot clock, else as reported."""
    clock = link.clock
    age_s = status.fields["time_boot_ms"] / 1000.0 - found.exposed_vehicle_s
    answered_utc_s = clock.time() - (clock.monotonic() - status.received_s)
    # a stamp from before a reboot of the camera is invalid
    exposed_utc_s = answered_utc_s - age_s if age_s >= 0 else math.nan
    return RecalledPhoto(evidence=found, exposed_utc_s=found.time_utc_s if math.isnan(exposed_utc_s) else exposed_utc_s)
