"""Short missions whose camera is panned by the vehicle, or proven by a count alone: processes, real UDP, real files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from panoexec.angles import rotation_from_quaternion, wrap_180
from panoexec.planning.geometry.pose_error import pose_error
from tests.system.dry_runs import accepted, flown, manifest_of

QUICK = ("--speedup", "10")
POSES = ((-10.0, 0.0), (-10.0, 40.0), (-45.0, 40.0))


def turned(output: Path, *arguments: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Summary and manifest of a complete mission over three poses."""
    plan = output / "plan.json"
    shots = [{"pitch_deg": pitch, "yaw_deg": yaw} for pitch, yaw in POSES]
    plan.write_text(json.dumps({"format": "panoexec.plan/1", "shots": shots}), encoding="utf-8")
    summary = flown("--plan", str(plan), *QUICK, *arguments, "--output", str(output))
    assert summary["shots"] == len(POSES)
    return summary, manifest_of(summary)


def test_a_two_axis_gimbal_is_panned_by_the_vehicle_and_the_gate_judges_the_sum(tmp_path: Path) -> None:
    summary, manifest = turned(tmp_path, "--yaw", "vehicle", "--image-width", "160")
    truth = (Path(summary["directory"]) / "images" / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    exposures = [event for event in map(json.loads, truth) if event["event"] == "exposure"]
    assert len(exposures) >= len(POSES)
    assert summary["turns"] == 2, "the last shot is above the second: nothing to turn"
    for photo in exposures:
        *_, (true_yaw, _, _) = photo["true_yaw_roll_pitch_deg"]
        nose = photo["vehicle_heading_deg"] - photo["heading_error_deg"]
        assert abs(float(wrap_180(true_yaw - nose))) < 0.2, "the camera looks along the nose"
    for attempt in accepted(manifest):
        measured = rotation_from_quaternion(np.array(attempt["measured"]["quaternion"]))
        error = pose_error(attempt["target"]["pitch_deg"], attempt["target"]["yaw_deg"], measured)
        assert abs(float(error.pitch_deg)) <= 0.1
        assert abs(float(error.yaw_deg)) <= 2.0


def test_a_servo_camera_is_proven_by_its_count(tmp_path: Path) -> None:
    """CAMERA_FEEDBACK is all that there is: no camera of its own, no message of a photo."""
    summary, manifest = turned(tmp_path, "--trigger", "servo", "--no-images")
    assert summary["evidence"] == {"counted": summary["shots"]}
    indices = [photo["image_index"] for attempt in accepted(manifest) for photo in attempt["photos"]]
    assert len(set(indices)) == summary["shots"]
