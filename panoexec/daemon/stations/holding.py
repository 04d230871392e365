"""Keeps the vehicle at a station while its panorama is flown, and lets the mission go on.

Nothing that the autopilot is told here outlasts a hold time: on ArduPilot the waypoint is made the current item again,
so that its hold time begins anew; on PX4, where that changes nothing, the plan's hold time must suffice. A vehicle
whose companion computer dies goes on when the hold time is over. `MAV_CMD_DO_PAUSE_CONTINUE` is not used: ArduCopter
refuses it where a waypoint holds, and paused on the way it would stay there for ever.
"""

from __future__ import annotations

import math
from typing import Final

import structlog

from panoexec.adapters.autopilot_mission import COMPLETE, AutopilotMission
from panoexec.clock import Clock
from panoexec.daemon.stations.marked import Station
from panoexec.devices import VehicleStatus
from panoexec.errors import DeviceError

MISSION_MODE: Final = "MISSION"
_LEFT_FRAC: Final = 0.5
"""The hold time is begun anew when so much of it is left, so that a restart of the process fits into the rest."""
READ_AGAIN_S: Final = 2.0
"""After a mission that could not be read."""
_RETRY_S: Final = 1.0
_GO_ON_S: Final = 3.0

_log = structlog.get_logger(__name__)


class Holding:
    """One stay at a station.

    Attributes:
        taken: the pilot has changed the flight mode: the mission is the pilot's from now on.
        gone: the vehicle flies on: another item is current.
        changed: the mission is another one than at the arrival.
        released: the hold time is not to be prolonged any more.
    """

    def __init__(
        self,
        station: Station,
        mission: AutopilotMission,
        *,
        clock: Clock,
        since_s: float,
        mode: str = MISSION_MODE,
    ) -> None:
        """Begin it.

        Args:
            station: where.
            mission: of the autopilot.
            clock: of the mission.
            since_s: when the hold time began; NaN if that is unknown.
            mode: the flight mode in which the panorama is flown.
        """
        self.taken = self.gone = self.changed = self.released = False
        self.mode = mode
        self._station = station
        self._mission = mission
        self._digest = mission.digest
        self._clock = clock
        self._ends_s = since_s + station.hold_s if math.isfinite(since_s) else -math.inf
        self._tried_s = self._failed_s = -math.inf

    @property
    def left_s(self) -> float:
        """How much of the hold time is left, at least; on the mission's clock."""
        return self._ends_s - self._clock.monotonic()

    @property
    def may_act(self) -> bool:
        """Whether the autopilot may be told anything about the mission."""
        return not (self.taken or self.gone or self.changed)

    async def look(self, status: VehicleStatus) -> None:
        """Take the vehicle's status, and prolong the hold time when it is due."""
        current = self._mission.current
        if status.connected and status.mode not in {self.mode, ""} and not self.taken:
            self.taken = True
            _log.warning("the pilot has taken over at a station", waypoint=self._station.waypoint, mode=status.mode)
        if self._mission.stale and self.may_act and self._clock.monotonic() - self._failed_s >= READ_AGAIN_S:
            try:
                await self._mission.read()
            except DeviceError as error:
                self._failed_s = self._clock.monotonic()
                _log.info("the mission could not be read", error=str(error))
        if self._mission.digest != self._digest and not self.changed:
            self.changed = True
            _log.warning("the mission was changed while the vehicle was at a station", waypoint=self._station.waypoint)
        if current is not None and current.seq != self._station.waypoint and status.mode == MISSION_MODE:
            self.gone = True
        if self._is_due(status):
            await self._prolong()

    def _is_due(self, status: VehicleStatus) -> bool:
        current = self._mission.current
        if not self.may_act or self.released or not self._mission.extends_hold or self.mode != MISSION_MODE:
            return False
        fresh = current is not None and current.seq == self._station.waypoint and not self._mission.stale
        now = self._clock.monotonic()
        due = self.left_s <= _LEFT_FRAC * self._station.hold_s
        return fresh and status.connected and status.mode == MISSION_MODE and due and now - self._tried_s >= _RETRY_S

    async def _prolong(self) -> None:
        began_s = self._tried_s = self._clock.monotonic()
        try:
            await self._mission.make_current(self._station.waypoint)
        except DeviceError as error:
            _log.warning("the hold time could not be prolonged", error=str(error))
        else:
            self._ends_s = began_s + self._station.hold_s

    async def go_on(self, status: VehicleStatus) -> str:
        """Let the mission go on with the item behind the waypoint; why it does not, "" if it does.

        The vehicle goes on by itself later where this fails.
        """
        if self.mode != MISSION_MODE:
            return "not in its mission"
        if self.gone:
            return ""
        if not self.may_act or status.mode != MISSION_MODE:
            return "the mission is the pilot's"
        _log.info("the mission goes on", behind=self._station.marker)
        try:
            await self._mission.make_current(self._station.marker)
            end_s = self._clock.monotonic() + _GO_ON_S
            while self._clock.monotonic() < end_s:
                current, done = self._mission.current, self._mission.reached == self._station.marker
                left = current is not None and (current.seq != self._station.waypoint or current.state == COMPLETE)
                if done or left:
                    return ""
                await self._clock.sleep(0.05)
        except DeviceError as error:
            return str(error)
        return "the autopilot told no other current item"
