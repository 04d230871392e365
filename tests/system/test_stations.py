"""Panoramas at waypoints of the autopilot's own mission, by the living daemon on the embedded vehicle."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panoexec.sim.config import AirframeConfig, AutopilotKind, SimConfig
from panoexec.sim.ports import free_udp_ports
from panoexec.sim.process import running_simulator
from tests.system.daemon import ground_station
from tests.system.mission_pilot import Pilot
from tests.system.station_flights import EMBEDDED_SPEEDUP as SPEEDUP
from tests.system.station_flights import FLOWN, HEIGHT_M, Daemon
from tests.wire.broker import needs_mosquitto, running_broker
from tests.wire.mission_conversation import DIGICAM, LATITUDE, LONGITUDE, TAKEOFF, WAYPOINT, item, offset

pytestmark = needs_mosquitto

HOLD_S = 30.0
CONFIG = """[presets.small]
elevation_deg = [-10, 15]
azimuth_deg = [-30, 30]
method = "paper"
[presets.other]
name = "The other side"
elevation_deg = [-10, 15]
azimuth_deg = [150, 210]
method = "paper"
[presets.large]
elevation_deg = [-80, 10]
method = "paper"
[stations]
enabled = true
"""


def two_stations(
    *more: Any, presets: tuple[int, int] = (1, 2), kind: str = "ardupilot", hold_s: float = HOLD_S
) -> list[Any]:
    """A mission with two stations; they are waypoints 2 and 4 of ArduPilot, 1 and 3 of PX4."""
    home = [item(0, WAYPOINT, at=offset(0, 0))] if kind == "ardupilot" else []
    n = len(home)
    return [
        *home,
        item(n, TAKEOFF, at=offset(0, 0), z=HEIGHT_M),
        item(n + 1, WAYPOINT, hold_s, at=offset(12, 0), z=HEIGHT_M),
        item(n + 2, DIGICAM, at=(0, presets[0])),
        item(n + 3, WAYPOINT, hold_s, at=offset(24, 0), z=HEIGHT_M),
        item(n + 4, DIGICAM, at=(0, presets[1])),
        item(n + 5, WAYPOINT, at=offset(24, 12), z=HEIGHT_M),
        *more,
    ]


@dataclass(kw_only=True)
class Flight(Daemon):
    """A daemon, its vehicle, its pilot and its ground station."""

    pilot: Pilot

    def closed(self) -> int:
        """How many stops are over, as the ground station hears."""
        tour = self.ground.state.get("tour") or {}
        return int(tour.get("done", 0)) + int(tour.get("skipped", 0))


@asynccontextmanager
async def flight(
    folder: Path, items: list[Any], *, more: str = "", autopilot: AutopilotKind = "ardupilot", **airframe: Any
) -> AsyncIterator[Flight]:
    near, far = free_udp_ports(2)
    config = SimConfig(
        port=near,
        speedup=SPEEDUP,
        autopilot=autopilot,
        output=None,
        airframe=AirframeConfig(latitude_deg=LATITUDE, longitude_deg=LONGITUDE, height_m=HEIGHT_M, **airframe),
    )
    with running_broker(folder) as broker, contextlib.closing(Pilot(near, far, autopilot)) as pilot:
        async with running_simulator(config), ground_station(broker) as ground:
            await pilot.upload(items)
            yield Flight(
                folder=folder,
                broker=broker,
                port=far,
                ground=ground,
                more=CONFIG + more,
                speedup=SPEEDUP,
                pilot=pilot,
            )


async def test_each_station_gets_its_panorama_also_when_the_daemon_is_killed(tmp_path: Path) -> None:
    async with flight(tmp_path, two_stations(hold_s=60.0)) as flown:
        async with flown.running() as process:
            await flown.pilot.until(lambda: "Pano: 2 stations in this mission" in flown.pilot.said.texts)
            await flown.pilot.mode("auto")
            await flown.ground.until(lambda: flown.ground.state["state"] == "capturing")
            process.send_signal(signal.SIGKILL)
            await process.wait()
        async with flown.running():
            await flown.ground.until(lambda: flown.closed() == 2)
            await flown.ground.until(lambda: flown.pilot.said.current[-1:] == [6])
        assert [waypoint for waypoint, outcome in flown.outcomes if outcome in FLOWN] == [2, 4]
        tour, manifests = flown.tour, flown.manifests()
        assert [one["times"]["restarts"] for one in manifests] == [1, 0]
        assert [one["name"] for one in manifests] == ["", "The other side"]
        assert [one["tour"] for one in manifests] == [
            {"tour_id": tour["tour_id"], "number": number, "waypoint": waypoint}
            for number, waypoint in ((1, 2), (2, 4))
        ]
        assert flown.ground.misfits == []
        # the markers were run, and nothing of the mission was left out
        assert flown.pilot.said.current[-3:] == [2, 4, 6]


async def test_the_pilot_takes_over_and_the_panorama_pauses(tmp_path: Path) -> None:
    """And goes on when the pilot flies the mission again: nothing is told to the autopilot from then on."""
    async with flight(tmp_path, two_stations()) as flown, flown.running():
        await flown.pilot.mode("auto")
        await flown.ground.until(lambda: flown.ground.state["state"] == "capturing")
        await flown.pilot.mode("loiter")
        await flown.ground.until(lambda: flown.ground.state["state"] == "paused")
        assert "the pilot has taken over (mode LOITER" in flown.ground.state["reason"]
        told = len(flown.pilot.said.autopilot_texts)
        await flown.pilot.mode("auto")
        await flown.ground.until(lambda: flown.pilot.said.current[-1:] == [4])
        assert flown.pilot.said.autopilot_texts[told:] == ["Reached command #2"]
        await flown.ground.until(lambda: flown.closed() == 2)
        assert flown.outcomes[0] == (2, "incomplete")
        assert flown.outcomes[1][1] in FLOWN


async def test_px4s_hold_times_are_waited_for_and_cut_short(tmp_path: Path) -> None:
    items = two_stations(kind="px4", hold_s=60.0, presets=(1, 3))
    items[3] = item(3, WAYPOINT, 10.0, at=offset(24, 0), z=HEIGHT_M)
    async with flight(tmp_path, items, autopilot="px4") as flown, flown.running():
        await flown.pilot.mode("auto")
        await flown.ground.until(lambda: flown.pilot.said.current[-1:] == [5])
        await flown.ground.until(lambda: flown.closed() == 2)
        assert flown.outcomes[0][1] in FLOWN
        assert flown.outcomes[1] == (3, "skipped")
        assert "too short" in flown.tour["stops"][1]["reason"]
