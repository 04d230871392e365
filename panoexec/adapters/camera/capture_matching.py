"""Matches capture reports to triggers. Pure logic; for the event loop.

Reports of one photo come from several senders (the camera itself, the autopilot's trigger, a counter), late, twice or
not at all, and in between somebody else may take photos. The camera's clock may run slow or be stepped. A wrong match
would call a photo proven that does not exist, or give it another one's file. So, in this order:

* the same index from the same sender is the same photo (a duplicate);
* a report belongs to the trigger that its index points to, counted from the last match, if the exposure was not before
  that trigger;
* a report whose index points to no trigger belongs to the last trigger before its exposure;
* a report without a date and without a usable index belongs to the oldest trigger that has no report of this sender.

A report that fits no trigger while a trigger waits for its own is a contradiction: the camera is asked for its clock,
the report is dated again, and if it still fits nothing the waiting triggers are marked. A marked trigger is proven by
its own report alone, never by a count.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import Final

import structlog

from panoexec.adapters.camera.camera_clock import CameraClock
from panoexec.adapters.camera.capture import Capture, Report, Source, dated
from panoexec.devices import CaptureEvidence, EvidenceLevel

_STAMP_SLACK_S: Final = 0.01
_LATEST_EXPOSURE_S: Final = 10.0
_LATEST_REPORT_S: Final = 60.0
_SAME_PHOTO_S: Final = 1.0
_KEEP: Final = 64
_LATENCIES: Final = 9
_SURE_S: Final = 0.25
"""A date that may be wrong by more than this does not decide against the index."""
_HELD_S: Final = 3.0
"""How long a report that fits no trigger waits for the camera's clock to be related anew."""

_log = structlog.get_logger(__name__)


class CaptureMatcher:
    """All triggers of a camera, and the reports that came.

    Args:
        clock: the camera's, by which its reports are dated.
    """

    def __init__(self, clock: CameraClock | None = None) -> None:
        self._clock = clock or CameraClock()
        self._held: list[Report] = []
        self._steps = self._clock.steps
        self._latencies_s: deque[float] = deque(maxlen=_LATENCIES)
        self.foreign_photos = 0
        """Photos that were reported but not triggered by us."""
        self.dated_photos = self.undated_photos = 0
        """Photos of ours that the camera's own reports dated, and those that they did not."""
        self.refused_taken_after_s = 0.0
        """The longest time after which a trigger that was refused took its photo all the same; 0: none did."""
        self._captures: deque[Capture] = deque(maxlen=_KEEP)
        self._refused: deque[Capture] = deque(maxlen=4)
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
        """Remove a refused trigger: it takes no photo, or one that is nobody's."""
        if capture in self._captures:
            self._captures.remove(capture)
            self._refused.append(capture)

    def report(self, report: Report) -> Capture | None:
        """Match a report; returns its trigger, or None for a photo that panoexec did not trigger."""
        key = (report.source, report.index)
        if report.index >= 0 and key in self._seen:
            first, capture = self._seen[key]
            if _is_same_photo(first, report):
                if capture is not None:
                    capture.add(report)
                return capture
        if any(held.source is report.source and held.index == report.index for held in self._held):
            return None
        capture = self._match(report)
        if self._may_be_dated_anew(report, capture):
            self._held.append(report)
            self._contradict(report)
            return None
        return self._settle(report, capture)

    def _contradict(self, report: Report) -> None:
        """Mark the triggers that wait for a report: until it is clear whose this one is, none of them is proven."""
        for waiting in self._open(report):
            waiting.contradict(_misfit(report))

    def _may_be_dated_anew(self, report: Report, capture: Capture | None) -> bool:
        """Whether a trigger waits for a report that fits none, or whose date cannot be true, or may not be."""
        stamped = math.isfinite(report.evidence.exposed_vehicle_s)
        if stamped and self._clock.suspicious:
            return True
        impossible = stamped and self._clock.related and math.isnan(report.exposed_s)
        return (impossible or (stamped and capture is None)) and bool(self._open(report))

    def redate(self, now_s: float) -> None:
        """The clocks were related anew, or that failed: date the reports that fitted no trigger again.

        Args:
            now_s: on the mission's clock; what has been held for long enough is settled either way.
        """
        self._doubt_dates_around_a_step()
        held, self._held = self._held, []
        for report in held:
            exposed_s, error_s = self._clock.date(report.evidence.exposed_vehicle_s, report.evidence.received_s)
            if self._clock.suspicious:
                exposed_s = error_s = math.nan
            again = dated(report, exposed_s, error_s)
            capture = self._match(again)
            if self._may_be_dated_anew(again, capture) and now_s - report.evidence.received_s < _HELD_S:
                self._held.append(report)
            else:
                for waiting in self._captures:
                    if waiting.known.contradiction == _misfit(report):
                        waiting.contradict("")
                self._settle(again, capture)

    def _doubt_dates_around_a_step(self) -> None:
        """After a step of the camera's clock: photos that were dated since the last message before it are in doubt.

        A stamp that lies in the future by the clock as it is now was given before the step: its date is true.
        """
        if self._clock.steps == self._steps:
            return
        self._steps = self._clock.steps
        _log.warning("the camera's clock was stepped", by_s=round(self._clock.step_s, 3))
        for capture in self._captures:
            report = capture.sources.get(Source.CAPTURED)
            if report is None or not report.evidence.received_s > self._clock.in_doubt_since_s:
                continue
            exposed_s, error_s = self._clock.date(report.evidence.exposed_vehicle_s, report.evidence.received_s)
            if not abs(exposed_s - report.exposed_s) <= error_s + report.error_s:  # NaN: from before the step or after
                capture.contradict(f"the camera's clock was stepped about when it reported photo {report.index}")

    def _settle(self, report: Report, capture: Capture | None) -> Capture | None:
        """Book a report on its trigger; on none, it is a photo of somebody else, or a contradiction."""
        if report.index >= 0:
            self._seen[report.source, report.index] = (report, capture)
            if len(self._seen) > 4 * _KEEP:
                del self._seen[next(iter(self._seen))]
        if capture is not None:
            if math.isfinite(report.exposed_s):
                self._latencies_s.append(report.exposed_s - capture.commanded_s)
            self._last_match[report.source] = (capture.number, report.index)
            capture.add(report)
            if report.source is Source.CAPTURED:
                self._note_date(report, capture)
            return capture
        if self._is_of_refused(report):
            _log.warning("a trigger that was refused took a photo", source=report.source, index=report.index)
        self.foreign_photos += 1
        _log.warning("unsolicited photo", source=report.source, index=report.index)
        number, index = self._last_match.get(report.source, (-1, -1))
        if number >= 0 and report.index > index:  # the next photo of ours has an index beyond it
            self._last_match[report.source] = (number, report.index)
        self._contradict(report)
        return None

    def _note_date(self, report: Report, capture: Capture) -> None:
        """Learn whether the camera dates its photos; one without a date from a camera that does contradicts it."""
        if math.isfinite(report.exposed_s):
            self.dated_photos += 1
        elif report.success:
            self.undated_photos += 1
            if self.dated_photos:
                capture.cannot_be_dated(report.index)

    def _is_of_refused(self, report: Report) -> bool:
        """Whether a photo that fits no trigger was taken soon after a refused one."""
        taken_s = report.evidence.received_s if math.isnan(report.exposed_s) else report.exposed_s
        delays_s = [taken_s - capture.commanded_s for capture in self._refused]
        fitting = [delay_s for delay_s in delays_s if 0 <= delay_s <= _LATEST_EXPOSURE_S]
        if fitting:
            self.refused_taken_after_s = max(self.refused_taken_after_s, *fitting)
        return bool(fitting)

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
            and not capture.contradicted
            and not self._held
            and received_s - capture.commanded_s < _LATEST_EXPOSURE_S
        ]
        for capture, _ in zip(waiting, range(images - before), strict=False):
            evidence = CaptureEvidence(level=EvidenceLevel.COUNTED, received_s=received_s, counted_s=received_s)
            capture.add(Report(source=Source.COUNT, evidence=evidence))

    def _match(self, report: Report) -> Capture | None:
        """The trigger of a report; None if it has none, or if index and time contradict each other."""
        if math.isnan(report.exposed_s):
            return self._match_undated(report)
        pointed, dated = self._by_index(report), self._by_time(report)
        if pointed is dated:
            return dated
        if pointed is None:
            return dated if self._is_usual(report, dated) or report.source not in self._last_match else None
        # the index contradicts the date: a trigger before brought no photo, or the shutter is later than the next
        # trigger, or the camera's clock was stepped; what the camera needed so far decides
        delay_s = report.exposed_s - pointed.commanded_s
        possible = -report.error_s <= delay_s <= _LATEST_EXPOSURE_S
        if possible and report.error_s > _SURE_S and self._is_usual(report, pointed):
            return pointed
        if dated is None:
            return pointed if possible and self._latencies_s and self._is_usual(report, pointed) else None
        usual_s = median(self._latencies_s) if self._latencies_s else 0.0
        candidates = [dated, pointed] if possible else [dated]
        return min(candidates, key=lambda capture: abs(report.exposed_s - capture.commanded_s - usual_s))

    def _is_usual(self, report: Report, capture: Capture | None) -> bool:
        """Whether an exposure is as late after a trigger as the camera's exposures are, as far as that is known."""
        if capture is None or not self._latencies_s:
            return capture is not None
        delay_s = report.exposed_s - capture.commanded_s
        return abs(delay_s - median(self._latencies_s)) <= _SURE_S + report.error_s

    def _match_undated(self, report: Report) -> Capture | None:
        open_ones = self._open(report)
        if report.index >= 0 and report.source in self._last_match:
            number, index = self._last_match[report.source]
            for capture in open_ones:
                if capture.number - number == report.index - index:
                    return capture
        return open_ones[0] if open_ones else None

    def _open(self, report: Report) -> list[Capture]:
        """Triggers before a report's arrival that have no report of its sender."""
        received_s = report.evidence.received_s
        return [
            capture
            for capture in self._captures
            if capture.commanded_s <= received_s
            and received_s - capture.commanded_s < _LATEST_REPORT_S
            and report.source not in capture.sources
        ]

    def _by_index(self, report: Report) -> Capture | None:
        """The open trigger that the index points to, counted from the last match."""
        if report.index < 0 or report.source not in self._last_match:
            return None
        number, index = self._last_match[report.source]
        wanted = number + report.index - index
        return next((capture for capture in self._open(report) if capture.number == wanted), None)

    def _by_time(self, report: Report) -> Capture | None:
        """The last trigger before the exposure, if it has no report of this sender."""
        latest_s = report.exposed_s + max(_STAMP_SLACK_S, report.error_s)
        before = [c for c in self._captures if c.commanded_s <= latest_s]
        if not before:
            return None
        latest = before[-1]
        number, index = self._last_match.get(report.source, (-1, -1))
        if 0 <= index < report.index and latest.number <= number:  # a later photo is no earlier trigger's
            return None
        late = report.exposed_s - latest.commanded_s > _LATEST_EXPOSURE_S
        return None if late or report.source in latest.sources else latest


def _misfit(report: Report) -> str:
    return f"the camera reported photo {report.index}, which fits no trigger"


def _is_same_photo(first: Report, again: Report) -> bool:
    """Whether two reports with the same index are of the same photo; a rebooted camera counts from 1 again."""
    stamps_apart_s = again.evidence.exposed_vehicle_s - first.evidence.exposed_vehicle_s
    if abs(stamps_apart_s) < _STAMP_SLACK_S:  # however the camera's clock was related to ours each time
        return True
    apart = again.exposed_s - first.exposed_s
    if math.isfinite(apart):
        return abs(apart) < _SAME_PHOTO_S
    return again.evidence.received_s - first.evidence.received_s < _LATEST_REPORT_S
