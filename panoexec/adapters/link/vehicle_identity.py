"""Which vehicle a link belongs to, whether that is certain, and what to set if it is not."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from panoexec.adapters.link.roster import AUTOPILOT, AutopilotKind, Member, Roster
from panoexec.adapters.link.stream_health import HEARTBEAT_LOST_S

_KEY: Final = "[vehicle] system_id"
_NAMES: Final[dict[AutopilotKind, str]] = {"ardupilot": "ArduPilot", "px4": "PX4", "other": "neither ArduPilot nor PX4"}


class VehicleIdentity:
    """The identity of the vehicle on one link; for the event loop.

    Attributes:
        pinned: the configured system id; None: the first vehicle that was heard.
        system: the system id of the vehicle; None until it was found.
    """

    def __init__(
        self, roster: Roster, *, pinned: int | None = None, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        """Create it.

        Args:
            roster: who sends heartbeats.
            pinned: see the attribute.
            monotonic: the roster's clock, real seconds.
        """
        self.pinned = pinned
        self.system: int | None = None
        self._roster = roster
        self._monotonic = monotonic
        self._told = ""

    @property
    def autopilot(self) -> AutopilotKind | None:
        """Which autopilot the vehicle has; None until it was found."""
        member = self._member
        return None if member is None else member.autopilot_kind

    @property
    def kind(self) -> int:
        """MAV_TYPE of the vehicle; 0 until it was found."""
        member = self._member
        return 0 if member is None else member.kind

    @property
    def strangers(self) -> list[Member]:
        """Every component with heartbeats under another system id."""
        now_s = self._monotonic()
        return [] if self.system is None else self._roster.outside(self.system, now_s)

    def is_own(self, heartbeat: Mapping[str, Any]) -> bool:
        """Whether a heartbeat of component 1 is of this vehicle and not of another one with the same system id.

        Args:
            heartbeat: fields of HEARTBEAT.
        """
        member = self._member
        return member is not None and member.is_like(int(heartbeat["type"]), int(heartbeat["autopilot"]))

    @property
    def label(self) -> str:
        """Text for messages: `ArduPilot, system 1 (the first that was heard)`."""
        autopilot = self.autopilot
        if autopilot is None:
            return "none"
        how = f"set by {_KEY}" if self.pinned is not None else "the first vehicle that was heard"
        return f"{_NAMES[autopilot]}, system {self.system} ({how})"

    @property
    def others(self) -> list[Member]:
        """The autopilots of other vehicles on the link."""
        return [] if self.system is None else self._roster.others(self.system, self._monotonic())

    @property
    def problem(self) -> str:
        """Why it is not certain that this is the right vehicle, and what to set; "" if it is certain."""
        if self.system is None:
            return ""
        if self._roster.is_contested(self.system, self._monotonic()):
            return (
                f"two autopilots of different kinds beat as system {self.system} component {AUTOPILOT}: give each "
                "vehicle a system id of its own (ArduPilot MAV_SYSID, before 4.7 SYSID_THISMAV; PX4 MAV_SYS_ID)"
            )
        others = self.others
        if self.pinned is not None or not others:
            return ""
        systems = " and ".join(str(member.system) for member in others)
        if self.is_silent:
            return (
                f"the vehicle of system {self.system} is silent, but the vehicle of system {systems} sends heartbeats: "
                f"if that is the right one, set {_KEY} = {others[0].system} and restart"
            )
        return (
            f"several vehicles are on this link: system {self.system}, which was heard first, and system {systems}: "
            f"set {_KEY} to the id of this vehicle and restart"
        )

    @property
    def is_silent(self) -> bool:
        """Whether the vehicle's autopilot sends no heartbeats any more."""
        member = self._member
        return member is not None and self._monotonic() - member.last_s >= HEARTBEAT_LOST_S

    @property
    def why_not_found(self) -> str:
        """What is on the link instead of the vehicle; "" for nothing, or if it was found."""
        if self.system is not None and self._member is not None:
            return self.problem
        now_s = self._monotonic()
        vehicles = self._roster.vehicles(now_s)
        if self.pinned is not None and vehicles:
            systems = ", ".join(str(member.system) for member in vehicles)
            return f"{_KEY} is {self.pinned}, but the vehicles on this link have the system ids {systems}"
        heard = ", ".join(str(system) for system in self._roster.systems(now_s))
        return f"heartbeats of system {heard} arrive, but none of a vehicle's autopilot (component 1)" if heard else ""

    def foreign(self, kind: int, name: str) -> str:
        """Devices of a type that beat under another system id than the vehicle's, and what to set; "" if none does.

        Args:
            kind: MAV_TYPE.
            name: what to call one: `camera`.
        """
        if self.system is None:
            return ""
        devices = self._roster.foreign(self.system, kind, self._monotonic())
        if not devices:
            return ""
        ids = " and ".join(device.ids for device in devices)
        return (
            f"a {name} sends heartbeats as {ids}, but the vehicle is system {self.system}: set the {name}'s system id "
            f"to {self.system} (what belongs to a vehicle has its system id)"
        )

    def news(self) -> str:
        """The problem if it was not told by this method yet, else ""."""
        problem = self.problem
        if problem == self._told:
            return ""
        self._told = problem
        return problem

    @property
    def _member(self) -> Member | None:
        return None if self.system is None else self._roster.member(self.system, AUTOPILOT)
