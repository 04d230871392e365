"""`calibrate` on a flown mission: the bias that the simulated gimbal has, and the lens, from the photos themselves."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("PIL")

from panoexec.cli.app import run
from panoexec.dryrun.run import DryRunOptions, run_dry_run
from panoexec.mission.settings import MissionSettings
from panoexec.sim.config import CameraConfig, GimbalConfig, SimConfig
from tests.unit.pictures.conftest import CAMERA, plan_of


@pytest.mark.skipif(not os.environ.get("PANOEXEC_CONTENT"), reason="PANOEXEC_CONTENT is not set")
async def test_the_bias_of_the_simulated_gimbal_and_its_lens(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_of({-28.0: 8, -60.0: 6})
    simulation = SimConfig(
        seed=4,
        speedup=10.0,
        gimbal=GimbalConfig(pitch_bias_deg=0.5, roll_bias_deg=-0.35),
        camera=CameraConfig(interval_s=1.0, render_width_px=480, optics=replace(CAMERA, focal_length_mm=15.15)),
    )
    settings = MissionSettings(tolerance=plan.constraints.tolerance, exposure_s=0.01, pictures="retake")
    summary = await run_dry_run(DryRunOptions(plan=plan, settings=settings, simulation=simulation, storage=tmp_path))
    assert summary.state == "complete"
    assert summary.rejected == {}, "nothing is contradicted"
    capsys.readouterr()
    assert run(["calibrate", str(summary.directory), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["axes"]["pitch"]["bias_deg"] == pytest.approx(0.5, abs=0.06)
    assert told["axes"]["roll"]["bias_deg"] == pytest.approx(-0.35, abs=0.06)
    assert told["axes"]["pitch"]["tolerance_deg"] > 0.5
    assert told["lens"]["calibrated_focal_length_mm"] == pytest.approx(15.15, abs=0.02)
    assert set(told["lens"]["distortion"]) == {"k1", "k2"}
    for photo in (summary.directory / "images").glob("*.jpg"):
        photo.unlink()
    assert run(["calibrate", str(summary.directory), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["lens"] is None
