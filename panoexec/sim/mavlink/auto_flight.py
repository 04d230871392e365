"""The embedded autopilot's AUTO or Mission mode: flies its mission, holds at waypoints, runs the items between.

As recorded with ArduCopter and PX4 (`tests/data/*-mission.jsonl`): a waypoint is reached, and the items behind it are
run, when its hold time is over. ArduCopter pauses on the way and refuses to where it holds; its hold time begins anew
when the waypoint is made current again, which on PX4 changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.component import Command
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.mission_items import (
    DO_JUMP,
    NAV_LAND,
    NAV_RTL,
    NAV_TAKEOFF,
    Item,
    MissionItems,
    place_of,
)
from panoexec.sim.mavlink.modes import FlightModes
from panoexec.sim.mavlink.wire import Message
from panoexec.sim.physics.airframe import METRES_PER_DEG, Airframe
from panoexec.sim.physics.world import Repeater, Timeline

_STEP_S = 0.05
_THERE_M = {"ardupilot": 0.3, "px4": 2.0}
"""How near a waypoint its hold time begins; PX4's is NAV_ACC_RAD, in which it has not come to rest yet."""
_TURNS_FROM_M = 2.0
_NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE = 2, 3, 4, 5
"""MISSION_STATE."""
_NO_MISSION = 1
_UNKNOWN_TOTAL = 65535
_ACCEPTED = int(mavlink.MAV_RESULT_ACCEPTED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)
_FAILED = int(mavlink.MAV_RESULT_FAILED)
_UNSUPPORTED = int(mavlink.MAV_RESULT_UNSUPPORTED)


class AutoFlight:
    """Flies the mission while the flight mode is that of missions.

    Attributes:
        store: the mission.
    """

    def __init__(
        self,
        config: SimConfig,
        *,
        timeline: Timeline,
        airframe: Airframe,
        modes: FlightModes,
        send: Callable[[Message], None],
        say: Callable[[str], None],
        do: Callable[[Item], None],
        home: Callable[[], None],
        land: Callable[[], None],
    ) -> None:
        self.store = MissionItems(config, changed=self._changed)
        self._ardupilot = config.autopilot == "ardupilot"
        self._there_m = _THERE_M[config.autopilot]
        self._config = config.airframe
        self._timeline = timeline
        self._airframe = airframe
        self._modes = modes
        self._send = send
        self._say = say
        self._do = do
        self._fly_home = home
        self._land = land
        self._seq = 0
        self._held_since_s = math.nan
        self._paused = self._complete = self._flies = self._under_way = self._begun = False
        self._jumps: dict[int, int] = {}
        self._stepper = Repeater(timeline, self._step)

    # --- what it says

    def current(self) -> Message:
        """MISSION_CURRENT (42)."""
        items = len(self.store.items)
        total = items - 1 if self._ardupilot and items else items
        if not items:
            state, total = _NO_MISSION, 0 if self._ardupilot else _UNKNOWN_TOTAL
        elif self._complete:
            state = _COMPLETE
        elif self._paused:
            state = _PAUSED
        elif self._ardupilot:
            state = _ACTIVE if self._flies else _NOT_STARTED
        else:
            state = _PAUSED if self._begun and not self._flies else _ACTIVE
        return mavlink.MAVLink_mission_current_message(self._seq, total, state, int(self._modes.is_auto))

    # --- what it is told

    @property
    def may_begin(self) -> bool:
        """Whether the mode can be changed to."""
        return bool(self.store.items) or not self._ardupilot

    def pause(self, command: Command) -> int:
        """MAV_CMD_DO_PAUSE_CONTINUE (193)."""
        if not self._ardupilot:
            return _UNSUPPORTED
        if not self._flies:
            return _FAILED
        if command.params[0] == 1:
            if self._paused:
                self._paused = False
                self._fly()
            return _ACCEPTED
        if command.params[0] != 0:
            return _DENIED
        if not math.isnan(self._held_since_s) or self._airframe.to_go_m < self._there_m:
            self._say("Failed to pause")
            return _FAILED
        self._paused = True
        self._airframe.brake()
        return _ACCEPTED

    def set_current(self, command: Command) -> int:
        """MAV_CMD_DO_SET_MISSION_CURRENT (224)."""
        if not self._ardupilot:
            return _UNSUPPORTED
        seq = int(command.params[0])
        if not 0 <= seq < len(self.store.items):
            return _DENIED
        self._go(max(seq, 1))
        self._send(self.current())
        return _ACCEPTED

    def take_current(self, message: Message) -> None:
        """MISSION_SET_CURRENT (41)."""
        if message.seq < len(self.store.items) and (self._ardupilot or message.seq != self._seq):
            self._go(message.seq)
            self._send(self.current())

    def _changed(self) -> None:
        """The mission was uploaded or cleared."""
        self._jumps.clear()
        self._complete = False
        self._seq = min(self._seq, max(0, len(self.store.items) - 1))
        if self.store.items:
            self._stepper.start(_STEP_S)
        if self._ardupilot:
            self._say("Flight plan received")

    # --- the flight

    def _step(self) -> None:
        if self._modes.is_auto != self._flies:
            self._flies = self._modes.is_auto
            if self._flies:
                self._enter()
            else:
                self._paused = False
                self._airframe.brake()
        if not self._flies or self._paused or self._complete or not self.store.items:
            return
        if not self._airframe.armed:
            self._under_way = False
            return
        if not self._under_way:
            self._fly()
        item = self._now
        if item.command == NAV_RTL:
            return
        if math.isnan(self._held_since_s):
            if self._airframe.to_go_m < self._there_m:
                self._held_since_s = self._timeline.now_s
            return
        hold_s = item.params[0] if item.command not in (NAV_TAKEOFF, NAV_LAND) else 0.0
        if self._timeline.now_s - self._held_since_s >= hold_s:
            self._go(self._seq + 1, reached=self._seq)

    @property
    def _now(self) -> Item:
        return self.store.items[self._seq]

    def _enter(self) -> None:
        if self._complete or (self._seq == 0 and self._ardupilot):
            self._complete = False
            self._jumps.clear()
            self._seq = 1 if self._ardupilot else 0
        self._go(self._seq)

    def _reached(self, seq: int) -> None:
        self._send(mavlink.MAVLink_mission_item_reached_message(seq))
        if self._ardupilot:
            self._say(f"Reached command #{seq}")

    def _go(self, seq: int, *, reached: int | None = None) -> None:
        """Make an item current; those that are no places to fly to are run, up to the next that is.

        Args:
            seq: the item.
            reached: the one before it, if it was completed.
        """
        self._held_since_s, self._paused = math.nan, False
        if reached is not None and self._ardupilot:
            self._reached(reached)
        items, loops = self.store.items, 255
        while seq < len(items) and not items[seq].navigates and loops:
            if not self._flies:
                self._seq = seq
                return
            loops -= 1
            if items[seq].command != DO_JUMP:
                reached = seq
            seq = self._ran(seq)
        if reached is not None and not self._ardupilot:
            self._reached(reached)  # of items that are completed at one moment it tells the last
        if seq >= len(items):
            self._complete = True
            self._seq = len(items) - 1
            return
        self._seq = seq
        if not self._ardupilot:
            self._send(self.current())
        if self._flies and self._airframe.armed:
            self._fly()

    def _ran(self, seq: int) -> int:
        """Run an item that is no place to fly to; the next one."""
        item = self.store.items[seq]
        if item.command == DO_JUMP:
            done, times = self._jumps.get(seq, 0), int(item.params[1])
            if times < 0 or done < times:
                self._jumps[seq] = done + 1
                return int(item.params[0])
            return seq + 1
        self._do(item)
        return seq + 1

    def _fly(self) -> None:
        self._under_way = self._begun = True
        item, home = self._now, self._config
        if item.command == NAV_RTL:
            self._fly_home()
            return
        if item.command == NAV_LAND:
            self._land()
            return
        height_m = item.height_m(home.home_altitude_m)
        if item.command == NAV_TAKEOFF:
            self._airframe.take_off(height_m)
            return
        north, east = place_of(
            item,
            latitude_deg=home.latitude_deg,
            longitude_deg=home.longitude_deg,
            metres_per_deg=METRES_PER_DEG,
        )
        from_north, from_east = self._airframe.away_m
        if math.hypot(north - from_north, east - from_east) > _TURNS_FROM_M:
            self._airframe.turn_to(math.degrees(math.atan2(east - from_east, north - from_north)))
        self._airframe.fly_to(north, east, height_m)
