"""Evaluates the guards, holds the mission while one has a finding, and acquires and releases the gimbal."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass

from panoexec.devices import VehicleStatus
from panoexec.errors import DeviceError
from panoexec.mission.context import MissionContext
from panoexec.mission.guards import Finding, GimbalControl, Guard, Situation, reasons
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import Stop
from panoexec.mission.protocols import AnswersControl
from panoexec.mission.reference_frame import update_reference_frame
from panoexec.mission.waiting import until, within

WATCH_S = 0.1
"""Period of the guards."""
TICK_S = 0.5
"""Period at which a held mission checks its holds when nothing wakes it."""
RECLAIM_EVERY_S = 3.0
ASK_CONTROL_EVERY_S = 1.0
"""Period at which the gimbal manager is asked who has control while that is unknown."""
MODE_REPORT_S = 1.5
"""How long the flight mode is awaited after control of the gimbal was lost. An autopilot that takes or drops the gimbal
for a flight mode tells the mode in its next heartbeat (1 Hz)."""
CONTROL_CODES = ("gimbal_control", "gimbal_unknown", "gimbal_lost")
_WATCHED = frozenset({MissionState.CAPTURING, MissionState.PAUSED, MissionState.FINISHING})
_ENDED_BY_ACQUIRING = frozenset({"gimbal_control", "gimbal_lost"})


@dataclass(slots=True, kw_only=True)
class _Loss:
    """Control of the gimbal was lost.

    Attributes:
        at_s: when it was noticed, on the mission's clock.
        heartbeats: of the autopilot until then.
        mode_told: whether another heartbeat has told the flight mode since.
    """

    at_s: float
    heartbeats: int
    mode_told: bool = False


class GuardMonitor:
    """Pauses the mission while a guard has a finding, and owns the gimbal's control."""

    def __init__(self, context: MissionContext, guards: tuple[Guard, ...]) -> None:
        self._context = context
        self._guards = guards
        # A killed process may have left the gimbal under our control: the manager identifies us by component id. The
        # journal may not have recorded it, so the manager's status also counts until this process acquires or releases.
        self._touched = context.record.gimbal_held or context.record.gimbal_left
        self._asks_manager = True
        self._taking = False
        self._north_told = False
        self._strangers_told: set[int] = set()
        self._boots = context.vehicle.status.boot_count
        self._charge_told = False
        self._loss: _Loss | None = None

    async def watch(self) -> None:
        """Evaluate the guards while the mission may have the gimbal; runs until cancelled."""
        while True:
            if self._context.record.state in _WATCHED:
                self.look()
            await self._context.clock.sleep(WATCH_S)

    def look(self) -> None:
        """Turn findings into holds, and remove holds whose cause is gone."""
        context = self._context
        now = context.clock.monotonic()
        status = context.vehicle.status
        if status.boot_count != self._boots:
            self._boots = status.boot_count
            context.recorder.emit(ev.Warned(code="reboot", text="the autopilot has rebooted"))
        update_reference_frame(context)
        context.gimbal.feed.ingest()
        self._look_at_north()
        self._look_at_strangers()
        self._look_at_charge(status)
        sample = context.gimbal.feed.latest
        situation = Situation(
            now_s=now,
            vehicle=status,
            sample_age_s=math.inf if sample is None else now - sample.received_s,
            control=GimbalControl.of(context.gimbal),
            # not while it is being acquired or released
            expects_control=context.record.gimbal_held and self._touched and not self._taking,
            origin=context.record.origin,
            storage_free_images=context.camera.storage_free_images,
            holding=frozenset(context.requests.holds),
            turn_modes=None if context.heading_controller is None else context.heading_controller.modes,
        )
        self._look_at_loss(situation)
        found = {f.code: f for guard in self._guards if (f := guard.check(situation)) is not None}
        if any(finding.release for finding in found.values()):
            # the gimbal is given up anyway: that an autopilot takes it for its own mode says nothing more
            for code in CONTROL_CODES:
                found.pop(code, None)
                context.requests.holds.pop(code, None)
        for finding in found.values():
            context.requests.hold(finding)
        for code in [code for code, hold in context.requests.holds.items() if not hold.finding.retry]:
            if code not in found:
                context.requests.clear(code, now_s=now, clear_s=context.settings.guards.clear_s)

    def _look_at_loss(self, situation: Situation) -> None:
        """Note when control of the gimbal was lost, and whether the flight mode was told since.

        By the status that the guards have read: a mode in which the mission may not act has its finding by then.
        """
        control, heartbeats = situation.control, situation.vehicle.heartbeats
        if control is GimbalControl.OURS or not (self._touched and self._context.record.gimbal_held):
            self._loss = None
        elif self._loss is not None:
            self._loss.mode_told |= heartbeats != self._loss.heartbeats
        elif control is not GimbalControl.UNKNOWN:
            self._loss = _Loss(at_s=situation.now_s, heartbeats=heartbeats)

    def _look_at_north(self) -> None:
        """Tell once if gimbal and autopilot contradict each other about the vehicle's heading."""
        context, known = self._context, self._context.gimbal.known
        limit_deg = context.settings.tolerance.yaw_deg
        if self._north_told or not abs(known.north_off_deg) > limit_deg:
            return
        self._north_told = True
        what = "its reports are corrected by it" if known.north_corrected else "which of them is right is unknown"
        context.recorder.emit(
            ev.GimbalContradicted(
                north_off_deg=known.north_off_deg,
                corrected=known.north_corrected,
                text=f"the gimbal's north is {known.north_off_deg:+.1f}° from that of the autopilot (tolerance"
                f" {limit_deg:g}°); {what}: calibrate its compass",
            )
        )

    def _look_at_strangers(self) -> None:
        """Tell once of each component whose attitudes are ignored."""
        known = self._context.gimbal.known
        for component in sorted(known.strangers - self._strangers_told):
            self._strangers_told.add(component)
            text = (
                f"component {component} tells attitudes, but the gimbal is component {known.device}: they are ignored"
            )
            self._context.recorder.emit(ev.Warned(code="stranger", text=text))

    def _look_at_charge(self, status: VehicleStatus) -> None:
        """Tell when the charge, which the floor is compared with, is no longer known."""
        floor_frac = self._context.settings.guards.battery_floor_frac
        if not math.isnan(status.battery_frac):
            self._charge_told = True
        elif self._charge_told and status.connected and floor_frac > 0:
            self._charge_told = False
            floor = f"the floor of {100 * floor_frac:.0f} % is not watched"
            text = f"the autopilot no longer tells the battery's charge: {floor}"
            self._context.recorder.emit(ev.Warned(code="battery_unknown", text=text))

    async def hold(self) -> None:
        """Hold until no hold is left (the mission is then capturing) or shooting must end."""
        context, requests = self._context, self._context.requests
        began = context.clock.monotonic()
        acquired_s, asked_s = math.nan, -math.inf
        announced: tuple[str, ...] = ()
        while not requests.must_end_shooting:
            requests.settled()
            if not requests.holds:
                if await self.acquire():
                    paused_s = context.clock.monotonic() - began
                    context.recorder.emit(ev.MissionResumed(paused_s=paused_s), MissionState.CAPTURING)
                    context.eta.restart(context.clock.monotonic())
                    return
                continue
            waits = self._awaits_mode()
            if tuple(requests.holds) != announced and not waits:
                announced = tuple(requests.holds)
                self._announce()
            if any(hold.finding.release for hold in requests.holds.values()):
                await self.release()
            now = context.clock.monotonic()
            if now - began > context.settings.max_pause_s:
                requests.request_stop(Stop("fail", f"paused for {now - began:.0f} s: {reasons(requests.holds)}"))
                return
            if self._is_control_unknown() and now - asked_s >= ASK_CONTROL_EVERY_S:
                asked_s = now
                await self._ask_control()
            if not waits and self._may_acquire() and now >= self._acquire_at_s(began, acquired_s):
                acquired_s = now
                await self.acquire()
            await until(context.clock.sleep(WATCH_S if waits else TICK_S), requests.changed.wait(), "paused")

    def _awaits_mode(self) -> bool:
        """Whether control of the gimbal was lost, and the flight mode that this may be for is not told yet."""
        loss, holds = self._loss, self._context.requests.holds
        if loss is None or loss.mode_told or holds.keys().isdisjoint(_ENDED_BY_ACQUIRING):
            return False
        return self._context.clock.monotonic() - loss.at_s < MODE_REPORT_S

    def _announce(self) -> None:
        holds = self._context.requests.holds
        paused = ev.MissionPaused(
            code="+".join(holds),
            reason=reasons(holds),
            automatic=all(hold.finding.automatic for hold in holds.values()),
        )
        self._context.recorder.emit(paused, MissionState.PAUSED)

    async def give_up_when_told(self) -> None:
        """Release the gimbal as soon as a guard says so, while nothing is shot; runs until cancelled."""
        while True:
            if any(hold.finding.release for hold in self._context.requests.holds.values()):
                await self.release()
            await self._context.clock.sleep(WATCH_S)

    async def acquire(self) -> bool:
        """Acquire the gimbal unless it is controlled already; a failure adds a hold. Stops when shooting must end."""
        context = self._context
        control = GimbalControl.of(context.gimbal)
        if context.record.gimbal_held and control is GimbalControl.OURS:
            return True
        if self._is_control_unknown():
            self.look()  # another station may have it: not taken before the manager has answered
            if context.requests.holds:
                return False
        self._touched, self._asks_manager, self._taking = True, False, True
        try:
            done, _ = await until(context.requests.leaving.wait(), context.gimbal.acquire(), "take the gimbal")
        except DeviceError as error:
            finding = Finding(code="gimbal_lost", reason=f"cannot acquire the gimbal: {error}", automatic=True)
            context.requests.hold(finding)
            return False
        finally:
            self._taking = False
        if done:
            known = context.gimbal.known
            context.recorder.emit(
                ev.GimbalAcquired(
                    manager=known.manager, device=known.device, device_id=known.device_id, feedback=known.feedback
                )
            )
        return done

    def _is_control_unknown(self) -> bool:
        """Whether the mission has acquired the gimbal and does not know who has it now, though it could be asked."""
        context = self._context
        unknown = GimbalControl.of(context.gimbal) is GimbalControl.UNKNOWN
        return unknown and context.record.gimbal_held and context.vehicle.status.connected

    def _may_acquire(self) -> bool:
        """Whether acquiring the gimbal again is all that the mission waits for, and may be done by itself."""
        holds = self._context.requests.holds
        automatic = all(hold.finding.automatic for hold in holds.values())
        return bool(holds) and automatic and holds.keys() <= _ENDED_BY_ACQUIRING and self._context.record.gimbal_held

    def _acquire_at_s(self, began_s: float, acquired_s: float) -> float:
        """When to acquire: at once if nobody has the gimbal, after a delay if another station took it, then repeatedly.

        Args:
            began_s: when the pause began.
            acquired_s: when it was last tried in this pause; NaN before.
        """
        if not math.isnan(acquired_s):
            return acquired_s + RECLAIM_EVERY_S
        taken = "gimbal_control" in self._context.requests.holds
        return began_s + (self._context.settings.guards.reclaim_after_s if taken else 0.0)

    async def _ask_control(self) -> None:
        """Ask the gimbal's manager who has control; the answer arrives with its status."""
        gimbal, requests = self._context.gimbal, self._context.requests
        if isinstance(gimbal, AnswersControl):
            await until(requests.stopping.wait(), gimbal.ask_control(), "ask for gimbal control")

    async def release(self) -> None:
        """Release the gimbal if this or a crashed process acquired it; with a timeout, never raises a device error."""
        context = self._context
        if not self._touched and not (self._asks_manager and context.gimbal.in_control):
            return
        self._touched = self._asks_manager = False
        try:
            await within(context.clock, context.settings.release_s, context.gimbal.release(), "release the gimbal")
        except (TimeoutError, DeviceError):
            confirmed = False
        except asyncio.CancelledError:
            self._touched = True  # the final call at the mission's end tries again
            raise
        else:
            confirmed = True
        context.recorder.emit(ev.GimbalReleased(confirmed=confirmed))
