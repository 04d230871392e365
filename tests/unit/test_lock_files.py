"""What the package ships is locked by version and hash, and the lock fits what pyproject.toml asks for."""

from __future__ import annotations

import re
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.repository import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = PROJECT["project"]["optional-dependencies"]
SHIPPED = [*PROJECT["project"]["dependencies"], *EXTRAS["vehicle"], *EXTRAS["service"], *EXTRAS["gphoto2"]]
BACKEND = PROJECT["build-system"]["requires"]
MANUAL = [requirement for requirement in EXTRAS["dev"] if requirement.startswith("shtab")]
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}")


def _locked(name: str) -> dict[str, list[tuple[Requirement, int]]]:
    """By package: what is locked (one entry a Python version where they differ) and the number of its hashes."""
    entries = re.split(r"\n(?=[A-Za-z0-9])", (ROOT / "packaging" / name).read_text())
    locked: dict[str, list[tuple[Requirement, int]]] = {}
    for entry in entries:
        requirement = Requirement(entry.split("\\")[0].strip())
        locked.setdefault(canonicalize_name(requirement.name), []).append((requirement, len(HASH.findall(entry))))
    return locked


@pytest.mark.parametrize("name", ["requirements.lock", "build.lock", "manual.lock"])
def test_each_entry_is_one_version_with_a_hash(name: str) -> None:
    for package, entries in _locked(name).items():
        for requirement, hashes in entries:
            assert [specifier.operator for specifier in requirement.specifier] == ["=="], package
            assert hashes >= 1, package


@pytest.mark.parametrize("name", ["requirements.lock", "build.lock", "manual.lock"])
def test_a_lock_names_no_index(name: str) -> None:
    text = (ROOT / "packaging" / name).read_text()
    assert "://" not in text
    assert "--index-url" not in text
    assert "--find-links" not in text


@pytest.mark.parametrize(
    ("name", "wanted"), [("requirements.lock", SHIPPED), ("build.lock", BACKEND), ("manual.lock", MANUAL)]
)
def test_what_is_asked_for_is_locked_in_its_range(name: str, wanted: list[str]) -> None:
    locked = _locked(name)
    for text in wanted:
        asked = Requirement(text)
        entries = locked[canonicalize_name(asked.name)]
        for requirement, _ in entries:
            version = next(iter(requirement.specifier)).version
            assert asked.specifier.contains(version), f"{text}: {version} is locked (make lock)"


@pytest.mark.parametrize(("name", "wanted"), [("build.in", BACKEND), ("manual.in", MANUAL)])
def test_what_builds_is_locked_as_it_is_asked_for(name: str, wanted: list[str]) -> None:
    lines = (ROOT / "packaging" / name).read_text().splitlines()
    assert [line for line in lines if line and not line.startswith("#")] == wanted
    assert wanted


def test_the_project_names_where_its_source_documents_and_issues_are() -> None:
    urls = PROJECT["project"]["urls"]
    assert urls.keys() >= {"Source", "Documentation", "Changelog", "Issues"}
    for url in urls.values():
        assert url.startswith(urls["Source"])
        _, _, inside = url.partition("/main/")
        assert (ROOT / inside).exists(), url
