"""Stations in missions of ArduPilot's and PX4's own software. Opt in: ARDUPILOT_SITL=… PX4_SITL=… pytest
tests/system/test_stations_sitl.py; PANOEXEC_STATIONS=10 flies so many (two without it).
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import shutil
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path
from statistics import median
from typing import Any

from panoexec.dryrun.autopilot import firmware_of, running_sitl
from panoexec.dryrun.firmware import SitlOptions
from panoexec.sim.config import AirframeConfig, AxisConfig, GimbalConfig, SimConfig
from panoexec.sim.ports import free_udp_ports
from panoexec.sim.process import running_simulator
from tests.support.truth import untruths
from tests.system.daemon import Ground, ground_station, ready, serving
from tests.system.mission_pilot import Pilot
from tests.system.sitl_kinds import Autopilot, autopilots
from tests.wire.broker import needs_mosquitto, running_broker
from tests.wire.mission_conversation import DIGICAM, LATITUDE, LONGITUDE, RTL, TAKEOFF, WAYPOINT, item, offset

pytestmark = needs_mosquitto

STATIONS = int(os.environ.get("PANOEXEC_STATIONS", "2"))
WIND_M_S = 6.0
HEIGHT_M = 25.0
HOLD_S = 40.0
LONG_S = 240.0
"""For one station and the way to it."""
OVERHEAD_S, LONGEST_OVERHEAD_S = 3.0, 4.0
"""Beside the panorama at a station: the median, and the longest where nothing starves."""
STARVED_S = 0.25
"""A process that is woken so late gets too little of the machine to say anything of the longest."""
CONFIG = """[presets.around]
elevation_deg = [-60, 10]
[stations]
enabled = true
"""
TURNING = """[presets.front]
elevation_deg = [-40, 0]
azimuth_deg = [-60, 60]
tolerance_deg = { yaw = 2.0, pitch = 0.3, roll = 0.3 }
[gimbal]
yaw = "vehicle"
[stations]
enabled = true
guided = true
"""


def many_stations(count: int, kind: str) -> list[Any]:
    """A zigzag of stations; home and landing."""
    home = [item(0, WAYPOINT, at=offset(0, 0))] if kind == "ardupilot" else []
    seq = itertools.count(len(home))
    items = [*home, item(next(seq), TAKEOFF, at=offset(0, 0), z=HEIGHT_M)]
    for number in range(count):
        at = offset(15.0 * (number + 1), 15.0 * (number % 2))
        items += [item(next(seq), WAYPOINT, HOLD_S, at=at, z=HEIGHT_M), item(next(seq), DIGICAM, at=(0, 1))]
    return [*items, item(next(seq), RTL)]


async def flown(
    autopilot: Autopilot,
    folder: Path,
    *,
    killed_in: int | None = None,
    count: int = STATIONS,
    gimbal: GimbalConfig | None = None,
    config: str = CONFIG,
) -> dict[str, Any]:
    """Fly the mission; the tour, with the seconds that the vehicle was at each station, by its own time."""
    binary = autopilot.binary()
    kind = firmware_of(binary).kind
    near, far, payload = free_udp_ports(3)
    card = folder / "card"
    simulation = SimConfig(
        attach_url=f"udpin:127.0.0.1:{payload}",
        output=card,
        airframe=AirframeConfig(wind_m_s=WIND_M_S),
        gimbal=gimbal or GimbalConfig(),
    )
    options = SitlOptions(
        binary=binary,
        ground_port=near,
        payload_port=payload,
        speedup=1.0,
        home=(LATITUDE, LONGITUDE, 488.0, 20.0),
        parameters=firmware_of(binary).parameters(simulation),
    )
    with running_broker(folder) as broker, contextlib.closing(Pilot(near, far, kind)) as pilot:
        async with running_simulator(simulation), running_sitl(options), ground_station(broker) as ground:
            await pilot.upload(many_stations(count, kind))
            async with serving(folder, broker, far, more=config, speedup=1.0) as daemon:
                await ready(ground)
                await pilot.take_off(HEIGHT_M)
                await pilot.mode("auto")
                if killed_in is not None:
                    await _in_station(ground, killed_in)
                    daemon.send_signal(signal.SIGKILL)
                    await daemon.wait()
                    async with serving(folder, broker, far, more=CONFIG, speedup=1.0):
                        await _over(ground, count)
                else:
                    await _over(ground, count)
    shutil.copy(card / "truth.jsonl", folder / "truth.jsonl")
    (path,) = (folder / "data" / "tours").glob("tour-*.json")
    return dict(json.loads(path.read_text()))


async def _in_station(ground: Ground, number: int) -> None:
    """Some shots of the panorama at a station are taken."""
    await ground.until(lambda: ((ground.state or {}).get("tour") or {}).get("done") == number - 1, LONG_S * number)
    await ground.until(lambda: ground.state["state"] == "capturing" and ground.state["shots_done"] >= 2, LONG_S)


async def _over(ground: Ground, count: int) -> None:
    def closed() -> int:
        tour = (ground.state or {}).get("tour") or {}
        return int(tour.get("done", 0)) + int(tour.get("skipped", 0))

    await ground.until(lambda: closed() == count, LONG_S * count)


def hold_to_account(folder: Path, tour: dict[str, Any], count: int) -> None:
    """Each station is certified, and true to what was exposed there."""
    assert [stop["outcome"] for stop in tour["stops"]] == ["complete"] * count, tour
    for stop in tour["stops"]:
        directory = folder / "data" / "missions" / stop["mission_id"]
        manifest = json.loads((directory / "manifest.json").read_text())
        assert manifest["certificate"]["certified"]
        assert manifest["tour"]["waypoint"] == stop["waypoint"]
        (directory / "images").mkdir(exist_ok=True)
        shutil.copy(folder / "truth.jsonl", directory / "images" / "truth.jsonl")
        assert untruths(directory) == []


@contextlib.asynccontextmanager
async def lateness() -> AsyncIterator[list[float]]:
    """How late this process is woken meanwhile: what the machine does to the daemon and the autopilot, too."""
    late_s = [0.0]

    async def watch() -> None:
        while True:
            due_s = time.monotonic() + 0.05
            await asyncio.sleep(0.05)
            late_s.append(time.monotonic() - due_s)

    task = asyncio.create_task(watch(), name="lateness")
    try:
        yield late_s
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


@autopilots()
async def test_a_mission_with_stations_in_wind(autopilot: Autopilot, tmp_path: Path) -> None:
    async with lateness() as late_s:
        tour = await flown(autopilot, tmp_path)
    print(json.dumps([[s["before_s"], s["after_s"]] for s in tour["stops"]]), f"late by {max(late_s):.2f} s at most")
    hold_to_account(tmp_path, tour, STATIONS)
    overheads_s = [stop["before_s"] + stop["after_s"] for stop in tour["stops"]]
    assert median(overheads_s) <= OVERHEAD_S, overheads_s
    assert max(overheads_s) <= LONGEST_OVERHEAD_S or max(late_s) > STARVED_S, overheads_s


@autopilots()
async def test_the_daemon_is_killed_in_a_station(autopilot: Autopilot, tmp_path: Path) -> None:
    count = max(2, STATIONS)
    tour = await flown(autopilot, tmp_path, killed_in=min(3, count), count=count)
    print(json.dumps([[s["before_s"], s["after_s"]] for s in tour["stops"]]))
    hold_to_account(tmp_path, tour, count)


@autopilots()
async def test_a_vehicle_with_two_axes_turns_in_its_own_mode_and_is_given_back(
    autopilot: Autopilot, tmp_path: Path
) -> None:
    """`[stations] guided`: GUIDED or Hold between two legs of the mission."""
    whole = GimbalConfig()
    no_pan = AxisConfig(
        rate_deg_s=whole.yaw.rate_deg_s, acceleration_deg_s2=whole.yaw.acceleration_deg_s2, min_deg=0.0, max_deg=0.0
    )
    tour = await flown(
        autopilot,
        tmp_path,
        count=2,
        gimbal=GimbalConfig(yaw=no_pan, yaw_endless=False),
        config=TURNING,
    )
    hold_to_account(tmp_path, tour, 2)
    log = (tmp_path / "serve.log").read_text()
    assert log.count("to turn the vehicle") == log.count("back to the mission") == 2
