"""Missions on a network with a forger: whatever it tells from ids of its own, nothing accepted is untrue.

`PANOEXEC_FORGED=200` flies that many missions, each with another seed; without it one. `PANOEXEC_FORGED_SEED` is the
first seed. A fourth as many, at least two, lose the gimbal, whose part a stranger plays.
"""

from __future__ import annotations

import json
import os
from functools import cache
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink")

from panoexec.dryrun import run as dry_run
from panoexec.dryrun.rigs import EmbeddedVehicle
from panoexec.dryrun.run import DryRunOptions, run_dry_run
from panoexec.inputs.camera_profiles import load_profile
from panoexec.mission.settings import MissionSettings
from panoexec.planning.make_plan import make_plan
from panoexec.planning.model import Band, Constraints, Plan, Timing, Tolerance
from panoexec.sim.config import CameraConfig, SimConfig
from panoexec.sim.faults import parse_fault
from tests.support.forger import SECRET, Forger, forged
from tests.support.truth import untruths

MISSIONS = int(os.environ.get("PANOEXEC_FORGED", "1"))
SILENCES = max(2, MISSIONS // 4)
FIRST_SEED = int(os.environ.get("PANOEXEC_FORGED_SEED", "1"))
TOLERANCE = Tolerance(pitch_deg=0.15, roll_deg=0.15, yaw_deg=0.7)


@cache
def sector() -> Plan:
    """The plan of every mission here."""
    camera = load_profile("dji-x5s-15mm").camera
    band = Band(elevation_min_deg=-30, elevation_max_deg=20, azimuth_min_deg=-50, azimuth_max_deg=50)
    constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=band, tolerance=TOLERANCE)
    return make_plan(camera, constraints, method="certified", timing=Timing(), order="fastest")


async def fly(storage: Path, forger: Forger, monkeypatch: pytest.MonkeyPatch, *faults: str, seed: int = 0) -> Any:
    """The manifest of a mission over a sector, and its directory."""
    plan = sector()
    options = DryRunOptions(
        plan=plan,
        settings=MissionSettings(tolerance=TOLERANCE, interval_s=1.0, exposure_s=0.01, max_pause_s=20.0),
        simulation=SimConfig(
            seed=seed,
            speedup=20.0,
            autopilot="px4" if seed % 4 == 3 else "ardupilot",
            camera=CameraConfig(optics=plan.camera, interval_s=1.0, render_width_px=64),
            faults=tuple(parse_fault(fault) for fault in faults),
        ),
        storage=storage,
    )
    monkeypatch.setattr(
        dry_run,
        "vehicle_under_test",
        lambda simulation, **_: forged(EmbeddedVehicle(simulation=simulation), forger),
    )
    summary = await run_dry_run(options, on_mission=lambda _: forger.speak_up())
    return summary, json.loads((summary.directory / "manifest.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("seed", range(FIRST_SEED, FIRST_SEED + MISSIONS))
async def test_no_mission_accepts_what_a_forger_tells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    forger = Forger(seed)
    summary, manifest = await fly(tmp_path, forger, monkeypatch, seed=seed)
    told = json.dumps(manifest)
    print(
        f"seed {seed}: {summary.state}, {summary.accepted}/{summary.shots}, {summary.attempts} attempts,",
        f"{sum(forger.sent.values())} forged messages; {summary.reason}",
    )
    assert untruths(summary.directory) == []
    assert SECRET.decode() not in told
    assert "hostname" not in told
    assert forger.heard > 0
    assert {"GIMBAL_DEVICE_ATTITUDE_STATUS", "CAMERA_IMAGE_CAPTURED", "COMMAND_ACK"} <= forger.sent.keys()
    assert summary.state == "complete", "and it is not kept from its end"


@pytest.mark.parametrize("seed", range(FIRST_SEED, FIRST_SEED + SILENCES))
async def test_a_stranger_is_not_taken_for_a_gimbal_that_falls_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """The gimbal loses power, while component 155 and others tell attitudes that are right at every target.

    With every other seed it comes back, and the mission is completed.
    """
    forger = Forger(seed, strangers=False)
    for_good = seed % 2 == 0
    span = f"{forger.random.uniform(0.1, 1.5):.1f}+{3600 if for_good else forger.random.uniform(2.0, 10.0):.1f}"
    faults = (f"attitude-stop={span}", f"gimbal-stuck={span}")
    summary, manifest = await fly(tmp_path, forger, monkeypatch, *faults, seed=seed)
    story = f"seed {seed}, gimbal silent {span}: {summary.state}, {summary.accepted}/{summary.shots}"
    print(f"{story}; {summary.reason}")
    assert untruths(summary.directory) == [], story
    assert (summary.state == "complete") != for_good, f"{story}; {summary.reason}"
    if for_good:
        assert summary.accepted < summary.shots, story
        missing = [shot for shot in manifest["shots"] if shot["status"] != "accepted"]
        assert len(missing) == summary.shots - summary.accepted, story
