"""`panoexec report`: where the page is, what is wrong with the photos, and the exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.store.directory import MissionDirectory
from tests.report_missions import edit, photographed


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MissionDirectory:
    monkeypatch.setattr("panoexec.report.panorama.QUICK_WIDTH_PX", 256)
    return photographed(tmp_path / "20260921T141300.000Z", width_px=64)


def test_says_where_the_page_is(directory: MissionDirectory, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["report", str(directory.path)]) == 0
    assert capsys.readouterr().out.strip() == str(directory.report)
    assert run(["report", str(directory.path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["photos"], document["problems"], document["panorama"]) == (7, [], "quick")


def test_missing_photos_end_with_1_and_advice(directory: MissionDirectory, capsys: pytest.CaptureFixture[str]) -> None:
    (directory.images / "IMG_0002.jpg").unlink()
    assert run(["report", str(directory.path)]) == 1
    err = capsys.readouterr().err
    assert "1 of 7 photos are still in the camera (shots 2)" in err
    assert f"panoexec import {directory.path} CARD" in err
    for path in directory.images.iterdir():
        path.unlink()
    assert run(["report", str(directory.path)]) == 1
    assert capsys.readouterr().err.count("still in the camera") == 1
    assert directory.report.exists()


def test_a_mission_without_an_accepted_photo_ends_with_1(
    directory: MissionDirectory, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(directory, lambda document: [shot.update(accepted_attempt=None) for shot in document["shots"]])
    assert run(["report", str(directory.path)]) == 1
    assert "no accepted photo" in capsys.readouterr().err
    assert directory.report.exists()


@pytest.mark.parametrize(
    ("content", "part"),
    [('{"format": "pano', "not JSON"), ("{}", "format: None found"), ("[]", "format: None found")],
)
def test_a_damaged_manifest_ends_with_2_and_one_line(
    directory: MissionDirectory, capsys: pytest.CaptureFixture[str], content: str, part: str
) -> None:
    directory.manifest.write_text(content, encoding="utf-8")
    assert run(["report", str(directory.path)]) == 2
    err = capsys.readouterr().err
    assert part in err
    assert len(err.strip().splitlines()) == 1


def test_no_mission(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["report", str(tmp_path)]) == 2
    assert "not a mission directory" in capsys.readouterr().err
