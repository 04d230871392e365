"""The bill of materials lists what a staged tree contains."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.repository import ROOT

WHEEL = """Metadata-Version: 2.4
Name: {name}
Version: {version}
{licence}
"""


def _installed(library: Path, name: str, version: str, licence: str) -> None:
    info = library / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(WHEEL.format(name=name, version=version, licence=licence))
    (info / "RECORD").write_text(f"{info.name}/METADATA,,\n{info.name}/RECORD,,\n")


def _sbom(tree: Path, output: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "packaging" / "sbom.py"), str(tree), "arm64", str(output)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_each_distribution_is_listed_with_version_and_licence(tmp_path: Path) -> None:
    library = tmp_path / "usr/lib/panoexec"
    _installed(library, "panoexec", "1.2.3", "License-Expression: Apache-2.0")
    _installed(library, "numpy", "2.4.6", "License-Expression: BSD-3-Clause AND MIT")
    _installed(library, "pyserial", "3.5", "License: BSD")
    viewer = library / "panoexec/report/assets/pannellum"
    viewer.mkdir(parents=True)
    (viewer / "VERSION").write_text("2.5.6\n")
    (viewer / "pannellum.js").write_text("// viewer\n")
    output = tmp_path / "panoexec.cdx.json"
    done = _sbom(tmp_path, output)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    bom = json.loads(output.read_text())
    assert (bom["bomFormat"], bom["specVersion"]) == ("CycloneDX", "1.6")
    root = bom["metadata"]["component"]
    assert (root["name"], root["version"], root["type"]) == ("panoexec", "1.2.3", "application")
    listed = {part["name"]: part for part in bom["components"]}
    assert {name: part["version"] for name, part in listed.items()} == {
        "numpy": "2.4.6", "pyserial": "3.5", "pannellum": "2.5.6",
    }  # fmt: skip
    assert listed["numpy"]["purl"] == "pkg:pypi/numpy@2.4.6"
    assert listed["numpy"]["licenses"] == [{"expression": "BSD-3-Clause AND MIT"}]
    assert listed["pyserial"]["licenses"] == [{"license": {"name": "BSD"}}]
    needs = next(entry for entry in bom["dependencies"] if entry["ref"] == root["bom-ref"])
    assert set(needs["dependsOn"]) == {part["bom-ref"] for part in bom["components"]}


def test_a_folder_that_is_no_staged_tree_is_refused(tmp_path: Path) -> None:
    done = _sbom(tmp_path, tmp_path / "out.json")
    assert done.returncode != 0
    assert "run packaging/stage first" in done.stderr
    assert not (tmp_path / "out.json").exists()
