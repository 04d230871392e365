"""`examples/mqtt_client.py` against a broker and a stand-in for the daemon, which uses the daemon's own models."""

from __future__ import annotations

import asyncio
import importlib.util
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import aiomqtt
import pytest

from panoexec.mission.log.events import Event, MissionFinished, ShotAccepted
from panoexec.mission.log.states import MissionState
from panoexec.mqtt.messages import dump, dump_json, failed, ok
from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.requests import RefusedRequestError
from panoexec.mqtt.topics import Topics
from tests.repository import ROOT
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto

MISSION = "20261130T063803.046Z"


def the_client() -> ModuleType:
    spec = importlib.util.spec_from_file_location("mqtt_client", ROOT / "examples" / "mqtt_client.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Vehicle:
    """Answers `plan` and `start`; after `start` it says what happens in a mission of one shot."""

    def __init__(self, client: aiomqtt.Client, *, ready: bool) -> None:
        self._client = client
        self._topics = Topics("panoexec", "drone")
        self._ready = ready
        self.commands: list[str] = []

    async def run(self) -> None:
        async for message in self._client.messages:
            command = str(message.topic).rpartition("/")[2]
            request = parse_request(command, bytes(message.payload))  # raises if the client asks for what is not there
            self.commands.append(command)
            data: dict[str, Any] = {"images": 14, "duration_s": 28.4, "mission_id": MISSION}
            answer = ok(request.transaction, data)
            if command == "start" and not self._ready:
                answer = failed(RefusedRequestError("not_ready", "the gimbal is missing"), request.transaction)
            await self._client.publish(self._topics.response(command), dump(answer), qos=1)
            if command == "start" and self._ready:
                await self._tell(ShotAccepted(shot=0, attempt=1, photos=(), state=MissionState.CAPTURING))
                await self._tell(MissionFinished(reason="", accepted=1, missing=(), state=MissionState.COMPLETE))

    async def _tell(self, event: Event) -> None:
        await self._client.publish(self._topics.event, dump_json(event.to_json()), qos=1)


@asynccontextmanager
async def vehicle(port: int, *, ready: bool) -> AsyncIterator[Vehicle]:
    async with aiomqtt.Client("127.0.0.1", port) as client:
        await client.subscribe(Topics("panoexec", "drone").requests, qos=1)
        await client.publish(Topics("panoexec", "drone").status, b"online", qos=1, retain=True)
        made = Vehicle(client, ready=ready)
        task = asyncio.create_task(made.run(), name="vehicle")
        try:
            yield made
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


async def test_it_flies_a_mission_and_prints_its_events(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with running_broker(tmp_path) as broker:
        async with asyncio.timeout(30), vehicle(broker.port, ready=True) as asked:
            assert await the_client().fly("127.0.0.1", "drone", str(broker.port)) == "complete"
    assert asked.commands == ["plan", "start"]
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == ["waiting for panoexec/drone/status", "14 images, 28 s", f"mission {MISSION}"]
    assert [line.split()[1] for line in lines[3:]] == ["shot_accepted", "mission_finished"]


async def test_it_tells_why_a_request_was_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with running_broker(tmp_path) as broker:
        async with asyncio.timeout(30), vehicle(broker.port, ready=False):
            assert await the_client().fly("127.0.0.1", "drone", str(broker.port)) == "not_ready"
    assert capsys.readouterr().out.splitlines()[-1] == "start refused: the gimbal is missing"
