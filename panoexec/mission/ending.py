"""The end of a mission: certify the panorama as flown, patch real holes, say how it ended."""

from __future__ import annotations

from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.waiting import until
from panoexec.planning.model import Certificate, Hole


class Ending:
    """Decides how a mission ends.

    Attributes:
        certificate: of the measured attitudes, once it was computed.
    """

    def __init__(self, flight: MissionContext) -> None:
        self._flight = flight
        self.certificate: Certificate | None = None

    async def finish(self) -> bool:
        """Certify what was flown; returns False when shooting goes on (patches, a repeat), True when it is over."""
        flight = self._flight
        if flight.record.state is not MissionState.FINISHING:
            reason = flight.control.finish or "nothing is left to shoot"
            flight.recorder.emit(ev.MissionFinishing(reason=reason), MissionState.FINISHING)
        await until(flight.control.stopping.wait(), self._certify(), "certificate")
        if flight.control.stop is not None:
            return True
        if not flight.control.must_leave and await self._patched():
            return False
        if len(flight.queue) and not flight.control.must_leave:
            flight.recorder.emit(ev.MissionResumed(paused_s=0.0, reason="a shot is repeated"), MissionState.CAPTURING)
            return False
        return True

    def conclude(self) -> None:
        """Emit the last event of this process."""
        flight, record, stop = self._flight, self._flight.record, self._flight.control.stop
        if record.ended:
            return
        if stop is not None and stop.kind == "interrupt":
            flight.recorder.emit(ev.MissionPaused(code="interrupted", reason=stop.reason), MissionState.PAUSED)
            return
        missing = record.missing()
        certified = None if self.certificate is None else self.certificate.certified
        if stop is not None:
            state = MissionState.ABORTED if stop.kind == "abort" else MissionState.FAILED
            reason = stop.reason
        elif not missing and (hole := self._hole()) is not None:
            state = MissionState.INCOMPLETE
            reason = (
                f"every shot was accepted, but as flown there is a hole of {hole.size_deg:.2g}° at elevation"
                f" {hole.elevation_deg:.1f}°, azimuth {hole.azimuth_deg:.1f}°"
            )
        elif not missing:
            state, reason = MissionState.COMPLETE, "every shot was accepted"
        elif certified:
            state = MissionState.COMPLETE
            reason = f"{len(missing)} shots are missing, but the measured attitudes prove the panorama complete"
        else:
            state, reason = MissionState.INCOMPLETE, f"{len(missing)} of {record.shots_total} shots are missing"
            if flight.control.finish is not None:
                reason += f" ({flight.control.finish})"
        finished = ev.MissionFinished(reason=reason, accepted=record.shots_done, missing=missing, certified=certified)
        flight.recorder.emit(finished, state)

    def _hole(self) -> Hole | None:
        """The largest hole as flown where the plan has none: drifted shots that counted by their overlaps left it."""
        planned = self._flight.plan.certificate
        if self.certificate is None or planned is None or planned.holes or not self.certificate.holes:
            return None
        return self.certificate.holes[0]

    async def _certify(self) -> None:
        rotations, rows = self._flight.record.measured()
        self.certificate = await self._flight.verifier.certify(rotations, rows) if rows else None

    async def _patched(self) -> bool:
        flight, record = self._flight, self._flight.record
        holes = () if self.certificate is None else self.certificate.holes
        if not holes or record.patch_rounds >= flight.settings.patches:
            return False
        # what was left out by decision is no hole to be patched
        rotations, rows = record.measured(also=record.skipped())
        _, shots = await until(flight.control.stopping.wait(), flight.verifier.patch(rotations, rows), "patches")
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
        flight.recorder.emit(planned, MissionState.CAPTURING)
        for shot in patches:
            flight.queue.add(shot.index)
        return True
