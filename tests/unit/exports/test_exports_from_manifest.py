from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from panoexec.angles import quaternion_from_rotation, rotation
from panoexec.errors import InputFileError
from panoexec.exports import export_set, write_exports


def pose(yaw: float, pitch: float, roll: float = 0.0) -> dict[str, Any]:
    q = quaternion_from_rotation(rotation(yaw, pitch, roll)).tolist()
    return {"quaternion": q, "yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll}


def attempt(number: int, verdict: str, measured: dict[str, Any] | None, *files: str, second: int = 0) -> dict[str, Any]:
    stamp = f"2026-09-21T14:13:{second:02d}.000Z"
    photos = [
        {
            "number": k,
            "file": name,
            "capture_time": stamp,
            "latitude_deg": 47.5,
            "longitude_deg": 8.25,
            "altitude_m": None,
        }
        for k, name in enumerate(files, start=1)
    ]
    return {
        "number": number, "verdict": verdict, "measured": measured, "evidence": "file_seen", "capture_time": stamp,
        "error_deg": {"pitch": 0.01, "roll": 0.0, "yaw": -0.2, "across": 0.1}, "photos": photos,
        "file": files[0] if files else "",
    }  # fmt: skip


def manifest(*shots: dict[str, Any]) -> dict[str, Any]:
    document = {
        "format": "panoexec.manifest/1",
        "mission_id": "20260921T141300.000Z",
        "camera": {
            "name": "c", "sensor_width_mm": 17.3, "sensor_height_mm": 13.0, "image_width_px": 5280,
            "image_height_px": 3956, "focal_length_mm": 15.0, "hfov_deg": 59.9, "vfov_deg": 46.9,
        },
        "reference": {"kind": "heading", "yaw_north_deg": 33.0},
        "shots": list(shots),
    }  # fmt: skip
    return json.loads(json.dumps(document))  # type: ignore[no-any-return]


def shot(index: int, accepted: int | None, *attempts: dict[str, Any]) -> dict[str, Any]:
    return {
        "index": index, "row": 1, "target": pose(10.0 * index, -40.0), "accepted_attempt": accepted,
        "attempts": list(attempts),
    }  # fmt: skip


def test_the_accepted_attempts_in_the_order_taken(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    PIL.Image.new("RGB", (80, 60)).save(tmp_path / "images" / "b.jpg")
    document = manifest(
        shot(0, 1, attempt(1, "accepted", pose(0.4, -40.1, 0.2), "/DCIM/late.jpg", second=30)),
        shot(
            1, 2, attempt(1, "rejected", pose(15.0, -40.0), "a.jpg", second=10),
            attempt(2, "accepted", pose(10.2, -40.0), "images/b.jpg", second=20),
        ),
        shot(2, None, attempt(1, "rejected", None, "c.jpg", second=15)),
    )  # fmt: skip
    made = export_set(document, tmp_path)
    assert [s.index for s in made.shots] == [1, 0]
    first, second = made.shots
    assert first.file_name == "images/b.jpg"
    assert (first.width_px, first.height_px, first.orientation, first.attempt) == (80, 60, 1, 2)
    np.testing.assert_allclose(first.rotation, rotation(10.2, -40.0), atol=1e-9)
    assert first.errors_deg == {"pitch": 0.01, "roll": 0.0, "yaw": -0.2}
    assert second.file_name == "late.jpg"
    assert second.width_px == 0
    assert second.latitude_deg == 47.5
    assert made.reference_yaw_north_deg == 33.0
    assert "20260921T141300.000Z" in made.title
    names = {str(p.relative_to(tmp_path)) for p in write_exports(made, tmp_path)}
    assert {"panorama.pto", "papywizard.xml", "shots.csv", "images/b.xmp", "xmp/late.xmp"} <= names


def test_the_order_taken_does_not_depend_on_the_clock(tmp_path: Path) -> None:
    """It was set back by 20 s between two shots."""
    document = manifest(
        shot(0, 1, attempt(1, "accepted", pose(0.0, -40.0), "second.jpg", second=10) | {"seq": 9}),
        shot(1, 1, attempt(1, "accepted", pose(9.0, -40.0), "first.jpg", second=30) | {"seq": 4}),
        shot(2, None, attempt(1, "rejected", None, "none.jpg", second=5) | {"seq": 6}),
    )
    assert [s.file_name for s in export_set(document, tmp_path).shots] == ["first.jpg", "second.jpg"]


def test_brackets_are_photos_of_their_own_and_an_open_loop_pose_is_the_target(tmp_path: Path) -> None:
    made = export_set(manifest(shot(3, 1, attempt(1, "accepted", None, "a.jpg", "b.jpg"))), tmp_path)
    assert [(s.file_name, s.bracket, s.measured) for s in made.shots] == [("a.jpg", 1, False), ("b.jpg", 2, False)]
    np.testing.assert_allclose(made.shots[0].rotation, rotation(30.0, -40.0), atol=1e-9)


def test_an_accepted_shot_whose_photo_has_no_name(tmp_path: Path) -> None:
    made = export_set(manifest(shot(3, 1, attempt(1, "accepted", pose(1, 2)))), tmp_path)
    assert [(s.file_name, s.name) for s in made.shots] == [("", "shot_0003.jpg")]


@pytest.mark.parametrize("missing", ["shots", "camera"])
def test_a_damaged_manifest_is_named(tmp_path: Path, missing: str) -> None:
    document = manifest()
    del document[missing]
    with pytest.raises(InputFileError, match=rf"manifest\.json: is damaged or incomplete \(KeyError: '{missing}'\)"):
        export_set(document, tmp_path)
    with pytest.raises(InputFileError, match="damaged"):
        export_set(manifest(shot(0, 7)), tmp_path)
