"""A flight of an autopilot through its own mission with held waypoints, alike with a real one, to record it, and with
the embedded one.

Record: `python -m tests.wire.mission_conversation ARDUCOPTER FILE`, and the same with PX4's binary (SIH).
"""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panoexec.dryrun.autopilot import firmware_of, running_sitl, sitl_binary
from panoexec.dryrun.firmware import SitlOptions
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.ports import free_udp_ports
from tests.wire.sim_peer import Heard, Peer, UdpPeer, command, result_of

LATITUDE, LONGITUDE = 47.4, 8.5
HEIGHT_M = 15.0
HOLD_S = 12
NAN = math.nan
MODES: dict[str, dict[str, tuple[float, ...]]] = {
    "ardupilot": {"guided": (1, 4), "auto": (1, 3), "loiter": (1, 5)},
    "px4": {"auto": (1, 4, 4), "loiter": (1, 4, 3)},
}
TAKEOFF, WAYPOINT, DIGICAM, JUMP, RTL = 22, 16, 203, 177, 20
PAUSE, SET_CURRENT, SET_MODE, ARM, INTERVAL = 193, 224, 176, 400, 511
_STEP_S = 0.1


def offset(north_m: float, east_m: float) -> tuple[int, int]:
    """Latitude and longitude, 1e-7 degrees, of a point near home."""
    latitude = LATITUDE + north_m / 111_319.5
    longitude = LONGITUDE + east_m / (111_319.5 * math.cos(math.radians(LATITUDE)))
    return round(latitude * 1e7), round(longitude * 1e7)


def item(seq: int, cmd: int, *params: float, at: tuple[int, int] = (0, 0), z: float = 0.0) -> Any:
    """MISSION_ITEM_INT; above home where it has a position."""
    frame = 3 if cmd in (TAKEOFF, WAYPOINT) else 2
    four = (*params, *(0.0,) * (4 - len(params)))
    return mavlink.MAVLink_mission_item_int_message(1, 1, seq, frame, cmd, 0, 1, *four, *at, z, 0)


def mission(kind: str) -> list[Any]:
    """Take-off, two held waypoints with a camera item behind each, a third one, a jump back, the way home."""
    first = [item(0, WAYPOINT, at=offset(0, 0))] if kind == "ardupilot" else []
    seq = itertools.count(len(first))
    start = item(next(seq), TAKEOFF, at=offset(0, 0), z=HEIGHT_M)
    one = item(next(seq), WAYPOINT, HOLD_S, at=offset(15, 0), z=HEIGHT_M)
    behind_one = item(next(seq), DIGICAM, at=(0, 2))
    two = item(next(seq), WAYPOINT, HOLD_S, at=offset(30, 0), z=HEIGHT_M)
    behind_two = item(next(seq), DIGICAM, at=(0, 1))
    third = item(next(seq), WAYPOINT, at=offset(30, 15), z=HEIGHT_M)
    back = item(next(seq), JUMP, two.seq, 1)
    return [*first, start, one, behind_one, two, behind_two, third, back, item(next(seq), RTL)]


@dataclass(slots=True)
class Progress:
    """What the vehicle said of its mission and where it is."""

    current: int = -1
    state: int = -1
    reached: int = -1
    at: tuple[int, int, int] = (0, 0, 0)

    def take(self, heard: list[Heard], told: list[list[Any]]) -> None:
        for one in heard:
            message = one.message
            if one.component != 1:
                continue
            if one.name == "MISSION_CURRENT" and (message.seq, message.mission_state) != (self.current, self.state):
                self.current, self.state = message.seq, message.mission_state
                told.append(["current", self.current, self.state, message.total])
            elif one.name == "MISSION_ITEM_REACHED" and message.seq not in (self.reached, 65535):
                self.reached = message.seq
                told.append(["reached", self.reached])
            elif one.name == "GLOBAL_POSITION_INT":
                self.at = (message.lat, message.lon, message.relative_alt)

    def away_m(self, at: tuple[int, int]) -> float:
        """Horizontal distance, metres."""
        north, east = ((here - there) * 111_319.5e-7 for here, there in zip(self.at, at, strict=False))
        return math.hypot(north, east * math.cos(math.radians(LATITUDE)))


class Flight:
    """Holds the conversation."""

    def __init__(self, peer: Peer, kind: str) -> None:
        self._peer, self._kind = peer, kind
        self.progress = Progress()
        self.items = mission(kind)

    def step(
        self, name: str, message: Any = None, *, until: Callable[[], bool] | None = None, patience_s: float = 1.2
    ) -> dict[str, Any]:
        """Send something; the acknowledgement, what was told of the mission, and the seconds until a condition."""
        told: list[list[Any]] = []
        heard: list[Heard] = []
        if message is not None:
            self._peer.send(message)
        waited_s, tick = 0.0, 0
        while waited_s < patience_s and not (until is not None and until()):
            if tick % 5 == 0:
                self._peer.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
            tick += 1
            now = self._peer.listen(_STEP_S)
            heard += now
            self.progress.take(now, told)
            waited_s += _STEP_S
        ack = None if message is None or not hasattr(message, "command") else result_of(heard, message.command)
        return {"step": name, "ack": ack, "told": told, "took_s": round(waited_s, 1)}

    def upload(self, items: list[Any]) -> int | None:
        self._peer.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), 0))
        for _ in range(100):
            for heard in self._peer.listen(0.1):
                if heard.name in ("MISSION_REQUEST", "MISSION_REQUEST_INT") and heard.component == 1:
                    self._peer.send(items[heard.message.seq])
                elif heard.name == "MISSION_ACK":
                    return int(heard.message.type)
        return None

    def download(self) -> list[list[float]]:
        self._peer.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
        count = -1
        rows: list[list[float]] = []
        for _ in range(100):
            for heard in self._peer.listen(0.1):
                if heard.name == "MISSION_COUNT":
                    count = heard.message.count
                elif heard.name == "MISSION_ITEM_INT" and heard.message.seq == len(rows):
                    one = heard.message
                    four = [one.param1, one.param2, one.param3, 0.0 if math.isnan(one.param4) else one.param4]
                    home = self._kind == "ardupilot" and one.seq == 0  # measured, a little different each time
                    rows.append([one.seq, one.command, one.frame, *four, *([] if home else [one.x, one.y, one.z])])
            if len(rows) == count:
                break
            if count >= 0:
                self._peer.send(mavlink.MAVLink_mission_request_int_message(1, 1, len(rows), 0))
        self._peer.send(mavlink.MAVLink_mission_ack_message(1, 1, 0, 0))
        return rows

    def at(self, number: int) -> bool:
        one = self.items[number]
        return self.progress.current == number and self.progress.away_m((one.x, one.y)) < 1.0

    def mode(self, name: str) -> Any:
        return command(SET_MODE, *MODES[self._kind][name])


def hold(peer: Peer, kind: str) -> Iterator[dict[str, Any]]:
    """Hold the conversation with a vehicle that can be armed."""
    flight = Flight(peer, kind)
    ardupilot = kind == "ardupilot"
    first = 2 if ardupilot else 1
    second, camera, third = first + 2, first + 3, first + 4
    yield {"step": "upload", "ack": flight.upload(flight.items), "items": flight.download()}
    for message_id in (42, 33):
        peer.send(command(INTERVAL, message_id, 100_000))
    peer.listen(1.0)
    yield from _took_off(flight, ardupilot=ardupilot)
    yield flight.step("fly to the first", until=lambda: flight.at(first), patience_s=60.0)
    flight.step("settle", patience_s=4.0)
    yield flight.step("pause where it is held", command(PAUSE, 0))
    yield flight.step("set the same current", _set_current(first, ardupilot))
    yield flight.step("set a current that is not there", _set_current(99, ardupilot))
    yield flight.step("the hold ends", until=lambda: flight.progress.current != first, patience_s=30.0)
    yield flight.step("pause on the way", command(PAUSE, 0))
    yield flight.step("continue", command(PAUSE, 1))
    yield flight.step("fly to the second", until=lambda: flight.at(second), patience_s=60.0)
    flight.step("settle", patience_s=4.0)
    yield flight.step(
        "go on before the hold ends", _set_current(camera, ardupilot), until=lambda: flight.progress.current == third
    )
    yield flight.step("the pilot takes over", flight.mode("loiter"))
    yield flight.step("the pilot gives it back", flight.mode("auto"))
    yield flight.step("the jump back", until=lambda: flight.at(second), patience_s=60.0)
    flight.step("settle", patience_s=2.0)
    yield {"step": "upload in flight", "ack": flight.upload(flight.items[: camera + 1])}
    yield flight.step("after that")


def _set_current(seq: int, ardupilot: bool) -> Any:
    """The way that each autopilot has."""
    if ardupilot:
        return command(SET_CURRENT, seq)
    return mavlink.MAVLink_mission_set_current_message(1, 1, seq)


def _took_off(flight: Flight, *, ardupilot: bool) -> Iterator[dict[str, Any]]:
    """ArduCopter takes off in GUIDED before its mission, PX4 within it."""
    if ardupilot:
        flight.step("", flight.mode("guided"))
    else:
        flight.step("", flight.mode("auto"))
    while flight.step("", command(ARM, 1), patience_s=2.0)["ack"] != 0:  # not ready yet
        flight.step("", patience_s=2.0)
    if ardupilot:
        flight.step(
            "",
            command(TAKEOFF, 0, 0, 0, 0, 0, 0, HEIGHT_M),
            until=lambda: flight.progress.at[2] > 14_500,
            patience_s=40.0,
        )
    yield flight.step("AUTO", flight.mode("auto"))


async def record(binary: Path) -> list[dict[str, Any]]:
    """Start the autopilot and hold the conversation."""
    kind = firmware_of(binary).kind
    ground_port, payload_port = free_udp_ports(2)
    options = SitlOptions(
        binary=binary,
        ground_port=ground_port,
        payload_port=payload_port,
        speedup=1.0,
        home=(LATITUDE, LONGITUDE, 488.0, 20.0),
        parameters={"MNT1_TYPE": 0, "CAM1_TYPE": 0} if kind == "ardupilot" else {"MNT_MODE_IN": -1},
    )
    ground = UdpPeer(ground_port)
    async with running_sitl(options):
        await asyncio.to_thread(ground.listen, 25.0)
        return await asyncio.to_thread(lambda: list(hold(ground, kind)))


if __name__ == "__main__":
    steps = asyncio.run(record(sitl_binary(sys.argv[1])))
    Path(sys.argv[2]).write_text("".join(json.dumps(step) + "\n" for step in steps), encoding="utf-8")
