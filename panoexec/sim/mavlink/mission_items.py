"""The embedded autopilot's mission: the MAVLink mission protocol, upload and download."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import Message

NAV_WAYPOINT = int(mavlink.MAV_CMD_NAV_WAYPOINT)
NAV_TAKEOFF = int(mavlink.MAV_CMD_NAV_TAKEOFF)
NAV_LAND = int(mavlink.MAV_CMD_NAV_LAND)
NAV_RTL = int(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
DO_JUMP = int(mavlink.MAV_CMD_DO_JUMP)
_FIRST_DO = 177
_NAVIGATES = frozenset({NAV_WAYPOINT, NAV_TAKEOFF, NAV_LAND, NAV_RTL})
_GLOBAL = 0
_RELATIVE, _RELATIVE_INT = 3, 6
_MOST = 500
_ACCEPTED = int(mavlink.MAV_MISSION_ACCEPTED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One item, as MISSION_ITEM_INT has it.

    Attributes:
        command: MAV_CMD.
        frame: MAV_FRAME.
        params: param1 to param4.
        x, y: 1e-7 degrees of a position, or the fifth and sixth parameter.
        z: metres, or the seventh parameter.
    """

    command: int
    frame: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float

    @property
    def navigates(self) -> bool:
        """Whether the vehicle flies it, until it is completed; others are done at once."""
        return self.command in _NAVIGATES

    @property
    def has_place(self) -> bool:
        """Whether x and y are a position."""
        return self.navigates and self.command != NAV_RTL and not (self.x == 0 and self.y == 0)

    def height_m(self, home_altitude_m: float) -> float:
        """Above home, metres."""
        return self.z if self.frame in (_RELATIVE, _RELATIVE_INT) else self.z - home_altitude_m


class MissionItems:
    """Stores a mission that a ground station uploads, and tells it.

    Attributes:
        items: by sequence number; ArduPilot's first one is home.
    """

    def __init__(self, config: SimConfig, *, changed: Callable[[], None]) -> None:
        self.items: list[Item] = []
        self._ardupilot = config.autopilot == "ardupilot"
        self._airframe = config.airframe
        self._changed = changed
        self._arriving: list[Item] = []
        self._expected = 0
        self._from = (0, 0)

    def answers(self, message: Message) -> list[Message] | None:
        """What it says to a message of the mission protocol; None for other messages."""
        kind = message.get_type()
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if not kind.startswith("MISSION_") or getattr(message, "mission_type", 0) != 0:
            return None
        answer: Message | None = None
        match kind:
            case "MISSION_REQUEST_LIST":
                answer = mavlink.MAVLink_mission_count_message(*sender, len(self._told), 0)
            case "MISSION_REQUEST_INT" | "MISSION_REQUEST":
                answer = self._item(sender, message.seq)
            case "MISSION_COUNT":
                answer = self._begin(sender, message.count)
            case "MISSION_ITEM_INT":
                answer = self._take(sender, message)
            case "MISSION_CLEAR_ALL":
                answer = self._clear(sender)
        return [] if answer is None else [answer]

    def _clear(self, sender: tuple[int, int]) -> Message:
        self.items = []
        self._changed()
        return _ack(sender, _ACCEPTED)

    @property
    def _told(self) -> list[Item]:
        if not self._ardupilot or not self.items:
            return self.items
        return [self._home(), *self.items[1:]]

    def _home(self) -> Item:
        home = self._airframe
        place = (round(home.latitude_deg * 1e7), round(home.longitude_deg * 1e7))
        return Item(
            command=NAV_WAYPOINT, frame=_GLOBAL, params=(0.0,) * 4, x=place[0], y=place[1], z=home.home_altitude_m
        )

    def _item(self, sender: tuple[int, int], seq: int) -> Message:
        if seq >= len(self._told):
            return _ack(sender, int(mavlink.MAV_MISSION_INVALID_SEQUENCE))
        one = self._told[seq]
        return mavlink.MAVLink_mission_item_int_message(
            *sender, seq, one.frame, one.command, 0, 1, *one.params, one.x, one.y, one.z, 0
        )

    def _begin(self, sender: tuple[int, int], count: int) -> Message:
        if count > _MOST:
            return _ack(sender, int(mavlink.MAV_MISSION_NO_SPACE))
        self._arriving, self._expected, self._from = [], count, sender
        if count == 0:
            return self._clear(sender)
        return mavlink.MAVLink_mission_request_int_message(*sender, 0, 0)

    def _take(self, sender: tuple[int, int], message: Message) -> Message | None:
        if sender != self._from or message.seq != len(self._arriving) or not self._expected:
            return None
        command = int(message.command)
        frame = int(message.frame)
        if self._ardupilot and (command >= _FIRST_DO or command == NAV_RTL):
            frame = _GLOBAL
        elif not self._ardupilot and frame == _RELATIVE:
            frame = _RELATIVE_INT
        params = (message.param1, message.param2, message.param3, message.param4)
        self._arriving.append(Item(command=command, frame=frame, params=params, x=message.x, y=message.y, z=message.z))
        if len(self._arriving) < self._expected:
            return mavlink.MAVLink_mission_request_int_message(*sender, len(self._arriving), 0)
        self.items, self._expected = self._arriving, 0
        self._changed()
        return _ack(sender, _ACCEPTED)


def place_of(item: Item, *, latitude_deg: float, longitude_deg: float, metres_per_deg: float) -> tuple[float, float]:
    """North and east of home, metres."""
    north = (item.x / 1e7 - latitude_deg) * metres_per_deg
    east = (item.y / 1e7 - longitude_deg) * metres_per_deg * math.cos(math.radians(latitude_deg))
    return north, east


def _ack(sender: tuple[int, int], result: int) -> Message:
    return mavlink.MAVLink_mission_ack_message(*sender, result, 0)
