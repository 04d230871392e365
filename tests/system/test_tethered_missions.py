"""Whole missions whose photos come through libgphoto2, from a simulated camera that speaks PTP/IP."""

from __future__ import annotations

import hashlib
import json
import signal
from pathlib import Path
from typing import Any

import pytest

from panoexec.sim.config import CameraConfig, SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.support.truth import untruths
from tests.system.daemon import ground_station, ready, serving
from tests.system.dry_runs import accepted, dry_run, flown, manifest_of
from tests.wire.broker import needs_mosquitto, running_broker

pytest.importorskip("gphoto2", reason="the extra gphoto2 is not installed")

BAND = ("--camera", "dji-x5s-15mm", "--elevation", "-30", "20", "--azimuth", "-50", "50", "--image-width", "160")
TETHERED = ("--camera-link", "gphoto2")
SMALL = {"elevation_deg": [-20, 0], "azimuth_deg": [-60, 60], "method": "certified"}


def assert_every_photo_is_here(mission: Path, manifest: dict[str, Any], card: Path) -> None:
    """Each accepted photo is in the mission directory, as it is in the camera, with its hash in the manifest."""
    files = set()
    for attempt in accepted(manifest):
        (photo,) = attempt["photos"]
        content = (mission / photo["file"]).read_bytes()
        assert (photo["evidence"], photo["source"]) == ("file_seen", "gphoto2")
        assert (photo["size_bytes"], photo["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
        assert content == (card / Path(photo["file"]).name).read_bytes()
        files.add(photo["file"])
    assert len(files) == len(manifest["shots"])


def test_a_dry_run_through_libgphoto2_with_lost_events_and_triggers(tmp_path: Path) -> None:
    faults = ("--fault", "capture-lost=#2", "--fault", "photo-refused=#3")
    summary = flown(*BAND, *TETHERED, *faults, "--speedup", "20", "--output", str(tmp_path))
    mission, manifest = Path(summary["directory"]), manifest_of(summary)
    assert_every_photo_is_here(mission, manifest, mission / "camera")
    assert untruths(mission, mission / "camera" / "truth.jsonl") == []
    assert summary["rejected"].keys() <= {"trigger", "evidence"}
    assert not (mission / ".incoming").exists()


def test_photos_are_needed_for_it(tmp_path: Path) -> None:
    done = dry_run(*BAND, *TETHERED, "--no-images", "--output", str(tmp_path))
    assert done.returncode == 2
    assert "--no-images" in done.stderr


@needs_mosquitto
async def test_a_mission_by_serve_ends_complete_with_every_photo_hashed(tmp_path: Path) -> None:
    port, card = free_udp_port(), tmp_path / "card"
    config = SimConfig(
        port=port,
        speedup=3.0,
        output=card,
        camera_link="gphoto2",
        camera_port=0,
        camera=CameraConfig(render_width_px=200),
    )
    with running_broker(tmp_path) as broker:
        async with running_simulator(config) as simulator, ground_station(broker) as ground:
            camera = simulator.ready["camera"]
            more = (
                f'[camera]\ntrigger = "gphoto2"\nport = "{camera}"\nevidence = "file_seen"\n'
                '[camera.lock]\nexposure = "first"\nwhite_balance = "Daylight"\nfocus = "manual"\n'
            )
            async with serving(tmp_path, broker, port, more=more, speedup=3.0) as process:
                await ready(ground)
                start = await ground.ask("start", "s", **SMALL)
                assert start["status"] == "ok"
                await ground.until(lambda: ground.state["state"] == "complete" and "mission_finished" in ground.types())
                stored = [event for event in ground.events if event["type"] == "photo_stored"]
                assert {event["source"] for event in stored} == {"gphoto2"}
                await ground.until(
                    lambda: (
                        len([event for event in ground.events if event["type"] == "photo_stored"])
                        >= ground.state["shots_total"]
                    )
                )
                process.send_signal(signal.SIGTERM)
                assert await process.wait() == 0
            assert ground.misfits == []
    mission = tmp_path / "data" / "missions" / start["data"]["mission_id"]
    manifest = json.loads((mission / "manifest.json").read_text())
    assert_every_photo_is_here(mission, manifest, card)
    assert untruths(mission, card / "truth.jsonl") == []
    # metered once, at the brightest row: no photo differs, and one more is in the camera
    settings = [photo["exif"] for attempt in accepted(manifest) for photo in attempt["photos"]]
    assert all(one == settings[0] for one in settings)
    assert settings[0]["white_balance"] == "manual"
    assert 0.001 <= settings[0]["exposure_s"] <= 0.004
    assert len(list(card.glob("*.jpg"))) > sum(shot["accepted_attempt"] is not None for shot in manifest["shots"])
    assert manifest["warnings"] == []
    assert list((tmp_path / "data" / "incoming").iterdir()) == []
