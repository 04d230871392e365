"""The daemon brings the files of a MAVLink camera into the mission directory, in flight and after landing."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.process import free_udp_port, running_simulator
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import load_journal
from panoexec.store.landed_mission import record_of
from tests.system.daemon import SMALL, ground_station, ready, serving
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto

_SPEEDUP = 3.0


def _is_whole(mission: Path) -> bool:
    try:
        manifest = json.loads((mission / "manifest.json").read_text())
    except (OSError, ValueError):
        return False
    return manifest["state"] == "complete" and all(shot["sha256"] for shot in manifest["shots"])


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


async def test_a_mission_ends_complete_with_every_photo_hashed_in_its_directory(tmp_path: Path) -> None:
    port, card = free_udp_port(), tmp_path / "card"
    simulation = settings.changed(
        SimConfig(port=port, speedup=_SPEEDUP, output=card), ["camera.files=http", "camera.render_width_px=160"]
    )
    more = '[camera]\nfile_hosts = ["127.0.0.1"]\n'
    with running_broker(tmp_path) as broker:
        async with (
            running_simulator(simulation),
            ground_station(broker) as ground,
            serving(tmp_path, broker, port, more=more, speedup=_SPEEDUP),
        ):
            await ready(ground)
            start = await ground.ask("start", "s", **SMALL, azimuth_deg=[0, 90])
            await ground.until(lambda: ground.state["state"] == "complete")
            mission = tmp_path / "data" / "missions" / start["data"]["mission_id"]
            await ground.until(lambda: _is_whole(mission) and (mission / "outputs.json").exists())
            await ground.until(lambda: not (mission / ".incoming").exists())
            await ground.until(lambda: ground.types().count("photo_stored") >= ground.state["shots_total"])
            assert ground.misfits == []
            # outputs are written after the last photo
            told = json.loads((mission / "manifest.json").read_text())["journal"]["events"]
            await ground.until(lambda: json.loads((mission / "outputs.json").read_text())["events"] == told)
            shots = _check(mission, card, source="http")
            assert len(shots) == ground.state["shots_total"]
