"""The daemon as a process, with a simulated vehicle and a real broker: missions by MQTT alone."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sys
from pathlib import Path

import aiomqtt
import pytest

from panoexec.mqtt.discovery import discovery_messages
from panoexec.mqtt.topics import Topics
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.system.daemon import SMALL, SPEEDUP, ground_station, ready, serving
from tests.wire.broker import Broker, needs_mosquitto, running_broker

pytestmark = needs_mosquitto

LONGER = SMALL | {"elevation_deg": [-60, 30]}
"""Is not over before a slow ground station has said what it wants of it."""


async def test_a_mission_from_start_to_complete_by_mqtt_with_the_broker_restarted_in_the_middle(tmp_path: Path) -> None:
    port = free_udp_port()
    simulator = running_simulator(SimConfig(port=port, speedup=SPEEDUP))
    with running_broker(tmp_path, persistent=True) as broker:
        async with simulator, ground_station(broker) as ground, serving(tmp_path, broker, port) as process:
            await ready(ground)
            assert (ground.state["state"], ground.state["mission_id"]) == ("idle", None)
            plan = await ground.ask("plan", "p", **SMALL)
            assert plan["status"] == "ok"
            images = plan["data"]["images"]
            assert images >= 7
            assert plan["data"]["certificate"]["images"] == images
            assert plan["data"]["duration_s"] > 0
            drawn = await ground.ask("plan", "p2", **SMALL, shots=True)
            assert len(drawn["data"]["plan"]["shots"]) == images
            assert drawn["data"]["battery_need_frac"] > 0
            assert ground.plan is None, "a plan is dry"

            start = await ground.ask("start", "s", **SMALL)
            assert start["data"]["images"] == images
            assert (await ground.ask("start", "s", **SMALL)) == start, "the same transaction acts once"
            assert (await ground.ask("start", "s2", **SMALL))["error"]["code"] == "busy"
            await ground.until(lambda: "shot_accepted" in ground.types())
            await ground.until(lambda: (ground.state["pose"] or {}).get("error_deg") is not None)
            assert ground.plan is not None
            assert len(ground.plan["shots"]) == images

            broker.stop()
            await ground.until(lambda: ground._client is None)
            broker.start()
            await ground.until(lambda: ground.state["state"] == "complete" and "mission_finished" in ground.types())
            assert ground.state["mission_id"] == start["data"]["mission_id"]
            # Algorithm 2 leaves holes for some errors: those that the measured attitudes show are patched
            assert ground.state["shots_done"] == ground.state["shots_total"] >= images
            process.send_signal(signal.SIGTERM)
            assert await process.wait() == 0
            await ground.until(lambda: ground.status == "offline")
            numbers = [int(event["id"].rpartition("/")[2]) for event in ground.events]
            assert sorted(set(numbers)) == list(range(min(numbers), max(numbers) + 1)), "no event was lost"
            assert min(numbers) <= 1, "from the first on"
            assert ground.misfits == []
            assert ground.heard.keys() >= {"status", "state", "plan", "event", "response_plan", "response_start"}
    mission = tmp_path / "data" / "missions" / start["data"]["mission_id"]
    manifest = json.loads((mission / "manifest.json").read_text())
    assert manifest["state"] == "complete"
    for name in ("panorama.pto", "papywizard.xml", "shots.csv", "report.html"):
        assert (mission / name).stat().st_size > 0, name


async def test_killed_in_a_mission_it_goes_on_and_a_pause_is_obeyed(tmp_path: Path) -> None:
    port = free_udp_port()
    more = '[mission]\nresume = "auto"\n'
    simulator = running_simulator(SimConfig(port=port, speedup=SPEEDUP))
    with running_broker(tmp_path) as broker:
        async with simulator, ground_station(broker) as ground:
            async with serving(tmp_path, broker, port, more=more) as process:
                await ready(ground)
                boot = ground.state["boot_id"]
                start = await ground.ask("start", 1, **LONGER)
                await ground.until(lambda: "shot_accepted" in ground.types())
                process.kill()
                await process.wait()
            await ground.until(lambda: ground.status == "offline")  # the will
            told = len(ground.states)
            async with serving(tmp_path, broker, port, more=more) as process:
                await ground.until(lambda: ground.state["boot_id"] != boot)
                await ground.until(lambda: "capturing" in ground.states[told:])  # it may be further already
                assert ground.state["mission_id"] == start["data"]["mission_id"]
                assert (await ground.ask("start", 1, **LONGER)) == start, "acts once, across restarts too"
                paused = await ground.ask("pause", 2, reason="look at this")
                assert paused["status"] == "ok"
                await ground.until(lambda: ground.state["state"] == "paused")
                assert "look at this" in ground.state["reason"]
                assert (await ground.ask("resume", 3))["status"] == "ok"
                await ground.until(lambda: ground.state["state"] == "complete")
                process.send_signal(signal.SIGTERM)
                assert await process.wait() == 0


async def retained(broker: Broker, topics: str, count: int) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    async with aiomqtt.Client("127.0.0.1", broker.port) as client, asyncio.timeout(120):
        await client.subscribe(topics, qos=1)
        async for message in client.messages:
            assert isinstance(message.payload, bytes)
            found[str(message.topic)] = message.payload
            if len(found) == count:
                break
    return found


async def test_answers_strangers_without_a_vehicle_and_tells_the_service_manager(tmp_path: Path) -> None:
    notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notices.bind(str(tmp_path / "notify"))
    notices.setblocking(False)
    with notices, running_broker(tmp_path) as broker:
        async with (
            ground_station(broker) as ground,
            serving(
                tmp_path, broker, free_udp_port(), notify=tmp_path / "notify", mqtt="discovery = true\n"
            ) as process,
        ):
            heard: list[str] = []

            def told(word: str) -> bool:
                while True:
                    try:
                        heard.append(notices.recv(4096).decode())
                    except BlockingIOError:
                        return any(word in one for one in heard)

            await ground.until(lambda: told("READY=1"))
            await ground.until(lambda: told("WATCHDOG=1"))
            await ground.until(lambda: ground.status == "online")
            assert await retained(broker, "homeassistant/#", 4) == dict(
                discovery_messages(Topics("panoexec", "drone"), "drone")
            )
            assert (await ground.ask("get", "g"))["data"]["state"] == "idle"
            answer = await ground.ask("start", "s", **SMALL)
            assert answer["error"]["code"] == "not_ready"
            answer = await ground.ask("plan", "c", camera={"sensor_width_mm": 36})
            assert answer["error"]["code"] == "invalid"
            assert answer["error"]["field"].startswith("camera.")
            assert (await ground.ask("plan", "f", overlap="much"))["error"]["field"] == "overlap"
            assert (await ground.ask("fly", "u"))["error"]["code"] == "unknown_command"
            assert (await ground.ask("pause", "n"))["error"]["code"] == "refused"
            assert (await ground.ask("set_profile", "q", camera="no-such"))["error"]["field"] == "camera"
            await ground.send("abort", b'{"transaction": "r"}', retain=True)
            await ground.until(lambda: "r" in ground.answers)
            assert ground.answers["r"]["error"]["code"] == "retained"
            for payload in (b"", b"\xff", b"{", b"[" * 50_000, b"x" * 70_000):
                await ground.send("start", payload)
            assert (await ground.ask("get", "last"))["status"] == "ok"
            process.send_signal(signal.SIGHUP)
            await ground.until(lambda: told("RELOADING=1"))
            process.send_signal(signal.SIGTERM)
            assert await process.wait() == 0
            assert told("STOPPING=1")


@pytest.mark.parametrize(("under_systemd", "code"), [(False, 2), (True, 78)])
async def test_a_wrong_configuration_ends_it_with_one_line(tmp_path: Path, under_systemd: bool, code: int) -> None:
    (tmp_path / "c.toml").write_text("[mqtt]\nhots = 1\n")
    environment = dict(os.environ) | ({"NOTIFY_SOCKET": str(tmp_path / "none")} if under_systemd else {})
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "panoexec", "serve", "--config", str(tmp_path / "c.toml")),
        stderr=asyncio.subprocess.PIPE,
        env=environment,
    )
    _, error = await process.communicate()
    assert process.returncode == code
    assert error.decode().count("\n") == 1
    assert "mqtt.hots is not a known key" in error.decode()
