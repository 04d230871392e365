"""What of a mission there is to stitch: brackets, missing photos, nothing at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from panoexec.stitching.mission import load_mission
from panoexec.stitching.tools import StitchError
from panoexec.store.directory import MissionDirectory
from tests.report_missions import edit, photographed


@pytest.fixture
def directory(tmp_path: Path) -> MissionDirectory:
    return photographed(tmp_path / "20260921T141300.000Z", width_px=32)


def bracketed(document: dict[str, Any]) -> None:
    """Three photos of each pose, the first one as it was."""
    for shot in document["shots"]:
        for attempt in shot["attempts"]:
            name = attempt["file"].removesuffix(".jpg")
            attempt["photos"] = [{"number": k, "file": f"{name}{'abc'[k - 1]}.jpg"} for k in (1, 2, 3)]


def test_of_a_bracket_the_first_photo_is_stitched(directory: MissionDirectory) -> None:
    for path in sorted(directory.images.iterdir()):
        for letter in "abc":
            (path.parent / f"{path.stem}{letter}.jpg").write_bytes(path.read_bytes())
        path.unlink()
    edit(directory, bracketed)
    mission = load_mission(directory.path)
    assert [image.file_name for image in mission.project.images] == [f"images/IMG_{k:04d}a.jpg" for k in range(7)]
    assert mission.left_out == {}
    (directory.images / "IMG_0004a.jpg").unlink()
    mission = load_mission(directory.path)
    assert mission.left_out == {"IMG_0004a.jpg": "is missing"}
    assert len(mission.project.images) == 6


def test_shots_without_an_accepted_photo_are_named(directory: MissionDirectory) -> None:
    edit(directory, lambda document: document["shots"][2].update(accepted_attempt=None))
    assert load_mission(directory.path).missing_shots == (2,)


def test_a_photo_of_another_size_is_left_out(directory: MissionDirectory, tmp_path: Path) -> None:
    other = photographed(tmp_path / "20260921T150000.000Z", width_px=48)
    (directory.images / "IMG_0001.jpg").write_bytes((other.images / "IMG_0001.jpg").read_bytes())
    assert load_mission(directory.path).left_out == {"images/IMG_0001.jpg": "is 48 x 36 px, the others 32 x 24 px"}


def test_nothing_to_stitch_is_said_with_what_would_help(directory: MissionDirectory) -> None:
    for path in directory.images.iterdir():
        path.unlink()
    with pytest.raises(StitchError, match=r"none of the 7 accepted photos is usable .* copy them from the camera"):
        load_mission(directory.path)
    edit(directory, lambda document: [shot.update(accepted_attempt=None) for shot in document["shots"]])
    with pytest.raises(StitchError, match="no accepted photo to stitch"):
        load_mission(directory.path)
