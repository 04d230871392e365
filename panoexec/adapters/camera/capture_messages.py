"""Converts MAVLink camera messages to reports for `CaptureMatcher`. Pure, except for a check for the file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from panoexec.adapters.camera.camera_clock import CameraClock
from panoexec.adapters.camera.capture import Report, Source, dated
from panoexec.adapters.gimbal.attitude_messages import number
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.devices import CaptureEvidence, EvidenceLevel

_UTC_FROM_S: Final = 1e9


_FEEDBACK_DELAY_S: Final = 0.1
"""Transport delay of CAMERA_FEEDBACK, whose arrival dates the photo."""


def captured_report(message: MavMessage, clock: CameraClock) -> Report:
    """From CAMERA_IMAGE_CAPTURED (263); `clock` relates the camera's boot time to the mission's clock."""
    fields = message.fields
    boot_s = fields["time_boot_ms"] / 1000.0 or math.nan
    url = str(fields["file_url"]).rstrip("\0")
    latitude_deg, longitude_deg, altitude_m = _position(fields["lat"], fields["lon"], number(fields["alt"]) / 1e3)
    report = Report(
        source=Source.CAPTURED,
        success=int(fields["capture_result"]) == 1,
        evidence=CaptureEvidence(
            level=EvidenceLevel.FILE_SEEN if file_is_there(url) else EvidenceLevel.CAPTURE_MESSAGE,
            received_s=message.received_s,
            reported_s=message.received_s,
            exposed_vehicle_s=boot_s,
            opened_s=clock.bounds(boot_s, message.received_s),
            image_index=int(fields["image_index"]),
            file_url=url,
            time_utc_s=_utc_s(fields["time_utc"]),
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_m=altitude_m,
        ),
    )
    return dated(report, *clock.date(boot_s, message.received_s))


def feedback_report(message: MavMessage, *, pin: bool) -> Report:
    """From CAMERA_FEEDBACK (180), sent at the trigger or at the pin's signal: its arrival is the exposure time.

    Args:
        message: from the autopilot.
        pin: whether a hot-shoe is wired to the autopilot (CAM1_FEEDBAK_PIN); otherwise it only reports the trigger.
    """
    fields = message.fields
    stamp_us = int(fields["time_usec"])
    latitude_deg, longitude_deg, altitude_m = _position(fields["lat"], fields["lng"], number(fields["alt_msl"]))
    return Report(
        source=Source.FEEDBACK,
        exposed_s=message.received_s,
        evidence=CaptureEvidence(
            level=EvidenceLevel.FEEDBACK_PIN if pin else EvidenceLevel.COUNTED,
            received_s=message.received_s,
            # ArduPilot stamps a pin's signal with 32-bit microseconds since boot, a trigger with UTC
            exposed_vehicle_s=stamp_us / 1e6 if 0 < stamp_us < 2**32 else math.nan,
            image_index=int(fields["img_idx"]),
            exposed_s=message.received_s,
            exposed_error_s=_FEEDBACK_DELAY_S,
            time_utc_s=_utc_s(stamp_us),
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_m=altitude_m,
        ),
    )


def px4_report(message: MavMessage) -> Report:
    """From CAMERA_IMAGE_CAPTURED (263) of PX4 itself, for its own trigger: its arrival is the exposure time.

    The result is 1 with a wired hot-shoe (CAM_CAP_FBACK), and -1, unknown, without one.
    """
    fields, result = message.fields, int(message.fields["capture_result"])
    latitude_deg, longitude_deg, altitude_m = _position(fields["lat"], fields["lon"], number(fields["alt"]) / 1e3)
    return Report(
        source=Source.FEEDBACK,
        exposed_s=message.received_s,
        success=result != 0,
        evidence=CaptureEvidence(
            level=EvidenceLevel.FEEDBACK_PIN if result == 1 else EvidenceLevel.COUNTED,
            received_s=message.received_s,
            image_index=int(fields["image_index"]),
            exposed_s=message.received_s,
            exposed_error_s=_FEEDBACK_DELAY_S,
            time_utc_s=_utc_s(fields["time_utc"]),
            latitude_deg=latitude_deg,
            longitude_deg=longitude_deg,
            altitude_m=altitude_m,
        ),
    )


def file_is_there(url: str) -> bool:
    """Whether a URL names a file on this machine that exists and is not empty."""
    parts = urlsplit(url)
    if parts.scheme != "file" or parts.netloc not in ("", "localhost"):
        return False
    try:
        return Path(unquote(parts.path)).stat().st_size > 0
    except OSError:
        return False


def _utc_s(stamp_us: Any) -> float:
    seconds = number(stamp_us) / 1e6
    return seconds if seconds > _UTC_FROM_S else math.nan


def _position(latitude_1e7: int, longitude_1e7: int, altitude_m: float) -> tuple[float, float, float]:
    """Latitude, longitude, altitude of a report; NaN for 0/0, which senders without a GNSS fix send."""
    if latitude_1e7 == longitude_1e7 == 0:
        return math.nan, math.nan, math.nan
    return latitude_1e7 / 1e7, longitude_1e7 / 1e7, altitude_m
