"""Photos that share too little are bridged in flight, also after a kill; a bridge that fails ends as told."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("PIL")

from panoexec.dryrun.run import DryRunOptions, DryRunSummary, resume_dry_run, run_dry_run
from panoexec.mission.log.events import BridgePlanned, Event, Warned
from panoexec.mission.settings import MissionSettings
from panoexec.sim.config import CameraConfig, SimConfig
from panoexec.sim.faults import parse_fault
from tests.support.truth import untruths
from tests.unit.pictures.test_bridging import gap_plan


def options(storage: Path, *faults: str) -> DryRunOptions:
    plan = gap_plan()
    simulation = SimConfig(
        seed=3,
        speedup=8.0,
        faults=tuple(parse_fault(fault) for fault in faults),
        camera=CameraConfig(interval_s=1.0, render_width_px=480),
    )
    settings = MissionSettings(tolerance=plan.constraints.tolerance, exposure_s=0.01, pictures="retake")
    return DryRunOptions(plan=plan, settings=settings, simulation=simulation, storage=storage)


def manifest_of(summary: DryRunSummary) -> dict[str, Any]:
    text = (summary.directory / "manifest.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


async def test_a_bridge_ties_two_groups_although_the_process_was_stopped_before_it_flew(tmp_path: Path) -> None:
    told: list[Event] = []

    def look(event: Event) -> None:
        told.append(event)
        if isinstance(event, BridgePlanned):
            flight.cancel()  # here: a moment later it may have been flown

    flight = asyncio.create_task(run_dry_run(options(tmp_path), on_event=look))
    async with asyncio.timeout(300):
        with contextlib.suppress(asyncio.CancelledError):
            ended = await flight
            planned = [event for event in told if isinstance(event, BridgePlanned)]
            pytest.fail(f"not stopped: {ended.state}, {ended.reason!r}, planned {planned}, {told[-12:]}")
        (directory,) = (tmp_path / "missions").iterdir()
        events: list[Event] = []
        summary = await resume_dry_run(directory, on_event=events.append)
    assert summary.state == "complete", summary.reason
    assert not [event for event in events if isinstance(event, BridgePlanned)], "it was planned before"
    manifest = manifest_of(summary)
    assert [shot["bridge"] for shot in manifest["shots"]] == [None] * 4 + [[1, 2]]
    content = manifest["certificate"]["content"]
    assert content["connected"]
    assert content["bridge_shots"] == [{"shot": 4, "between": [1, 2], "ties": [1, 2]}]
    assert manifest["shots"][4]["accepted_attempt"]
    assert manifest["counts"]["shots_total"] == 5
    assert untruths(summary.directory) == []
    report = (summary.directory / "report.html").read_text(encoding="utf-8")
    assert '"bridge_shots"' in report


@pytest.mark.skipif(not os.environ.get("PANOEXEC_ALL_FAULTS"), reason="PANOEXEC_ALL_FAULTS is not set")
async def test_a_bridge_whose_photos_are_black_is_given_up_and_told(tmp_path: Path) -> None:
    events: list[Event] = []
    async with asyncio.timeout(300):
        summary = await run_dry_run(options(tmp_path, "photo-black=#5,#6,#7,#8"), on_event=events.append)
    assert summary.state == "complete"
    assert "bridge shots do not tie" in summary.reason
    assert "tied in 2 groups" in summary.reason
    assert summary.missing[0] == 4
    assert len([event for event in events if isinstance(event, BridgePlanned)]) <= 2
    assert any(isinstance(event, Warned) and event.code == "untied" for event in events)
    manifest = manifest_of(summary)
    assert manifest["shots"][4]["status"] == "missed"
    assert [attempt["code"] for attempt in manifest["shots"][4]["attempts"]] == ["exposure", "exposure"]
    assert manifest["certificate"]["content"]["groups"] == 2
    assert untruths(summary.directory) == []
