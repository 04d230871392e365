"""The daemon is killed again and again while a script on ArduCopter watches its heartbeats, and lands without them.

Opt in: ARDUPILOT_SITL names the binary, PANOEXEC_WATCHDOG a Lua script that lands a copter in GUIDED 3 s after the last
heartbeat of component 191, as ArduPilot's companion_watchdog.lua does. PANOEXEC_WATCHDOG_KILLS=100 kills so often.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import random
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from statistics import median

import pytest

from panoexec.dryrun.autopilot import firmware_of, running_sitl
from panoexec.dryrun.firmware import SitlOptions
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_ports
from panoexec.sim.process import running_simulator
from tests.bench.bench_heartbeats import restart_s
from tests.system.daemon import Ground, ground_station, ready, serving
from tests.system.mission_pilot import Pilot
from tests.system.sitl_kinds import ARDUCOPTER, Autopilot, autopilots
from tests.wire.broker import Broker, needs_mosquitto, running_broker
from tests.wire.mission_conversation import LATITUDE, LONGITUDE
from tests.wire.sim_peer import command

pytestmark = needs_mosquitto

SCRIPT = os.environ.get("PANOEXEC_WATCHDOG", "")
KILLS = int(os.environ.get("PANOEXEC_WATCHDOG_KILLS", "10"))
SEED = 4
HEIGHT_M = 25.0
GUIDED, LAND = 4, 9
LIMIT_S = 3.0
SHARE_NICE = -5
"""CPUWeight=300 of the unit as autogroup(5) has it: three times the processor of other sessions."""
SCRIPTING, RESTART_SCRIPTS = 42701, 3
BETWEEN_S = (2.0, 8.0)


@asynccontextmanager
async def hovering(autopilot: Autopilot, folder: Path) -> AsyncIterator[tuple[Pilot, Ground, Broker, int]]:
    """An ArduCopter with the script and a payload, on the ground; and the port of the daemon."""
    near, far, payload = free_udp_ports(3)
    simulation = SimConfig(attach_url=f"udpin:127.0.0.1:{payload}", output=None)
    options = SitlOptions(
        binary=autopilot.binary(),
        ground_port=near,
        payload_port=payload,
        speedup=1.0,
        home=(LATITUDE, LONGITUDE, 488.0, 20.0),
        parameters=firmware_of(autopilot.binary()).parameters(simulation) | {"SCR_ENABLE": 1},
    )
    with running_broker(folder) as broker, contextlib.closing(Pilot(near, far)) as pilot:
        async with running_simulator(simulation), running_sitl(options) as sitl, ground_station(broker) as ground:
            scripts = Path(f"/proc/{sitl.pid}/cwd") / "scripts"
            scripts.mkdir(exist_ok=True)
            shutil.copy(SCRIPT, scripts / "watchdog.lua")
            await pilot.until(lambda: pilot.said.custom_mode >= 0)
            while pilot.said.acks.get(SCRIPTING) != 0:
                pilot.send(command(SCRIPTING, RESTART_SCRIPTS))
                await asyncio.sleep(1.0)
            yield pilot, ground, broker, far


@asynccontextmanager
async def started(folder: Path, broker: Broker, port: int) -> AsyncIterator[None]:
    """The daemon with the share of the processor that the unit gives it; killed at the end."""
    async with serving(folder, broker, port, speedup=1.0, own_session=True) as process:
        await asyncio.to_thread(_share, process.pid)
        yield


def _share(pid: int) -> None:
    with contextlib.suppress(OSError):  # root may, where the kernel has it
        Path(f"/proc/{pid}/autogroup").write_text(str(SHARE_NICE))


@pytest.mark.skipif(not SCRIPT, reason="set PANOEXEC_WATCHDOG to a Lua script that lands without heartbeats to run it")
@autopilots(ARDUCOPTER)
async def test_a_daemon_that_is_killed_is_back_before_the_watchdog_lands(autopilot: Autopilot, tmp_path: Path) -> None:
    chance = random.Random(SEED)
    async with hovering(autopilot, tmp_path) as (pilot, ground, broker, port):
        said = pilot.said
        async with started(tmp_path, broker, port):
            await ready(ground)
            await pilot.take_off(HEIGHT_M)
        # the script does what it is there for: nobody brings the daemon back
        await pilot.until(lambda: said.custom_mode == LAND, 3 * LIMIT_S)
        async with contextlib.AsyncExitStack() as stack:
            await stack.enter_async_context(started(tmp_path, broker, port))
            await ready(ground)
            await pilot.mode("guided")
            said.modes.clear()
            said.beats_s.clear()
            for _ in range(KILLS):
                await asyncio.sleep(chance.uniform(*BETWEEN_S))
                await stack.aclose()  # SIGKILL
                await asyncio.sleep(restart_s())
                await stack.enter_async_context(started(tmp_path, broker, port))
            await asyncio.sleep(BETWEEN_S[1])
        gaps_s = sorted(after - before for before, after in itertools.pairwise(said.beats_s))
        own = f", the script's own {said.floats['HBGAP']:.2f} s" if "HBGAP" in said.floats else ""
        print(
            f"{KILLS} kills: {len(said.beats_s)} heartbeats, without them {gaps_s[-1]:.2f} s at most{own}, "
            f"median of the {KILLS} longest {median(gaps_s[-KILLS:]):.2f} s; modes {said.modes}, "
            f"height {said.height_m:.1f} m"
        )
        assert said.modes == [GUIDED]
        assert said.armed
        assert said.height_m > HEIGHT_M / 2
