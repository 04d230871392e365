"""`cameras --new`, and the table of a profile's keys."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.inputs.camera_profiles import _ProfileModel, load_profile

ROOT = Path(__file__).resolve().parents[3]


def test_a_new_profile_explains_itself_and_is_never_written_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.toml"
    assert run(["cameras", "--new", str(path)]) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert load_profile(str(path)).camera.hfov_deg > 0
    path.write_text("# mine")
    assert run(["cameras", "--new", str(path)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert path.read_text() == "# mine"
    assert run(["cameras", "--new", str(tmp_path / "mine")]) == 2
    assert run(["cameras", "--new", str(tmp_path / "none" / "x.toml")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_every_key_is_in_the_table() -> None:
    rows = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs" / "cameras.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert rows == list(_ProfileModel.model_fields)
