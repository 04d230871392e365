"""The loop over the shots: attempt, verdict, retake. Evidence is awaited while the gimbal slews to the next shot."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence

import structlog

from panoexec.devices import CaptureEvidence, EvidenceLevel, PendingCapture
from panoexec.mission import dated_exposure, evidence
from panoexec.mission.attempt import Shooter
from panoexec.mission.attempt_result import Exposure, NotSettled, Settled
from panoexec.mission.context import MissionContext
from panoexec.mission.guard_monitor import GuardMonitor
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import Verdict
from panoexec.mission.log.states import MissionState
from panoexec.mission.measured_certificate import overlaps_hold
from panoexec.mission.mission_requests import Stop
from panoexec.mission.pointing.steady_error import cannot_hold
from panoexec.mission.pointing.tolerance_gate import WindowVerdict
from panoexec.mission.preflight import ECHO_ADVICE
from panoexec.mission.protocols import ReportsPhotos
from panoexec.mission.shot_queue import Decision, Task
from panoexec.mission.waiting import until


class Shooting:
    """Takes the queued shots until the queue is empty and all evidence has arrived, or shooting must end."""

    def __init__(self, context: MissionContext, guard_monitor: GuardMonitor, group: asyncio.TaskGroup) -> None:
        self._context = context
        self._guard_monitor = guard_monitor
        self._group = group
        self._outstanding = 0
        self._proven = asyncio.Event()
        self._must_keep_seq = 0
        self.began_s = math.nan
        """When the first slew began, on the mission's clock."""
        self.ended_s = math.nan
        """When the last photo got its verdict."""
        self.shooter = Shooter(
            gimbal=context.gimbal,
            camera=context.camera,
            clock=context.clock,
            settings=context.settings,
            reference_yaw_north_deg=context.record.reference_yaw_north_deg,
            open_loop=context.settings.feedback == "none",
            heading_controller=context.heading_controller,
        )

    async def run(self) -> None:
        """Take the remaining shots, if any; afterwards the mission is capturing or paused if a shot was taken."""
        context, requests = self._context, self._context.requests
        if math.isnan(self.began_s):
            self.began_s = context.clock.monotonic()
        while not requests.must_end_shooting:
            requests.settled()
            if context.record.state is MissionState.CAPTURING:
                self._guard_monitor.look()  # conditions may have changed during the last wait
            if requests.holds:
                await self._guard_monitor.hold()
            elif not len(context.queue) and not self._outstanding:
                return
            elif not len(context.queue):
                self._proven.clear()
                await until(requests.changed.wait(), self._proven.wait(), "evidence")
            elif context.record.gimbal_held or await self._guard_monitor.acquire():
                task = context.queue.take()
                assert task is not None
                await self._attempt(task)

    async def evidence_in(self) -> None:
        """Return when no photo awaits evidence any more (each wait has a timeout), or the mission must stop."""
        while self._outstanding and self._context.requests.stop is None:
            self._proven.clear()
            await until(self._context.requests.stopping.wait(), self._proven.wait(), "last evidence")
        self.ended_s = self._context.clock.monotonic()

    async def _attempt(self, task: Task) -> None:
        context = self._context
        record = context.record.shots[task.shot]
        shot, number = record.shot, len(record.attempts) + 1
        patience_s = context.settings.patience_s * 2**task.round
        started = ev.ShotStarted(
            shot=shot.index,
            attempt=number,
            round=task.round,
            pitch_deg=shot.pitch_deg,
            yaw_deg=shot.yaw_deg,
            patience_s=patience_s,
        )
        self._keep(started)
        # log entries of the devices, and of tasks that await this photo's evidence, carry its ids
        with structlog.contextvars.bound_contextvars(shot=shot.index, attempt=number):
            await self._take(task, number, patience_s)

    async def _take(self, task: Task, number: int, patience_s: float) -> None:
        context, requests = self._context, self._context.requests
        shot = context.record.shots[task.shot].shot
        coming = (
            [context.record.shots[index].shot.yaw_deg for index in context.queue.coming()]
            if context.heading_controller
            else []
        )
        approach = self.shooter.approach(shot, patience_s=patience_s, clear=self._blocker, coming_yaw_deg=coming)
        done, result = await until(requests.interrupt.wait(), approach, f"shot {shot.index}")
        if not done or result is None or (requests.interrupt.is_set() and isinstance(result, Settled)):
            self._interrupted(shot.index, number)
            return
        exposure: Exposure | NotSettled
        if isinstance(result, Settled):
            exposure = await self.shooter.expose(shot, result, interrupt=requests.interrupt)
        else:
            exposure = result
        if isinstance(exposure, NotSettled):
            self._reject(shot.index, number, exposure.code, exposure.reason, ())
            self._learn_from(exposure)
            return
        assert isinstance(result, Settled)
        self._exposed(shot.index, number, result, exposure)

    def _learn_from(self, failure: NotSettled) -> None:
        """Stop the mission if the gimbal has shown that no pose can be verified, or that none can be held."""
        context, known = self._context, self._context.gimbal.known
        if failure.code == "echo":
            known.echo = self.shooter.echo.reason
            self._revoke_unverified()
            context.requests.request_stop(Stop("fail", f"{failure.reason}; {ECHO_ADVICE}"))
            return
        steady = self.shooter.steady_error.found
        if steady is None or context.record.shots_done:
            return
        if why := cannot_hold(steady, context.settings.tolerance):
            known.steady_error = steady
            context.requests.request_stop(Stop("fail", why))

    def _revoke_unverified(self) -> None:
        """No photo stays accepted whose pose was read from an echo."""
        for index, shot in sorted(self._context.record.shots.items()):
            for attempt in shot.attempts:
                if attempt.verdict is Verdict.ACCEPTED and attempt.by != "open_loop":
                    reason = f"the pose was never measured: {self.shooter.echo.reason}"
                    self._keep(ev.ShotRevoked(shot=index, attempt=attempt.number, code="echo", reason=reason))

    def _exposed(self, shot: int, number: int, settled: Settled, exposure: Exposure) -> None:
        may_overlap = not exposure.failure and not exposure.broken_off and self._may_overlap(exposure.verdict)
        verdict, photos = exposure.verdict, evidence.first_photos(exposure.trigger_utc_s, exposure.captures)
        exposed = ev.ShotExposed(
            shot=shot,
            attempt=number,
            photos=photos,
            pointing_ok=verdict.ok,
            reason=verdict.reason,
            samples=verdict.samples,
            measured=verdict.measured,
            errors=verdict.errors,
            slew_settle_s=settled.settled_s - settled.commanded_s,
            trigger_delay_s=exposure.trigger_delay_s,
            open_loop=self.shooter.open_loop,
            images_before=exposure.images_before,
            may_overlap=may_overlap,
        )
        self._keep(exposed)
        if exposure.broken_off:
            self._interrupted(shot, number)
            self._group.create_task(self._identify(shot, number, photos, exposure.captures), name=f"photo of {shot}")
            return
        by = "open_loop" if self.shooter.open_loop else "tolerance" if verdict.ok else "overlap"
        if not exposure.failure and (verdict.ok or may_overlap):
            self._outstanding += 1
            proof = self._prove(shot, number, photos, exposure, by=by)
            self._group.create_task(proof, name=f"evidence of {shot}")
            return
        code = "trigger" if exposure.failure else verdict.code
        self._reject(shot, number, code, exposure.failure or verdict.reason, photos)
        self._group.create_task(self._identify(shot, number, photos, exposure.captures), name=f"photo of {shot}")

    def _may_overlap(self, verdict: WindowVerdict) -> bool:
        """Whether an exposure outside tolerance is sharp and measured, so that the overlaps may still accept it."""
        settings = self._context.settings
        sharp = verdict.spread_deg <= settings.max_rate_deg_s * settings.exposure_bound_s
        return settings.accept == "overlap" and verdict.code == "pointing" and sharp

    async def _prove(
        self,
        shot: int,
        number: int,
        photos: Sequence[ev.Photo],
        exposure: Exposure,
        *,
        by: str,
    ) -> None:
        """Await the evidence of an exposure, then check its date and its overlaps; accept or reject the attempt."""
        settings = self._context.settings
        captures, verdict = exposure.captures, exposure.verdict
        wanted = settings.min_evidence
        if isinstance(self._context.camera, ReportsPhotos) and self._context.camera.reports_photos:
            wanted = max(wanted, EvidenceLevel.CAPTURE_MESSAGE)  # its report also dates the exposure
        try:
            proven = await evidence.gather(photos, captures, at_least=wanted, timeout_s=settings.evidence_s)
            code, why = await self._evidence_problem(shot, exposure)
            level = evidence.weakest(proven)
            if level < settings.min_evidence:
                reason = (
                    f"the photo is only {level.name.lower()} after {settings.evidence_s:g} s,"
                    f" {settings.min_evidence.name.lower()} is required"
                )
                self._reject(shot, number, "evidence", reason, proven)
            elif code:
                self._reject(shot, number, code, why, proven)
            elif self.shooter.echo.reason and by != "open_loop":  # found while the evidence was awaited
                self._reject(shot, number, "echo", self.shooter.echo.reason, proven)
            elif by == "overlap" and not await overlaps_hold(self._context, shot, verdict.measured):
                reason = f"{verdict.reason}, and the overlaps are too small with this pose"
                self._reject(shot, number, verdict.code, reason, proven)
            else:
                self._keep(ev.ShotAccepted(shot=shot, attempt=number, photos=proven, by=by))
                self._context.requests.skips.discard(shot)
                self._context.eta.accepted(self._context.clock.monotonic())
        finally:
            self._outstanding -= 1
            self._proven.set()
        await self._identify(shot, number, proven, captures)

    async def _evidence_problem(self, index: int, exposure: Exposure) -> tuple[str, str]:
        """Code and reason if a photo may be another one, or was exposed at a wrong pose; ("", "") otherwise."""
        shot = self._context.record.shots[index].shot
        found = await self._learn_lag(exposure.captures)
        for one, capture in zip(found, exposure.captures, strict=True):
            verdict = await self.shooter.judge_date(shot, one, capture.commanded_s, exposure)
            if verdict is not None and not verdict.ok:
                return "late_exposure", f"{dated_exposure.when(one, capture.commanded_s)}: {verdict.reason}"
        why = dated_exposure.contradictions(found)
        return ("evidence", why) if why else ("", "")

    async def _learn_lag(self, captures: Sequence[PendingCapture]) -> list[CaptureEvidence]:
        """The current evidence of photos; warns about a shutter lag longer than configured."""
        found = [await capture.evidence(EvidenceLevel.COMMANDED, 0.0) for capture in captures]
        for one, capture in zip(found, captures, strict=True):
            if text := self.shooter.lag.note(one, capture.commanded_s):
                self._context.recorder.emit(ev.Warned(code="latency", text=text))
        if text := self.shooter.interval_warning():
            self._context.recorder.emit(ev.Warned(code="interval", text=text))
        return found

    async def _identify(
        self, shot: int, number: int, photos: Sequence[ev.Photo], captures: Sequence[PendingCapture]
    ) -> None:
        """Get the file names of photos that already have a verdict; nothing waits for this."""
        if evidence.weakest(photos) >= EvidenceLevel.CAPTURE_MESSAGE:
            return
        level, timeout_s = EvidenceLevel.CAPTURE_MESSAGE, self._context.settings.evidence_s
        better = await evidence.gather(photos, captures, at_least=level, timeout_s=timeout_s)
        await self._learn_lag(captures)
        if better != tuple(photos):
            self._context.recorder.emit(ev.PhotoIdentified(shot=shot, attempt=number, photos=better))

    def _interrupted(self, shot: int, number: int) -> None:
        requests = self._context.requests
        why = "skipped" if shot in requests.skips else "finishing" if requests.must_end_shooting else "paused"
        self._keep(ev.ShotInterrupted(shot=shot, attempt=number, reason=why))
        if not self._skipped(shot, number):
            self._context.queue.put_back(shot)

    def _reject(self, shot: int, number: int, code: str, reason: str, photos: Sequence[ev.Photo]) -> None:
        self._keep(ev.ShotRejected(shot=shot, attempt=number, code=code, reason=reason, photos=tuple(photos)))
        if self._skipped(shot, number):
            return
        emit, queue = self._context.recorder.emit, self._context.queue
        match queue.rejected(shot):
            case Decision.AT_ONCE:
                emit(ev.ShotRetaken(shot=shot, attempt=number + 1, reason=reason))
            case Decision.LATER:
                emit(ev.ShotDeferred(shot=shot, attempt=number, reason=reason, round=queue.round_of(shot)))
            case Decision.GIVE_UP:
                emit(ev.ShotMissed(shot=shot, attempt=number, reason=reason))

    def _skipped(self, shot: int, number: int) -> bool:
        requests = self._context.requests
        if shot not in requests.skips:
            return False
        requests.skips.discard(shot)
        self._context.queue.drop(shot)
        self._context.recorder.emit(ev.ShotSkipped(shot=shot, attempt=number, reason="skipped by command"))
        return True

    def _keep(self, event: ev.Event) -> None:
        """Emit an event that must be on disk before the next trigger."""
        self._must_keep_seq = self._context.recorder.emit(event).seq

    def _blocker(self) -> asyncio.Event | None:
        """What blocks the next trigger: the journal, or outstanding evidence of earlier photos; None: nothing."""
        blocker = self._context.recorder.blocker(self._must_keep_seq)
        if blocker is not None:
            return blocker
        if self._outstanding >= self._context.settings.pending:
            self._proven.clear()
            return self._proven
        return None
