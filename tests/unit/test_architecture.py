"""docs/architecture.md draws the layers that `lint-imports` enforces, and names every package and real files."""

from __future__ import annotations

import re
import tomllib

from tests.repository import ROOT

TEXT = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
DECISIONS = ROOT / "docs" / "decisions"


def test_the_drawing_has_the_layers_of_the_import_contract() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = next(contract["layers"] for contract in settings["contracts"] if contract["type"] == "layers")
    drawing = re.search(r"^```text\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    assert drawing is not None
    drawn = [re.split(r" {3,}(?=\w)", line.strip())[0] for line in drawing[1].splitlines()]
    assert [sorted(re.findall(r"\w+", line)) for line in drawn] == [sorted(re.findall(r"\w+", line)) for line in layers]


def test_every_package_is_described() -> None:
    packages = {path.parent.name for path in (ROOT / "panoexec").glob("*/__init__.py")}
    described = set(re.findall(r"\*\*`panoexec/(\w+)`\*\*", TEXT))
    assert described == packages


def test_files_that_are_named_without_their_folder_are_there() -> None:
    names = {path.name for path in (ROOT / "panoexec").rglob("*.py")}
    for document in (ROOT / "docs" / "architecture.md", ROOT / "CONTRIBUTING.md", *DECISIONS.glob("*.md")):
        text = document.read_text(encoding="utf-8")
        for name in re.findall(r"`(?:[\w/]*/)?(\w+\.py)`", text):
            assert name in names or list((ROOT / "tests").rglob(name)), f"{document.name}: {name}"


def test_the_index_lists_every_decision() -> None:
    listed = set(re.findall(r"\]\(([\w-]+\.md)\)", (DECISIONS / "README.md").read_text(encoding="utf-8")))
    assert listed == {path.name for path in DECISIONS.glob("*.md")} - {"README.md"}
    for path in DECISIONS.glob("*.md"):
        if path.name != "README.md":
            text = path.read_text(encoding="utf-8")
            assert all(part in text for part in ("**Decision", "**Why", "**So do not**")), path.name
