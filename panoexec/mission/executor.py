"""The mission executor: runs the phases of a mission and records every event before it is published."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Literal, TypeVar

from panoexec.clock import Clock
from panoexec.devices import Camera, Gimbal, Vehicle
from panoexec.errors import DeviceError, MissionError
from panoexec.mission.attempt import Shooter
from panoexec.mission.content_check import ContentCheck, PictureSource
from panoexec.mission.context import MissionContext
from panoexec.mission.ending import Ending
from panoexec.mission.eta import EtaEstimator
from panoexec.mission.guard_monitor import GuardMonitor
from panoexec.mission.guards import Guard, flight_guards, parallax_guard
from panoexec.mission.lens_check import lens_problem
from panoexec.mission.live_pose import LivePose, live_pose
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.recorder import Recorder
from panoexec.mission.log.shot_record import ShotStatus
from panoexec.mission.log.states import FINISHED, MissionState
from panoexec.mission.metering import meter_exposure
from panoexec.mission.mission_requests import MissionRequests, Stop
from panoexec.mission.operator_commands import OperatorCommands
from panoexec.mission.pointing.heading import HeadingController
from panoexec.mission.preflight import battery_need_frac, battery_warning, preflight_problems
from panoexec.mission.protocols import Journal, LimitsTurns, PreparesForPhotos, TellsLens, Verifier
from panoexec.mission.recovery import settle_open_attempts
from panoexec.mission.reference_frame import update_reference_frame, warn_if_moved
from panoexec.mission.settings import MissionSettings
from panoexec.mission.shooting import Shooting
from panoexec.mission.shot_queue import ShotQueue
from panoexec.mission.waiting import first_failure, uncancelled, until, within
from panoexec.planning.model import Certificate, Plan, Turning

PREFLIGHT_S = 5.0
"""How long preflight retries failed checks (a stream that was just requested needs time to start)."""
PREPARE_S = 12.0
"""Timeout for preparing the camera."""
RESTORE_S = 6.0
"""Timeout for restoring it."""
E = TypeVar("E", bound=ev.Event)
DONE = frozenset({ShotStatus.ACCEPTED, ShotStatus.SKIPPED})


class Mission:
    """One mission from its start (or resumption) to its end in this process.

    `run` executes it; other tasks of the same event loop may call `commands` meanwhile. Every event passes the
    recorder: it is written to the journal first, then published to the sink.

    Args:
        mission_id: the mission's unique identifier.
        plan: camera, constraints and shots.
        settings: tolerances, timing, retries and guards.
        gimbal, camera, vehicle: the devices.
        clock: the mission's clock.
        journal: stores the events durably.
        sink: receives each event after it was stored.
        verifier: computes certificates outside the event loop.
        reference: direction of the plan's yaw 0: true north, or the vehicle's heading at the start.
        past: events of this mission from an earlier process, to resume from.
        pictures: where photos are, and what examines them; None: their content is not checked.
        guards: the guards to evaluate; None: those that the settings enable.

    Raises:
        MissionError: the mission is finished and cannot be resumed.
        ValueError: the past events are inconsistent (a damaged journal).
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
        pictures: PictureSource | None = None,
    ) -> None:
        record = MissionRecord.from_events(mission_id=mission_id, shots=plan.shots, events=past)
        if record.state in FINISHED:
            raise MissionError(f"mission {mission_id} is {record.state} and cannot be resumed: {record.reason}")
        again = record.asked.repeats
        todo = [index for index, shot in sorted(record.shots.items()) if shot.status not in DONE or index in again]
        self._context = MissionContext(
            plan=plan,
            settings=settings,
            gimbal=gimbal,
            camera=camera,
            vehicle=vehicle,
            clock=clock,
            verifier=verifier,
            recorder=Recorder(record=record, journal=journal, sink=sink, clock=clock),
            requests=MissionRequests(),
            queue=ShotQueue(todo, attempts=settings.attempts, rounds=settings.rounds),
            eta=EtaEstimator(expected_shot_s=_expected_shot_s(plan, settings)),
            heading_controller=_heading_controller(vehicle, clock, settings),
        )
        self._resumed = bool(past)
        self._reference = reference
        enabled = (*flight_guards(settings), *parallax_guard(settings, plan)) if guards is None else guards
        self._guard_monitor = GuardMonitor(self._context, enabled)
        self._ending = Ending(self._context)
        self._content = ContentCheck(self._context, pictures, self._take_back)
        self._shooting: Shooting | None = None
        self._run_called = False
        self.commands = OperatorCommands(self._context)

    @property
    def record(self) -> MissionRecord:
        """The mission's record; read only."""
        return self._context.record

    @property
    def plan(self) -> Plan:
        """The plan of this mission."""
        return self._context.plan

    @property
    def certificate(self) -> Certificate | None:
        """The certificate of the measured attitudes; None before it was computed."""
        return self._ending.certificate

    @property
    def eta_s(self) -> float:
        """Estimated seconds until the last shot."""
        return self._context.eta.eta_s(self._context.shots_left())

    @property
    def battery_need_frac(self) -> float:
        """The part of a full battery that the rest of the shooting needs; NaN without a hover time."""
        guards = self._context.settings.guards
        return battery_need_frac(guards, self.eta_s) if guards.hover_s > 0 else math.nan

    @property
    def pose(self) -> LivePose | None:
        """Where the camera points now; None if that is not known."""
        return live_pose(self._context)

    @property
    def shot_s(self) -> float:
        """Estimated seconds per shot."""
        return self._context.eta.shot_s

    @property
    def shooting_s(self) -> float:
        """Seconds from the first slew in this process to the last verdict, including pauses; NaN before the end."""
        return math.nan if self._shooting is None else self._shooting.ended_s - self._shooting.began_s

    @property
    def turns(self) -> int:
        """How often this process commanded the vehicle to turn."""
        return 0 if self._context.heading_controller is None else self._context.heading_controller.turns

    @property
    def turning(self) -> Turning | None:
        """How the vehicle is expected to turn; None if it does not."""
        return None if self._context.heading_controller is None else self._context.heading_controller.turning

    @property
    def shooter(self) -> Shooter | None:
        """The component that points and triggers, to read the live pointing error; None before the start."""
        return None if self._shooting is None else self._shooting.shooter

    def note(self, event: E) -> E | None:
        """Record an event that others found out about a photo: its file is stored, its content was checked.

        Returns:
            The event as recorded; None if the mission no longer records (then its journal is to be opened again).

        Raises:
            ValueError: the event contradicts the record.
        """
        recorder = self._context.recorder
        return None if recorder.closed else recorder.emit(event)

    async def durable(self) -> None:
        """Return when all events so far are on disk and published.

        Raises:
            MissionError: the journal failed.
        """
        await self._context.recorder.durable()

    async def run(self) -> MissionRecord:
        """Execute the mission and return its record when it ends, in whatever state. May be called only once.

        Cancellation stops the mission at once and leaves it resumable; `commands.interrupt` does so after the current
        photo.

        Raises:
            MissionError: the journal failed (the gimbal was still released), or `run` was called before.
        """
        if self._run_called:
            raise MissionError("run() was called before; resume the mission from its journal")
        self._run_called = True
        recorder = self._context.recorder
        try:
            async with asyncio.TaskGroup() as group:
                writing = group.create_task(recorder.run(), name="mission recorder")
                try:
                    await self._run_guarded()
                finally:
                    recorder.close()
                    await uncancelled(writing)
        except BaseExceptionGroup as failures:
            raise first_failure(failures) from None
        return self.record

    async def _run_guarded(self) -> None:
        requests = self._context.requests
        planned_end = False
        try:
            self._start()
            async with asyncio.TaskGroup() as group:
                watching = group.create_task(self._guard_monitor.watch(), name="mission guards")
                checking = group.create_task(self._content.run(), name="content of photos")
                await self._run_phases(group)
                requests.over = True
                await self._guard_monitor.release()
                checking.cancel()
                watching.cancel()
            planned_end = True
        except asyncio.CancelledError:
            requests.request_stop(Stop("interrupt", "panoexec was stopped at once; the mission can be resumed"))
            raise
        finally:
            if not planned_end and requests.stop is None:
                requests.request_stop(Stop("fail", "internal error in panoexec; the mission can be resumed"))
            try:
                await uncancelled(asyncio.create_task(self._guard_monitor.release(), name="release the gimbal"))
            finally:
                try:
                    await uncancelled(asyncio.create_task(self._restore_camera(), name="restore the camera"))
                finally:
                    self._ending.conclude()

    def _start(self) -> None:
        context, record = self._context, self._context.record
        status = context.vehicle.status
        kind = record.reference if self._resumed else self._reference
        reference = record.reference_yaw_north_deg
        if math.isnan(reference):  # a new mission, or one that took no photo because the heading was unknown
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
        context.recorder.emit(started, MissionState.PREFLIGHT)
        if self._resumed:
            warn_if_moved(context)
        if context.settings.feedback == "none":
            text = "no attitude feedback: poses are assumed, not measured (open loop)"
            context.recorder.emit(ev.Warned(code="open_loop", text=text))
        self.commands.begin()

    async def _run_phases(self, group: asyncio.TaskGroup) -> None:
        """Run preflight, shooting and finishing; return when the mission has ended or must stop."""
        context = self._context
        if self._resumed:
            self._restore_commands()
            await settle_open_attempts(context)
            self._skip_shots()
        checked = False
        while context.requests.stop is None:
            # patches of a resumed mission need a preflight, too
            if len(context.queue) and not checked and not context.requests.must_end_shooting:
                checked, _ = await until(context.requests.leaving.wait(), self._preflight(), "preflight")
            if self._shooting is None:  # not earlier: it needs the direction of yaw 0
                self._shooting = Shooting(context, self._guard_monitor, group)
            if not context.requests.must_end_shooting and len(context.queue):
                await self._meter(self._shooting.shooter)
            if not context.requests.must_end_shooting:
                await self._shooting.run()
            await until(self._guard_monitor.give_up_when_told(), self._photos_in(self._shooting), "the last photos")
            if len(context.queue) and not context.requests.must_end_shooting:
                continue  # an accepted photo was revoked
            if context.requests.stop is not None:
                return
            _, over = await until(self._guard_monitor.give_up_when_told(), self._ending.finish(), "finish")
            if over:
                return

    async def _photos_in(self, shooting: Shooting) -> None:
        """Return when all photos that were taken are judged, by evidence and content."""
        await shooting.evidence_in()
        await until(self._context.requests.stopping.wait(), self._content.settle(), "content of photos")

    def _take_back(self, shot: int, number: int, code: str, reason: str, photos: tuple[ev.Photo, ...]) -> None:
        assert self._shooting is not None
        self._shooting.revoke(shot, number, code, reason, photos)

    def _restore_commands(self) -> None:
        """Restore commands that an earlier process acknowledged but did not carry out."""
        asked, requests = self._context.record.asked, self._context.requests
        if asked.end == "abort":
            requests.request_stop(Stop("abort", asked.reason or "aborted by command"))
        elif asked.end:
            requests.request_finish(asked.reason or "finished by command, the gaps are accepted")

    def _skip_shots(self) -> None:
        """Skip the shots of pending skip commands, unless their photo was accepted meanwhile."""
        context = self._context
        for index in sorted(context.record.asked.skips):
            shot = context.record.shots[index]
            if shot.accepted is None and shot.open_attempt is None:
                context.queue.drop(index)
                skipped = ev.ShotSkipped(shot=index, attempt=len(shot.attempts), reason="skipped by command")
                context.recorder.emit(skipped)

    async def _meter(self, shooter: Shooter) -> None:
        """Fix the exposure, if that is asked for; begins again after a hold."""
        requests = self._context.requests
        while not requests.must_end_shooting:
            requests.settled()
            if requests.holds:
                await self._guard_monitor.hold()
                continue
            metering = meter_exposure(self._context, shooter)
            done, problem = await until(requests.interrupt.wait(), metering, "meter the exposure")
            if problem:
                requests.request_stop(Stop("fail", problem))
            if done:
                return

    async def _preflight(self) -> None:
        context = self._context
        problems = self._problems()
        deadline = context.clock.monotonic() + PREFLIGHT_S
        while problems and context.clock.monotonic() < deadline:
            await context.clock.sleep(0.25)
            problems = self._problems()
        if not problems:
            problems = await self._prepare_camera()
        await self._learn_turn_limits()
        if not problems and not await self._guard_monitor.acquire():
            problems = [hold.finding.reason for hold in context.requests.holds.values()]
        if problems:
            context.recorder.emit(ev.PreflightFailed(problems=tuple(problems)))
            context.requests.request_stop(Stop("fail", "; ".join(problems)))
            return
        warning = battery_warning(context.vehicle.status.battery_frac, context.settings.guards, expected_s=self.eta_s)
        if warning:
            context.recorder.emit(ev.Warned(code="battery_estimate", text=warning))
        context.recorder.emit(ev.PreflightPassed(), MissionState.CAPTURING)
        context.eta.restart(context.clock.monotonic())

    async def _learn_turn_limits(self) -> None:
        """Expect of the vehicle what its autopilot's parameters say."""
        heading, vehicle = self._context.heading_controller, self._context.vehicle
        if heading is not None and isinstance(vehicle, LimitsTurns):
            with suppress(DeviceError):  # without its answer, turns are expected as planned
                heading.limit(await vehicle.turn_limits())

    async def _prepare_camera(self) -> list[str]:
        """Make the camera ready for photos (photo mode); returns what prevents that."""
        camera = self._context.camera
        problem = ""
        if isinstance(camera, PreparesForPhotos):
            try:
                problem = await within(self._context.clock, PREPARE_S, camera.prepare(), "prepare the camera")
            except (DeviceError, TimeoutError) as error:
                problem = f"the camera cannot be prepared: {error}"
        if not problem and isinstance(camera, TellsLens):
            problem = lens_problem(camera.focal_length_mm, self._context.plan.camera)
        return [problem] if problem else []

    async def _restore_camera(self) -> None:
        """Leave the camera as it was found; an interrupted mission will prepare it again."""
        camera = self._context.camera
        if isinstance(camera, PreparesForPhotos):
            with suppress(TimeoutError):
                await within(self._context.clock, RESTORE_S, camera.restore(), "restore the camera")

    def _problems(self) -> list[str]:
        context = self._context
        update_reference_frame(context)
        shots = [record.shot for record in context.record.shots.values() if record.shot.index in context.queue]
        reference = context.record.reference_yaw_north_deg
        if math.isnan(reference):
            return ["the vehicle's heading is unknown, but the panorama is to start from it (reference = heading)"]
        return preflight_problems(
            shots=shots,
            settings=context.settings,
            gimbal=context.gimbal,
            camera=context.camera,
            vehicle=context.vehicle,
            reference_yaw_north_deg=reference,
            now_s=context.clock.monotonic(),
            expected_s=self.eta_s,
        )


def _heading_controller(vehicle: Vehicle, clock: Clock, settings: MissionSettings) -> HeadingController | None:
    turning = settings.gimbal.turning
    if turning is None:
        return None
    return HeadingController(
        vehicle=vehicle, clock=clock, turning=turning, tolerance_yaw_deg=settings.tolerance.yaw_deg
    )


def _expected_shot_s(plan: Plan, settings: MissionSettings) -> float:
    """The initial estimate of the seconds per shot."""
    least = max(settings.interval_s, settings.settle_s + settings.exposure_bound_s)
    if plan.estimate is None or not plan.shots:
        return least + 1.0
    return max(least, plan.estimate.duration_s / len(plan.shots))
