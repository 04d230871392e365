"""The mission that the autopilot flies: its items, which of them is current, and going on with another one.

MISSION_ITEM_REACHED is of no use for arriving: ArduPilot and PX4 send it when the hold time of a waypoint is over. And
an upload by another station is acknowledged to that station alone, so the mission is read again when anything hints at
a change: its length, its id where the autopilot has one, what the autopilot announces, another current item.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final, Self

from mavsdk.plugins.mission_raw import MissionRaw

from panoexec.adapters.link.mavsdk_errors import MAV_RESULTS
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_health import ARDUPILOT, Stream
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.errors import DeviceError

MISSION_STREAM: Final = Stream(
    message_id=42, name="MISSION_CURRENT", rate_hz=2.0, idle_rate_hz=2.0, autopilot=ARDUPILOT
)
"""PX4 refuses an interval and sends it by itself, at each change and about once a second."""
DO_SET_MISSION_CURRENT: Final = 224
DO_SET_MODE: Final = 176
_CUSTOM_MODE: Final = 1
_UPLOADED: Final = "flight plan received"
"""How ArduPilot announces an upload by STATUSTEXT; PX4 announces nothing, but tells the mission's id."""
INTRODUCTION: Final = "{} stations in this mission"
"""What panoexec says, behind its name, when it has read a mission; other ones on the vehicle know it by that."""
_INTRODUCED: Final = re.compile("Pano: " + INTRODUCTION.format(r"\d+"))
_GONE_S: Final = 5.0
"""Another panoexec without heartbeats for so long flies no stations."""
_AFTER_S: Final = 2.0
"""So long after the panoexec that flies the stations, others read the mission."""
_MODES: Final = {
    ("ardupilot", "MISSION"): (3.0,),
    ("ardupilot", "OFFBOARD"): (4.0,),
    ("px4", "MISSION"): (4.0, 4.0),
    ("px4", "HOLD"): (4.0, 3.0),
}
_CONFIRM_S: Final = 1.5
_TRIES: Final = 3
COMPLETE: Final = 5
"""MISSION_STATE."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionItem:
    """One item of the autopilot's mission.

    Attributes:
        seq: its number.
        command: MAV_CMD.
        frame: MAV_FRAME.
        params: param1 to param4; NaN where none is given.
        x, y: 1e-7 degrees of latitude and longitude, or the fifth and sixth parameter.
        z: metres, or the seventh parameter.
    """

    seq: int
    command: int
    frame: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Current:
    """What MISSION_CURRENT says.

    Attributes:
        seq: the current item.
        total: number of items; 0 if unknown.
        state: MISSION_STATE, 0 if unknown.
        mission_id: of the uploaded mission; 0 if unknown.
        heard_s: when it was said, on the mission's clock.
    """

    seq: int
    total: int
    state: int
    mission_id: int
    heard_s: float


class AutopilotMission:
    """An async context manager on an open link.

    Attributes:
        items: as read last.
        digest: of these items; "" before they were read.
        stale: something hints that they are not the autopilot's any more.
        current: as told last; None before.
        reached: the item that was told as reached since one was made current; None for none.
        is_to_introduce: another panoexec was heard that may not know of this one.
    """

    def __init__(self, link: MavsdkLink) -> None:
        """Create it; entering the context subscribes to messages."""
        self.items: tuple[MissionItem, ...] = ()
        self.digest = ""
        self.stale = True
        self.current: Current | None = None
        self.reached: int | None = None
        self.is_to_introduce = False
        self._others: frozenset[int] = frozenset()
        self._link = link
        self._off: list[Callable[[], None]] = []

    @property
    def extends_hold(self) -> bool:
        """Whether a hold time begins anew when its waypoint is made the current one again (ArduPilot)."""
        return self._link.autopilot == "ardupilot"

    @property
    def claimed(self) -> str:
        """Why the mission is left to another panoexec on the vehicle; "" if it is not.

        With the same MAVLink ids, none of them acts; with different ones, that with the lowest component id.
        """
        if self._link.has_id_conflict:
            return "another panoexec has this vehicle's MAVLink ids"
        now, components = time.monotonic(), self._link.components
        alive = [one for one in self._others if now - components.get(one, (0, -math.inf))[1] < _GONE_S]
        first = min(alive, default=self._link.own_ids[1])
        return f"the panoexec of component {first} does it" if first < self._link.own_ids[1] else ""

    async def read(self) -> bool:
        """Read the mission; whether it is another one than before.

        Raises:
            DeviceError: refused, not answered, or mixed with what another station reads.
            LinkError: no link.
        """
        if self.claimed:  # what two read at the same time is of no use to either
            await asyncio.sleep(_AFTER_S)
        self.stale = False
        plugin = self._link.requests.plugin(MissionRaw)
        try:
            told = await self._link.requests.mavsdk_call("reading the mission", plugin.download_mission)
        except DeviceError:
            self.stale = True
            raise
        items = tuple(_item(one) for one in told)
        if [one.seq for one in items] != list(range(len(items))):  # MAVSDK takes the items that another one asked for
            self.stale = True
            raise DeviceError("reading the mission: another station reads it at the same time")
        digest = _digest(items)
        changed, self.items, self.digest = digest != self.digest, items, digest
        return changed

    async def make_current(self, seq: int) -> None:
        """Have the autopilot go on with an item; returns when it was acknowledged (PX4: when it is current, or done).

        PX4 tells another current item at its next turn, once a second (measured), and an item that is done at once.

        Raises:
            DeviceError: refused, not answered, or not done.
            LinkError: no link.
        """
        what = f"going on with item {seq} of the mission"
        self.reached = None
        if self._link.autopilot == "ardupilot":
            result = await self._link.requests.command(DO_SET_MISSION_CURRENT, [seq])
            if result != 0:
                raise DeviceError(f"{what}: {MAV_RESULTS.get(result, result)}")
            return
        before = self.current
        fields = {"target_system": self._link.requests.system_id, "target_component": AUTOPILOT, "seq": seq}
        for _ in range(_TRIES):
            await self._link.requests.send(what, "MISSION_SET_CURRENT", fields)
            end_s = time.monotonic() + _CONFIRM_S
            while time.monotonic() < end_s:
                now = self.current
                if self.reached == seq or (now is not None and before is not None and now.seq != before.seq):
                    return
                await asyncio.sleep(0.05)
        raise DeviceError(f"{what}: the autopilot did not")

    async def change_mode(self, name: str) -> None:
        """Change the flight mode to MISSION, OFFBOARD (ArduPilot's GUIDED) or HOLD (PX4).

        Raises:
            DeviceError: refused or not answered, or the autopilot has no such mode.
            LinkError: no link.
        """
        numbers = _MODES.get((self._link.autopilot or "", name))
        if numbers is None:
            raise DeviceError(f"changing to {name}: this autopilot has no such mode")
        result = await self._link.requests.command(DO_SET_MODE, [_CUSTOM_MODE, *numbers])
        if result != 0:
            raise DeviceError(f"changing to {name}: {MAV_RESULTS.get(result, result)}")

    async def __aenter__(self) -> Self:
        """Subscribe to messages."""
        self._off = [
            self._link.on("MISSION_CURRENT", self._told),
            self._link.on("MISSION_ITEM_REACHED", self._done),
            self._link.on("STATUSTEXT", self._announced),
            self._link.when_back(self._came_back),
        ]
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Unsubscribe."""
        for off in self._off:
            off()

    # --- in MAVSDK's thread; each assignment is atomic

    def _told(self, message: MavMessage) -> None:
        if message.component_id != AUTOPILOT:
            return
        fields, before = message.fields, self.current
        now = Current(
            seq=int(fields["seq"]),
            total=int(fields.get("total") or 0),
            state=int(fields.get("mission_state") or 0),
            mission_id=int(fields.get("mission_id") or 0),
            heard_s=message.heard_s,
        )
        self.current = now
        if before is None or (now.seq, now.total, now.mission_id) != (before.seq, before.total, before.mission_id):
            self.stale = True

    def _done(self, message: MavMessage) -> None:
        if message.component_id == AUTOPILOT:
            self.reached = int(message.fields["seq"])

    def _announced(self, message: MavMessage) -> None:
        text, sender = str(message.fields.get("text", "")), message.component_id
        if sender == AUTOPILOT and text.lower().startswith(_UPLOADED):
            self.stale = True
        elif sender not in {AUTOPILOT, self._link.own_ids[1]} and _INTRODUCED.match(text):
            self.is_to_introduce |= sender not in self._others
            self._others |= {sender}

    # --- on the loop

    def _came_back(self) -> None:
        self.stale, self.current = True, None


def _item(told: Any) -> MissionItem:
    four = (told.param1, told.param2, told.param3, told.param4)
    return MissionItem(
        seq=int(told.seq),
        command=int(told.command),
        frame=int(told.frame),
        params=(float(four[0]), float(four[1]), float(four[2]), float(four[3])),
        x=int(told.x),
        y=int(told.y),
        z=float(told.z),
    )


def _digest(items: Sequence[MissionItem]) -> str:
    """Of everything but where an ArduPilot's home is, which it measures anew."""
    lines = [
        f"{one.command} {one.frame} {[round(p, 3) if math.isfinite(p) else None for p in one.params]} {one.x} {one.y}"
        f" {one.z:.2f}"
        for one in items
        if one.seq > 0
    ]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
