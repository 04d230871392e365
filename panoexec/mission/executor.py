"""The mission: every shot proven or the reason why not, and nothing lost whatever happens."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from typing import Literal

from panoexec.clock import Clock
from panoexec.devices import Camera, Gimbal, Vehicle
from panoexec.errors import MissionError
from panoexec.mission.attempt import Shooter
from panoexec.mission.context import MissionContext
from panoexec.mission.ending import Ending
from panoexec.mission.eta import EtaEstimator
from panoexec.mission.guard_monitor import GuardMonitor
from panoexec.mission.guards import Guard, flight_guards
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord, ShotStatus
from panoexec.mission.log.recorder import Recorder
from panoexec.mission.log.states import FINISHED, MissionState
from panoexec.mission.mission_requests import MissionRequests, Stop
from panoexec.mission.operator_commands import OperatorCommands
from panoexec.mission.pointing.heading import HeadingController
from panoexec.mission.preflight import battery_warning, preflight_problems
from panoexec.mission.protocols import Journal, Verifier
from panoexec.mission.recovery import settle_open_attempts
from panoexec.mission.reference_frame import anchor, tell_if_moved
from panoexec.mission.settings import MissionSettings
from panoexec.mission.shooting import Shooting
from panoexec.mission.shot_queue import ShotQueue
from panoexec.mission.waiting import first_failure, unbroken, until
from panoexec.planning.model import Certificate, Plan

PREFLIGHT_S = 5.0
"""How long preflight waits for problems to go away by themselves (a stream that has just been asked for)."""
DONE = frozenset({ShotStatus.ACCEPTED, ShotStatus.SKIPPED})


class Mission:
    """One mission from its start (or its resumption) to its end, in this process.

    `run` flies it; `verbs` may be used from other tasks of the same event loop meanwhile. Everything that happens goes
    through the recorder: durable in the journal first, then announced to the sink.

    Args:
        mission_id: names it for ever.
        plan: camera, constraints and shots.
        settings: how to fly it.
        gimbal, camera, vehicle: the devices.
        clock: the mission's time.
        journal: keeps the events.
        sink: gets the events once they are kept.
        verifier: computes certificates beside the event loop.
        reference: what the plan's yaw 0 means: true north, or the vehicle's heading at the start.
        past: events of this mission from an earlier process, to go on from.
        guards: watch the flight; None: those that the settings ask for.

    Raises:
        MissionError: the mission is finished and cannot be resumed.
        ValueError: the past contradicts itself (a damaged journal).
    """

    def __init__(
        self,
        *,
        mission_id: str,
        plan: Plan,
        settings: MissionSettings,
        gimbal: Gimbal,
        camera: Camera,
        vehicle: Vehicle,
        clock: Clock,
        journal: Journal,
        sink: ev.EventSink,
        verifier: Verifier,
        reference: Literal["north", "heading"] = "north",
        past: Sequence[ev.Event] = (),
        guards: tuple[Guard, ...] | None = None,
    ) -> None:
        record = MissionRecord.from_events(mission_id=mission_id, shots=plan.shots, events=past)
        if record.state in FINISHED:
            raise MissionError(f"mission {mission_id} is {record.state} and cannot be resumed: {record.reason}")
        again = record.asked.repeats
        todo = [index for index, shot in sorted(record.shots.items()) if shot.status not in DONE or index in again]
        self._flight = MissionContext(
            plan=plan,
            settings=settings,
            gimbal=gimbal,
            camera=camera,
            vehicle=vehicle,
            clock=clock,
            verifier=verifier,
            recorder=Recorder(record=record, journal=journal, sink=sink, clock=clock),
            control=MissionRequests(),
            queue=ShotQueue(todo, attempts=settings.attempts, rounds=settings.rounds),
            pace=EtaEstimator(expected_shot_s=_expected_shot_s(plan, settings)),
            turner=_turner(vehicle, clock, settings),
        )
        self._resumed = bool(past)
        self._reference = reference
        self._holding = GuardMonitor(self._flight, flight_guards(settings) if guards is None else guards)
        self._ending = Ending(self._flight)
        self._shooting: Shooting | None = None
        self._began = False
        self.verbs = OperatorCommands(self._flight)

    @property
    def record(self) -> MissionRecord:
        """All that is known of the mission; read only."""
        return self._flight.record

    @property
    def plan(self) -> Plan:
        """What is flown."""
        return self._flight.plan

    @property
    def certificate(self) -> Certificate | None:
        """Of the measured attitudes; None before the end."""
        return self._ending.certificate

    @property
    def eta_s(self) -> float:
        """Seconds until shooting is over, as learned so far."""
        return self._flight.pace.eta_s(self._flight.shots_left())

    @property
    def shot_s(self) -> float:
        """Seconds a shot costs, as learned so far."""
        return self._flight.pace.shot_s

    @property
    def shooting_s(self) -> float:
        """Seconds from the first slew of this process to the last verdict, pauses included; NaN before the end."""
        return math.nan if self._shooting is None else self._shooting.ended_s - self._shooting.began_s

    @property
    def turns(self) -> int:
        """How often this process has had the vehicle turned."""
        return 0 if self._flight.turner is None else self._flight.turner.turns

    @property
    def shooter(self) -> Shooter | None:
        """The part that points and triggers, for a look at the live pointing error; None before the start."""
        return None if self._shooting is None else self._shooting.shooter

    async def durable(self) -> None:
        """Return when everything that happened so far is on disk and announced."""
        await self._flight.recorder.durable()

    async def run(self) -> MissionRecord:
        """Fly the mission; returns at its end, whatever that is. Once only.

        Cancelling it stops at once and leaves a mission that can be resumed; `verbs.interrupt` does so after the photo.

        Raises:
            MissionError: the journal failed; the gimbal was released all the same.
        """
        if self._began:
            raise MissionError("a mission runs once; resume it from its journal")
        self._began = True
        recorder = self._flight.recorder
        try:
            async with asyncio.TaskGroup() as group:
                writing = group.create_task(recorder.run(), name="mission recorder")
                try:
                    await self._fly()
                finally:
                    recorder.close()
                    await unbroken(writing)
        except BaseExceptionGroup as failures:
            raise first_failure(failures) from None
        return self.record

    async def _fly(self) -> None:
        control = self._flight.control
        planned_end = False
        try:
            self._start()
            async with asyncio.TaskGroup() as group:
                watching = group.create_task(self._holding.watch(), name="mission guards")
                await self._course(group)
                control.over = True
                await self._holding.release()
                watching.cancel()
            planned_end = True
        except asyncio.CancelledError:
            control.ask_stop(Stop("interrupt", "panoexec was stopped at once; the mission can be resumed"))
            raise
        finally:
            if not planned_end and control.stop is None:
                control.ask_stop(Stop("fail", "panoexec met an error of its own; the mission can be resumed"))
            try:
                await unbroken(asyncio.create_task(self._holding.release(), name="release the gimbal"))
            finally:
                self._ending.conclude()

    def _start(self) -> None:
        flight, record = self._flight, self._flight.record
        status = flight.vehicle.status
        kind = record.reference if self._resumed else self._reference
        reference = record.reference_yaw_north_deg
        if math.isnan(reference):  # of a new mission, or one that never knew it and so took no photo
            reference = status.heading_deg if kind == "heading" else 0.0
        started = ev.MissionStarted(
            shots_total=record.shots_total,
            resumed=self._resumed,
            reference=kind,
            reference_yaw_north_deg=reference,
            latitude_deg=status.latitude_deg,
            longitude_deg=status.longitude_deg,
            altitude_m=status.altitude_m,
        )
        flight.recorder.emit(started, MissionState.PREFLIGHT)
        if self._resumed:
            tell_if_moved(flight)
        if flight.settings.feedback == "none":
            text = "no attitude feedback: poses are believed, not proven (open loop)"
            flight.recorder.emit(ev.Warned(code="open_loop", text=text))

    async def _course(self, group: asyncio.TaskGroup) -> None:
        """Preflight, shooting, finishing; returns when the mission is over or must end."""
        flight = self._flight
        if self._resumed:
            self._take_up_commands()
            await settle_open_attempts(flight)
            self._leave_out()
        checked = False
        while flight.control.stop is None:
            if len(flight.queue) and not checked and not flight.control.must_leave:  # also patches of a resumed one
                checked, _ = await until(flight.control.leaving.wait(), self._preflight(), "preflight")
            if self._shooting is None:  # now that the direction of yaw 0 is known
                self._shooting = Shooting(flight, self._holding, group)
            if not flight.control.must_leave:
                await self._shooting.run()
            await self._shooting.evidence_in()
            if flight.control.stop is not None or await self._ending.finish():
                return

    def _take_up_commands(self) -> None:
        """Go on to obey what the earlier process was told, and answered for, but did not come to do."""
        asked, control = self._flight.record.asked, self._flight.control
        if asked.end == "abort":
            control.ask_stop(Stop("abort", asked.reason or "aborted by command"))
        elif asked.end:
            control.ask_finish(asked.reason or "finished by command, the gaps are accepted")

    def _leave_out(self) -> None:
        """Shots that were to be skipped, unless their photo counts after all."""
        flight = self._flight
        for index in sorted(flight.record.asked.skips):
            shot = flight.record.shots[index]
            if shot.accepted is None and shot.open_attempt is None:
                flight.queue.drop(index)
                skipped = ev.ShotSkipped(shot=index, attempt=len(shot.attempts), reason="skipped by command")
                flight.recorder.emit(skipped)

    async def _preflight(self) -> None:
        flight = self._flight
        problems = self._problems()
        deadline = flight.clock.monotonic() + PREFLIGHT_S
        while problems and flight.clock.monotonic() < deadline:
            await flight.clock.sleep(0.25)
            problems = self._problems()
        if not problems and not await self._holding.acquire():
            problems = [hold.finding.reason for hold in flight.control.holds.values()]
        if problems:
            flight.recorder.emit(ev.PreflightFailed(problems=tuple(problems)))
            flight.control.ask_stop(Stop("fail", "; ".join(problems)))
            return
        warning = battery_warning(flight.vehicle.status.battery_frac, flight.settings.guards, expected_s=self.eta_s)
        if warning:
            flight.recorder.emit(ev.Warned(code="battery_estimate", text=warning))
        flight.recorder.emit(ev.PreflightPassed(), MissionState.CAPTURING)
        flight.pace.restart(flight.clock.monotonic())

    def _problems(self) -> list[str]:
        flight = self._flight
        anchor(flight)
        shots = [record.shot for record in flight.record.shots.values() if record.shot.index in flight.queue]
        reference = flight.record.reference_yaw_north_deg
        if math.isnan(reference):
            return ["the vehicle's heading is unknown, and the panorama is to start from it"]
        return preflight_problems(
            shots=shots,
            settings=flight.settings,
            gimbal=flight.gimbal,
            camera=flight.camera,
            vehicle=flight.vehicle,
            reference_yaw_north_deg=reference,
            now_s=flight.clock.monotonic(),
            expected_s=self.eta_s,
        )


def _turner(vehicle: Vehicle, clock: Clock, settings: MissionSettings) -> HeadingController | None:
    turning = settings.gimbal.turning
    if turning is None:
        return None
    return HeadingController(
        vehicle=vehicle, clock=clock, turning=turning, tolerance_yaw_deg=settings.tolerance.yaw_deg
    )


def _expected_shot_s(plan: Plan, settings: MissionSettings) -> float:
    """A first guess of the seconds a shot costs."""
    least = max(settings.interval_s, settings.settle_s + settings.exposure_bound_s)
    if plan.estimate is None or not plan.shots:
        return least + 1.0
    return max(least, plan.estimate.duration_s / len(plan.shots))
