"""Every command of docs/contract.md, by MQTT to the daemon as a process, over MQTT 5 and 3.1.1."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.system.daemon import SMALL, SPEEDUP, Ground, ground_station, ready, serving
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto

CAMERA: dict[str, Any] = {
    "name": "inline",
    "sensor_width_mm": 17.3,
    "sensor_height_mm": 13.0,
    "image_width_px": 5280,
    "image_height_px": 3956,
    "focal_length_mm": 15,
    "min_interval_s": 0.5,
    "source": "the test",
}
ROW = {"shots": [{"pitch_deg": -10, "yaw_deg": 20 * number} for number in range(6)]}


async def plans(ground: Ground) -> None:
    """`plan` and `set_profile`."""
    dry = await ground.ask("plan", "dry", camera=CAMERA, azimuth_deg=[0, 60], tolerance_deg={"yaw": 1.0}, **SMALL)
    assert dry["data"]["camera"]["name"] == "inline"
    assert dry["data"]["images"] < (await ground.ask("plan", "more", overlap=0.3, **SMALL))["data"]["images"]
    assert (await ground.ask("plan", "whole", plan=ROW))["data"]["images"] == 6
    assert ground.state["state"] == "idle"
    tele = await ground.ask("set_profile", "tele", camera="dji-x5s-45mm")
    assert tele["data"]["camera"]["focal_length_mm"] == 45
    assert (await ground.ask("plan", "tele plan", plan=ROW))["data"]["camera"]["focal_length_mm"] == 45
    assert (await ground.ask("set_profile", "back", camera=None))["data"]["camera"]["focal_length_mm"] == 15
    wrong = await ground.ask("plan", "none", elevation_deg=[-40, 0], tolerance_deg={"pitch": 40})
    assert wrong["error"]["code"] == "planning"


async def flown_by_hand(ground: Ground) -> None:
    """`start` with a whole plan, then every verb at once after it."""
    start = await ground.ask("start", "hand", plan=ROW)
    assert start["data"]["images"] == 6
    paused = await ground.ask("pause", "hold", reason="wait for the sun")
    assert (paused["status"], paused["data"]["mission_id"]) == ("ok", start["data"]["mission_id"])
    await ground.until(lambda: ground.state["state"] == "paused")
    assert ground.state["reason"] == "wait for the sun"
    assert (await ground.ask("pause", "hold again"))["error"]["code"] == "refused"
    assert (await ground.ask("skip", "five", shot=5))["data"]["shot"] == 5
    assert (await ground.ask("skip", "five again", shot=5))["error"]["code"] == "refused"
    assert (await ground.ask("skip", "none", shot=99))["error"]["message"].endswith("shots are 0 to 5")
    answer = await ground.ask("get", "now")
    assert (answer["data"]["state"], answer["data"]["shots_total"]) == ("paused", 6)
    assert (await ground.ask("resume", "go"))["status"] == "ok"
    await ground.until(lambda: "shot_accepted" in ground.types())
    done = next(event["shot"] for event in ground.events if event["type"] == "shot_accepted")
    assert (await ground.ask("repeat", "again", shot=done))["data"] == {
        "shot": done,
        "mission_id": start["data"]["mission_id"],
        "state": ground.answers["again"]["data"]["state"],
    }
    await ground.until(lambda: "mission_finished" in ground.types())
    taken = [event["shot"] for event in ground.events if event["type"] == "shot_accepted"]
    assert taken.count(done) == 2
    assert 5 not in taken
    assert (await ground.ask("resume", "over"))["error"]["code"] == "refused"


async def ended_early(ground: Ground, folder: Path) -> None:
    """`finish` keeps what was taken, `abort` ends."""
    ground.events.clear()
    first = await ground.ask("start", "short", camera=CAMERA, azimuth_deg=[0, 200], **SMALL)
    assert first["data"]["images"] > 2
    assert first["data"]["camera"]["name"] == "inline"
    assert (await ground.ask("finish", "enough", reason="the light goes"))["status"] == "ok"
    await ground.until(lambda: ground.state["state"] == "incomplete")
    assert "the light goes" in ground.state["reason"]
    second = await ground.ask("start", "called off", plan=ROW)
    assert second["data"]["mission_id"] > first["data"]["mission_id"], "mission ids sort by time"
    assert (await ground.ask("abort", "stop", reason="a bird"))["status"] == "ok"
    await ground.until(lambda: ground.state["state"] == "aborted")
    assert ground.state["reason"] == "a bird"
    for name in ("pause", "finish", "skip", "repeat", "abort"):
        assert (await ground.ask(name, f"late {name}"))["error"]["code"] == "refused"
    manifest = json.loads((folder / "data/missions" / second["data"]["mission_id"] / "manifest.json").read_text())
    assert manifest["state"] == "aborted"


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
async def test_every_command_is_obeyed_and_answered(tmp_path: Path, protocol: str) -> None:
    port = free_udp_port()
    simulator = running_simulator(SimConfig(port=port, speedup=SPEEDUP))
    with running_broker(tmp_path) as broker:
        more = f'protocol = "{protocol}"\n'
        async with simulator, ground_station(broker) as ground, serving(tmp_path, broker, port, mqtt=more):
            await ready(ground)
            if protocol == "5":  # what is said is the same with the other
                await plans(ground)
                await flown_by_hand(ground)
            await ended_early(ground, tmp_path)
            assert ground.misfits == []
