"""Mission after mission on one daemon: it holds no more after them than before. Opt in: PANOEXEC_SOAK=200 (missions).

The mission is short, three shots, and flown at a speed-up, so that a night's work passes in minutes.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.system.daemon import Ground, ground_station, ready, write_config
from tests.waiting import eventually
from tests.wire.broker import needs_mosquitto, running_broker

MISSIONS = int(os.environ.get("PANOEXEC_SOAK", "0"))
WARM_UP = 20
SPEEDUP = 10.0
PLAN = {"shots": [{"pitch_deg": -20, "yaw_deg": yaw} for yaw in (0, 15, 30)]}
GROWTH_MB = 5.0
GROWTH_OBJECTS = 4000
"""Attitudes of the last minute, more or fewer by chance."""
PHOTO_OBJECTS = 10
"""What the camera's ledger keeps of a photo; it keeps the last ones only."""
LEDGER = 256

pytestmark = [needs_mosquitto, pytest.mark.skipif(not MISSIONS, reason="set PANOEXEC_SOAK to the number of missions")]


async def fly(ground: Ground, number: int) -> str:
    """One mission to its end; the state it ended in."""
    ground.events.clear()
    answer = await ground.ask("start", f"soak {number}", plan=PLAN)
    assert answer["status"] == "ok", answer
    await ground.until(lambda: "mission_finished" in ground.types(), 120)
    return str(ground.events[-1]["state"] if "state" in ground.events[-1] else ground.state["state"])


async def counted(process: asyncio.subprocess.Process, folder: Path, name: str) -> dict[str, Any]:
    """What the daemon holds, at rest."""
    file, held = folder / "counts.json", {"resting": False}
    async with asyncio.timeout(60):
        while not held["resting"]:  # the streams go back to their slow rates
            process.send_signal(signal.SIGUSR1)
            await eventually(file.exists, 30)
            held = dict(json.loads(await asyncio.to_thread(file.read_text)))
            await asyncio.to_thread(file.rename, folder / name)
    return held


async def test_many_missions_leave_nothing_behind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    port = free_udp_port()
    with running_broker(tmp_path) as broker:
        config = write_config(tmp_path, broker, port)
        async with running_simulator(SimConfig(port=port, speedup=SPEEDUP)), ground_station(broker) as ground:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "tests.system.counted_daemon"),
                *(str(config), str(SPEEDUP), str(tmp_path / "counts.json")),
                stderr=asyncio.subprocess.DEVNULL,
            )
            try:
                await ready(ground)
                for number in range(WARM_UP):
                    await fly(ground, number)
                before = await counted(process, tmp_path, "before")
                for number in range(WARM_UP, MISSIONS):
                    await fly(ground, number)
                after = await counted(process, tmp_path, "after")
                process.send_signal(signal.SIGTERM)
                assert await process.wait() == 0
            finally:
                if process.returncode is None:
                    process.kill()
                    await process.wait()
            assert ground.misfits == []
    with capsys.disabled():
        figures = [
            {name: value for name, value in one.items() if name not in {"kinds", "open"}} for one in (before, after)
        ]
        print(f"\n{MISSIONS} missions: after {WARM_UP} {figures[0]}, at the end {figures[1]}")
    assert len(list((tmp_path / "data" / "missions").iterdir())) == MISSIONS
    for what in ("tasks", "threads", "native_threads", "files"):
        assert after[what] <= before[what] + 1, (what, before["open"], after["open"])
    assert after["resident_mb"] - before["resident_mb"] <= GROWTH_MB
    photos = min(LEDGER, len(PLAN["shots"]) * (MISSIONS - WARM_UP))
    assert after["objects"] - before["objects"] <= GROWTH_OBJECTS + PHOTO_OBJECTS * photos, after["kinds"]
