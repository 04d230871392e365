"""The end of a mission: certify the measured attitudes, patch holes, determine the final state."""

from __future__ import annotations

import math

from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState
from panoexec.mission.waiting import until
from panoexec.planning.model import Certificate, Hole

_NAMED = 5


class Ending:
    """Determines a mission's final state."""

    def __init__(self, context: MissionContext) -> None:
        self._context = context
        self._computed: Certificate | None = None
        self._counted: tuple[tuple[int, int], ...] = ()

    @property
    def certificate(self) -> Certificate | None:
        """Of the measured attitudes; None before it was computed, and once other photos are accepted than it counts."""
        return self._computed if self._counted == self._accepted() else None

    def _accepted(self) -> tuple[tuple[int, int], ...]:
        """Shots and attempts whose photos are accepted."""
        shots = self._context.record.shots.items()
        return tuple((index, shot.accepted.number) for index, shot in sorted(shots) if shot.accepted is not None)

    async def finish(self) -> bool:
        """Certify the measured attitudes; returns whether the mission is over (no patches, no repeat to take)."""
        context = self._context
        if context.record.state is not MissionState.FINISHING:
            reason = context.requests.finish or "no shots are left"
            context.recorder.emit(ev.MissionFinishing(reason=reason), MissionState.FINISHING)
        await until(context.requests.stopping.wait(), self._certify(), "certificate")
        if context.requests.stop is not None:
            return True
        if not context.requests.must_end_shooting and await self._patched():
            return False
        if len(context.queue) and not context.requests.must_end_shooting:
            context.recorder.emit(ev.MissionResumed(paused_s=0.0, reason="a shot is repeated"), MissionState.CAPTURING)
            return False
        return True

    def conclude(self) -> None:
        """Emit the last event of this process."""
        context, record, stop = self._context, self._context.record, self._context.requests.stop
        if record.ended:
            return
        if stop is not None and stop.kind == "interrupt":
            context.recorder.emit(ev.MissionPaused(code="interrupted", reason=stop.reason), MissionState.PAUSED)
            return
        missing = record.missing()
        # nothing hangs on a bridge shot: it adds a tie or nothing
        lost = [shot for shot in missing if record.shots[shot].between is None]
        certified = None if self.certificate is None else self.certificate.certified
        if stop is not None:
            state = MissionState.ABORTED if stop.kind == "abort" else MissionState.FAILED
            reason = stop.reason
        elif not lost and (hole := self._hole()) is not None:
            state = MissionState.INCOMPLETE
            reason = (
                f"every shot was accepted, but the measured attitudes leave a hole of {hole.size_deg:.2g}° at elevation"
                f" {hole.elevation_deg:.1f}°, azimuth {hole.azimuth_deg:.1f}°"
            )
        elif not lost and record.bad_photos():
            state, reason = MissionState.INCOMPLETE, f"{_all_but(len(missing))} accepted, but {_said(record)}"
        elif not lost:
            state, reason = MissionState.COMPLETE, f"{_all_but(len(missing))} accepted{_proved(record)}"
        elif certified and not record.bad_photos():
            state = MissionState.COMPLETE
            reason = f"{len(missing)} shots are missing, but the measured attitudes prove the panorama complete"
        else:
            state, reason = MissionState.INCOMPLETE, f"{len(missing)} of {record.shots_total} shots are missing"
            if context.requests.finish is not None:
                reason += f" ({context.requests.finish})"
        finished = ev.MissionFinished(reason=reason, accepted=record.shots_done, missing=missing, certified=certified)
        context.recorder.emit(finished, state)

    def _hole(self) -> Hole | None:
        """The largest hole of the measured attitudes if the plan has none: left by shots accepted by their overlaps."""
        planned = self._context.plan.certificate
        if self.certificate is None or planned is None or planned.holes or not self.certificate.holes:
            return None
        return self.certificate.holes[0]

    async def _certify(self) -> None:
        counted = self._accepted()
        rotations, rows = self._context.record.measured()
        self._computed = await self._context.verifier.certify(rotations, rows) if rows else None
        self._counted = counted

    async def _patched(self) -> bool:
        context, record = self._context, self._context.record
        holes = () if self.certificate is None else self.certificate.holes
        if not holes or record.patch_rounds >= context.settings.patches:
            return False
        # a skipped shot leaves no hole to patch
        rotations, rows = record.measured(also=record.skipped())
        _, shots = await until(context.requests.stopping.wait(), context.verifier.patch(rotations, rows), "patches")
        if not shots:
            return False
        patches = record.renumbered(shots)
        planned = ev.PatchPlanned(
            shots=tuple(shot.index for shot in patches),
            rows=tuple(shot.row for shot in patches),
            pitch_deg=tuple(shot.pitch_deg for shot in patches),
            yaw_deg=tuple(shot.yaw_deg for shot in patches),
            holes=len(holes),
            largest_hole_deg=holes[0].size_deg,
        )
        context.recorder.emit(planned, MissionState.CAPTURING)
        for shot in patches:
            context.queue.add(shot.index)
        return True


def _all_but(bridges: int) -> str:
    """Begin of a sentence about all shots; bridge shots that were not taken are named."""
    return f"every shot but {bridges} bridge shots was" if bridges else "every shot was"


def _said(record: MissionRecord) -> str:
    """Which photos do not count, and why."""
    bad = record.bad_photos()
    named = ", ".join(f"shot {shot} ({code})" for shot, code in list(bad.items())[:_NAMED])
    more = f" and {len(bad) - _NAMED} more" if len(bad) > _NAMED else ""
    return f"the content of {len(bad)} photos does not count: {named}{more}"


def _proved(record: MissionRecord) -> str:
    """What the content adds to the geometry; nothing if no content was to be checked."""
    content = record.content
    if content is None:
        return ""
    parts = []
    if content.geometry_only:
        bound = "" if math.isnan(content.geometry_bound_deg) else f" (within {content.geometry_bound_deg:.2g}°)"
        parts.append(f"{len(content.geometry_only)} photos are proved by geometry only{bound}")
    if content.unchecked:
        parts.append(f"the content of {len(content.unchecked)} is unchecked")
    failed = [shot for shot, tied in record.bridge_ties().items() if len(tied) < 2]
    if failed:
        parts.append(f"{len(failed)} bridge shots do not tie what they were to tie")
    if content.groups > 1:
        parts.append(f"the photos are tied in {content.groups} groups that only geometry connects")
    return "; " + "; ".join(parts) if parts else "; their content is good"
