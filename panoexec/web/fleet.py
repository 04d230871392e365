"""All vehicles of the broker as browsers see them: what was heard is folded, and told to whoever follows."""

from __future__ import annotations

import time
import zlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

from panoexec.web.allowed import allowed
from panoexec.web.broker import BrokerLink, Document, Heard, Response, Thumbnail
from panoexec.web.mission import Mission
from panoexec.web.protocol import encode, is_mission
from panoexec.web.values import table, text

_MOST_VEHICLES: Final = 500
_THUMBNAIL_BYTES: Final = 24_000_000
"""All thumbnails together; the oldest are dropped, and can be asked for again."""

_RUN_MOST: Final = 10_000


class Audience(Protocol):
    """Where messages to browsers go."""

    def tell(self, vehicle: str, message: str) -> None:
        """To those who follow the vehicle."""
        ...

    def tell_all(self, message: str) -> None:
        """To everybody."""
        ...

    def is_followed(self, vehicle: str) -> bool:
        """Whether anybody follows the vehicle."""
        ...


class Vehicle:
    """What was heard from one vehicle.

    Attributes:
        id: of the vehicle.
        status: `online`, `offline`, or "" while unknown.
        state: the newest state; None before it.
        mission: None without one.
        heard_s: time.monotonic of the last message; None before one came that the broker had not kept.
        changed: whether its summary changed since it was last told.
        next_plan: a plan that came while the mission had one: that of the next mission, whose id is not known yet.
    """

    def __init__(self, vehicle_id: str) -> None:
        self.id = vehicle_id
        self.status = ""
        self.state: dict[str, Any] | None = None
        self.mission: Mission | None = None
        self.heard_s: float | None = None
        self.changed = True
        self.next_plan: dict[str, Any] | None = None
        self._boot = ("", -1)

    def is_outdated(self, state: Mapping[str, Any]) -> bool:
        """Whether a state is older than the newest one of the same process."""
        boot, seq = text(state.get("boot_id"), 64), state.get("seq")
        if not isinstance(seq, int) or not boot:
            return False
        outdated = boot == self._boot[0] and seq < self._boot[1]
        if not outdated:
            self._boot = (boot, seq)
        return outdated

    @property
    def silent_s(self) -> float | None:
        """Seconds since it was heard; None if only what the broker kept is known."""
        return None if self.heard_s is None else round(time.monotonic() - self.heard_s, 1)

    def summary(self) -> dict[str, Any]:
        """See `panoexec.web.protocol`."""
        return {"id": self.id, "status": self.status, "state": self.state, "silent_s": self.silent_s}


class Fleet:
    """Implements `Listener`.

    Attributes:
        vehicles: by id.
        on_response: called with each answer of a vehicle.
        is_starting: whether a mission of a vehicle is being planned.
        on_link: called when the connection to the broker was made or lost.
    """

    def __init__(self, audience: Audience) -> None:
        self.vehicles: dict[str, Vehicle] = {}
        self.on_response: Callable[[Response], None] = lambda _: None
        self.is_starting: Callable[[str], bool] = lambda _: False
        self.on_link: Callable[[], None] = lambda: None
        self.link_up = False
        self._audience = audience
        self._thumbnails: OrderedDict[tuple[str, str, int], bytes] = OrderedDict()
        self._thumbnail_bytes = 0

    # --- Listener

    def hear(self, message: Heard) -> None:
        """See `Listener`."""
        vehicle = self._vehicle(message.vehicle)
        if vehicle is None:
            return
        if not (isinstance(message, Document) and (message.retained or message.document == "offline")):
            vehicle.heard_s = time.monotonic()
        if isinstance(message, Response):
            self.on_response(message)
        elif isinstance(message, Thumbnail):
            self._take_thumbnail(vehicle, message)
        elif message.kind == "status":
            self._take_status(vehicle, str(message.document))
        elif message.kind == "state" and message.document is not None:
            self._take_state(vehicle, message.document)
        elif message.kind == "plan":
            self._take_plan(vehicle, message)
        elif message.kind == "event" and message.document is not None:
            self._take_event(vehicle, message.document)

    def link_changed(self, link: BrokerLink) -> None:
        """See `Listener`."""
        self.link_up = link.up
        self.on_link()
        self._audience.tell_all(link_message(link))
        for vehicle in self.vehicles.values():
            vehicle.changed = True
            self._tell_state(vehicle)

    # --- what browsers ask for

    def snapshot(self, vehicle_id: str, log: list[dict[str, Any]]) -> str:
        """The message `vehicle`; of one that was never heard, an empty one."""
        vehicle = self.vehicles.get(vehicle_id) or Vehicle(vehicle_id)
        return encode(
            "vehicle",
            vehicle=vehicle_id,
            status=vehicle.status,
            state=vehicle.state,
            may=self._may(vehicle),
            marks=unfolded(vehicle.state),
            mission=None if vehicle.mission is None else vehicle.mission.document(),
            log=log,
            silent_s=vehicle.silent_s,
        )

    def summaries(self) -> list[dict[str, Any]]:
        """All vehicles."""
        return [vehicle.summary() for _, vehicle in sorted(self.vehicles.items())]

    def changes(self) -> list[dict[str, Any]]:
        """The vehicles that changed since the last call."""
        changed = [vehicle for _, vehicle in sorted(self.vehicles.items()) if vehicle.changed]
        for vehicle in changed:
            vehicle.changed = False
        return [vehicle.summary() for vehicle in changed]

    def thumbnail(self, vehicle: str, mission_id: str, shot: int) -> bytes | None:
        """The JPEG; None if it is not here."""
        return self._thumbnails.get((vehicle, mission_id, shot))

    # --- what vehicles say

    def _vehicle(self, vehicle_id: str) -> Vehicle | None:
        vehicle = self.vehicles.get(vehicle_id)
        if vehicle is None and len(self.vehicles) < _MOST_VEHICLES:
            vehicle = self.vehicles[vehicle_id] = Vehicle(vehicle_id)
        return vehicle

    def _take_status(self, vehicle: Vehicle, status: str) -> None:
        if status == vehicle.status:
            return
        vehicle.status, vehicle.changed = status, True
        self._audience.tell(vehicle.id, encode("status", vehicle=vehicle.id, status=status))
        self._tell_state(vehicle)

    def _take_state(self, vehicle: Vehicle, state: dict[str, Any]) -> None:
        if vehicle.is_outdated(state):
            return
        vehicle.state, vehicle.changed = state, True
        mission_id = state.get("mission_id")
        if is_mission(mission_id):
            mission, new = self._mission(vehicle, str(mission_id))
            if (name := text(state.get("name"), 80)) != mission.name:
                mission.name, new = name, True
            if new:
                self._tell_mission(vehicle)
        self._tell_state(vehicle)

    def _take_plan(self, vehicle: Vehicle, message: Document) -> None:
        """Take a plan, whose topic does not say which mission it is of; it comes before or after the first event."""
        plan, mission = message.document, vehicle.mission
        if plan is None:
            return  # no mission any more: the last one stays until the next
        if mission is None:
            mission = vehicle.mission = Mission("")
        if mission.plan is not None and (not mission.plan_is_guess or mission.is_of(plan)):
            vehicle.next_plan = plan
            return
        mission.take_plan(plan, guess=False)
        self._tell_mission(vehicle)

    def _take_event(self, vehicle: Vehicle, event: Mapping[str, Any]) -> None:
        mission_id = event.get("mission_id")
        if not is_mission(mission_id):
            return
        mission_id = str(mission_id)
        mission = vehicle.mission
        if mission is not None and mission.id and mission_id < mission.id:
            return  # a photo of an earlier mission that was stored late
        mission, begun = self._mission(vehicle, mission_id)
        if begun:
            self._tell_mission(vehicle)
        new, entry, index = mission.take_event(event)
        if not new or not self._audience.is_followed(vehicle.id):
            return
        where = {"vehicle": vehicle.id, "mission_id": mission_id}
        if index is not None:
            self._audience.tell(vehicle.id, encode("shot", **where, shot=mission.shots[index]))
        if entry is not None:
            self._audience.tell(vehicle.id, encode("event", **where, event=entry))
        kind = event.get("type")
        if kind == "content_judged":
            self._audience.tell(vehicle.id, encode("content", **where, content=mission.content))
        elif kind in {"patch_planned", "bridge_planned"}:
            self._tell_mission(vehicle)

    def _take_thumbnail(self, vehicle: Vehicle, thumbnail: Thumbnail) -> None:
        key = (vehicle.id, thumbnail.mission_id, thumbnail.shot)
        old = self._thumbnails.pop(key, None)
        self._thumbnail_bytes += len(thumbnail.jpeg) - (0 if old is None else len(old))
        self._thumbnails[key] = thumbnail.jpeg
        while self._thumbnail_bytes > _THUMBNAIL_BYTES:
            _, dropped = self._thumbnails.popitem(last=False)
            self._thumbnail_bytes -= len(dropped)
        mission = vehicle.mission
        if mission is None or mission.id != thumbnail.mission_id or old == thumbnail.jpeg:
            return
        # the number makes browsers fetch the picture of another attempt
        url = f"/thumbnails/{vehicle.id}/{thumbnail.mission_id}/{thumbnail.shot}?n={_number(thumbnail.jpeg)}"
        mission.set_thumbnail(thumbnail.shot, url)
        self._audience.tell(
            vehicle.id,
            encode("thumbnail", vehicle=vehicle.id, mission_id=thumbnail.mission_id, shot=thumbnail.shot, url=url),
        )

    def _mission(self, vehicle: Vehicle, mission_id: str) -> tuple[Mission, bool]:
        """The vehicle's mission of this id, a new one in place of an earlier one, and whether it is new."""
        mission = vehicle.mission
        if mission is not None and mission.id == mission_id:
            return mission, False
        if mission is not None and not mission.id:
            mission.id = mission_id  # its plan came first
        else:
            mission = vehicle.mission = Mission(mission_id)
            if vehicle.next_plan is not None:
                mission.take_plan(vehicle.next_plan, guess=True)
                vehicle.next_plan = None
        return mission, True

    def _tell_mission(self, vehicle: Vehicle) -> None:
        if vehicle.mission is not None and self._audience.is_followed(vehicle.id):
            self._audience.tell(vehicle.id, encode("mission", vehicle=vehicle.id, mission=vehicle.mission.document()))

    def _may(self, vehicle: Vehicle) -> dict[str, str]:
        starting = self.is_starting(vehicle.id)
        return allowed(vehicle.status, vehicle.state, link=self.link_up, starting=starting)

    def tell_again(self, vehicle_id: str) -> None:
        """Tell the state of a vehicle, because what it can be commanded has changed."""
        vehicle = self.vehicles.get(vehicle_id)
        if vehicle is not None:
            self._tell_state(vehicle)

    def _tell_state(self, vehicle: Vehicle) -> None:
        if not self._audience.is_followed(vehicle.id):
            return
        fields = {"state": vehicle.state, "may": self._may(vehicle), "marks": unfolded(vehicle.state)}
        message = encode("state", vehicle=vehicle.id, **fields)
        self._audience.tell(vehicle.id, message)


def link_message(link: BrokerLink) -> str:
    """The message `link`."""
    return encode("link", up=link.up, since=link.since.isoformat(timespec="seconds"), reason=link.reason)


def unfolded(state: Mapping[str, Any] | None) -> str:
    """`state.shots` as one letter a shot; "" if it makes no sense."""
    parts = text(table(state).get("shots"), 100_000).split()
    out, length = [], 0
    for part in parts:
        count = part[1:]
        if part[0] not in "tcdram" or not count.isdecimal() or len(count) > 6:
            return ""
        length += int(count)
        if length > _RUN_MOST:
            return ""
        out.append(part[0] * int(count))
    return "".join(out)


def _number(jpeg: bytes) -> str:
    return f"{zlib.crc32(jpeg):08x}"
