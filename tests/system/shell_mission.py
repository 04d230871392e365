"""A mission by mosquitto's own command-line clients, as anybody with a shell would fly one."""

from __future__ import annotations

import asyncio
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.schemas import misfits
from tests.system.daemon import BASE
from tests.waiting import eventually
from tests.wire.broker import PATH, Broker

PUB, SUB = (shutil.which(name, path=PATH) for name in ("mosquitto_pub", "mosquitto_sub"))
LISTENER = "shell-listener"


async def publish(broker: Broker, command: str, document: dict[str, Any]) -> None:
    assert PUB is not None
    process = await asyncio.create_subprocess_exec(
        *(PUB, "-h", "127.0.0.1", "-p", str(broker.port), "-q", "1"),
        *("-t", f"{BASE}/request/{command}", "-m", json.dumps(document)),
    )
    assert await process.wait() == 0


async def heard(process: asyncio.subprocess.Process, topic: str, **wanted: Any) -> dict[str, Any]:
    """The next message of that topic with these values; those before it are held to the AsyncAPI document too."""
    assert process.stdout is not None
    while True:
        line = (await asyncio.wait_for(process.stdout.readline(), 120)).decode().strip()
        assert line, "mosquitto_sub ended"
        name, _, text = line.partition(" ")
        document: Any = text if name.endswith("/status") else json.loads(text)
        assert misfits(name.removeprefix(f"{BASE}/").replace("/", "_"), document) == []
        if name == f"{BASE}/{topic}" and all(document.get(key) == value for key, value in wanted.items()):
            return dict(document)


async def flown_from_a_shell(broker: Broker, folder: Path) -> None:
    """A mission of a vehicle that is ready, from `start` to its end; skips the test without the two programs."""
    if PUB is None or SUB is None:
        pytest.skip("no mosquitto_pub and mosquitto_sub: apt-get install mosquitto-clients")
    topics = [part for name in ("event", "response/start") for part in ("-t", f"{BASE}/{name}")]
    listener = await asyncio.create_subprocess_exec(
        *(SUB, "-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-v", "-i", LISTENER, *topics),
        stdout=asyncio.subprocess.PIPE,
        limit=2**22,
    )
    try:
        await eventually(lambda: f"Sending SUBACK to {LISTENER}" in broker.log.read_text(encoding="utf-8"), 30)
        wish = {"transaction": "shell", "method": "paper", "elevation_deg": [-30, 0], "azimuth_deg": [0, 90]}
        await publish(broker, "start", wish)
        answer = await heard(listener, "response/start", transaction="shell")
        assert answer["status"] == "ok", answer
        mission = answer["data"]["mission_id"]
        end = await heard(listener, "event", type="mission_finished")
        assert end["accepted"] >= answer["data"]["images"], "a hole is patched"
        assert (end["missing"], end["id"].partition("/")[0]) == ([], mission)
    finally:
        listener.kill()
        await listener.wait()
    assert (folder / "data" / "missions" / mission / "plan.json").exists()
