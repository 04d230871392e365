"""What pages show of a real mission is what its manifest says, and the commands of a page fly it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import parse_fault
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.support.web import base, browser, web_server
from tests.system.daemon import SPEEDUP, serving
from tests.wire.broker import needs_mosquitto, running_broker

pytestmark = needs_mosquitto
BAND: dict[str, Any] = {"elevation_deg": [-40, 0], "name": "chapel, west"}
BAND_OF_PLAN = {name: value for name, value in BAND.items() if name != "name"}


async def test_a_page_flies_a_mission_and_shows_what_the_manifest_says(tmp_path: Path) -> None:
    port, photos = free_udp_port(), tmp_path / "photos"
    simulator = running_simulator(
        SimConfig(port=port, speedup=SPEEDUP, output=photos, faults=(parse_fault("photo-refused=#2"),))
    )
    more = f'[camera]\nfile_folders = ["{photos}"]\n'
    with running_broker(tmp_path) as broker:
        async with simulator, serving(tmp_path, broker, port, more=more), web_server(broker.port) as server:
            async with browser(server, follow="drone", name="TABLET-1") as page:
                ready = await page.until("state", lambda one: one["may"]["start"] == "")
                assert ready["may"]["pause"] == "no mission is under way"
                plan = (await page.command("plan-0001", "plan", **BAND_OF_PLAN, shots=True))["data"]
                started = await page.command("start-0001", "start", **BAND)
                assert started["data"]["images"] == len(plan["plan"]["shots"]) == plan["images"]
                mission_id = started["data"]["mission_id"]
                taken = await page.until("shot", lambda one: one["shot"]["accepted"] is not None)
                assert (await page.command("pause-0001", "pause", reason="look"))["stage"] == "done"
                paused = await page.until("state", lambda one: one["state"]["state"] == "paused")
                assert paused["may"]["resume"] == ""
                assert "by TABLET-1: look" in paused["state"]["reason"]
                assert (await page.command("repeat-001", "repeat", shot=taken["shot"]["i"]))["stage"] == "done"
                assert (await page.command("resume-001", "resume"))["stage"] == "done"
                total = paused["state"]["shots_total"]
                for shot in range(total):
                    await page.until(
                        "shot",
                        lambda one, shot=shot: one["shot"]["i"] == shot and one["shot"]["accepted"] is not None,  # type: ignore[misc]
                    )
                await page.until("state", lambda one: one["state"]["state"] == "complete")
                await page.until("event", lambda one: one["event"]["kind"] == "mission_finished")
                for shot in range(total):
                    await page.until("thumbnail", lambda one, shot=shot: one["shot"] == shot)  # type: ignore[misc]
            async with browser(server, follow="drone") as late:
                snapshot = late.of("vehicle")[0]
            folder = tmp_path / "data" / "missions" / mission_id
            compare(snapshot, json.loads((folder / "manifest.json").read_text(encoding="utf-8")))
            async with aiohttp.ClientSession() as session:
                for shot in snapshot["mission"]["shots"]:
                    async with session.get(base(server) + shot["url"]) as picture:
                        jpeg = await picture.read()
                    assert jpeg.startswith(b"\xff\xd8")
                    assert len(jpeg) <= 20_000


def compare(snapshot: dict[str, Any], manifest: dict[str, Any]) -> None:
    """Hold what a page shows to the manifest."""
    mission = snapshot["mission"]
    assert (mission["id"], mission["name"], mission["gap"]) == (manifest["mission_id"], manifest["name"], False)
    assert snapshot["state"]["shots_done"] == manifest["counts"]["shots_done"]
    assert len(snapshot["marks"]) == len(manifest["shots"]) == len(mission["shots"])
    retaken = 0
    for shown, written in zip(mission["shots"], manifest["shots"], strict=True):
        assert shown["i"] == written["index"]
        assert shown["q"] == pytest.approx(written["target"]["quaternion"], abs=1e-5)
        assert shown["accepted"] == written["accepted_attempt"]
        assert len(shown["attempts"]) == len(written["attempts"])
        retaken += len(shown["attempts"]) > 1
        for attempt, stored in zip(shown["attempts"], written["attempts"], strict=True):
            told = {name: attempt[name] for name in ("verdict", "code", "by")}
            assert told == {name: stored[name] or "" for name in told}
            if stored["measured"]:
                assert attempt["q"] == pytest.approx(stored["measured"]["quaternion"], abs=1e-5)
                errors = [stored["error_deg"][axis] for axis in ("pitch", "roll", "yaw")]
                assert attempt["error"] == pytest.approx(errors, abs=1e-3)
            if stored["verdict"] == "accepted":
                assert attempt["file"] == stored["file"]
            if stored["content"] is not None:
                shown_verdict = (attempt["content"] or {"verdict": "unchecked"})["verdict"]
                assert shown_verdict == stored["content"]["verdict"]
    assert retaken, "a shot was repeated"
