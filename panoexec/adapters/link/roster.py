"""Who sends heartbeats on a link: systems, their components, and which of them are vehicles. Pure logic.

Times are real seconds, passed in. `note` may be called in MAVSDK's thread, everything else on the event loop: entries
are replaced as a whole, so that a reader sees the old or the new one.

Sources: MAVLink minimal.xml (HEARTBEAT, MAV_TYPE, MAV_AUTOPILOT). The autopilot's kind is taken from the heartbeats of
component 1 alone. MAVSDK takes it from whichever component beat last, and until the first heartbeat was processed its
answer is a default: a program that asks in that moment turns an ArduPilot as a PX4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

AUTOPILOT: Final = 1
"""MAV_COMP_ID_AUTOPILOT1."""

AutopilotKind: TypeAlias = Literal["ardupilot", "px4", "other"]

_ARDUPILOT, _INVALID, _PX4 = 3, 8, 12
_KINDS: Final[dict[int, AutopilotKind]] = {_ARDUPILOT: "ardupilot", _PX4: "px4"}
_NO_VEHICLES: Final = frozenset({5, 6, 18, 26, 27, 30, 31, 32, 33, 34, 36, 37, 38, 39, 40, 41, 42})
"""MAV_TYPEs that do not move: antenna tracker, ground station, companion computer, gimbal, camera, beacons, …"""

PRESENT_S: Final = 10.0
"""A system that has not been heard for so long is not on the link any more."""
_CONTEST_BEATS: Final = 3
_ADOPT_S: Final = 5.0
"""An autopilot that beats as another kind for so long, with no heartbeat of the old one between, is believed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """One component with heartbeats.

    Attributes:
        system, component: its MAVLink ids.
        kind: MAV_TYPE.
        autopilot: MAV_AUTOPILOT.
        first_s, last_s: when its first and its last heartbeat arrived.
    """

    system: int
    component: int
    kind: int
    autopilot: int
    first_s: float
    last_s: float

    @property
    def is_vehicle(self) -> bool:
        """Whether it is the autopilot of a vehicle."""
        return self.component == AUTOPILOT and self.autopilot != _INVALID and self.kind not in _NO_VEHICLES

    @property
    def autopilot_kind(self) -> AutopilotKind:
        """Which autopilot it is, by its heartbeat."""
        return _KINDS.get(self.autopilot, "other")

    def is_like(self, kind: int, autopilot: int) -> bool:
        """Whether a heartbeat may be of the same autopilot; at start-up it may not know its type yet (0)."""
        return autopilot == self.autopilot and (kind == self.kind or 0 in (kind, self.kind))

    @property
    def ids(self) -> str:
        """Text for messages: `system 4 component 100`."""
        return f"system {self.system} component {self.component}"


class Roster:
    """Everybody with heartbeats."""

    def __init__(self) -> None:
        self._members: dict[tuple[int, int], Member] = {}
        self._rivals: dict[tuple[int, int], tuple[int, float]] = {}

    def note(self, system: int, component: int, kind: int, autopilot: int, now_s: float) -> None:
        """Take a heartbeat.

        An autopilot keeps the kind that it had first, as long as that one is heard: a second program that beats with
        the same ids would otherwise decide how the vehicle is turned.
        """
        key = system, component
        known = self._members.get(key)
        if known is None:
            self._members[key] = Member(
                system=system, component=component, kind=kind, autopilot=autopilot, first_s=now_s, last_s=now_s
            )
        elif not known.is_vehicle or known.is_like(kind, autopilot) or now_s - known.last_s > _ADOPT_S:
            self._members[key] = replace(known, kind=kind or known.kind, autopilot=autopilot, last_s=now_s)
        else:
            beats, last_s = self._rivals.get(key, (0, now_s))
            self._rivals[key] = (beats + 1 if now_s - last_s < PRESENT_S else 1), now_s

    def member(self, system: int, component: int) -> Member | None:
        """The component, None if it was never heard."""
        return self._members.get((system, component))

    def is_contested(self, system: int, now_s: float) -> bool:
        """Whether two kinds of autopilot beat with the ids of this one: two vehicles have the same system id."""
        key = system, AUTOPILOT
        beats, last_s = self._rivals.get(key, (0, 0.0))
        known = self._members.get(key)
        both = known is not None and now_s - max(last_s, known.last_s) < PRESENT_S > abs(last_s - known.last_s)
        return both and beats >= _CONTEST_BEATS

    def vehicles(self, now_s: float) -> list[Member]:
        """The autopilots of vehicles that are present, in the order in which they appeared."""
        return [member for member in self._present(now_s) if member.is_vehicle]

    def choose(self, wanted: int | None, now_s: float) -> Member | None:
        """The vehicle to connect to: that of system `wanted`, or the first one; None while there is none."""
        fits = (member for member in self.vehicles(now_s) if wanted in (None, member.system))
        return next(fits, None)

    def others(self, system: int, now_s: float) -> list[Member]:
        """The autopilots of other vehicles that are present."""
        return [member for member in self.vehicles(now_s) if member.system != system]

    def outside(self, system: int, now_s: float) -> list[Member]:
        """Components that are present under other system ids than the vehicle's."""
        return [member for member in self._present(now_s) if member.system != system]

    def foreign(self, system: int, kind: int, now_s: float) -> list[Member]:
        """Those of them that have that MAV_TYPE."""
        return [member for member in self.outside(system, now_s) if member.kind == kind]

    def systems(self, now_s: float) -> list[int]:
        """The ids of all systems that are present, sorted."""
        return sorted({member.system for member in self._present(now_s)})

    def _present(self, now_s: float) -> list[Member]:
        present = [member for member in tuple(self._members.values()) if now_s - member.last_s < PRESENT_S]
        return sorted(present, key=lambda member: (member.first_s, member.system, member.component))
