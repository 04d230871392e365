"""Which report proves which photo. Pure bookkeeping of triggers and reports; lives on the event loop.

Reports of one photo come from several senders (the camera itself, the autopilot's trigger, a counter), late, twice or
not at all, and in between somebody else may take photos. A wrong match would call a photo proven that does not exist,
or give it another one's file. So, in this order:

* the same index from the same sender is the same photo (a duplicate);
* a report that tells when the photo was exposed belongs to the last trigger before that;
* a report without time belongs to the trigger that its index points to, counted from the last match;
* else to the oldest trigger that has no report of this kind.
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
_FIRST_NUDGE_S: Final = 1.0

_log = structlog.get_logger(__name__)


class Source(StrEnum):
    """Who reports."""

    CAPTURED = "CAMERA_IMAGE_CAPTURED"
    FEEDBACK = "CAMERA_FEEDBACK"
    COUNT = "CAMERA_CAPTURE_STATUS"


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """One message about one photo.

    Attributes:
        source: who reports.
        success: False if the sender says that there is no photo.
        exposed_s: start of the exposure on the mission's clock, NaN if that cannot be told.
        evidence: what it proves and tells.
    """

    source: Source
    evidence: CaptureEvidence
    exposed_s: float = math.nan
    success: bool = True

    @property
    def index(self) -> int:
        """The sender's number of the photo, -1 if it has none."""
        return self.evidence.image_index


class Capture:
    """Implements `PendingCapture`: one trigger and what became known of its photo."""

    def __init__(
        self,
        number: int,
        *,
        clock: Clock,
        nudge: Callable[[Capture], Awaitable[None]] | None = None,
        final: bool = False,
    ) -> None:
        """Describe a trigger that is about to go out.

        Args:
            number: running number of the trigger.
            clock: of the mission.
            nudge: asks the camera for news, if it can be asked.
            final: nothing can ever become known of the photo.
        """
        self.number = number
        self.sources: dict[Source, Report] = {}
        """The first report of each sender."""
        self.failed = False
        """A sender said that there is no photo."""
        self._clock = clock
        self._nudge = nudge
        self._final = final
        self._commanded_s = self._acknowledged_s = math.nan
        self._evidence = CaptureEvidence(level=EvidenceLevel.COMMANDED, received_s=math.nan)
        self._changed = asyncio.Event()

    @property
    def commanded_s(self) -> float:
        """See `PendingCapture.commanded_s`; NaN before the trigger went out."""
        return self._commanded_s

    @property
    def known(self) -> CaptureEvidence:
        """What is known by now."""
        return self._evidence

    @property
    def acknowledged_s(self) -> float:
        """See `PendingCapture.acknowledged_s`."""
        return self._acknowledged_s

    def commanded(self, time_s: float) -> None:
        """The trigger goes out now; may be called in another thread."""
        self._commanded_s = time_s
        self._evidence = replace(self._evidence, received_s=time_s)

    def acknowledged(self, time_s: float) -> None:
        """The trigger was acknowledged."""
        self._acknowledged_s = time_s
        self._merge(CaptureEvidence(level=EvidenceLevel.ACKNOWLEDGED, received_s=time_s))

    def file_seen(self, time_s: float) -> None:
        """The file that a report named is there."""
        self._merge(CaptureEvidence(level=EvidenceLevel.FILE_SEEN, received_s=time_s))

    def add(self, report: Report) -> None:
        """Take a report of this photo."""
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
        """See `PendingCapture.evidence`; returns early when the camera says that there is no photo."""
        if self._is_decided(at_least):
            return self._evidence
        left_s = self._commanded_s + timeout_s - self._clock.monotonic()
        async with asyncio.TaskGroup() as group:
            over = group.create_task(self._clock.sleep(max(0.0, left_s)), name="evidence timeout")
            over.add_done_callback(lambda _: self._changed.set())
            asking = group.create_task(self._ask(), name="evidence nudge")
            while not (over.done() or self._is_decided(at_least)):
                self._changed.clear()
                await self._changed.wait()
            over.cancel()
            asking.cancel()
        return self._evidence

    def _is_decided(self, at_least: EvidenceLevel) -> bool:
        return self._final or self.failed or self._evidence.level >= at_least

    async def _ask(self) -> None:
        """A report may have been lost on the way: ask, with growing patience."""
        patience_s = _FIRST_NUDGE_S
        while self._nudge is not None:
            await self._clock.sleep(patience_s)
            patience_s *= 2
            try:
                await self._nudge(self)
            except DeviceError as error:
                _log.debug("no news of the photo", number=self.number, error=str(error))

    def _merge(self, news: CaptureEvidence) -> None:
        old = self._evidence
        best, other = (news, old) if news.level > old.level else (old, news)

        def told(first: float, second: float) -> float:
            return second if math.isnan(first) else first

        self._evidence = CaptureEvidence(
            level=best.level,
            received_s=best.received_s,
            exposed_vehicle_s=told(best.exposed_vehicle_s, other.exposed_vehicle_s),
            image_index=best.image_index if best.image_index >= 0 else other.image_index,
            file_url=best.file_url or other.file_url,
            time_utc_s=told(best.time_utc_s, other.time_utc_s),
            latitude_deg=told(best.latitude_deg, other.latitude_deg),
            longitude_deg=told(best.longitude_deg, other.longitude_deg),
            altitude_m=told(best.altitude_m, other.altitude_m),
            duplicates=old.duplicates,
        )
        self._changed.set()


class CaptureMatcher:
    """All triggers of a camera, and the reports that came."""

    def __init__(self) -> None:
        self.surplus = 0
        """Photos that were reported but not triggered by us."""
        self._captures: deque[Capture] = deque(maxlen=_KEEP)
        self._seen: dict[tuple[Source, int], tuple[Report, Capture | None]] = {}
        self._last_match: dict[Source, tuple[int, int]] = {}
        self._count: int | None = None
        self._count_s = math.nan

    @property
    def image_count(self) -> int:
        """The camera's count of images, if it includes every photo triggered since its first count; else -1."""
        counts_all = all(
            Source.COUNT in capture.sources for capture in self._captures if not capture.commanded_s <= self._count_s
        )
        return self._count if self._count is not None and counts_all else -1

    def enter(self, capture: Capture) -> None:
        """A trigger is about to go out."""
        self._captures.append(capture)

    def withdraw(self, capture: Capture) -> None:
        """A trigger was refused: no photo will come of it."""
        if capture in self._captures:
            self._captures.remove(capture)

    def report(self, report: Report) -> Capture | None:
        """Take a report; returns the trigger that it belongs to, None for a photo that is not ours."""
        key = (report.source, report.index)
        if report.index >= 0 and key in self._seen:
            first, capture = self._seen[key]
            if _same_photo(first, report):
                if capture is not None:
                    capture.add(report)
                return capture
        capture = self._match(report)
        if report.index >= 0:
            self._seen[key] = (report, capture)
            if len(self._seen) > 4 * _KEEP:
                del self._seen[next(iter(self._seen))]
        if capture is None:
            self.surplus += 1
            _log.warning("a photo that was not asked for", source=report.source, index=report.index)
        else:
            self._last_match[report.source] = (capture.number, report.index)
            capture.add(report)
        return capture

    def counted(self, images: int, received_s: float) -> None:
        """Take the camera's count of images: each one more proves one trigger since the first count, newest first.

        Newest first, because a count follows a photo at once: if the photo before was lost, the count is not its.
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
    """Turns a sender's boot time into the mission's clock, by the fastest message so far.

    A message arrives after it was stamped, so arrival minus stamp is the difference of the clocks plus a delay; the
    least of many comes close to the difference. A stamp turned so is never earlier than the truth. The bound relaxes
    by 100 parts in a million, which is more than clocks drift apart.
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
        """When a stamped exposure began, on the mission's clock; NaN if too little is known of the sender's clock."""
        rebooted = stamp_s < self._newest_stamp_s - _LATEST_REPORT_S
        if rebooted or not self._known or math.isnan(stamp_s):
            return math.nan
        return min(stamp_s + self._offset_s, received_s)


def _same_photo(first: Report, again: Report) -> bool:
    """Whether two reports of one index are of one photo; a camera that rebooted counts from 1 again."""
    apart = again.exposed_s - first.exposed_s
    if math.isfinite(apart):
        return abs(apart) < _SAME_PHOTO_S
    return again.evidence.received_s - first.evidence.received_s < _LATEST_REPORT_S
