"""A disk that is full or read-only, on a real file system: the daemon is up, says so, and goes on when that is over.

Needs the right to mount a small file system in memory (root); what it is about is in tests/unit without one.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.system.daemon import SMALL, SPEEDUP, Ground, ground_station, ready, serving
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto


def fill(folder: Path) -> Path:
    """Leave no byte free; returns the file that takes the room."""
    name = folder / "fill"
    descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    try:
        for size in (4096, 1):
            while True:
                try:
                    os.write(descriptor, b"x" * size)
                except OSError:
                    break
    finally:
        os.close(descriptor)
    return name


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """The daemon's storage, a disk of 4 MB."""
    folder = tmp_path / "data"
    folder.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(folder)], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        pytest.skip(f"cannot mount a file system: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def accepted(ground: Ground, mission: str) -> bool:
    """Whether a shot of a mission was accepted."""
    return any(event["type"] == "shot_accepted" and event["id"].startswith(f"{mission}/") for event in ground.events)


async def started(ground: Ground, number: int) -> dict[str, Any]:
    """The answer to a start that is asked for until the mission before has told its end."""
    for tries in itertools.count():
        answer = await ground.ask("start", f"{number} {tries}", **SMALL)
        if answer["status"] == "ok" or answer["error"]["code"] != "busy":
            break
        await asyncio.sleep(0.2)
    return answer


def ended_or_resumable(ground: Ground, mission: str) -> bool:
    return ground.state["resumable"] == mission or (ground.state["mission_id"], ground.state["state"]) == (
        mission,
        "complete",
    )


async def test_a_disk_that_is_full_at_boot_and_in_a_mission(disk: Path, tmp_path: Path) -> None:
    port = free_udp_port()
    filler = fill(disk)
    with running_broker(tmp_path) as broker:
        simulator = running_simulator(SimConfig(port=port, speedup=SPEEDUP))
        async with simulator, ground_station(broker) as ground, serving(tmp_path, broker, port) as process:
            await ground.until(lambda: ground.status == "online" and "free space" in ground.state.get("reason", ""))
            await ground.until(lambda: all(link["ok"] for link in ground.state["link"].values()))
            refused = await ground.ask("start", 1, **SMALL)
            assert refused["error"]["code"] == "storage"
            assert "nothing was done" in refused["error"]["message"]
            assert (await ground.ask("plan", 2, **SMALL))["status"] == "ok", "what does not act is answered"

            filler.unlink()
            start = await ground.ask("start", 1, **SMALL)
            assert start["status"] == "ok", "it was not noted, so it acts now"
            for again in range(5):
                mission = start["data"]["mission_id"]
                await ground.until(partial(accepted, ground, mission))
                fill(disk)
                await ground.until(partial(ended_or_resumable, ground, mission))
                if ground.state["resumable"] == mission:
                    break
                # it was over before the disk was full
                filler.unlink()
                start = await started(ground, again)
            assert ground.state["resumable"] == mission
            assert "the mission was interrupted and can be resumed" in ground.state["reason"]
            assert "the journal cannot be written" in ground.state["reason"], "and the crew learns why"

            filler.unlink()
            assert (await ground.ask("resume", 3))["status"] == "ok"
            await ground.until(lambda: ground.state["state"] == "complete")
            assert ground.state["mission_id"] == start["data"]["mission_id"]
            process.send_signal(signal.SIGTERM)
            assert await process.wait() == 0


async def test_a_disk_that_is_read_only_at_boot(disk: Path, tmp_path: Path) -> None:
    port = free_udp_port()
    with running_broker(tmp_path) as broker:
        simulator = running_simulator(SimConfig(port=port, speedup=SPEEDUP))
        async with simulator, ground_station(broker) as ground:
            async with serving(tmp_path, broker, port) as process:
                await ready(ground)
                assert (await ground.ask("set_profile", 1, camera="dji-x5s-45mm"))["status"] == "ok"
                process.send_signal(signal.SIGTERM)
                assert await process.wait() == 0
            boot = ground.state["boot_id"]
            await asyncio.to_thread(subprocess.run, ["mount", "-o", "remount,ro", str(disk)], check=True)
            async with serving(tmp_path, broker, port) as process:
                await ground.until(lambda: ground.state["boot_id"] != boot and ground.status == "online")
                await ground.until(lambda: "cannot be written" in ground.state["reason"])
                assert (await ground.ask("start", 2, **SMALL))["error"]["code"] == "storage"
                await asyncio.to_thread(subprocess.run, ["mount", "-o", "remount,rw", str(disk)], check=True)
                again = await ground.ask("set_profile", 1, camera="dji-x5s-45mm")
                assert again["data"]["camera"]["name"] == "dji-x5s-45mm", "answered as before"
                process.send_signal(signal.SIGTERM)
                assert await process.wait() == 0
