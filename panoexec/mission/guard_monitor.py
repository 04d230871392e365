"""Watching the guards, holding while something is wrong, and who has the gimbal."""

from __future__ import annotations

import asyncio
import math

from panoexec.errors import DeviceError
from panoexec.mission.context import MissionContext
from panoexec.mission.guards import Finding, Guard, Situation, reasons
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.mission.mission_requests import Stop
from panoexec.mission.reference_frame import anchor
from panoexec.mission.waiting import until, within

WATCH_S = 0.1
"""How often the guards look."""
TICK_S = 0.5
"""How often a held mission looks at itself when nothing wakes it."""
RECLAIM_EVERY_S = 3.0


class GuardMonitor:
    """Keeps a mission from shooting while it must not, and owns the gimbal's control."""

    def __init__(self, flight: MissionContext, guards: tuple[Guard, ...]) -> None:
        self._flight = flight
        self._guards = guards
        # a process that was killed may have left the gimbal in our hands: its manager knows us by our component. It is
        # asked too, until this process did something itself: the last one may have died before the journal knew
        self._touched = flight.record.gimbal_held or flight.record.gimbal_left
        self._asks_manager = True
        self._taking = False
        self._boots = flight.vehicle.status.boot_count

    async def watch(self) -> None:
        """Look at the guards for as long as the mission shoots or holds; runs until cancelled."""
        while True:
            if self._flight.record.state in {MissionState.CAPTURING, MissionState.PAUSED}:
                self.look()
            await self._flight.clock.sleep(WATCH_S)

    def look(self) -> None:
        """Turn findings into holds, and let holds go whose cause is gone."""
        flight = self._flight
        now = flight.clock.monotonic()
        status = flight.vehicle.status
        if status.boot_count != self._boots:
            self._boots = status.boot_count
            flight.recorder.emit(ev.Warned(code="reboot", text="the autopilot has rebooted"))
        anchor(flight)
        flight.gimbal.feed.ingest()
        sample = flight.gimbal.feed.latest
        situation = Situation(
            now_s=now,
            vehicle=status,
            sample_age_s=math.inf if sample is None else now - sample.received_s,
            in_control=flight.gimbal.in_control,
            # not while it is being taken or given back
            expects_control=flight.record.gimbal_held and self._touched and not self._taking,
            unclaimed=flight.gimbal.controlled_by == (0, 0),
            origin=flight.record.origin,
            storage_free_images=flight.camera.storage_free_images,
            holding=frozenset(flight.control.holds),
            turn_modes=None if flight.turner is None else flight.turner.modes,
        )
        found = {f.code: f for guard in self._guards if (f := guard.check(situation)) is not None}
        for finding in found.values():
            flight.control.hold(finding)
        for code in set(flight.control.holds) - set(found) - {"command"}:
            flight.control.clear(code, now_s=now, clear_s=flight.settings.guards.clear_s)

    async def hold(self) -> None:
        """Hold until nothing holds the mission any more (then it is capturing), or it must leave."""
        flight, control = self._flight, self._flight.control
        began = asked = flight.clock.monotonic()
        announced: tuple[str, ...] = ()
        while not control.must_leave:
            control.settled()
            if not control.holds:
                if await self.acquire():
                    paused_s = flight.clock.monotonic() - began
                    flight.recorder.emit(ev.MissionResumed(paused_s=paused_s), MissionState.CAPTURING)
                    flight.pace.restart(flight.clock.monotonic())
                    return
                continue
            if tuple(control.holds) != announced:
                announced = tuple(control.holds)
                self._announce()
            if any(hold.finding.release for hold in control.holds.values()):
                await self.release()
            now = flight.clock.monotonic()
            if now - began > flight.settings.max_pause_s:
                control.ask_stop(Stop("fail", f"paused for {now - began:.0f} s: {reasons(control.holds)}"))
                return
            patience_s = flight.settings.guards.reclaim_after_s if asked == began else RECLAIM_EVERY_S
            if set(control.holds) == {"gimbal_control"} and now - asked >= patience_s:
                asked = now
                await self._reclaim()
            await until(flight.clock.sleep(TICK_S), control.changed.wait(), "paused")

    def _announce(self) -> None:
        holds = self._flight.control.holds
        paused = ev.MissionPaused(
            code="+".join(holds),
            reason=reasons(holds),
            automatic=all(hold.finding.automatic for hold in holds.values()),
        )
        self._flight.recorder.emit(paused, MissionState.PAUSED)

    async def acquire(self) -> bool:
        """Take the gimbal, unless this process has it; on failure the mission holds. Gives up when it must leave."""
        flight = self._flight
        if flight.record.gimbal_held and flight.gimbal.in_control:
            return True
        self._touched, self._asks_manager, self._taking = True, False, True
        try:
            done, _ = await until(flight.control.leaving.wait(), flight.gimbal.acquire(), "take the gimbal")
        except DeviceError as error:
            finding = Finding(code="gimbal_control", reason=f"cannot take the gimbal: {error}", automatic=True)
            flight.control.hold(finding)
            return False
        finally:
            self._taking = False
        if done:
            flight.recorder.emit(ev.GimbalAcquired())
        return done

    async def _reclaim(self) -> None:
        finding = self._flight.control.holds["gimbal_control"].finding
        if finding.automatic and self._flight.record.gimbal_held:
            await self.acquire()

    async def release(self) -> None:
        """Give the gimbal back if it was asked for, now or before a crash; bounded, never raises if it is gone."""
        flight = self._flight
        if not self._touched and not (self._asks_manager and flight.gimbal.in_control):
            return
        self._touched = self._asks_manager = False
        try:
            await within(flight.clock, flight.settings.release_s, flight.gimbal.release(), "release the gimbal")
        except (TimeoutError, DeviceError):
            confirmed = False
        except asyncio.CancelledError:
            self._touched = True  # the last try, at the very end, will see to it
            raise
        else:
            confirmed = True
        flight.recorder.emit(ev.GimbalReleased(confirmed=confirmed))
