"""Flights with stations, alike on the embedded vehicle and on ArduPilot's and PX4's own software."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panoexec.dryrun.autopilot import SitlProcess, firmware_of, running_sitl
from panoexec.dryrun.firmware import SitlOptions
from panoexec.sim.config import AirframeConfig, AutopilotKind, CameraConfig, SimConfig
from panoexec.sim.ports import free_udp_ports
from panoexec.sim.process import running_simulator
from tests.support.truth import untruths
from tests.system.daemon import Ground, ground_station, ready, serving
from tests.system.mission_pilot import Pilot
from tests.system.sitl_kinds import Autopilot
from tests.wire.broker import Broker, running_broker
from tests.wire.mission_conversation import DIGICAM, JUMP, LATITUDE, LONGITUDE, TAKEOFF, WAYPOINT, item, offset

HEIGHT_M = 20.0
EMBEDDED_SPEEDUP = 4.0
FLOWN = {"complete", "incomplete"}
"""On a machine that is busy with other things, a shot may be missing: these flights are about the mission."""


@dataclass(kw_only=True)
class Daemon:
    """Where a daemon lives: storage, broker, port, and a ground station that listens to it."""

    folder: Path
    broker: Broker
    port: int
    ground: Ground
    more: str
    speedup: float

    @asynccontextmanager
    async def running(self) -> AsyncIterator[asyncio.subprocess.Process]:
        before = self.ground.state.get("boot_id")
        async with serving(self.folder, self.broker, self.port, more=self.more, speedup=self.speedup) as process:
            if before is None:
                await ready(self.ground)
            else:  # the mission of the last process may be under way again, or over, for a reason that is told
                await self.ground.until(
                    lambda: self.ground.state["boot_id"] != before and self.ground.status == "online"
                )
            yield process

    @property
    def tour(self) -> dict[str, Any]:
        """The newest tour's file."""
        paths = sorted((self.folder / "data" / "tours").glob("tour-*.json"))
        return dict(json.loads(paths[-1].read_text())) if paths else {"stops": []}

    def closed(self) -> int:
        """How many stops are over."""
        return sum(outcome != "open" for _, outcome in self.outcomes)

    @property
    def outcomes(self) -> list[tuple[int, str]]:
        return [(stop["waypoint"], stop["outcome"]) for stop in self.tour["stops"]]

    @property
    def reasons(self) -> list[str]:
        return [stop["reason"] for stop in self.tour["stops"]]

    async def until_state(self, state: str, shots: int = 0) -> None:
        await self.ground.until(
            lambda: self.ground.state["state"] == state and self.ground.state.get("shots_done", 0) >= shots, 180
        )

    def manifests(self) -> list[dict[str, Any]]:
        paths = sorted((self.folder / "data" / "missions").glob("*/manifest.json"))
        return [json.loads(path.read_text()) for path in paths]


@dataclass(kw_only=True)
class Flight(Daemon):
    """A vehicle with its pilot, and the daemon.

    Attributes:
        kind: of the autopilot.
        first: number of the first item behind the take-off.
        second: another daemon on the same vehicle, if the flight has one.
        sitl: the autopilot's own process; None on the embedded vehicle.
        card: where the payload's truth file is; None on the embedded vehicle.
    """

    pilot: Pilot
    kind: AutopilotKind
    second: Daemon | None = None
    sitl: SitlProcess | None = None
    card: Path | None = None

    @property
    def first(self) -> int:
        return 2 if self.kind == "ardupilot" else 1

    async def begin(self, *steps: tuple[Any, ...]) -> None:
        """Upload a mission, take off, and fly it."""
        await self.upload(*steps)
        if self.sitl is not None:
            await self.pilot.take_off(HEIGHT_M)
        await self.pilot.mode("auto")

    async def upload(self, *steps: tuple[Any, ...]) -> None:
        await self.pilot.upload(mission_of(self.kind, *steps))

    async def at(self, waypoint: int) -> None:
        """Wait until it is the current item."""
        await self.pilot.until(lambda: self.pilot.said.current[-1:] == [waypoint], 240)

    def untruths(self) -> list[str]:
        """What the payload really exposed, against every panorama of every daemon; there must be some."""
        if self.card is None:
            return []
        found = []
        for daemon in (self, self.second):
            missions = [] if daemon is None else sorted((daemon.folder / "data" / "missions").glob("*/manifest.json"))
            for manifest in missions:
                found += untruths(manifest.parent, self.card / "truth.jsonl")
        return found


def mission_of(kind: str, *steps: tuple[Any, ...]) -> list[Any]:
    """Home and take-off as the autopilot wants them, then the steps.

    A step is ("station", metres north, preset, hold time), two items; ("waypoint", metres north); or ("jump", to the
    item so many behind the take-off, times).
    """
    items = [item(0, WAYPOINT, at=offset(0, 0))] if kind == "ardupilot" else []
    items.append(item(len(items), TAKEOFF, at=offset(0, 0), z=HEIGHT_M))
    first = len(items)
    for what, where, *more in steps:
        seq = len(items)
        if what == "jump":
            items.append(item(seq, JUMP, first + where, more[0]))
            continue
        hold_s = more[1] if what == "station" else 0.0
        items.append(item(seq, WAYPOINT, hold_s, at=offset(where, 0), z=HEIGHT_M))
        if what == "station":
            items.append(item(seq + 1, DIGICAM, at=(0, more[0])))
    return items


@asynccontextmanager
async def _daemons(
    folder: Path, pilot: Pilot, ports: list[int], mores: tuple[str, ...], speedup: float, kind: AutopilotKind
) -> AsyncIterator[Flight]:
    async with contextlib.AsyncExitStack() as stack:
        made: list[dict[str, Any]] = []
        for number, (port, more) in enumerate(zip(ports, mores, strict=True)):
            own = folder / f"daemon{number + 1}" if number else folder
            own.mkdir(exist_ok=True)
            broker = stack.enter_context(running_broker(own))
            ground = await stack.enter_async_context(ground_station(broker))
            made.append({"folder": own, "broker": broker, "port": port, "ground": ground, "more": more})
        second = Daemon(**made[1], speedup=speedup) if len(made) > 1 else None
        yield Flight(**made[0], speedup=speedup, pilot=pilot, kind=kind, second=second)


@asynccontextmanager
async def embedded_flight(
    folder: Path, more: str, *, autopilot: AutopilotKind = "ardupilot", second: str | None = None, **airframe: Any
) -> AsyncIterator[Flight]:
    """The embedded vehicle, in the air from the beginning.

    Args:
        folder: for everything.
        more: of the daemon's configuration.
        autopilot: which one it is like.
        second: the same of another daemon on it.
        airframe: of the vehicle.
    """
    mores = (more,) if second is None else (more, second)
    near, *far = free_udp_ports(1 + len(mores))
    config = SimConfig(
        port=near,
        speedup=EMBEDDED_SPEEDUP,
        autopilot=autopilot,
        airframe=AirframeConfig(latitude_deg=LATITUDE, longitude_deg=LONGITUDE, height_m=HEIGHT_M, **airframe),
    )
    with contextlib.closing(Pilot(near, far[0], autopilot, *far[1:])) as pilot:
        async with (
            running_simulator(config),
            _daemons(folder, pilot, far, mores, EMBEDDED_SPEEDUP, autopilot) as flight,
        ):
            yield flight


@asynccontextmanager
async def sitl_flight(
    folder: Path, more: str, autopilot: Autopilot, *, second: str | None = None, **parameters: float
) -> AsyncIterator[Flight]:
    """An autopilot in software, on the ground, with the simulated payload, in 4 m/s of wind, as fast as a clock.

    Args:
        folder: for everything.
        more: of the daemon's configuration.
        autopilot: which one.
        second: the same of another daemon on it.
        parameters: of the autopilot.
    """
    binary, card = autopilot.binary(), folder / "card"
    kind: AutopilotKind = "px4" if firmware_of(binary).kind == "px4" else "ardupilot"
    mores = (more,) if second is None else (more, second)
    near, payload, *far = free_udp_ports(2 + len(mores))
    simulation = SimConfig(
        attach_url=f"udpin:127.0.0.1:{payload}",
        output=card,
        airframe=AirframeConfig(wind_m_s=4.0),
        camera=CameraConfig(render_width_px=100),
    )
    options = SitlOptions(
        binary=binary,
        ground_port=near,
        payload_port=payload,
        speedup=1.0,
        home=(LATITUDE, LONGITUDE, 488.0, 20.0),
        parameters=firmware_of(binary).parameters(simulation) | parameters,
    )
    with contextlib.closing(Pilot(near, far[0], kind, *far[1:])) as pilot:
        async with (
            running_simulator(simulation),
            running_sitl(options) as sitl,
            _daemons(folder, pilot, far, mores, 1.0, kind) as flight,
        ):
            flight.sitl, flight.card = sitl, card
            yield flight
    shutil.rmtree(card, ignore_errors=True)
