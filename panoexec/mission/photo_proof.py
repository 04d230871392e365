"""Proof of photos: evidence, date and overlaps of an exposure decide, before and after it is accepted.

A photo is accepted when its evidence suffices, its date is one at which the pose was held, and nothing contradicts it.
Where a camera reports its photos, its report is required: a count or an acknowledgement says that some photo was taken,
not which one, nor when. What becomes known of an accepted photo later is judged again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from panoexec.devices import CaptureEvidence, EvidenceLevel, PendingCapture
from panoexec.mission import dated_exposure, evidence
from panoexec.mission.attempt import Shooter
from panoexec.mission.attempt_result import Exposure
from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.measured_certificate import overlaps_hold
from panoexec.mission.protocols import ReportsPhotos

_REMEMBERED: Final = 64
"""How many of the last accepted photos are judged again."""
_REQUIRED_PATIENCE: Final = 2.0
"""How much longer than `evidence_s` a required report is waited for: it is requested from the camera meanwhile."""
_LAST_LOOK_S: Final = 20.0
"""Longest wait for the first report of a camera at the end of a mission."""
_LOOK_EVERY_S: Final = 0.5
_TWICE: Final = "the camera's reports assign the same photo to two shots"
_ONE_FILE: Final = "the camera's reports name one file for two photos of a bracket"


class Verdicts(Protocol):
    """Records the verdicts on attempts."""

    def accept(self, shot: int, number: int, photos: Sequence[ev.Photo], *, by: str) -> None:
        """Accept the attempt."""
        ...

    def reject(self, shot: int, number: int, code: str, reason: str, photos: Sequence[ev.Photo]) -> None:
        """Reject the attempt."""
        ...

    def revoke(self, shot: int, number: int, code: str, reason: str, photos: Sequence[ev.Photo]) -> None:
        """Reject an attempt that was accepted."""
        ...


@dataclass(slots=True, kw_only=True)
class _Accepted:
    """An accepted attempt."""

    shot: int
    number: int
    photos: tuple[ev.Photo, ...]
    exposure: Exposure


class PhotoProof:
    """Waits for the evidence of exposures, and judges it."""

    def __init__(self, context: MissionContext, shooter: Shooter, verdicts: Verdicts) -> None:
        self._context = context
        self._shooter = shooter
        self._verdicts = verdicts
        self._recent: deque[_Accepted] = deque(maxlen=_REMEMBERED)
        self._dates = False  # whether the camera has dated a photo

    @property
    def _expected(self) -> EvidenceLevel:
        """Evidence that is waited for, though less may suffice: a report also dates the exposure."""
        wanted = self._context.settings.min_evidence
        camera = self._context.camera
        if isinstance(camera, ReportsPhotos) and camera.reports_photos:
            wanted = max(wanted, EvidenceLevel.CAPTURE_MESSAGE)
        return max(wanted, self._required)

    @property
    def _required(self) -> EvidenceLevel:
        """Evidence without which nothing is accepted: that of the camera's other photos."""
        return max(self._context.settings.min_evidence, self._context.record.reported_level)

    async def judge(self, shot: int, number: int, photos: Sequence[ev.Photo], exposure: Exposure, *, by: str) -> None:
        """Await the evidence of an exposure, then check its date and its overlaps; accept or reject the attempt.

        Args:
            shot: index of the shot.
            number: of the attempt.
            photos: with the evidence so far.
            exposure: of the attempt.
            by: why the pose is accepted.
        """
        settings, verdict = self._context.settings, exposure.verdict
        captures = exposure.captures
        proven = await evidence.gather(photos, captures, at_least=self._expected, timeout_s=settings.evidence_s)
        if evidence.weakest(proven) < self._required:
            patience_s = _REQUIRED_PATIENCE * settings.evidence_s
            proven = await evidence.gather(proven, captures, at_least=self._required, timeout_s=patience_s)
        code, why = await self._problem(shot, exposure)
        level = evidence.weakest(proven)
        if level < settings.min_evidence:
            reason = (
                f"the photo is only {level.name.lower()} after {settings.evidence_s:g} s,"
                f" {settings.min_evidence.name.lower()} is required"
            )
            self._verdicts.reject(shot, number, "evidence", reason, proven)
        elif code:
            self._verdicts.reject(shot, number, code, why, proven)
        elif level < self._required:
            self._verdicts.reject(shot, number, "evidence", _unreported(level), proven)
        elif _share_a_file(proven):
            self._verdicts.reject(shot, number, "evidence", _ONE_FILE, proven)
        elif others := self._claims(proven):
            self._verdicts.reject(shot, number, "evidence", _TWICE, proven)
            for other in others:
                self._revoke(other, "evidence", _TWICE)
        elif self._shooter.slews.echo.reason and by != "open_loop":  # found while the evidence was awaited
            self._verdicts.reject(shot, number, "echo", self._shooter.slews.echo.reason, proven)
        elif by == "overlap" and not await overlaps_hold(self._context, shot, verdict.measured):
            reason = f"{verdict.reason}, and the overlaps are too small with this pose"
            self._verdicts.reject(shot, number, verdict.code, reason, proven)
        else:
            self._verdicts.accept(shot, number, proven, by=by)
            self._recent.append(_Accepted(shot=shot, number=number, photos=tuple(proven), exposure=exposure))
        await self.review()

    async def review(self) -> None:
        """Judge accepted photos again by what became known of them since; returns without waiting for more."""
        for one in tuple(self._recent):
            level = EvidenceLevel.COMMANDED
            better = await evidence.gather(one.photos, one.exposure.captures, at_least=level, timeout_s=0.0)
            if one not in self._recent:
                continue  # another review was faster
            if any(map(_tells_more, better, one.photos)):
                one.photos = better
                self._context.recorder.emit(ev.PhotoIdentified(shot=one.shot, attempt=one.number, photos=better))
            code, why = await self._problem(one.shot, one.exposure)
            if one not in self._recent:
                continue
            reported = evidence.weakest(one.photos)
            if not code and len(claims := self._claims(one.photos)) > 1:
                for other in claims:
                    self._revoke(other, "evidence", _TWICE)
                continue
            if not code and _share_a_file(one.photos):
                code, why = "evidence", _ONE_FILE
            if not code and reported < self._context.record.reported_level and self._is_overdue(one):
                code, why = "evidence", _unreported(reported)
            if code:
                self._revoke(one, code, why)

    def _revoke(self, one: _Accepted, code: str, why: str) -> None:
        self._recent.remove(one)
        self._verdicts.revoke(one.shot, one.number, code, why, one.photos)

    def _claims(self, photos: Sequence[ev.Photo]) -> list[_Accepted]:
        """The accepted attempts that claim one of these photos, by its file."""
        files = {photo.file for photo in photos} - {""}
        return [one for one in self._recent if files & {photo.file for photo in one.photos}]

    async def last_look(self) -> None:
        """Review the accepted photos before the end; waits for a camera whose first report may be on its way."""
        clock = self._context.clock
        until_s = clock.monotonic() + _LAST_LOOK_S
        await self.review()
        while clock.monotonic() < until_s and any(map(self._may_be_reported, self._recent)):
            await clock.sleep(_LOOK_EVERY_S)
            await self.review()

    def _may_be_reported(self, one: _Accepted) -> bool:
        camera = self._context.camera
        level = evidence.weakest(one.photos)
        if level < self._context.record.reported_level:
            return True
        return level < EvidenceLevel.CAPTURE_MESSAGE and isinstance(camera, ReportsPhotos) and camera.reports_photos

    def _is_overdue(self, one: _Accepted) -> bool:
        """Whether a report that the camera gives of its other photos should have arrived."""
        since_s = self._context.clock.monotonic() - one.exposure.captures[-1].commanded_s
        return since_s > _REQUIRED_PATIENCE * self._context.settings.evidence_s

    async def follow_up(self, shot: int, number: int) -> None:
        """Await a report of an attempt that was accepted without one and judge it again; nothing waits for this."""
        one = next((one for one in self._recent if (one.shot, one.number) == (shot, number)), None)
        if one is not None:
            level, timeout_s = EvidenceLevel.CAPTURE_MESSAGE, self._context.settings.evidence_s
            await evidence.gather(one.photos, one.exposure.captures, at_least=level, timeout_s=timeout_s)
            await self.review()

    async def identify(
        self, shot: int, number: int, photos: Sequence[ev.Photo], captures: Sequence[PendingCapture]
    ) -> None:
        """Get the file names of photos that already have a verdict; nothing waits for this."""
        if evidence.weakest(photos) >= EvidenceLevel.CAPTURE_MESSAGE:
            return
        level, timeout_s = EvidenceLevel.CAPTURE_MESSAGE, self._context.settings.evidence_s
        better = await evidence.gather(photos, captures, at_least=level, timeout_s=timeout_s)
        await self._learn_lag(captures)
        attempts = self._context.record.shots[shot].attempts
        if better != tuple(photos) and better != attempts[number - 1].photos:
            self._context.recorder.emit(ev.PhotoIdentified(shot=shot, attempt=number, photos=better))

    async def _problem(self, index: int, exposure: Exposure) -> tuple[str, str]:
        """Code and reason if a photo may be another one, or was exposed at a wrong pose; ("", "") otherwise."""
        shot = self._context.record.shots[index].shot
        found = await self._learn_lag(exposure.captures)
        for one, capture in zip(found, exposure.captures, strict=True):
            if dated_exposure.is_before(one, capture.commanded_s):
                ago_s = capture.commanded_s - one.exposed_s
                return "evidence", f"the camera dates the photo {ago_s:.2f} s before its trigger: it is another one"
            verdict = await self._shooter.judge.judge_date(shot, one, capture.commanded_s, exposure)
            if verdict is not None and not verdict.ok:
                return "late_exposure", f"{dated_exposure.when(one, capture.commanded_s)}: {verdict.reason}"
        if exposure.by_opening and self._shooter.lag.is_irregular:
            return "late_exposure", "the camera's stamps are irregular: it is not known when the shutter was open"
        why = dated_exposure.contradictions(found)
        if not why and self._dates and any(map(dated_exposure.is_unlike_others, found)):
            why = "the camera's report has a time that cannot be dated, unlike its others: its clock was stepped"
        return ("evidence", why) if why else ("", "")

    async def _learn_lag(self, captures: Sequence[PendingCapture]) -> list[CaptureEvidence]:
        """The current evidence of photos; warns about a shutter lag longer than configured."""
        found = [await capture.evidence(EvidenceLevel.COMMANDED, 0.0) for capture in captures]
        for one, capture in zip(found, captures, strict=True):
            self._dates |= dated_exposure.is_dated(one) and one.level >= EvidenceLevel.CAPTURE_MESSAGE
            if text := self._shooter.lag.note(one, capture.commanded_s):
                self._context.recorder.emit(ev.Warned(code="latency", text=text))
        if text := self._shooter.interval_warning():
            self._context.recorder.emit(ev.Warned(code="interval", text=text))
        return found


def _tells_more(new: ev.Photo, old: ev.Photo) -> bool:
    named = (new.file and not old.file) or (new.image_index >= 0 > old.image_index)
    return new.evidence > old.evidence or bool(named)


def _share_a_file(photos: Sequence[ev.Photo]) -> bool:
    files = [photo.file for photo in photos if photo.file]
    return len(set(files)) < len(files)


def _unreported(level: EvidenceLevel) -> str:
    return f"the camera reported other photos, but not this one, which is only {level.name.lower()}"
