"""The comparison of a manifest with the truth finds what is untrue, and only that."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.support.truth import untruths


def written(
    folder: Path,
    photos: list[dict[str, Any]],
    exposures: list[tuple[int, str, float]],
    *,
    heading_error_deg: float = 0.3,
) -> Path:
    """A mission with one accepted photo a shot, shot i aimed at yaw 10·i, and exposures (index, file, yaw)."""
    (folder / "images").mkdir()
    shots = [
        {
            "index": i,
            "accepted_attempt": 1,
            "target": {"pitch_deg": -20.0, "yaw_deg": 10.0 * i, "yaw_north_deg": 10.0 * i},
            "attempts": [{"number": 1, "started": f"2026-01-01T00:00:{i:02d}Z", "photos": [{"number": 1} | photo]}],
        }
        for i, photo in enumerate(photos)
    ]
    manifest = {"tolerance_deg": {"pitch": 0.1, "roll": 0.1, "yaw": 0.7}, "shots": shots}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    lines = [
        {
            "event": "exposure",
            "sim_s": float(number),
            "end_s": number + 0.01,
            "image_index": index,
            "file": file,
            "heading_error_deg": heading_error_deg,
            "true_yaw_roll_pitch_deg": [[yaw - heading_error_deg, 0.0, -20.0]] * 3,
        }
        for number, (index, file, yaw) in enumerate(exposures)
    ]
    text = "\n".join(json.dumps(line) for line in [{"event": "start"}, *lines])
    (folder / "images" / "truth.jsonl").write_text(text, encoding="utf-8")
    return folder


def named(index: int, file: str = "") -> dict[str, Any]:
    return {"image_index": index, "file": file}


def test_a_true_mission_has_no_untruths(tmp_path: Path) -> None:
    mission = written(tmp_path, [named(1), named(2, "images/b.jpg")], [(1, "a.jpg", 0.1), (2, "b.jpg", 10.6)])
    assert untruths(mission) == []


def test_a_photo_of_another_pose_is_untrue(tmp_path: Path) -> None:
    mission = written(tmp_path, [named(1), named(2)], [(1, "a.jpg", 0.0), (2, "b.jpg", 0.0)])
    (line,) = untruths(mission)
    assert line.startswith("shot 1, attempt 1, photo 1: photo 2 was exposed 9.")


def test_a_photo_must_exist_and_be_nobody_elses(tmp_path: Path) -> None:
    mission = written(tmp_path, [named(7), named(2), named(2)], [(2, "a.jpg", 10.0)])
    assert [line.split(": ", 1)[1] for line in untruths(mission)] == [
        "no exposure has the file '' or the index 7",
        "its photo is that of shot 1, attempt 1, photo 1",
    ]


def test_an_index_that_is_used_twice_means_the_exposure_that_fits(tmp_path: Path) -> None:
    mission = written(tmp_path, [named(1), named(1)], [(1, "a.jpg", 0.0), (1, "b.jpg", 10.0)])
    assert untruths(mission) == []


def test_a_counted_photo_needs_an_exposure_of_its_own(tmp_path: Path) -> None:
    mission = written(tmp_path, [named(-1), named(-1)], [(1, "a.jpg", 0.0), (2, "b.jpg", 90.0)])
    assert untruths(mission) == ["shot 1, attempt 1, photo 1: nothing was exposed at its pose"]
