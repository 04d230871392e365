"""Matches capture reports to triggers. Pure logic; for the event loop.

Reports of one photo come from several senders (the camera itself, the autopilot's trigger, a counter), late, twice or
not at all, and others may take photos in between. A wrong match would give a missing photo evidence or another photo's
file. The rules, in this order:

* the same index from the same sender is the same photo (a duplicate);
* a report with an exposure time belongs to the last trigger before that time;
* a report without a time belongs to the trigger that its index points to, counted from the last match;
* else to the oldest trigger without a report of this kind.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import structlog

from panoexec.clock import Clock
from panoexec.devices import CaptureEvidence, EvidenceLevel
from panoexec.errors import DeviceError

_STAMP_SLACK_S: Final = 0.01
_LATEST_EXPOSURE_S: Final = 10.0
_LATEST_REPORT_S: Final = 60.0
_SAME_PHOTO_S: Final = 1.0
_KEEP: Final = 64
_FIRST_POLL_S: Final = 1.0

_log = structlog.get_logger(__name__)


class Source(StrEnum):
    """The message that reports a photo."""

    CAPTURED = "CAMERA_IMAGE_CAPTURED"
    FEEDBACK = "CAMERA_FEEDBACK"
    COUNT = "CAMERA_CAPTURE_STATUS"


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """One message about one photo.

    Attributes:
        source: the kind of message.
        success: False if the sender reports that no photo was taken.
        exposed_s: start of the exposure on the mission's clock, NaN if unknown.
        evidence: the evidence that it contains.
    """

    source: Source
    evidence: CaptureEvidence
    exposed_s: float = math.nan
    success: bool = True

    @property
    def index(self) -> int:
        """The sender's image index, -1 if it has none."""
        return self.evidence.image_index


class Capture:
    """Implements `PendingCapture`: one trigger and the evidence of its photo."""

    def __init__(
        self,
        number: int,
        *,
        clock: Clock,
        poll: Callable[[Capture], Awaitable[None]] | None = None,
        final: bool = False,
    ) -> None:
        """Create it for a trigger that is about to be sent.

        Args:
            number: sequence number of the trigger.
            clock: of the mission.
            poll: requests the capture status from the camera; None if that is not possible.
            final: no evidence can ever arrive.
        """
        self.number = number
        self.sources: dict[Source, Report] = {}
        """The first report of each sender."""
        self.failed = False
        """A sender reported that no photo was taken."""
        self._clock = clock
        self._poll = poll
        self._final = final
        self._commanded_s = self._acknowledged_s = math.nan
        self._evidence = CaptureEvidence(level=EvidenceLevel.COMMANDED, received_s=math.nan)
        self._changed = asyncio.Event()

    @property
    def commanded_s(self) -> float:
        """See `PendingCapture.commanded_s`; NaN before the trigger was sent."""
        return self._commanded_s

    @property
    def known(self) -> CaptureEvidence:
        """The evidence so far."""
        return self._evidence

    @property
    def acknowledged_s(self) -> float:
        """See `PendingCapture.acknowledged_s`."""
        return self._acknowledged_s

    def commanded(self, time_s: float) -> None:
        """The trigger is sent now; may be called in another thread."""
        self._commanded_s = time_s
        self._evidence = replace(self._evidence, received_s=time_s)

    def acknowledged(self, time_s: float) -> None:
        """The trigger was acknowledged."""
        self._acknowledged_s = time_s
        self._merge(CaptureEvidence(level=EvidenceLevel.ACKNOWLEDGED, received_s=time_s))

    def file_seen(self, time_s: float) -> None:
        """The file that a report named exists."""
        self._merge(CaptureEvidence(level=EvidenceLevel.FILE_SEEN, received_s=time_s))

    def add(self, report: Report) -> None:
        """Add a report of this photo."""
        duplicate = bool(self.sources)
        self.sources.setdefault(report.source, report)
        if not report.success:
            self.failed = True
        else:
            self._merge(report.evidence)
            if duplicate:
                self._evidence = replace(self._evidence, duplicates=self._evidence.duplicates + 1)
        self._changed.set()

    async def evidence(self, at_least: EvidenceLevel, timeout_s: float) -> CaptureEvidence:
        """See `PendingCapture.evidence`; returns early if the camera reports that no photo was taken."""
        if self._is_decided(at_least):
            return self._evidence
        left_s = self._commanded_s + timeout_s - self._clock.monotonic()
        async with asyncio.TaskGroup() as group:
            over = group.create_task(self._clock.sleep(max(0.0, left_s)), name="evidence timeout")
            over.add_done_callback(lambda _: self._changed.set())
            asking = group.create_task(self._ask(), name="evidence poll")
            while not (over.done() or self._is_decided(at_least)):
                self._changed.clear()
                await self._changed.wait()
            over.cancel()
            asking.cancel()
        return self._evidence

    def _is_decided(self, at_least: EvidenceLevel) -> bool:
        return self._final or self.failed or self._evidence.level >= at_least

    async def _ask(self) -> None:
        """Poll the camera at growing intervals, because a report may have been lost."""
        interval_s = _FIRST_POLL_S
        while self._poll is not None:
            await self._clock.sleep(interval_s)
            interval_s *= 2
            try:
                await self._poll(self)
            except DeviceError as error:
                _log.debug("capture status request failed", number=self.number, error=str(error))

    def _merge(self, new: CaptureEvidence) -> None:
        old = self._evidence
        best, other = (new, old) if new.level > old.level else (old, new)

        def reported(first: float, second: float) -> float:
            return second if math.isnan(first) else first

        self._evidence = CaptureEvidence(
            level=best.level,
            received_s=best.received_s,
            exposed_vehicle_s=reported(best.exposed_vehicle_s, other.exposed_vehicle_s),
            image_index=best.image_index if best.image_index >= 0 else other.image_index,
            file_url=best.file_url or other.file_url,
            time_utc_s=reported(best.time_utc_s, other.time_utc_s),
            latitude_deg=reported(best.latitude_deg, other.latitude_deg),
            longitude_deg=reported(best.longitude_deg, other.longitude_deg),
            altitude_m=reported(best.altitude_m, other.altitude_m),
            duplicates=old.duplicates,
        )
        self._changed.set()


class CaptureMatcher:
    """The recent triggers of a camera and their reports."""

    def __init__(self) -> None:
        self.foreign_photos = 0
        """Number of reported photos that panoexec did not trigger."""
        self._captures: deque[Capture] = deque(maxlen=_KEEP)
        self._seen: dict[tuple[Source, int], tuple[Report, Capture | None]] = {}
        self._last_match: dict[Source, tuple[int, int]] = {}
        self._count: int | None = None
        self._count_s = math.nan

    @property
    def image_count(self) -> int:
        """The camera's image count if it includes every photo triggered since its first count; else -1."""
        counts_all = all(
            Source.COUNT in capture.sources for capture in self._captures if not capture.commanded_s <= self._count_s
        )
        return self._count if self._count is not None and counts_all else -1

    def enter(self, capture: Capture) -> None:
        """Add a trigger that is about to be sent."""
        self._captures.append(capture)

    def withdraw(self, capture: Capture) -> None:
        """Remove a refused trigger: it takes no photo."""
        if capture in self._captures:
            self._captures.remove(capture)

    def report(self, report: Report) -> Capture | None:
        """Match a report; returns its trigger, or None for a photo that panoexec did not trigger."""
        key = (report.source, report.index)
        if report.index >= 0 and key in self._seen:
            first, capture = self._seen[key]
            if _is_same_photo(first, report):
                if capture is not None:
                    capture.add(report)
                return capture
        capture = self._match(report)
        if report.index >= 0:
            self._seen[key] = (report, capture)
            if len(self._seen) > 4 * _KEEP:
                del self._seen[next(iter(self._seen))]
        if capture is None:
            self.foreign_photos += 1
            _log.warning("unexpected photo", source=report.source, index=report.index)
        else:
            self._last_match[report.source] = (capture.number, report.index)
            capture.add(report)
        return capture

    def counted(self, images: int, received_s: float) -> None:
        """Take the camera's image count: each increment is evidence of one trigger since the first count.

        The newest trigger comes first, because the count is sent right after a photo: an older trigger without a report
        has lost its photo.
        """
        before, self._count = self._count, images
        if before is None or images < before:  # the first count, or the card was formatted
            self._count_s = received_s
            return
        waiting = [
            capture
            for capture in reversed(self._captures)
            if capture.commanded_s > self._count_s
            and Source.COUNT not in capture.sources
            and received_s - capture.commanded_s < _LATEST_EXPOSURE_S
        ]
        for capture, _ in zip(waiting, range(images - before), strict=False):
            evidence = CaptureEvidence(level=EvidenceLevel.COUNTED, received_s=received_s)
            capture.add(Report(source=Source.COUNT, evidence=evidence))

    def _match(self, report: Report) -> Capture | None:
        if math.isfinite(report.exposed_s):
            return self._match_by_time(report)
        received_s = report.evidence.received_s
        open_ones = [
            capture
            for capture in self._captures
            if capture.commanded_s <= received_s
            and received_s - capture.commanded_s < _LATEST_REPORT_S
            and report.source not in capture.sources
        ]
        if report.index >= 0 and report.source in self._last_match:
            number, index = self._last_match[report.source]
            for capture in open_ones:
                if capture.number - number == report.index - index:
                    return capture
        return open_ones[0] if open_ones else None

    def _match_by_time(self, report: Report) -> Capture | None:
        before = [c for c in self._captures if c.commanded_s <= report.exposed_s + _STAMP_SLACK_S]
        if not before:
            return None
        latest = before[-1]
        late = report.exposed_s - latest.commanded_s > _LATEST_EXPOSURE_S
        return None if late or report.source in latest.sources else latest


class StampClock:
    """Converts a sender's boot time to the mission's clock, by the message with the least delay so far.

    A message arrives after it was stamped, so arrival minus stamp is the clock offset plus a delay; the minimum over
    many messages approximates the offset. A converted stamp is never too early. The minimum relaxes by 100 ppm, which
    exceeds the drift between clocks.
    """

    _DRIFT: Final = 1e-4
    _REBOOT_S: Final = 1.0

    def __init__(self) -> None:
        self._offset_s = math.nan
        self._offset_at_s = math.nan
        self._newest_stamp_s = -math.inf
        self._known = 0

    def note(self, stamp_s: float, received_s: float) -> None:
        """Take a message that was stamped and sent at once."""
        if stamp_s < self._newest_stamp_s - self._REBOOT_S:  # the sender rebooted
            self._offset_s, self._known, self._newest_stamp_s = math.nan, 0, stamp_s
        self._newest_stamp_s = max(self._newest_stamp_s, stamp_s)
        offset = received_s - stamp_s
        relaxed = self._offset_s + self._DRIFT * (received_s - self._offset_at_s)
        self._offset_s = offset if math.isnan(relaxed) else min(offset, relaxed)
        self._offset_at_s = received_s
        self._known += 1

    def exposed_s(self, stamp_s: float, received_s: float) -> float:
        """Convert the start of an exposure to the mission's clock; NaN if the offset is unknown."""
        rebooted = stamp_s < self._newest_stamp_s - _LATEST_REPORT_S
        if rebooted or not self._known or math.isnan(stamp_s):
            return math.nan
        return min(stamp_s + self._offset_s, received_s)


def _is_same_photo(first: Report, again: Report) -> bool:
    """Whether two reports with the same index are of the same photo; a rebooted camera counts from 1 again."""
    apart = again.exposed_s - first.exposed_s
    if math.isfinite(apart):
        return abs(apart) < _SAME_PHOTO_S
    return again.evidence.received_s - first.evidence.received_s < _LATEST_REPORT_S
