"""`panoexec experiment` with Hugin's real tools on a small plan."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.experiment import running
from panoexec.planning.baselines.published import PAPER_TOLERANCE
from panoexec.planning.model import Constraints, Plan, Shot
from panoexec.sim.photos.scene import procedural_scene
from tests.missions import BAND, CAMERA, ring_poses

pytestmark = pytest.mark.skipif(
    shutil.which("nona") is None or shutil.which("cpfind") is None,
    reason="Hugin's tools are not installed: apt-get install hugin-tools",
)


def a_plan(scenario: int, plan: str) -> Plan:
    """Seven images that cover the band; six with a hole at the nadir for HDRpano."""
    rows = [(-35.0, 6)] if plan == "hdrpano" else [(-90.0, 1), (-35.0, 6)]
    constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=BAND, tolerance=PAPER_TOLERANCE)
    shots = tuple(
        Shot(index=index, row=row, pitch_deg=pitch, yaw_deg=yaw)
        for index, (row, pitch, yaw) in enumerate(ring_poses(rows))
    )
    return Plan(method="foreign", camera=CAMERA, constraints=constraints, shots=shots)


def test_holes_are_found_and_complete_plans_are_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(running, "plan_of", a_plan)
    monkeypatch.setattr(running, "_scene", lambda _: procedural_scene(1, 2048))
    arguments = ["experiment", "--scenario", "1", "--plans", "certified", "hdrpano", "--width", "300"]
    assert run([*arguments, "--output", str(tmp_path), "--json"]) == 0
    captured = capsys.readouterr()
    certified, hdrpano = json.loads(captured.out)["outcomes"]
    assert certified["completeness"] == 1.0
    assert certified["hole_px"] == certified["untied"] == 0
    # pointing errors of up to 0.667° are found to a fraction of a pixel (0.3°)
    assert certified["misalignment_deg"] < 0.09
    # one hole around the nadir, below the lowest edges of six images (-68.6°); its middle is that of its pixels
    assert hdrpano["hole_elevations_deg"] == pytest.approx([-79], abs=3)
    assert 0.5 < hdrpano["completeness"] < 0.95
    left = {path.name for path in (tmp_path / "scenario-1-certified-seed-1-run-1").iterdir()}
    assert "outcome.json" in left
    assert "images" not in left
    # nothing is done twice
    assert run([*arguments, "--output", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert captured.err.count("already done") == 2
    assert "100.00 %" in captured.out
