"""Dated exposures: the pose is judged at the time at which the camera reports that it exposed.

The pose is judged from the trigger to the end of the exposure bound. A shutter that is late, or a trigger that the
autopilot deferred, exposes after that, when the gimbal may already be on its way. A report that dates the exposure
outside the judged window therefore does not verify that pose: the attitude at the date is judged instead.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

from panoexec.devices import CaptureEvidence, EvidenceLevel, PendingCapture
from panoexec.mission.settings import MissionSettings

MAX_DATE_ERROR_S: Final = 0.25
"""Nothing is learned from dates less certain than this."""
_MAX_LAG_S: Final = 10.0
_REMEMBERED: Final = 16
_IRREGULAR_S: Final = 0.2
"""Lags that differ by more than this, and by more than their dates may be wrong, are irregular."""
_WARN_ABOVE_S: Final = 0.1
_REGULAR_S: Final = 0.03
"""Openings of the shutter that differ by no more than this, beyond what their bounds leave open, are regular."""


class ShutterLag:
    """How long after the trigger the shutter opens, estimated from the camera's dates.

    Args:
        configured_s: `[camera] latency_s`.
    """

    def __init__(self, configured_s: float) -> None:
        self._configured_s = configured_s
        self._measured_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._openings_s: dict[float, tuple[float, float]] = {}  # after the trigger, by when that was sent
        self._warned = False
        self.until_report = False
        """Whether the pose must be held until the autopilot reports that it triggered."""

    @property
    def bound_s(self) -> float:
        """The longest lag to expect: what is configured, or the longest of the last photos.

        A shutter that is later one time than another can be later still: half of what the lags differ by is added.
        The wait ends when the camera reports the photo, so a long bound costs nothing with a camera that does.
        """
        if not self._measured_s:
            return self._configured_s
        spread_s = max(self._measured_s) - min(self._measured_s)
        reserve_s = spread_s / 2 if spread_s > _IRREGULAR_S else 0.0
        return max(self._configured_s, max(self._measured_s) + reserve_s)

    @property
    def is_irregular(self) -> bool:
        """Whether the shutter, or its stamp, was later after one of the last triggers than after another."""
        lags_s = self._openings_s.values()
        if not lags_s:
            return False
        return max(earliest for earliest, _ in lags_s) - min(latest for _, latest in lags_s) > _REGULAR_S

    def opening(self, found: CaptureEvidence, capture: PendingCapture, exposure_s: float) -> tuple[float, float] | None:
        """The interval in which the shutter was open, if the stamp can be nothing but that of the shutter; else None.

        A camera may stamp a photo when it receives the command, or when it reports. So the stamp must lie after the
        acknowledgement and, with the exposure, before the report, and must be as late as those of the other photos;
        where a later one is not, see `is_irregular`.

        Args:
            found: what is known of the photo.
            capture: its trigger.
            exposure_s: longest exposure.
        """
        earliest_s, latest_s = found.opened_s
        closed_s = latest_s + exposure_s
        if found.contradiction or not capture.acknowledged_s < earliest_s <= closed_s < found.reported_s:
            return None
        self._note_opening(found, capture.commanded_s)
        return None if self.is_irregular else (earliest_s, closed_s)

    def note(self, found: CaptureEvidence, commanded_s: float) -> str:
        """Add the date of a photo; returns a warning for the operator, "" if there is none."""
        self._note_opening(found, commanded_s)
        if is_undatable(found):
            self._note_report(found.received_s - commanded_s)
            return ""
        if is_only_counted(found):
            return self._note_count(found.counted_s - commanded_s)
        if not is_dated(found):
            return ""
        if found.level < EvidenceLevel.FEEDBACK_PIN:
            return self._note_trigger_report(found.exposed_s - commanded_s, found.exposed_error_s)
        return self._note_date(found.exposed_s - commanded_s, found.exposed_error_s)

    def _note_opening(self, found: CaptureEvidence, commanded_s: float) -> None:
        earliest_s, latest_s = found.opened_s
        if math.isfinite(earliest_s):
            self._openings_s[commanded_s] = (earliest_s - commanded_s, latest_s - commanded_s)
            if len(self._openings_s) > _REMEMBERED:
                del self._openings_s[next(iter(self._openings_s))]

    def _note_date(self, lag_s: float, error_s: float) -> str:
        """The camera tells when its shutter opened."""
        if not 0 <= lag_s <= _MAX_LAG_S:
            return ""
        self._measured_s.append(lag_s + error_s)
        if self._warned or lag_s <= self._configured_s + _WARN_ABOVE_S:
            return ""
        self._warned = True
        advised_s = math.ceil(10 * (lag_s + error_s)) / 10
        return (
            f"the camera exposes {lag_s:.2f} s after its trigger, [camera] latency_s is {self._configured_s:g}: "
            f"set it to {advised_s:g}"
        )

    def _note_report(self, reported_after_s: float) -> None:
        """The shutter opened before the report: wait for so long."""
        if 0 <= reported_after_s <= _MAX_LAG_S:
            self._measured_s.append(reported_after_s)

    def _note_trigger_report(self, reported_after_s: float, error_s: float) -> str:
        """The photo was taken when its trigger was reported, or before: hold the pose until then."""
        if not error_s < reported_after_s <= _MAX_LAG_S:
            return ""
        self._measured_s.append(reported_after_s + error_s)
        self.until_report = True
        if self._warned or reported_after_s <= self._configured_s + _WARN_ABOVE_S:
            return ""
        self._warned = True
        return (
            f"the autopilot reports its triggers {reported_after_s:.1f} s after they were commanded: each pose is held"
            " until then"
        )

    def _note_count(self, counted_after_s: float) -> str:
        """The photo was taken before it was counted: wait for so long."""
        if not 0 <= counted_after_s <= _MAX_LAG_S:
            return ""
        self._measured_s.append(counted_after_s)
        if self._warned or counted_after_s <= self._configured_s + _WARN_ABOVE_S:
            return ""
        self._warned = True
        return (
            "the camera counts its photos, but reports none of them: each pose is held until its photo is counted,"
            f" {counted_after_s:.1f} s after the trigger"
        )


def is_dated(found: CaptureEvidence) -> bool:
    """Whether a photo is dated well enough to learn from its date."""
    return math.isfinite(found.exposed_s) and found.exposed_error_s <= MAX_DATE_ERROR_S


def is_undatable(found: CaptureEvidence) -> bool:
    """Whether a camera stamped its report with a time that cannot be related to the mission's clock well enough.

    The camera's clock was stepped, or nothing related the two clocks: all that is known is that the photo was exposed
    between its trigger and its report.
    """
    stamped = found.level >= EvidenceLevel.CAPTURE_MESSAGE and math.isfinite(found.exposed_vehicle_s)
    return stamped and not is_dated(found)


def is_unlike_others(found: CaptureEvidence) -> bool:
    """Whether a stamp tells nothing at all, which from a camera whose other stamps do means that its clock was stepped.

    A date that is only uncertain, as while a message is late, is judged from the trigger to the report.
    """
    return is_undatable(found) and math.isnan(found.exposed_s)


def is_only_counted(found: CaptureEvidence) -> bool:
    """Whether the camera's count is all that tells of a photo: it was exposed between its trigger and its count."""
    untold = math.isnan(found.exposed_s) and math.isnan(found.reported_s)
    return untold and found.level == EvidenceLevel.COUNTED and math.isfinite(found.counted_s)


def is_before(found: CaptureEvidence, commanded_s: float) -> bool:
    """Whether a photo is dated before its trigger, so that it cannot be the one that was requested."""
    return found.exposed_s + found.exposed_error_s < commanded_s  # False without a date, NaN


def has_window(found: CaptureEvidence) -> bool:
    """Whether something was reported that tells when a photo was exposed, however roughly."""
    reported = found.level >= EvidenceLevel.CAPTURE_MESSAGE and math.isfinite(found.reported_s)
    return math.isfinite(found.exposed_s) or reported or is_undatable(found) or is_only_counted(found)


def _arrival_s(found: CaptureEvidence) -> float:
    """When a photo was reported, or counted: it was exposed before that."""
    if is_only_counted(found):
        return found.counted_s
    return found.received_s if math.isnan(found.reported_s) else found.reported_s


def window(found: CaptureEvidence, commanded_s: float, settings: MissionSettings) -> tuple[float, float]:
    """The interval in which a reported photo was exposed, bounds included, on the mission's clock.

    Not before its trigger; and not after its report, where the camera reports a photo that it has: that is all that a
    report says which has no date, or one that cannot be believed. CAMERA_FEEDBACK is dated by its arrival alone: one
    that is late tells of a trigger that was deferred, or was itself held up on the link, so that the exposure may have
    been any time since the trigger. Without a pin, the exposure follows the report within the bound.
    """
    if math.isnan(found.exposed_s) or is_undatable(found):
        return commanded_s, _arrival_s(found)
    if found.level < EvidenceLevel.FEEDBACK_PIN:
        prompt = found.exposed_s - commanded_s <= found.exposed_error_s
        return commanded_s, (commanded_s if prompt else found.exposed_s) + settings.exposure_bound_s
    start_s = max(commanded_s, found.exposed_s - found.exposed_error_s)
    if found.level < EvidenceLevel.CAPTURE_MESSAGE:
        start_s = commanded_s
    end_s = found.exposed_s + found.exposed_error_s + settings.exposure_s
    if found.level >= EvidenceLevel.CAPTURE_MESSAGE:
        end_s = min(end_s, _arrival_s(found))
    return start_s, max(start_s, end_s)


def when(found: CaptureEvidence, commanded_s: float) -> str:
    """When a photo was exposed, as far as its report tells, for a reason."""
    if is_dated(found):
        return f"exposed {found.exposed_s - commanded_s:.2f} s after its trigger"
    late_s = _arrival_s(found) - commanded_s
    if is_only_counted(found):
        return f"the photo is only counted, {late_s:.2f} s after its trigger"
    if is_undatable(found):
        return f"reported {late_s:.2f} s after its trigger with a time that cannot be dated"
    if math.isfinite(found.exposed_s):
        return f"exposed about {found.exposed_s - commanded_s:.1f} s after its trigger"
    return f"the photo is not dated, and was reported {late_s:.2f} s after its trigger"


def contradictions(found: Sequence[CaptureEvidence]) -> str:
    """Why photos may be other ones than those requested; "" without such a reason."""
    return next((one.contradiction for one in found if one.contradiction), "")
