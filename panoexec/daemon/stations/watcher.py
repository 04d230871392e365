"""Flies a panorama at each station of the autopilot's mission: waits for the arrival, starts, holds, lets it go on."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Any, Final

import structlog

from panoexec.adapters.autopilot_mission import COMPLETE, INTRODUCTION, AutopilotMission
from panoexec.clock import Clock
from panoexec.daemon.missions import Missions
from panoexec.daemon.own_requests import submit
from panoexec.daemon.stations.arrival import Arrival
from panoexec.daemon.stations.holding import MISSION_MODE, READ_AGAIN_S, Holding
from panoexec.daemon.stations.marked import Station, marked_stations
from panoexec.daemon.stations.refusals import refusal
from panoexec.daemon.stations.tour_log import TourLog
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.errors import DeviceError, PanoexecError
from panoexec.inputs.config import Config
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import ENDED, FINISHED, MissionState
from panoexec.mission.tour_stop import TourStop
from panoexec.mqtt.incoming import Incoming
from panoexec.mqtt.messages import TourFields
from panoexec.planning.model import Plan
from panoexec.store.tours import OPEN, Stop

TICK_S: Final = 0.2
_SOON_S: Final = 0.05
"""A tick near a station, and when all photos are taken."""
_MODE_S: Final = 3.0
_RELEASING: Final = frozenset({"pilot", "landed", "battery", "gimbal_control"})
"""Codes of pauses after which the vehicle is not kept at the station."""

_log = structlog.get_logger(__name__)


class Stations:
    """Runs beside the missions; `run` it in a task.

    Args:
        config: returns the current configuration.
        vehicle: with the autopilot's mission.
        missions: of the daemon.
        take: takes a request.
        plan_of: the plan of a preset.
        clock: of missions.
        changed: called when the tour changes.
        boot_id: of this process; makes transactions unique.
    """

    def __init__(
        self,
        *,
        config: Callable[[], Config],
        vehicle: VehicleLink,
        missions: Missions,
        take: Callable[[Incoming], None],
        plan_of: Callable[[str], Awaitable[Plan]],
        clock: Clock,
        changed: Callable[[], None],
        boot_id: str,
    ) -> None:
        self._config = config
        self._vehicle = vehicle
        self._missions = missions
        self._take = take
        self._plan_of = plan_of
        self._clock = clock
        self._changed = changed
        self._boot_id = boot_id
        self._tour = TourLog(storage=lambda: config().storage.path, vehicle=lambda: config().vehicle.id, clock=clock)
        self._arrival = Arrival()
        self._stations: dict[int, Station] = {}
        self._digest = ""
        self._plans: dict[str, Plan | PanoexecError] = {}
        self._planning: asyncio.Task[None] | None = None
        self._done_at = -1
        """Number of the waypoint that is current and where nothing is left to be done; -1 for none."""
        self._told_at = -1
        """Number of the waypoint of which the pilot was told why there is no panorama; -1 for none."""
        self._read_s = -math.inf
        self._asked = 0
        self._shot_s = self._shot_all_s = math.nan
        self._paused_by: frozenset[str] = frozenset()
        self._status = ""

    # --- what others ask and tell

    def fields(self) -> TourFields | None:
        """The tour, for the state; None without one."""
        tour = self._tour.tour
        if not self._stations and tour is None:
            return None
        stops = () if tour is None else tour.stops
        stop = None if tour is None else tour.open_stop
        closed = [one for one in stops if one.outcome != OPEN]
        return TourFields(
            tour_id=None if tour is None else tour.tour_id,
            stations=len(self._stations),
            waypoint=None if stop is None else stop.waypoint,
            done=sum(one.outcome == MissionState.COMPLETE.value for one in closed),
            skipped=sum(one.outcome != MissionState.COMPLETE.value for one in closed),
            text=self._status,
        )

    def heard(self, event: ev.Event) -> None:
        """Take an event of the running mission."""
        match event:
            case ev.ShotStarted() if math.isnan(self._shot_s):
                self._shot_s = self._clock.monotonic()
            case ev.MissionFinishing():
                self._shot_all_s = self._clock.monotonic()
            case ev.MissionPaused():
                self._paused_by = frozenset(event.code.split("+"))
            case ev.MissionResumed() | ev.MissionStarted():
                self._paused_by = frozenset()

    # --- the watch

    async def run(self) -> None:
        """Watch until cancelled; returns at once where `[stations]` is off."""
        if not self._config().stations.enabled:
            return
        trouble = ""
        while True:
            try:
                await self._look()
                trouble = trouble if self._told_at >= 0 else ""
            except (PanoexecError, OSError) as error:
                if str(error) != trouble:
                    trouble = str(error)
                    _log.warning("stations", error=trouble)
            except Exception as error:  # noqa: BLE001  (a bug at a station must not end the daemon)
                if repr(error) != trouble:
                    trouble = repr(error)
                    _log.exception("stations: internal error")
            await self._clock.sleep(TICK_S if math.isnan(self._arrival.since_s) else _SOON_S)

    async def _look(self) -> None:
        mission, status = self._vehicle.autopilot_mission, self._vehicle.status
        if mission is None or not status.connected:
            self._arrival.forget()
            return
        now = self._clock.monotonic()
        if mission.stale and self._vehicle.devices is not None and now - self._read_s >= READ_AGAIN_S:
            self._read_s = now
            await self._read(mission)
            self._read_s = -math.inf
        if mission.is_to_introduce and self._stations:
            mission.is_to_introduce = False
            await self._say(INTRODUCTION.format(len(self._stations)))
        current = mission.current
        if current is None or not self._digest:
            return
        if current.seq != self._done_at:
            self._done_at = -1
        if not status.armed or current.state == COMPLETE:
            await self._end_tour()
        station = self._stations.get(current.seq)
        flies = status.armed and status.in_air and status.mode == MISSION_MODE
        if station is None or not flies or self._done_at == station.waypoint or mission.stale:
            self._arrival.forget()
            return
        if self._arrival.there(station, status, now, radius_m=self._config().stations.radius_m):
            since_s = self._arrival.since_s
            self._arrival.forget()
            await self._arrive(station, mission, since_s)

    async def _read(self, mission: AutopilotMission) -> None:
        changed = await mission.read()
        if not changed and self._digest == mission.digest:
            return
        if self._digest and self._digest != mission.digest:
            await self._end_tour()
        self._digest, self._done_at = mission.digest, -1
        found, problems = marked_stations(mission.items, list(self._config().presets))
        self._stations = {station.waypoint: station for station in found}
        _log.info("the autopilot's mission", items=len(mission.items), stations=len(found), problems=problems)
        for problem in problems:
            await self._say(problem)
        if found:
            await self._say(INTRODUCTION.format(len(found)))
        self._changed()
        if self._planning is not None:
            self._planning.cancel()
        self._plans.clear()
        self._planning = asyncio.create_task(self._plan(), name="plans of stations")

    async def _plan(self) -> None:
        """Compute what the stations need before the vehicle is there."""
        for preset in dict.fromkeys(station.preset for station in self._stations.values()):
            try:
                self._plans[preset] = await self._plan_of(preset)
            except PanoexecError as error:
                self._plans[preset] = error
                await self._say(f"preset {preset}: {error}")

    async def _end_tour(self) -> None:
        if self._tour.tour is not None:
            await self._tour.end()
            self._done_at = -1
            self._changed()

    # --- a stay

    async def _arrive(self, station: Station, mission: AutopilotMission, since_s: float) -> None:
        """Stay; an error is told to the pilot once. It is tried again until the hold time is over."""
        try:
            await self._stay(station, mission, since_s)
        except Exception as error:
            if self._told_at != station.waypoint:
                self._told_at = station.waypoint
                await self._say(f"waypoint {station.waypoint}: no panorama: {str(error) or type(error).__name__}")
            raise
        self._told_at = -1

    async def _stay(self, station: Station, mission: AutopilotMission, since_s: float) -> None:
        """From the arrival until the mission goes on."""
        tour = await self._tour.of_mission(self._digest, tuple(self._stations))
        stop = tour.open_stop
        again = stop is not None and stop.waypoint == station.waypoint
        if stop is not None and not again:
            # the vehicle has flown on while no process was here
            await self._tour.close(stop, outcome="left", reason="the vehicle flew on without panoexec")
            stop = None
        if stop is None:
            if tour.visits(station.waypoint) >= self._config().stations.visits:
                self._done_at = station.waypoint
                await self._say(f"waypoint {station.waypoint}: done already, not again")
                return
            stop = await self._tour.begin_stop(station)
        refused = "" if again else self._refusal(station, mission)
        over = await self._tour.state_of(stop.mission_id) if again else None
        mode = MISSION_MODE if refused or over in FINISHED else await self._mode(station, stop)
        if mode is None:
            refused = "the flight mode could not be changed"
        holding = Holding(
            station, mission, clock=self._clock, since_s=math.nan if again else since_s, mode=mode or MISSION_MODE
        )
        self._status = f"at waypoint {station.waypoint}"
        self._changed()
        try:
            if over in FINISHED:
                stop = replace(stop, outcome=over.value, reason="panoexec was started again when it was over")
            elif not refused:
                stop = await self._fly(station, stop, holding, since_s)
            else:
                stop = replace(stop, outcome="skipped", reason=refused)
                await self._say(f"waypoint {station.waypoint} skipped: {refused}")
            if stop.outcome != OPEN and not mission.claimed:
                stop = await self._leave(station, stop, holding)
        finally:
            self._done_at = station.waypoint
            self._status = ""
            self._changed()
        if stop.outcome != OPEN:
            await self._tour.close(stop, outcome=stop.outcome, reason=stop.reason)
            self._changed()

    def _refusal(self, station: Station, mission: AutopilotMission) -> str:
        """Why no panorama is to be flown; "" if it may."""
        return mission.claimed or refusal(
            self._config(),
            self._vehicle.status,
            station,
            plan=self._plans.get(station.preset),
            items=mission.items,
            others=self._stations,
            extends_hold=mission.extends_hold,
        )

    async def _mode(self, station: Station, stop: Stop) -> str | None:
        """The flight mode in which the panorama is to be flown, after changing to it; None if that failed."""
        config = self._config()
        if not (config.gimbal.yaw != "gimbal" and config.stations.guided):
            return MISSION_MODE
        devices, mission = self._vehicle.devices, self._vehicle.autopilot_mission
        if devices is None or mission is None or not devices.vehicle.turn_modes:
            return None
        mode = devices.vehicle.turn_modes[0]
        await self._say(f"waypoint {station.waypoint}: changing to {_MODE_WORDS.get(mode, mode)} to turn the vehicle")
        try:
            await mission.change_mode(mode)
        except DeviceError as error:
            _log.warning("the flight mode could not be changed", mode=mode, stop=stop.number, error=str(error))
            return None
        return mode if await self._in_mode(mode) else None

    async def _in_mode(self, mode: str) -> bool:
        end_s = self._clock.monotonic() + _MODE_S
        while self._clock.monotonic() < end_s:
            if self._vehicle.status.mode == mode:
                return True
            await self._clock.sleep(0.1)
        return False

    async def _fly(self, station: Station, stop: Stop, holding: Holding, since_s: float) -> Stop:
        """Fly the panorama; the stop with its outcome, open if the process ends before."""
        self._shot_s, self._shot_all_s, self._paused_by = math.nan, math.nan, frozenset()
        began_s = self._clock.monotonic()
        asking = asyncio.create_task(self._ask_for_it(station, stop, holding), name="start at a station")
        begun = finishing = False
        while True:
            await holding.look(self._vehicle.status)
            if asking.done() and not begun:
                begun = True
                error, mission_id = asking.result()
                if error:
                    await self._say(f"waypoint {station.waypoint}: not started: {error}")
                    return replace(stop, outcome="skipped", reason=error)
                stop = replace(stop, mission_id=mission_id)
                try:
                    await self._tour.note(stop)
                except PanoexecError as error:  # the vehicle must be held all the same
                    _log.error("the tour could not be kept", error=str(error))
            if begun and (ended := self._outcome(stop)) is not None:
                outcome, reason = ended
                break
            holding.released = not self._paused_by.isdisjoint(_RELEASING)
            too_long = self._clock.monotonic() - began_s > self._config().stations.longest_s
            if (holding.gone or too_long or self._gives_up(holding)) and not finishing and begun:
                finishing = True
                why = "the vehicle flew on" if holding.gone else "too long" if too_long else "cannot go on here"
                await self._ask("finish", {"reason": f"station: {why}"})
            await self._clock.sleep(TICK_S if math.isnan(self._shot_all_s) else _SOON_S)
        before_s = None if math.isnan(self._shot_s) else round(self._shot_s - since_s, 2)
        return replace(stop, outcome=outcome, reason=reason, before_s=before_s)

    def _gives_up(self, holding: Holding) -> bool:
        """A panorama that nobody but a person could continue, in a mission that is still the plan's."""
        return holding.may_act and holding.released and bool(self._paused_by & {"battery", "landed"})

    def _outcome(self, stop: Stop) -> tuple[str, str] | None:
        """How the panorama ended; `open` if it was only interrupted; None while it is not over."""
        record = self._missions.record
        if record is None or record.mission_id != stop.mission_id:
            return None
        if record.state in ENDED:  # the gimbal is released; what is still written needs no vehicle
            return record.state.value, record.reason
        if record.state is MissionState.PAUSED and self._missions.mission is None:
            return OPEN, record.reason
        return None

    async def _ask_for_it(self, station: Station, stop: Stop, holding: Holding) -> tuple[str, str | None]:
        """Start the panorama, or go on with it; why that was refused, and its mission id."""
        place = TourStop(
            tour_id=self._tour.tour_id, number=stop.number, waypoint=station.waypoint, modes=(holding.mode,)
        )
        offer, known = self._missions.offer, self._missions.record
        if known is not None and known.mission_id == stop.mission_id and self._missions.busy:
            return "", stop.mission_id  # it was resumed already
        if offer is not None and (offer.stored_id == stop.mission_id or offer.stop == place.to_json()):
            answer = await self._ask("resume", {})
        else:
            answer = await self._ask("start", {"preset": station.preset}, place)
        error = _error_of(answer)
        if not error:
            await self._missions.under_way()
        return error, (answer.get("data") or {}).get("mission_id")

    async def _leave(self, station: Station, stop: Stop, holding: Holding) -> Stop:
        """Let the mission go on."""
        if holding.mode != MISSION_MODE and holding.may_act:
            await self._give_back(station, holding)
        await holding.look(self._vehicle.status)
        problem = await holding.go_on(self._vehicle.status)
        if problem:
            _log.warning("the mission goes on by itself", waypoint=station.waypoint, reason=problem)
            return stop
        if stop.mission_id is None or math.isnan(self._shot_all_s):
            return stop
        return replace(stop, after_s=round(self._clock.monotonic() - self._shot_all_s, 2))

    async def _give_back(self, station: Station, holding: Holding) -> None:
        """Back to the autopilot's mission from the mode in which the vehicle was turned."""
        mission = self._vehicle.autopilot_mission
        if mission is None or self._vehicle.status.mode != holding.mode:
            holding.taken = True
            return
        await self._say(f"waypoint {station.waypoint}: back to the mission")
        try:
            await mission.change_mode(MISSION_MODE)
        except DeviceError as error:
            _log.error("the mission could not be given back", error=str(error))
            await self._say("the mission was not accepted: change the flight mode yourself")
            return
        if await self._in_mode(MISSION_MODE):
            holding.mode = MISSION_MODE

    # --- requests and messages

    async def _ask(self, verb: str, fields: Mapping[str, Any], stop: TourStop | None = None) -> dict[str, Any]:
        """Execute a request of the daemon's own; its response."""
        self._asked += 1
        transaction = f"station-{self._boot_id}-{self._asked}"
        document: dict[str, Any] = json.loads(
            await submit(self._take, verb, fields, transaction=transaction, stop=stop)
        )
        return document

    async def _say(self, text: str) -> None:
        _log.info("to the pilot", text=text)
        await self._vehicle.say(f"Pano: {text}")


_MODE_WORDS: Final = {"OFFBOARD": "GUIDED", "HOLD": "Hold"}


def _error_of(answer: Mapping[str, Any]) -> str:
    error = answer.get("error")
    return str(error["message"]) if isinstance(error, Mapping) else ""
