"""One photo: its trigger, the reports about it, and the evidence that they add up to."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import structlog

from panoexec.clock import Clock
from panoexec.devices import CaptureEvidence, EvidenceLevel
from panoexec.errors import DeviceError

_FIRST_POLL_S: Final = 1.0
_UNREPORTED_S: Final = 2.5
"""A photo without a report for so long, from a camera that reports its photos, contradicts it."""

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
        source: who reports.
        success: False if the sender says that there is no photo.
        exposed_s: start of the exposure on the mission's clock, NaN if that cannot be told.
        error_s: how far `exposed_s` may be wrong.
        evidence: what it proves and tells.
    """

    source: Source
    evidence: CaptureEvidence
    exposed_s: float = math.nan
    error_s: float = 0.0
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
        synchronise: Callable[[], Awaitable[None]] | None = None,
        final: bool = False,
        defer_s: float = 0.0,
        must_report: bool = False,
    ) -> None:
        """Create it for a trigger that is about to be sent.

        Args:
            number: sequence number of the trigger.
            clock: of the mission.
            poll: asks the camera for news, if it can be asked.
            synchronise: asks the camera for a stamp of its clock, if the last one is old.
            final: nothing can ever become known of the photo.
            defer_s: how long after it was sent the trigger may be carried out unseen, if no report tells that it was.
            must_report: the camera reports its photos, so a photo without a report is a contradiction.
        """
        self.number = number
        self.sources: dict[Source, Report] = {}
        """The first report of each sender."""
        self.failed = False
        """A sender reported that no photo was taken."""
        self._clock = clock
        self._poll = poll
        self._synchronise = synchronise
        self._final = final
        self._must_report = must_report
        self._undatable = False
        self.defer_s = defer_s
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

    def file_seen(self, time_s: float, *, file_url: str = "") -> None:
        """The file that a report named exists; `file_url` names another one of the same photo instead."""
        self._merge(CaptureEvidence(level=EvidenceLevel.FILE_SEEN, received_s=time_s, file_url=file_url))

    @property
    def contradicted(self) -> bool:
        """Whether the camera reported a photo that may be this one and may be another."""
        return bool(self._evidence.contradiction)

    def contradict(self, why: str) -> None:
        """A photo was reported that fits no trigger, while this one waits for its report."""
        self._evidence = replace(self._evidence, contradiction=why)
        self._changed.set()

    def cannot_be_dated(self, index: int) -> None:
        """The report of this photo has a stamp that cannot be true, from a camera whose other stamps are."""
        self._undatable = True
        self.contradict(f"the camera's stamp of photo {index} cannot be true: it may be another one")

    @property
    def is_reported(self) -> bool:
        """Whether a sender reported the photo or its trigger, and not only its count increased."""
        return any(source is not Source.COUNT for source in self.sources)

    async def fired(self) -> float:
        """See `MayFireLate.fired`."""
        if self.defer_s > 0 and not (self.is_reported or self.failed):
            deadline_s = self._commanded_s + self.defer_s
            await self._wait(lambda: self.is_reported or self.failed, deadline_s - self._clock.monotonic())
        exposed_s = self._evidence.exposed_s
        return max(self._commanded_s, exposed_s)

    def add(self, report: Report) -> None:
        """Add a report of this photo."""
        duplicate = bool(self.sources)
        if report.source is not Source.COUNT and (not self._undatable or math.isfinite(report.exposed_s)):
            self._undatable = False
            self._evidence = replace(self._evidence, contradiction="")
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
        await self._wait(lambda: self._is_decided(at_least), left_s)
        missing = self._must_report and not (self.is_reported or self.failed or self.contradicted)
        if missing and self._clock.monotonic() - self._commanded_s >= _UNREPORTED_S:
            self.contradict("the camera did not report this photo, but reports its photos")
        return self._evidence

    async def _wait(self, done: Callable[[], bool], timeout_s: float) -> None:
        """Return when something is done, at the latest after a time; the camera is asked for news meanwhile."""
        async with asyncio.TaskGroup() as group:
            over = group.create_task(self._clock.sleep(max(0.0, timeout_s)), name="evidence timeout")
            over.add_done_callback(lambda _: self._changed.set())
            asking = group.create_task(self._ask(), name="evidence poll")
            while not (over.done() or done()):
                self._changed.clear()
                await self._changed.wait()
            over.cancel()
            asking.cancel()

    def _is_decided(self, at_least: EvidenceLevel) -> bool:
        if self._final or self.failed:
            return True
        counts = self.is_reported or not self._must_report or at_least <= EvidenceLevel.ACKNOWLEDGED
        return counts and self._evidence.level >= at_least

    async def _ask(self) -> None:
        """A report may have been lost on the way: ask, with growing patience."""
        patience_s = _FIRST_POLL_S
        if self._synchronise is not None:
            try:
                await self._synchronise()
            except DeviceError as error:
                _log.debug("camera clock request failed", number=self.number, error=str(error))
        while self._poll is not None:
            await self._clock.sleep(patience_s)
            patience_s *= 2
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
            exposed_s=reported(best.exposed_s, other.exposed_s),
            exposed_error_s=other.exposed_error_s if math.isnan(best.exposed_s) else best.exposed_error_s,
            opened_s=other.opened_s if math.isnan(best.opened_s[0]) else best.opened_s,
            contradiction=old.contradiction,
            reported_s=reported(old.reported_s, new.reported_s),
            counted_s=reported(old.counted_s, new.counted_s),
        )
        self._changed.set()


def dated(report: Report, exposed_s: float, error_s: float) -> Report:
    """A report with the date of its exposure on the mission's clock; a date after its arrival is none."""
    if exposed_s > report.evidence.received_s:
        exposed_s = error_s = math.nan
    earliest_s, latest_s = opened_s = report.evidence.opened_s
    if not (earliest_s - error_s <= exposed_s <= latest_s + error_s):
        opened_s = (math.nan, math.nan)
    evidence = replace(report.evidence, exposed_s=exposed_s, exposed_error_s=error_s, opened_s=opened_s)
    return replace(report, evidence=evidence, exposed_s=exposed_s, error_s=0.0 if math.isnan(error_s) else error_s)
