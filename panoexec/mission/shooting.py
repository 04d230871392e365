"""The loop over the shots: attempt, verdict, retake. Evidence is awaited while the gimbal slews to the next shot."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence

import structlog

from panoexec.mission import evidence
from panoexec.mission.attempt import Shooter
from panoexec.mission.attempt_result import Exposure, NotSettled, Offset, Settled
from panoexec.mission.context import MissionContext
from panoexec.mission.guard_monitor import GuardMonitor
from panoexec.mission.guards import Finding
from panoexec.mission.log import events as ev
from panoexec.mission.log.shot_record import ShotStatus, Verdict
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import Stop
from panoexec.mission.parallax import ParallaxWatch
from panoexec.mission.photo_proof import PhotoProof
from panoexec.mission.pointing.nose_hold import HEADING_CODE
from panoexec.mission.pointing.steady_error import cannot_hold
from panoexec.mission.pointing.tolerance_gate import WindowVerdict
from panoexec.mission.preflight import ECHO_ADVICE, gimbal_limits
from panoexec.mission.shot_queue import Decision, Task
from panoexec.mission.systematic_failure import SystematicFailure
from panoexec.mission.waiting import until

_log = structlog.get_logger(__name__)


class Shooting:
    """Takes the queued shots until the queue is empty and all evidence has arrived, or shooting must end."""

    def __init__(self, context: MissionContext, guard_monitor: GuardMonitor, group: asyncio.TaskGroup) -> None:
        self._context = context
        self._guard_monitor = guard_monitor
        self._group = group
        self._outstanding = self._followed = 0
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
        self._parallax = ParallaxWatch(context)
        self._proof = PhotoProof(context, self.shooter, self)
        pans = gimbal_limits(context.gimbal, context.settings).pans
        self._failures = SystematicFailure(
            context.settings.tolerance, vehicle_pans=context.heading_controller is not None and not pans
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
        """Return when no photo awaits evidence any more (each wait has a timeout), or the mission must stop.

        That of photos that were accepted with less is waited for, too: it may take one back, and what is certified then
        must be what stays accepted.
        """
        while (self._outstanding or self._followed) and self._context.requests.stop is None:
            self._proven.clear()
            await until(self._context.requests.stopping.wait(), self._proven.wait(), "last evidence")
        if self._context.requests.stop is None:
            await until(self._context.requests.stopping.wait(), self._proof.last_look(), "last look at the photos")
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
            self.reject(shot.index, number, exposure.code, exposure.reason, (), offset=exposure.offset)
            self._learn_from(exposure)
            return
        assert isinstance(result, Settled)
        self._exposed(shot.index, number, result, exposure)

    def _learn_from(self, failure: NotSettled) -> None:
        """Stop the mission if the gimbal has shown that no pose can be verified, or that none can be held."""
        context, known = self._context, self._context.gimbal.known
        if failure.code == "echo":
            known.echo = self.shooter.slews.echo.reason
            self._revoke_unverified()
            context.requests.request_stop(Stop("fail", f"{failure.reason}; {ECHO_ADVICE}"))
            return
        nose, settings = self.shooter.slews.nose, context.settings
        if why := nose.cannot_hold(settings.tolerance.yaw_deg, settings.max_rate_deg_s):
            finding = Finding(code=HEADING_CODE, reason=why, automatic=False, retry=True)
            self._hold_for(finding, nose.shots)
            nose.settled()
            return
        steady = self.shooter.slews.steady_error.found
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
                    reason = f"the pose was never measured: {self.shooter.slews.echo.reason}"
                    self._keep(ev.ShotRevoked(shot=index, attempt=attempt.number, code="echo", reason=reason))

    def _exposed(self, shot: int, number: int, settled: Settled, exposure: Exposure) -> None:
        may_overlap = not exposure.failure and not exposure.broken_off and self._may_overlap(exposure.verdict)
        verdict, photos = exposure.verdict, evidence.first_photos(exposure.trigger_utc_s, exposure.captures)
        status = self._context.vehicle.status
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
            latitude_deg=status.latitude_deg,
            longitude_deg=status.longitude_deg,
            altitude_m=status.altitude_m,
            height_m=status.relative_altitude_m,
            proof=verdict.proof,
        )
        self._keep(exposed)
        if exposure.broken_off:
            self._interrupted(shot, number)
            self._group.create_task(
                self._proof.identify(shot, number, photos, exposure.captures), name=f"photo of {shot}"
            )
            return
        by = "open_loop" if self.shooter.open_loop else "tolerance" if verdict.ok else "overlap"
        too_far = "" if exposure.failure else self._parallax.problem(shot, exposed)
        if not exposure.failure and not too_far and (verdict.ok or may_overlap):
            self._outstanding += 1
            proof = self._prove(shot, number, photos, exposure, by=by)
            self._group.create_task(proof, name=f"evidence of {shot}")
            return
        code = "trigger" if exposure.failure else "parallax" if too_far else verdict.code
        reason = exposure.failure or too_far or verdict.reason
        self.reject(shot, number, code, reason, photos, offset=_offset_of(verdict))
        self._group.create_task(self._proof.identify(shot, number, photos, exposure.captures), name=f"photo of {shot}")

    def _may_overlap(self, verdict: WindowVerdict) -> bool:
        """Whether an exposure outside tolerance is sharp and measured, so that the overlaps may still accept it."""
        settings = self._context.settings
        sharp = verdict.spread_deg <= settings.max_rate_deg_s * settings.exposure_bound_s
        return settings.accept == "overlap" and verdict.code == "pointing" and sharp

    async def _prove(self, shot: int, number: int, photos: Sequence[ev.Photo], exposure: Exposure, *, by: str) -> None:
        """Have an exposure judged by its evidence; the next trigger waits for this."""
        try:
            await self._proof.judge(shot, number, photos, exposure, by=by)
        finally:
            self._outstanding -= 1
            self._proven.set()
        self._followed += 1
        try:
            await self._proof.follow_up(shot, number)
        finally:
            self._followed -= 1
            self._proven.set()

    def accept(self, shot: int, number: int, photos: Sequence[ev.Photo], *, by: str) -> None:
        """See `Verdicts.accept`."""
        self._failures.reset()
        self._keep(ev.ShotAccepted(shot=shot, attempt=number, photos=tuple(photos), by=by))
        self._context.requests.skips.discard(shot)
        self._parallax.accepted(shot, self._context.record.shots[shot].attempts[number - 1])
        self._context.eta.accepted(self._context.clock.monotonic())

    def _interrupted(self, shot: int, number: int) -> None:
        requests = self._context.requests
        why = "skipped" if shot in requests.skips else "finishing" if requests.must_end_shooting else "paused"
        self._keep(ev.ShotInterrupted(shot=shot, attempt=number, reason=why))
        if not self._skipped(shot, number):
            self._context.queue.put_back(shot)

    def reject(
        self,
        shot: int,
        number: int,
        code: str,
        reason: str,
        photos: Sequence[ev.Photo],
        *,
        offset: Offset | None = None,
    ) -> None:
        """See `Verdicts.reject`; with its pointing error, if known. Holds the mission if several shots fail alike."""
        self._keep(ev.ShotRejected(shot=shot, attempt=number, code=code, reason=reason, photos=tuple(photos)))
        if self._skipped(shot, number):
            return
        self._again(shot, number, reason)
        failure = self._failures.rejected(
            self._context.record.shots[shot].shot, code=code, reason=reason, offset=offset
        )
        if failure is not None:
            self._hold_for(failure, self._failures.shots)

    def _hold_for(self, failure: Finding, shots: Sequence[int]) -> None:
        """Pause for a systematic failure; its shots get all their attempts back and are first after a `resume`."""
        for shot in reversed(shots):
            record = self._context.record.shots[shot]
            if record.accepted is None and record.open_attempt is None and record.status is not ShotStatus.SKIPPED:
                self._context.queue.restore(shot)
        self._failures.reset()
        _log.warning("systematic failure", code=failure.code, reason=failure.reason)
        self._context.requests.hold(failure)

    def revoke(self, shot: int, number: int, code: str, reason: str, photos: Sequence[ev.Photo]) -> None:
        """See `Verdicts.revoke`; the shot is taken again unless an earlier photo of it counts."""
        self._keep(ev.ShotRevoked(shot=shot, attempt=number, code=code, reason=reason, photos=tuple(photos)))
        record = self._context.record.shots[shot]
        if record.accepted is None and record.open_attempt is None and shot not in self._context.queue:
            self._again(shot, number, reason)

    def _again(self, shot: int, number: int, reason: str) -> None:
        """Decide when a shot is taken again, if at all."""
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


def _offset_of(verdict: WindowVerdict) -> Offset | None:
    errors = verdict.errors
    if errors is None:
        return None
    return Offset(pitch_deg=errors.pitch_deg, roll_deg=errors.roll_deg, yaw_deg=errors.yaw_deg)
