"""Missions on the embedded vehicle under its faults, over real UDP and MAVSDK.

`PANOEXEC_ALL_FAULTS=1` flies one mission for every fault of the simulator instead of a few.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink")

from panoexec.cli import dry_run
from panoexec.cli.app import parser_of
from panoexec.daemon.mission_request import settings_of
from panoexec.dryrun.run import DryRunOptions, DryRunSummary, resume_dry_run, run_dry_run
from panoexec.inputs.camera_profiles import configured_profile
from panoexec.inputs.config import Config
from panoexec.inputs.plan_options import configured_spec
from panoexec.mission.log.events import Event, MissionPaused, ShotAccepted
from panoexec.mission.log.states import MissionState
from panoexec.mission.settings import GuardSettings, MissionSettings
from panoexec.sim.config import AirframeConfig, CameraConfig, SimConfig
from panoexec.sim.faults import parse_fault
from tests.repository import ROOT
from tests.system.kind_missions import CONTENT_FAULT_ENDS, FAULT_ENDS, TOLERANCE, ring

SPEEDUP = 20.0
EVERY_FAULT = {**FAULT_ENDS, **CONTENT_FAULT_ENDS}


def _options(storage: Path, *faults: str, count: int = 8, images: bool = False, **simulation: Any) -> DryRunOptions:
    settings = MissionSettings(
        tolerance=TOLERANCE,
        exposure_s=0.01,
        interval_s=1.0,
        max_rate_deg_s=4.0,
        max_pause_s=15.0,
        guards=GuardSettings(allowed_modes=("OFFBOARD", "HOLD"), position_drift_m=20.0, attitude_silence_s=1.5),
    )
    config = SimConfig(
        speedup=SPEEDUP,
        faults=tuple(parse_fault(fault) for fault in faults),
        camera=CameraConfig(interval_s=1.0, render_width_px=160),
        airframe=AirframeConfig(wind_m_s=1.0),
    )
    return DryRunOptions(
        plan=ring(count=count),
        settings=settings,
        simulation=replace(config, **simulation),
        storage=storage,
        images=images,
    )


async def _fly(options: DryRunOptions) -> tuple[DryRunSummary, list[Event]]:
    events: list[Event] = []
    async with asyncio.timeout(300):
        return await run_dry_run(options, on_event=events.append), events


async def test_a_mission_survives_many_faults_at_once(tmp_path: Path) -> None:
    faults = ["photo-refused=#2", "capture-twice=#3", "link-loss=4+5", "control-stolen=16", "attitude-stop=24+4"]
    summary, events = await _fly(_options(tmp_path, *faults, count=12))
    assert summary.state == "complete"
    codes = {code for event in events if isinstance(event, MissionPaused) for code in event.code.split("+")}
    assert codes >= {"attitude", "gimbal_control"}
    assert Counter(event.shot for event in events if isinstance(event, ShotAccepted)) == dict.fromkeys(range(12), 1)


async def test_the_pilot_takes_over_and_the_mission_can_be_resumed_afterwards(tmp_path: Path) -> None:
    summary, events = await _fly(_options(tmp_path, "mode-change=3"))
    assert summary.state == "failed"
    assert "the pilot has taken over" in summary.reason
    assert any(event.type == "gimbal_released" for event in events)
    async with asyncio.timeout(300):
        summary = await resume_dry_run(summary.directory, simulation=lambda config: replace(config, faults=()))
    assert summary.state == "complete"


def _exposures(directory: Path) -> list[dict[str, Any]]:
    """What the camera really did: the simulator's truth."""
    lines = (directory / "images" / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    return [line for line in map(json.loads, lines) if line["event"] == "exposure"]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_no_photo_is_taken_without_a_gps_fix(tmp_path: Path, autopilot: str) -> None:
    start_s, lasts_s = 3.0, 5.0
    fault = f"gps-lost={start_s:g}+{lasts_s:g}"
    summary, events = await _fly(_options(tmp_path, fault, images=True, autopilot=autopilot))
    assert summary.state == "complete"
    # a machine that is too busy for the simulator silences the link, too, which is another hold of its own
    paused = [event for event in events if isinstance(event, MissionPaused) and event.code != "link"]
    assert [(event.code, event.automatic) for event in paused] == [("fix", True)]
    assert "no 3D fix" in paused[0].reason
    taken_s = [exposure["sim_s"] for exposure in _exposures(summary.directory)]
    command_s = taken_s[0] - 0.1  # the fault is counted from the first photo command
    blind = [t for t in taken_s if command_s + start_s + 0.6 < t < command_s + start_s + lasts_s]
    assert not blind, "a photo in flight may come 0.6 s after the loss at the latest"
    assert any(t > command_s + start_s + lasts_s for t in taken_s)


async def test_a_gps_that_stays_away_ends_in_the_failsafe_and_takes_no_more_photos(tmp_path: Path) -> None:
    summary, events = await _fly(_options(tmp_path, "gps-lost=3+60", images=True))
    assert summary.state == "failed"
    codes = [event.code for event in events if isinstance(event, MissionPaused) and event.code != "link"]
    assert codes[0] == "fix"
    assert "pilot" in codes[-1], "the estimator's failsafe lands: the gimbal is released"
    assert any(event.type == "gimbal_released" for event in events)
    taken_s = [exposure["sim_s"] for exposure in _exposures(summary.directory)]
    assert max(taken_s) < taken_s[0] + 3.6


@pytest.mark.parametrize("fault", ["rtl=2", "mode-change=2"])
async def test_a_dry_run_as_the_command_line_flies_it_stops_shooting_in_another_flight_mode(
    tmp_path: Path, fault: str
) -> None:
    band = ["--elevation", "-35", "-15", "--method", "paper"]
    arguments = [*band, "--speedup", "20", "--fault", fault, "--output", str(tmp_path)]
    options = dry_run._options(parser_of("dry-run", dry_run).parse_args(arguments))
    assert options.settings.guards == replace(
        settings_of(Config(), configured_spec(Config(), configured_profile(Config()))).guards,
        position_hold=True,  # a dry-run flies
        reclaim="ask",  # nobody could resume it
    )
    summary, events = await _fly(replace(options, settings=replace(options.settings, max_pause_s=10.0)))
    assert summary.state == "failed"
    assert "the pilot has taken over" in summary.reason
    released = next(event for event in events if event.type == "gimbal_released")
    assert not any(event.type == "gimbal_acquired" for event in events if event.seq > released.seq)
    taken_s = [exposure["sim_s"] for exposure in _exposures(summary.directory)]
    assert max(taken_s) < taken_s[0] + 2.0 + 1.5, "a photo in flight at most"


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_after_a_reboot_in_flight_the_mission_stays_paused(tmp_path: Path, autopilot: str) -> None:
    summary, events = await _fly(_options(tmp_path, "reboot=3", images=True, autopilot=autopilot))
    assert summary.state == "failed"
    assert "paused for" in summary.reason
    last = [event for event in events if isinstance(event, MissionPaused)][-1]
    # ArduPilot boots in STABILIZE, PX4 in Hold: there only the landed state tells
    assert ("pilot" if autopilot == "ardupilot" else "landed") in last.code.split("+")
    assert not last.automatic
    paused = next(event for event in events if isinstance(event, MissionPaused))
    assert not any(event.type in {"shot_started", "gimbal_acquired"} for event in events if event.seq > paused.seq)
    taken_s = [exposure["sim_s"] for exposure in _exposures(summary.directory)]
    assert max(taken_s) < taken_s[0] + 3.0 + 0.5


@pytest.mark.skipif(
    "PANOEXEC_ALL_FAULTS" not in os.environ, reason="PANOEXEC_ALL_FAULTS=1 flies all of them (2 to 4 min)"
)
@pytest.mark.parametrize("fault", EVERY_FAULT)
async def test_each_fault_ends_as_documented(tmp_path: Path, fault: str) -> None:
    summary, _ = await _fly(_options(tmp_path, fault))
    assert summary.state == EVERY_FAULT[fault]
    assert not summary.missing or summary.state == "failed"


def test_every_fault_of_the_simulator_is_flown() -> None:
    from panoexec.sim.faults import FAULTS  # noqa: PLC0415

    assert {fault.partition("=")[0] for fault in EVERY_FAULT} == set(FAULTS)


def test_the_documentation_has_each_fault_with_its_reaction_and_its_state() -> None:
    text = (ROOT / "docs" / "mission.md").read_text(encoding="utf-8")
    section = text[text.index("## Faults") : text.index("## Messages to the pilot")]
    ends: dict[str, set[str]] = {}
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if len(cells) != 5 or cells[1] in {"simulated by", "–"}:
            continue
        by_itself = cells[4].startswith(("by itself", "–"))
        for name in re.findall(r"`([a-z-]+)`", cells[1]):
            ends.setdefault(name, set()).add("complete" if by_itself else "failed")
            assert cells[3] in set(MissionState), line
    assert set(ends) == {fault.partition("=")[0] for fault in EVERY_FAULT}
    for fault, end in EVERY_FAULT.items():
        assert end in ends[fault.partition("=")[0]], fault
