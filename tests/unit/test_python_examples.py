"""The examples of docs/python.md run and print what the document shows; the files of `examples` are good."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import panoexec
from tests.repository import ROOT

EXAMPLES = ROOT / "examples"
TEXT = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```\n+```text\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def test_every_example_shows_what_it_prints() -> None:
    assert len(BLOCKS) == TEXT.count("```python") == 3


@pytest.mark.parametrize(("code", "printed"), BLOCKS, ids=["plan", "camera", "mission"])
def test_examples_print_what_the_document_shows(
    code: str, printed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(EXAMPLES / "camera.toml", tmp_path)
    shutil.copytree(ROOT / "tests" / "data" / "recorded", tmp_path / "missions" / "20261130T063803.046Z")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/python.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out == printed


def test_the_plan_is_certified_and_of_this_version() -> None:
    path = EXAMPLES / "plan.json"
    assert panoexec.verify(path).certified
    plan = panoexec.plan("dji-x5s-15mm")
    loaded = panoexec.Plan.load(path)
    assert (loaded.shots, loaded.constraints, loaded.camera) == (plan.shots, plan.constraints, plan.camera)


def test_the_camera_profile_loads_and_explains_every_key() -> None:
    profile = panoexec.load_profile(str(EXAMPLES / "camera.toml"))
    assert profile.orientation == "landscape"
    text = (EXAMPLES / "camera.toml").read_text(encoding="utf-8")
    keys = set(re.findall(r"^(?:# )?(\w+) = ", text, re.MULTILINE))
    shipped = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "panoexec" / "profiles").glob("*.toml"))
    assert keys >= set(re.findall(r"^(\w+) = ", shipped, re.MULTILINE))
