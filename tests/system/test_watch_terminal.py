"""`watch` on a terminal of 80 × 24: the map, a key that is confirmed, the answer, the report's address at the end."""

from __future__ import annotations

import asyncio
import json
import os
import pty
import sys
import termios
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiomqtt

from panoexec.inputs.camera_profiles import load_profile
from panoexec.inputs.plan_file import camera_to_data
from tests.waiting import eventually
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto

MISSION = "20260921T141300.000Z"
STATE: dict[str, Any] = {
    "state": "capturing",
    "mission_id": MISSION,
    "reference": "north",
    "shots_total": 6,
    "shots_done": 1,
    "shots": "d1 c1 t4",
    "retakes": 0,
    "reason": "",
}
PLAN = {
    "camera": camera_to_data(load_profile("dji-x5s-15mm").camera),
    "shots": [{"index": n, "row": 0, "pitch_deg": -20, "yaw_deg": 60 * n - 150} for n in range(6)],
}


class Terminal:
    """The other end of a terminal: what it shows, and its keys."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.text = ""
        asyncio.get_running_loop().add_reader(descriptor, self._read)

    def _read(self) -> None:
        try:
            self.text += os.read(self._descriptor, 65536).decode(errors="replace")
        except OSError:  # nobody has the terminal any more
            asyncio.get_running_loop().remove_reader(self._descriptor)

    async def until(self, text: str) -> None:
        try:
            await eventually(lambda: text in self.text, 60)
        except TimeoutError:
            raise AssertionError(f"{text!r} is not in {self.text[-3000:]!r}") from None

    def type(self, key: str) -> None:
        os.write(self._descriptor, key.encode())


@asynccontextmanager
async def on_a_terminal(*arguments: object) -> AsyncIterator[tuple[Terminal, asyncio.subprocess.Process]]:
    there, here = pty.openpty()
    termios.tcsetwinsize(here, (24, 80))
    command = ["setsid", "--ctty", "--wait", sys.executable, "-m", "panoexec", *map(str, arguments)]
    env = os.environ | {"TERM": "xterm-256color", "COLUMNS": "", "LINES": ""}
    process = await asyncio.create_subprocess_exec(*command, stdin=here, stdout=here, stderr=here, env=env)
    os.close(here)
    terminal = Terminal(there)
    try:
        yield terminal, process
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        asyncio.get_running_loop().remove_reader(there)
        os.close(there)


async def test_a_mission_is_watched_and_paused_by_a_key(tmp_path: Path) -> None:
    with running_broker(tmp_path) as broker:
        async with aiomqtt.Client("127.0.0.1", broker.port) as vehicle:
            base = "panoexec/drone"

            async def tell(topic: str, document: object, *, retain: bool = False) -> None:
                payload = document if isinstance(document, str) else json.dumps(document)
                await vehicle.publish(f"{base}/{topic}", payload, qos=1, retain=retain)

            await vehicle.subscribe(f"{base}/request/#", qos=1)
            await tell("status", "online", retain=True)
            await tell("plan", PLAN, retain=True)
            await tell("state", STATE, retain=True)
            async with on_a_terminal("watch", "--port", broker.port) as (terminal, process):
                await terminal.until("keys: p pause, r resume, s skip, f finish, a abort")
                await terminal.until("▀" * 3)
                assert "+30" in terminal.text
                terminal.type("p")
                await terminal.until("pause drone? y yes, any other key no")
                terminal.type("y")
                async with asyncio.timeout(300):
                    message = await anext(aiter(vehicle.messages))
                assert str(message.topic) == f"{base}/request/pause"
                assert isinstance(message.payload, bytes)
                request = json.loads(message.payload)
                kind, name, _ = request["transaction"].split("/")
                assert (kind, "@" in name) == ("panoexec-cli", True)
                data = {"mission_id": MISSION, "state": "paused", "durable": True}
                answer = {"transaction": request["transaction"], "status": "ok", "error": None, "data": data}
                await tell("response/pause", answer)
                await terminal.until(f"drone: mission {MISSION} is paused")
                received = {"type": "command_received", "id": f"{MISSION}/8", "command": "pause", "by": name}
                await tell("event", received)
                await terminal.until(f"pause received from {name}"[:70])
                await tell("state", STATE | {"state": "aborted"})
                await tell("event", {"type": "mission_finished", "id": f"{MISSION}/9", "reason": "rain"})
                async with asyncio.timeout(300):
                    assert await process.wait() == 1
                await terminal.until(f"report: missions/{MISSION}/report.html on drone")
