"""The daemon brings the files of a MAVLink camera into the mission directory, in flight and after landing."""

from __future__ import annotations

import asyncio
import hashlib
import json
from pathlib import Path
from typing import Any

import aiomqtt

from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import load_journal
from panoexec.store.landed_mission import record_of
from tests.system.daemon import SMALL, Ground, ground_station, ready, serving
from tests.wire.broker import Broker, needs_mosquitto, running_broker

pytestmark = needs_mosquitto

_SPEEDUP = 3.0


def _is_whole(mission: Path) -> bool:
    try:
        manifest = json.loads((mission / "manifest.json").read_text())
    except (OSError, ValueError):
        return False
    return manifest["state"] == "complete" and all(shot["sha256"] for shot in manifest["shots"])


def _is_told_whole(mission: Path) -> bool:
    """Whether manifest and outputs are of the journal's last event."""
    events = record_of(MissionDirectory(mission), load_journal(mission / "journal.sqlite")).seq
    manifest = json.loads((mission / "manifest.json").read_text())["journal"]["events"]
    return bool(events == manifest == json.loads((mission / "outputs.json").read_text())["events"])


def _check(mission: Path, card: Path, *, source: str) -> list[dict[str, Any]]:
    """Every photo of the panorama is in the mission directory, as the camera has it, and the reports name it."""
    manifest = json.loads((mission / "manifest.json").read_text())
    for shot in manifest["shots"]:
        photo = shot["attempts"][shot["accepted_attempt"] - 1]["photos"][0]
        data = (mission / shot["file"]).read_bytes()
        assert (photo["source"], photo["evidence"]) == (source, "file_seen")
        assert (photo["sha256"], photo["size_bytes"]) == (hashlib.sha256(data).hexdigest(), len(data))
        name = photo["told"].rpartition("/")[2]
        assert data == (card / name).read_bytes()
        assert shot["file"] == f"images/{name}"
        assert shot["file"] in (mission / "panorama.pto").read_text()
    assert not (mission / ".incoming").exists()
    record = record_of(MissionDirectory(mission), load_journal(mission / "journal.sqlite"))
    assert record.seq == manifest["journal"]["events"]
    return list(manifest["shots"])


def _check_settings(shots: list[dict[str, Any]], card: Path) -> None:
    """Metered once: no photo differs, and one more is in the camera."""
    photos = [photo for shot in shots for attempt in shot["attempts"] for photo in attempt["photos"]]
    settings = [photo["exif"] for photo in photos if photo["exif"]]
    assert all(one == settings[0] for one in settings)
    assert settings[0]["white_balance"] == "manual"
    assert 0.001 <= settings[0]["exposure_s"] <= 0.004
    assert not any(photo["differs"] for photo in photos)
    assert len(list(card.glob("*.jpg"))) > len(shots)


async def _check_thumbnails(ground: Ground, broker: Broker, mission: Path) -> None:
    """All are kept in the mission directory, and published when they are asked for."""
    kept = mission / "thumbnails"
    await ground.until(lambda: len(list(kept.glob("*.jpg"))) == ground.state["shots_total"])
    async with aiomqtt.Client("127.0.0.1", broker.port) as client:
        await client.subscribe("panoexec/drone/thumbnail/#")
        answer = await ground.ask("thumbnails", "t")
        assert answer["data"] == {"mission_id": mission.name, "count": ground.state["shots_total"]}
        seen: dict[str, bytes] = {}
        async with asyncio.timeout(300):
            async for message in client.messages:
                seen[str(message.topic).removeprefix("panoexec/drone/thumbnail/")] = bytes(message.payload)
                assert (message.qos, message.retain) == (0, False)
                if len(seen) == answer["data"]["count"]:
                    break
    assert seen == {f"{mission.name}/{path.stem}": path.read_bytes() for path in kept.glob("*.jpg")}
    assert all(len(payload) <= 20_000 for payload in seen.values())


async def test_a_mission_ends_complete_with_every_photo_hashed_in_its_directory(tmp_path: Path) -> None:
    port, card = free_udp_port(), tmp_path / "card"
    simulation = settings.changed(
        SimConfig(port=port, speedup=_SPEEDUP, output=card),
        ["camera.files=http", "camera.definition=http", "camera.render_width_px=160"],
    )
    more = (
        '[camera]\nfile_hosts = ["127.0.0.1"]\n'
        '[camera.lock]\nexposure = "first"\nwhite_balance = "Daylight"\nfocus = "manual"\n'
    )
    with running_broker(tmp_path) as broker:
        async with (
            running_simulator(simulation),
            ground_station(broker) as ground,
            serving(tmp_path, broker, port, more=more, speedup=_SPEEDUP),
        ):
            await ready(ground)
            start = await ground.ask("start", "s", **SMALL, azimuth_deg=[0, 90], name="a chapel")
            await ground.until(lambda: ground.state["state"] == "complete")
            mission = tmp_path / "data" / "missions" / start["data"]["mission_id"]
            await ground.until(lambda: _is_whole(mission) and (mission / "outputs.json").exists())
            await ground.until(lambda: not (mission / ".incoming").exists())
            await ground.until(lambda: ground.types().count("photo_stored") >= ground.state["shots_total"])
            assert ground.misfits == []
            await ground.until(lambda: _is_told_whole(mission))  # outputs are written after the last photo
            listed = (await ground.ask("missions", "m"))["data"]["missions"]
            assert [(one["mission_id"], one["name"]) for one in listed] == [(mission.name, "a chapel")]
            assert ground.state["name"] == "a chapel"
            await _check_thumbnails(ground, broker, mission)
            assert ground.misfits == []
            shots = _check(mission, card, source="http")
            assert len(shots) == ground.state["shots_total"]
            _check_settings(shots, card)


async def test_what_was_under_way_when_the_daemon_was_killed_is_brought_after_its_restart(tmp_path: Path) -> None:
    port, card = free_udp_port(), tmp_path / "card"
    slow = ["camera.files=http", "camera.files_kb_s=1", "camera.render_width_px=160"]
    simulation = settings.changed(SimConfig(port=port, speedup=_SPEEDUP, output=card), slow)
    more = '[camera]\nfile_hosts = ["127.0.0.1"]\n[pictures]\nthumbnails = "off"\ncheck = "off"\n'
    with running_broker(tmp_path) as broker:
        async with running_simulator(simulation), ground_station(broker) as ground:
            async with serving(tmp_path, broker, port, more=more, speedup=_SPEEDUP) as process:
                await ready(ground)
                start = await ground.ask("start", "s", **SMALL, azimuth_deg=[0, 90])
                mission = tmp_path / "data" / "missions" / start["data"]["mission_id"]
                await ground.until(lambda: ground.state["state"] == "complete")
                await ground.until(lambda: any((mission / ".incoming").glob("*-*-?")))
                process.kill()
                await process.wait()
            assert not _is_whole(mission), "it was killed too late"
            assert {path.suffix for path in (mission / "images").glob("*")} <= {".jpg", ".xmp", ""}
            async with serving(tmp_path, broker, port, more=more, speedup=_SPEEDUP):
                await ground.until(lambda: _is_whole(mission) and not (mission / ".incoming").exists())
                told = json.loads((mission / "manifest.json").read_text())["journal"]["events"]
                await ground.until(lambda: json.loads((mission / "outputs.json").read_text())["events"] == told)
                _check(mission, card, source="http")
